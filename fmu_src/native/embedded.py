"""What a program without FMI needs of the component: a header of sizes and names, and an example that is compiled with functions.c.

They are in `sources/embedded/`, where no importer of the FMU looks for sources.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.resources import files

from fmu_src.native.sources import largest, real
from observers.component import Component, Port

_MODEL_H = """\
/* {name} without FMI, generated: sizes, places of the variables in their vectors, start values.

   {name}_start(p, t0) -> z, {name}_flow(z, u, p, t, h) -> z, {name}_jump(z, u, p, t) -> z where it samples,
   {name}_output(z, u, p, t) -> y. All take (arg, res, iw, w, 0) and return 0 unless they fail. */
#ifndef {name}_MODEL_H
#define {name}_MODEL_H

#include <float.h>

#include "../functions.h"

enum {{ {name}_N_Z = {n_z}, {name}_N_U = {n_u}, {name}_N_P = {n_p}, {name}_N_Y = {n_y} }};

/* Work space that the largest of the functions needs. */
#define {name}_LARGER(a, b) ((a) > (b) ? (a) : (b))
#define {name}_SZ_ARG {arg}
#define {name}_SZ_RES {res}
#define {name}_SZ_IW {iw}
#define {name}_SZ_W {w}
#define {name}_ROOM(n) {name}_LARGER(n, 1) /* of an array: none is empty in C */

/* The longest h of a flow [s], and the time from one call to the next [s]: the sample time, where there is one. */
#define {name}_MAX_STEP {max_step}
#define {name}_STEP(p) {step}
{groups}
#endif
"""


def embedded(component: Component) -> dict[str, bytes]:
    """`embedded/model.h` and `embedded/example.c`."""
    name = component.name
    work = {
        kind: largest([f"{name}_{f}_SZ_{kind.upper()}" for f in component.functions], f"{name}_LARGER")
        for kind in ("arg", "res", "iw", "w")
    }
    groups = {"u": component.inputs, "p": component.parameters, "y": component.outputs}
    header = _MODEL_H.format(
        name=name,
        n_z=component.n_z,
        **{f"n_{group}": len(ports) for group, ports in groups.items()},
        **work,
        max_step=real(component.max_step),
        step=_step(component),
        groups="".join(_group(name, group, ports) for group, ports in groups.items()),
    )
    example = (files("fmu_src.native") / "templates" / "example.c").read_text()
    # MODEL stands alone in the first sentence, and begins names elsewhere.
    return {
        "embedded/model.h": header.encode(),
        "embedded/example.c": re.sub(r"\bMODEL(?=_|\b)", name, example).encode(),
    }


def _step(component: Component) -> str:
    if not isinstance(component.sample_time, str):
        return real(component.sample_time or component.step_size)
    place = [port.name for port in component.parameters].index(component.sample_time)
    return f"((p)[{place}] > 0 ? (p)[{place}] : {real(component.step_size)})"


def _group(name: str, group: str, ports: Sequence[Port]) -> str:
    """The places of a vector's variables, and their start values unless they are outputs."""
    what = {"u": "Inputs", "p": "Parameters", "y": "Outputs"}[group]
    lines = ["", f"/* {what}. */"]
    if ports:
        lines.append("enum {")
        lines += [
            f"    {place}, /* {_comment(port)} */"
            for place, port in zip(_places(name, group, ports), ports, strict=True)
        ]
        lines.append("};")
    if group != "y":
        values = ", ".join(real(port.start) for port in ports) or "0"
        lines.append(f"static const casadi_real {name}_{group}_start[] = {{{values}}};")
    return "\n".join(lines) + "\n"


def _places(name: str, group: str, ports: Sequence[Port]) -> list[str]:
    """Identifiers made of the variables' names; where two become one, or one that of the start values, a number tells them apart."""
    taken = {f"{name}_{group}_start"}
    made: list[str] = []
    for port in ports:
        plain = f"{name}_{group}_" + re.sub(r"\W+", "_", port.name).strip("_")
        number = 2
        place = plain
        while place in taken:
            place, number = f"{plain}_{number}", number + 1
        taken.add(place)
        made.append(place)
    return made


def _comment(port: Port) -> str:
    unit = f" [{port.unit}]" if port.kind == "Real" and port.unit not in ("", "1") else ""
    text = f"{port.name}{unit}: {port.description}" if port.description else f"{port.name}{unit}"
    return text.replace("*/", "* /").replace("/*", "/ *")
