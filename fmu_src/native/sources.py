"""The C sources of an FMU: CasADi's functions, the component's tables, the shell and FMI's headers."""

from __future__ import annotations

import json
import math
import tempfile
from importlib.resources import files
from pathlib import Path

import casadi as ca

from fmu_src.errors import ExportError
from observers.component import Component, Port, bounds

FMI_HEADERS = ("fmi2FunctionTypes.h", "fmi2Functions.h", "fmi2TypesPlatform.h")

EXTERNAL = (
    "/* External functions */"  # CasADi's comment above the declarations of functions that are linked from elsewhere
)

# CasADi gives every function the same five arguments, whether it needs them or not.
_CASADI_WARNINGS = b"""\
#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
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
    return found | {name: (headers / name).read_bytes() for name in FMI_HEADERS}


def functions(component: Component) -> dict[str, bytes]:
    """`functions.c` and `functions.h`: start, flow, jump and output as CasADi writes them.

    Raises:
        ExportError: C that CasADi cannot write in full, or that would share memory between instances.
    """
    # 32-bit indices: no faster than CasADi's 64 bits, but the tables take half the space.
    generator = ca.CodeGenerator("functions", {"with_header": True, "with_export": False, "casadi_int": "int"})
    for function in component.functions.values():
        generator.add(function)
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(folder + "/")
        code = (Path(folder) / "functions.c").read_text()
        header = (Path(folder) / "functions.h").read_text()
    if "#error" in code or EXTERNAL in code:
        raise ExportError(_cannot_generate(component))
    if "CASADI_MAX_NUM_THREADS" in code:
        raise ExportError(
            f"component '{component.name}': a solver in it keeps its memory "
            "in static variables of the C code, which all instances would share"
        )
    return {"functions.c": _CASADI_WARNINGS + code.encode(), "functions.h": header.encode()}


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


def tables(component: Component, guid: str) -> dict[str, bytes]:
    """`component.c`: ports, sizes and clock for the shell. Value references: inputs, parameters, outputs, constants."""
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
    failures = [f"{{{json.dumps(failure.what)}, {json.dumps(failure.measure)}}}" for failure in component.failures]
    fields = {
        "name": json.dumps(component.name),
        "guid": json.dumps(guid),
        "variables": "variables",
        "n_inputs": len(component.inputs),
        "n_parameters": len(component.parameters),
        "n_outputs": len(component.outputs),
        "n_constants": len(component.constants),
        "n_states": component.n_z,
        "sample_time": "0.0" if isinstance(component.sample_time, str) else _real(component.sample_time),
        "sample_time_parameter": p_index[str(component.sample_time)] if named else -1,
        "samples_inputs": int(component.samples_inputs),
        "max_step": _real(component.max_step),
        "breaks": "breaks" if breaks else "NULL",
        "n_breaks": len(breaks),
        "counters": "counters" if counters else "NULL",
        "n_counters": len(counters),
        "failures": "failures" if component.failures else "NULL",
        "n_failures": len(component.failures),
        "start": "start",
        "flow": "flow",
        "jump": "jump" if component.jump is not None else "NULL",
        "output": "output",
        **{
            f"sz_{kind}": _largest([f"{f}_SZ_{kind.upper()}" for f in component.functions])
            for kind in ("arg", "res", "iw", "w")
        },
    }
    lines = [
        f"/* The tables of {component.name}, generated. */",
        "#include <math.h>",
        "",
        '#include "component.h"',
        '#include "functions.h"',
        "",
        "#define LARGER(a, b) ((a) > (b) ? (a) : (b))",
        "",
        "static const Variable variables[] = {",
        *[f"    {row}," for row in rows],
        "};",
        *([f"static const size_t breaks[] = {{{', '.join(map(str, breaks))}}};"] if breaks else []),
        *([f"static const size_t counters[] = {{{', '.join(map(str, counters))}}};"] if counters else []),
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
    return f"{{{json.dumps(port.name)}, {role}, {kind}, {_real(start)}, {_real(low)}, {_real(high)}}}"


def _real(value: float) -> str:
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))


def _largest(macros: list[str]) -> str:
    expression = macros[0]
    for macro in macros[1:]:
        expression = f"LARGER({macro}, {expression})"
    return expression
