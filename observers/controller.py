"""A static controller: outputs that follow directly from inputs, u = k(x, p, t). `compose` takes its direct feedthrough away."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import casadi as ca

from observers.arguments import checked
from observers.component import Component, Port
from observers.expressions import evaluated
from observers.model import Names, Variable, column_of


@checked
def controller(
    name: str,
    *,
    inputs: Sequence[Variable],
    outputs: Sequence[Variable],
    law: Callable[[Any, Any, Any], Iterable[Any]],
    parameters: Sequence[Variable] = (),
    description: str = "",
    stop_time: float = 10.0,
    step_size: float = 0.01,
) -> Component:
    """The component with outputs u = law(x, p, t), written with names as a Model's equations are.

    Args:
        inputs: what it reads, x; `compose` finds each among the observer's estimates.
        outputs: what it puts out, u, one for each entry that `law` returns.
        law: `(x, p, t) -> [u_1, ...]`, t in s.
        parameters: p, tunable.
        stop_time, step_size: the default experiment [s].

    Raises:
        ModelError: `law` fails, knows a name that is none, or gives another number of scalars than there are outputs.
    """
    groups = {"input": inputs, "parameter": parameters}
    x, p = ({v.name: ca.SX.sym(v.name) for v in variables} for variables in groups.values())
    t, h, z = ca.SX.sym("t"), ca.SX.sym("h"), ca.SX(0, 1)
    where = f"controller '{name}'"
    values = evaluated(f"{where}, law", law, [Names("input", x), Names("parameter", p), t], "(x, p, t)")
    made = column_of(f"{where}, law", values, outputs)
    u, q = ca.vertcat(ca.SX(0, 1), *x.values()), ca.vertcat(ca.SX(0, 1), *p.values())
    return Component(
        name=name,
        description=description or f"static controller {name}",
        start=ca.Function("start", [q, t], [z]),
        flow=ca.Function("flow", [z, u, q, t, h], [z]),
        output=ca.Function("output", [z, u, q, t], [ca.densify(made)]),
        inputs=tuple(_port(v, "continuous") for v in inputs),
        parameters=tuple(_port(v, "tunable") for v in parameters),
        outputs=tuple(_port(v, "continuous") for v in outputs),
        stop_time=stop_time,
        step_size=step_size,
        documentation=(
            "<p>A static controller: its outputs follow its inputs at once (direct feedthrough). A master that does not exchange values "
            "in the order of the ModelStructure's dependencies delays it by one communication step.</p>"
        ),
    )


def _port(v: Variable, variability: str) -> Port:
    return Port(v.name, v.description, v.unit, v.start, v.nominal, v.min, v.max, variability=variability)
