"""Known inputs that are linear between samples, for an observer that moves its estimate from sample to sample.

What the inputs do after t_k is not known before t_{k+1}: until then the estimate moves with those of t_k. At t_{k+1} that motion is
taken again, from what the sample at t_k left, with the inputs on the line between the two, and then the sample acts. So the innovation
compares the measurement with the model as it is declared; held, an input is half a sample late.
"""

from __future__ import annotations

import math
from dataclasses import replace

import casadi as ca

from observers.component import Component
from observers.model import Model
from observers.numerics.finite import finite, kept
from observers.numerics.layout import Layout


def with_linear_inputs(component: Component, model: Model, sample_time: float) -> Component:
    """The observer `component` of `model` for known inputs that the model declares linear between samples; itself where they are held.

    Its inputs are the model's outputs, then the known ones, as `ports.inputs` orders them. A sample time that is set to more than twice
    `sample_time` [s] would need more steps than are there if `max_step` is finite: the inputs are then held.
    """
    if not model.inputs or model.input_between_samples == "held":
        return component
    ny, nu, n_p = len(model.outputs), len(model.inputs), len(component.parameters)
    # The component's own state comes last: it may end with why its motion failed.
    state = Layout(sampled=component.n_z, inputs=nu, whole=1, parameters=n_p, elapsed=1, now=component.n_z)
    z, u, p = ca.MX.sym("z", state.total), ca.MX.sym("u", len(component.inputs)), ca.MX.sym("p", n_p)
    t, h = ca.MX.sym("t"), ca.MX.sym("h")
    s = state.unpack(z)
    first = component.start(p, t)
    begun = {
        "sampled": first,
        "inputs": ca.DM.zeros(nu),
        "whole": ca.DM(0),
        "parameters": p,
        "elapsed": ca.DM(0),
        "now": first,
    }
    flown = state.replace(z, now=component.flow(s.now, u, p, t, h), elapsed=s.elapsed + h)

    substeps = max(1, math.ceil(sample_time / component.max_step - 1e-6))
    known = u[ny : ny + nu]
    again = _motion(component, ny, nu, substeps)(s.sampled, s.inputs, known, s.parameters, t - s.elapsed, s.elapsed)
    whole = ca.sum1(finite(known)) == nu  # an input that is no number says nothing of what is between it and the next
    taken = ca.logic_and(
        ca.logic_and(s.whole, whole), ca.logic_and(s.elapsed > 0, s.elapsed / (2 * substeps) <= component.max_step)
    )
    assert component.jump is not None, f"{component.name} moves from sample to sample"
    after = component.jump(ca.if_else(taken, again, s.now), u, p, t)
    left = {"inputs": kept(known, 0), "whole": whole, "parameters": p, "elapsed": ca.DM(0)}
    jumped = state.pack({"sampled": after, **left, "now": after})
    return replace(
        component,
        start=ca.Function("start", [p, t], [ca.densify(state.pack(begun))]),
        flow=ca.Function("flow", [z, u, p, t, h], [flown]),
        jump=ca.Function("jump", [z, u, p, t], [ca.densify(jumped)]),
        output=ca.Function("output", [z, u, p, t], [component.output(s.now, u, p, t)]),
    )


def _motion(component: Component, ny: int, nu: int, substeps: int) -> ca.Function:
    """(z, inputs at the beginning, at the end, p, t, h) -> z after h from t, as `Instance` takes inputs that change over its substeps."""
    z, p = ca.MX.sym("z", component.n_z), ca.MX.sym("p", len(component.parameters))
    begin, end, t, h = ca.MX.sym("begin", nu), ca.MX.sym("end", nu), ca.MX.sym("t"), ca.MX.sym("h")
    unused = ca.MX.zeros(ny), ca.MX.zeros(len(component.inputs) - ny - nu)  # measurements act at samples only
    moved, part = z, h / (2 * substeps)
    for i in range(2 * substeps):
        place = (i // 2 + (1 / 6, 5 / 6)[i % 2]) / substeps
        u = ca.vertcat(unused[0], begin + place * (end - begin), unused[1])
        moved = component.flow(moved, u, p, t + i * part, part)
    return ca.Function("motion", [z, begin, end, p, t, h], [moved])
