"""The C sources of an FMU: CasADi's functions, the component's tables, the shell and FMI's headers.

Every name that the linker sees begins with the model's identifier, so that the sources of several FMUs fit into one program.
"""

from __future__ import annotations

import json
import math
import re
import tempfile
from importlib.resources import files
from pathlib import Path

import casadi as ca

from fmu_src.errors import ExportError
from fmu_src.native.products import with_fast_products
from observers.component import Component, Port, bounds

FMI_HEADERS = ("fmi2FunctionTypes.h", "fmi2Functions.h", "fmi2TypesPlatform.h")

EXTERNAL = (
    "/* External functions */"  # CasADi's comment above the declarations of functions that are linked from elsewhere
)

PLANT_CALLS = ("plant_open", "plant_begin", "plant_enter", "plant_words", "plant_close")  # in the order of component.h

# CasADi gives every function the same five arguments, whether it needs them or not, and leaves addresses of what was local
# in arrays that nobody reads again. From its loops that run once gcc concludes that a variable may never be set, from its checks for
# null pointers that its work space may begin at address 0. Its code comes after the system's header, whose functions are not ours
# to hide.
_CASADI_HEAD = """\
#include <math.h>

#include "prefix.h"

#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
#if defined __GNUC__ && !defined __clang__
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#pragma GCC diagnostic ignored "-Warray-bounds"
#endif
#if defined __GNUC__ && !defined __clang__ && __GNUC__ >= 7
#pragma GCC diagnostic ignored "-Wstringop-overflow"
#endif
#if defined __GNUC__ && !defined __clang__ && __GNUC__ >= 12
#pragma GCC diagnostic ignored "-Wdangling-pointer"
#endif
/* Bounds in CasADi's tables. tcc folds what overflows, but no operation on an infinity: -INFINITY is no constant to it, and in
   parentheses neither is this. */
#if defined __TINYC__
#include <float.h>
#define casadi_inf DBL_MAX * 10
#endif
BEGIN_INTERNAL
"""
_CASADI_TAIL = "END_INTERNAL\n"
# CasADi's comments that print a constant matrix, which is in a table already: of 32 states half a megabyte.
_CONSTANT = re.compile(r"^  /\* #\d+: @\d+ = \n(?:(?!\*/).*\n)*?.*\*/\n", re.MULTILINE)

# In fmpy's copy of the standard's header: the part that it says to have changed, "to add no prefix".
_UNPREFIXED = re.compile(r"/\*\s*Export FMI2 API functions.*?#define fmi2FullName\(name\) name\n", re.S)
# What the header of FMI 2.0.4 says there.
_PREFIXED = """\
/* Allow override of FMI2_FUNCTION_PREFIX: if FMI2_OVERRIDE_FUNCTION_PREFIX is defined, then there is no prefix. */
#if !defined(FMI2_OVERRIDE_FUNCTION_PREFIX) && defined(FMI2_FUNCTION_PREFIX)
  #define fmi2Paste(a,b)     a ## b
  #define fmi2PasteB(a,b)    fmi2Paste(a,b)
  #define fmi2FullName(name) fmi2PasteB(FMI2_FUNCTION_PREFIX, name)
  #if !defined(FMI2_Export)
    #define FMI2_Export
  #endif
#else
  #define fmi2FullName(name) name
#endif

/* Export FMI2 API functions on Windows and under GCC, where they have no prefix. */
#if !defined(FMI2_Export)
  #if defined _WIN32 || defined __CYGWIN__
    #define FMI2_Export __declspec(dllexport)
  #elif __GNUC__ >= 4
    #define FMI2_Export __attribute__ ((visibility ("default")))
  #else
    #define FMI2_Export
  #endif
#endif
"""

_PREFIX = """\
/* Names of {name}, generated, and what every file of these sources must know of its compiler. */
#ifndef PREFIX_H
#define PREFIX_H

#define PREFIX(name) {name}_##name

/* Between these: functions that a shared library keeps to itself. */
#if defined __GNUC__ && !defined _WIN32 && !defined __TINYC__
#define BEGIN_INTERNAL _Pragma("GCC visibility push(hidden)")
#define END_INTERNAL _Pragma("GCC visibility pop")
#else
#define BEGIN_INTERNAL
#define END_INTERNAL
#endif

/* A missing measurement is a NaN, and what is not finite must be seen. */
#if (defined __FINITE_MATH_ONLY__ && __FINITE_MATH_ONLY__) || defined _M_FP_FAST
#error "{name} needs NaN and infinity: compile it without -ffast-math, -ffinite-math-only, /fp:fast"
#endif

#endif
"""


def fixed_sources() -> dict[str, bytes]:
    """Contents by file name of what is the same in every FMU: the shell, and FMI's headers from the fmpy package."""
    found = {
        entry.name: entry.read_bytes()
        for entry in (files("fmu_src.native") / "shell").iterdir()
        if entry.name.endswith((".c", ".h"))
    }
    headers = files("fmpy") / "c-code"
    found |= {name: (headers / name).read_bytes() for name in FMI_HEADERS}
    functions_h, changed = _UNPREFIXED.subn(lambda _: _PREFIXED, found["fmi2Functions.h"].decode())
    if changed != 1:
        raise ExportError("fmi2Functions.h of the fmpy package is another than expected: its macro fmi2FullName")
    return found | {"fmi2Functions.h": functions_h.encode()}


def prefix(component: Component) -> dict[str, bytes]:
    """`prefix.h`, which every other file includes."""
    return {"prefix.h": _PREFIX.format(name=component.name).encode()}


def functions(component: Component, plant: str = "") -> dict[str, bytes]:
    """`functions.c` and `functions.h`: <name>_start, <name>_flow, <name>_jump and <name>_output as CasADi writes them.

    They may call external functions of the name `plant`, as <name>_plant_rate and the like.

    Raises:
        ExportError: C that CasADi cannot write in full, or that would share memory between instances.
    """
    # 32-bit indices: no faster than CasADi's 64 bits, but the tables take half the space.
    # The generator's name is the prefix of its internal names.
    name = f"{component.name}_functions"
    generator = ca.CodeGenerator(name, {"with_header": True, "with_export": False, "casadi_int": "int"})
    for function in component.functions.values():
        generator.add(function)
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(folder + "/")
        code = (Path(folder) / f"{name}.c").read_text()
        header = (Path(folder) / f"{name}.h").read_text()
    if "#error" in code or (EXTERNAL in code and not plant):
        raise ExportError(_cannot_generate(component))
    if "[CASADI_MAX_NUM_THREADS]" in code:
        raise ExportError(
            f"component '{component.name}': a solver in it keeps its memory "
            "in static variables of the C code, which all instances would share"
        )
    # CasADi has no option to name a function otherwise in C: its definition, its calls, and what belongs to it, such as start_SZ_W.
    ours = re.compile(rf"\b({'|'.join(component.functions)})(?=(_[A-Za-z_]+)?\(|_SZ_)")
    code, header = (ours.sub(rf"{component.name}_\1", text) for text in (code, header))
    if plant:
        code = re.sub(rf"\b(fwd1_)?{plant}_", rf"{component.name}_\1plant_", code)
    code = with_fast_products(_CONSTANT.sub("", code))
    return {"functions.c": (_CASADI_HEAD + code + _CASADI_TAIL).encode(), "functions.h": header.encode()}


def _cannot_generate(component: Component) -> str:
    """Which of the functions holds a node that CasADi has no C for, and CasADi's words for it."""
    for name, function in component.functions.items():
        generator = ca.CodeGenerator(name)
        generator.add(function)
        reasons = [
            line.strip().removeprefix("#error ")
            for line in generator.dump().splitlines()
            if line.strip().startswith("#error")
        ]
        if EXTERNAL in generator.dump():
            reasons.append("it calls an external function, whose code is not in it")
        if reasons:
            return (
                f"component '{component.name}': CasADi cannot write C for the function '{name}': {'; '.join(reasons)}"
            )
    return f"component '{component.name}': CasADi cannot write C for the functions together"


def tables(component: Component, guid: str, plant: bool = False) -> dict[str, bytes]:
    """`component.c`: ports, sizes and clock for the shell. Value references: inputs, parameters, outputs, constants.

    With a `plant` the component's functions call one, whose C is beside.
    """
    rows = []
    for port in component.inputs:
        rows.append(_variable(port, "INPUT"))
    for port in component.parameters:
        rows.append(_variable(port, "FIXED_PARAMETER" if port.variability == "fixed" else "TUNABLE_PARAMETER"))
    for port in component.outputs:
        rows.append(_variable(port, "OUTPUT"))
    for port in component.constants:
        rows.append(_variable(port, "CONSTANT"))
    p_index = {port.name: i for i, port in enumerate(component.parameters)}
    y_index = {port.name: i for i, port in enumerate(component.outputs)}
    named = isinstance(component.sample_time, str)
    breaks = [p_index[name] for name in component.breaks]
    counters = [y_index[name] for name in component.counters]
    failures = [f"{{{text(failure.what)}, {text(failure.measure)}}}" for failure in component.failures]
    fields = {
        "name": json.dumps(component.name),
        "guid": json.dumps(guid),
        "variables": "variables",
        "n_inputs": len(component.inputs),
        "n_parameters": len(component.parameters),
        "n_outputs": len(component.outputs),
        "n_constants": len(component.constants),
        "n_states": component.n_z,
        "sample_time": "0.0" if isinstance(component.sample_time, str) else real(component.sample_time),
        "sample_time_parameter": p_index[str(component.sample_time)] if named else -1,
        "samples_inputs": int(component.samples_inputs),
        "max_step": real(component.max_step),
        "breaks": "breaks" if breaks else "NULL",
        "n_breaks": len(breaks),
        "counters": "counters" if counters else "NULL",
        "n_counters": len(counters),
        "failures": "failures" if component.failures else "NULL",
        "n_failures": len(component.failures),
        "plant": "&plant_calls" if plant else "NULL",
        "start": f"{component.name}_start",
        "flow": f"{component.name}_flow",
        "jump": f"{component.name}_jump" if component.jump is not None else "NULL",
        "output": f"{component.name}_output",
        **{
            f"sz_{kind}": largest([f"{component.name}_{f}_SZ_{kind.upper()}" for f in component.functions])
            for kind in ("arg", "res", "iw", "w")
        },
    }
    lines = [
        f"/* The tables of {component.name}, generated. */",
        "#include <float.h>",
        "",
        '#include "component.h"',
        '#include "functions.h"',
        *(['#include "plant.h"'] if plant else []),
        "",
        "#define LARGER(a, b) ((a) > (b) ? (a) : (b))",
        "",
        "static const Variable variables[] = {",
        *[f"    {row}," for row in rows],
        "};",
        *([f"static const size_t breaks[] = {{{', '.join(map(str, breaks))}}};"] if breaks else []),
        *([f"static const size_t counters[] = {{{', '.join(map(str, counters))}}};"] if counters else []),
        *([f"static const PlantCalls plant_calls = {{{', '.join(PLANT_CALLS)}}};"] if plant else []),
        *([f"static const Failure failures[] = {{{', '.join(failures)}}};"] if failures else []),
        "",
        "const Component component = {",
        *[f"    .{name} = {value}," for name, value in fields.items()],
        "};",
        "",
    ]
    return {"component.c": "\n".join(lines).encode()}


def _variable(port: Port, role: str) -> str:
    kind = {"Real": "REAL", "Boolean": "BOOLEAN"}.get(port.kind, "INTEGER")
    start = 0.0 if role == "OUTPUT" else port.start
    low, high = bounds(port)
    return f"{{{json.dumps(port.name)}, {role}, {kind}, {real(start)}, {real(low)}, {real(high)}}}"


def text(value: str) -> str:
    """A string of C in UTF-8: what is no plain ASCII, and what begins an escape or a trigraph, is escaped byte by byte."""
    return '"' + "".join(chr(b) if 32 <= b < 127 and b not in b'"\\?' else f"\\{b:03o}" for b in value.encode()) + '"'


def real(value: float) -> str:
    """A constant of C. INFINITY is none for every compiler; no bound, or no limit of a step, is one that nothing finite exceeds."""
    if math.isinf(value):
        return "DBL_MAX" if value > 0 else "-DBL_MAX"
    return repr(float(value))


def largest(macros: list[str], larger: str = "LARGER") -> str:
    """The expression for the largest of the macros; `larger` is the macro that compares two."""
    expression = macros[0]
    for macro in macros[1:]:
        expression = f"{larger}({macro}, {expression})"
    return expression
