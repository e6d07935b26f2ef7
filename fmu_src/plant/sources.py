"""The C that stands between CasADi's functions and a plant: its tables, and the library by which CasADi calls it in this process."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib.resources import files

import numpy as np

from fmu_src.native.sources import real, text
from fmu_src.plant.description import PlantDescription, Scalar
from fmu_src.plant.examine import Behaviour, Selection

FUNCTIONS = ("rate", "measure")

# CasADi asks a library for the sizes of a function's arguments; an FMU's own code knows them.
_INTERPRETER = """\
/* The plant {identifier} for CasADi in the process that builds, generated. */
#include <stdio.h>
#include <stdlib.h>

#include "plant.h"

static THREAD_LOCAL Plant *own;
static const char *folder; /* in which the folder `plant` lies */

__attribute__((visibility("default"))) void plant_lies_in(const char *path)
{{
    folder = path;
}}

static void ignore(void *listener, fmi2Status status, const char *text)
{{
    (void)listener;
    (void)status;
    (void)text;
}}

static bool ready(void)
{{
    char words[512] = "";
    const fmi2CallbackFunctions callbacks = {{NULL, calloc, free, NULL, NULL}};
    if (!own)
        own = plant_open(folder, plant_tables.identifier, &callbacks, false, ignore, NULL, words, sizeof words);
    if (!own)
        fprintf(stderr, "plant %s: %s\\n", plant_tables.identifier, words);
    plant_enter(own);
    return own != NULL;
}}
"""
_FUNCTION = """
__attribute__((visibility("default"))) int {name}(const double **arg, double **res, int *iw, double *w, int mem)
{{
    return ready() ? {ours}(arg, res, iw, w, mem) : 1;
}}
"""
_COUNT = '\n__attribute__((visibility("default"))) long long {name}(void)\n{{\n    return {count};\n}}\n'
_SPARSITY = """
__attribute__((visibility("default"))) const long long *{name}(long long i)
{{
    static const long long *const patterns[] = {{{patterns}}};
    return i < 0 || i >= {count} ? NULL : patterns[i];
}}
"""


def plant_sources() -> dict[str, bytes]:
    """Contents by file name of what is the same for every plant."""
    folder = files("fmu_src.native") / "plant"
    return {entry.name: entry.read_bytes() for entry in folder.iterdir() if entry.name.endswith((".c", ".h"))}


def plant_tables(plant: PlantDescription, chosen: Selection, behaviour: Behaviour) -> bytes:
    """`plant_tables.c`."""
    inputs, parameters = chosen.inputs, chosen.parameters
    nominals = [
        *behaviour.nominal,
        *(v.nominal or 1.0 for v in inputs),
        *(nominal(v, start) for v, start in zip(parameters, behaviour.parameters, strict=True)),
    ]
    arrays = {
        "driven": ("fmi2ValueReference", _references((*plant.states, *inputs))),
        "derivatives": ("fmi2ValueReference", _references(plant.derivatives)),
        "parameters": ("fmi2ValueReference", _references(parameters)),
        "outputs": ("fmi2ValueReference", _references(chosen.outputs)),
        "fixed": ("unsigned char", [str(int(v.variability == "fixed")) for v in parameters]),
        "starts": ("double", [real(value) for value in behaviour.parameters]),
        "nominals": ("double", [real(value) for value in nominals]),
    }
    fields = {
        "identifier": text(plant.identifier),
        "guid": text(plant.guid),
        "n_states": len(plant.states),
        "n_inputs": len(inputs),
        "n_known": len(chosen.known),
        "n_parameters": len(parameters),
        "n_outputs": len(chosen.outputs),
        **{name: name if values else "NULL" for name, (_, values) in arrays.items()},
        "directional_rate": int(behaviour.directional[0]),
        "directional_measure": int(behaviour.directional[1]),
    }
    lines = ["/* What the description of the plant says, generated. */", '#include "plant.h"', ""]
    lines += [f"static const {kind} {name}[] = {{{', '.join(v)}}};" for name, (kind, v) in arrays.items() if v]
    lines += ["", "const PlantTables plant_tables = {", *(f"    .{k} = {v}," for k, v in fields.items()), "};", ""]
    return "\n".join(lines).encode()


def interpreter(name: str, plant: PlantDescription, chosen: Selection, behaviour: Behaviour) -> bytes:
    """`interpreter.c`: the functions `<name>_rate` and `<name>_measure` as CasADi loads them, once `plant_lies_in` was told where."""
    sizes = [len(plant.states), len(chosen.inputs), len(chosen.known), len(chosen.unknown), 1]
    dense = np.ones
    parts = [_INTERPRETER.format(identifier=plant.identifier)]
    for what, pattern in (("rate", behaviour.rate), ("measure", behaviour.output)):
        n = pattern.shape[0]
        result = dense((n, 1))
        arguments = [dense((size, 1)) for size in sizes]
        blocks = [
            pattern[:, : sizes[0]],
            pattern[:, sizes[0] :],
            *(dense((n, size)) for size in sizes[2:]),
        ]
        ours = f"{name}_{what}"
        parts += _function(ours, f"plant_{what}", arguments, result)
        parts += _function(f"fwd1_{ours}", f"fwd1_plant_{what}", [*arguments, result, *arguments], result)
        parts += _patterns(f"jac_{ours}_sparsity_out", blocks)
    return "".join(parts).encode()


def nominal(v: Scalar, start: float) -> float:
    """A parameter's magnitude: as declared, or that of its value."""
    return v.nominal or abs(start) or 1.0


def _function(name: str, ours: str, arguments: Sequence[np.ndarray], result: np.ndarray) -> list[str]:
    return [
        _FUNCTION.format(name=name, ours=ours),
        _COUNT.format(name=f"{name}_n_in", count=len(arguments)),
        _COUNT.format(name=f"{name}_n_out", count=1),
        *_patterns(f"{name}_sparsity_in", arguments),
        *_patterns(f"{name}_sparsity_out", [result]),
    ]


def _patterns(name: str, patterns: Sequence[np.ndarray]) -> list[str]:
    """A function (i) -> sparsity pattern in CasADi's form: rows, columns, where each column begins, the row of each entry."""
    made = []
    for i, pattern in enumerate(patterns):
        rows, columns = pattern.shape
        entries = [np.flatnonzero(pattern[:, j]).tolist() for j in range(columns)]
        starts = np.cumsum([0, *(len(column) for column in entries)]).tolist()
        values = [rows, columns, *starts, *(row for column in entries for row in column)]
        made.append(f"\nstatic const long long {name}_{i}[] = {{{', '.join(map(str, values))}}};")
    names = ", ".join(f"{name}_{i}" for i in range(len(patterns)))
    return [*made, _SPARSITY.format(name=name, patterns=names, count=len(patterns))]


def _references(scalars: Iterable[Scalar]) -> list[str]:
    return [str(v.reference) for v in scalars]
