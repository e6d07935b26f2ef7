"""Tables in a model's equations (`ca.interpolant`) whose values end at the grid: a B-spline is 0 beyond it, and says nothing."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import casadi as ca
import numpy as np

from observers.model import Model, ModelError, Variable
from observers.numerics.operations import calls

FAR = 1e9  # nominal values, of a variable without a bound


def refuse_tables_that_end(model: Model, method: str) -> None:
    """Raise a ModelError for a table that an estimate within the bounds of states and unknown parameters can leave.

    Looked at are the corners of the bounds, with everything else at its start value: there a monotonous argument is farthest out. Beyond
    its grid a B-spline and its derivative are 0; a linear interpolant goes on in its last slope, and is not refused.
    """
    eq = model.equations
    symbols = ca.vertcat(eq.x, eq.theta, eq.z, eq.u, eq.w, eq.p, eq.t)
    others = (*model.algebraic, *model.inputs, *model.unknown_disturbances, *model.parameters)
    estimated = (*model.states, *model.unknown_parameters)
    start = np.array([*(v.start for v in (*estimated, *others)), 0.0])
    for what, expressions, variables in (("ode", eq.ode, model.states), ("output", eq.output, model.outputs)):
        for expression, variable in zip(ca.vertsplit(expressions), variables, strict=True):
            for table, argument in _tables(expression):
                at = ca.Function("argument", [symbols], [argument])
                depends = ca.which_depends(argument, symbols[: len(estimated)], 1, False)
                for corner in _corners([v for v, does in zip(estimated, depends, strict=True) if does]):
                    point = [corner.get(v.name, start[i]) for i, v in enumerate(estimated)]
                    value = float(at(np.r_[point, start[len(estimated) :]]))
                    if float(table(value)) == 0 and float(table.jacobian()(value, 0)) == 0:
                        where = ", ".join(f"{name} = {number:g}" for name, number in corner.items())
                        raise ModelError(
                            f"{method}: model '{model.name}', {what} of '{variable.name}': the table '{table.name()}' is 0 beyond its "
                            f"grid, and its argument reaches {value:g} where {where}: bound these within the grid (min, max)"
                        )


def _corners(variables: list[Variable]) -> Iterator[dict[str, float]]:
    ends = [
        [
            v.min if math.isfinite(v.min) else v.start - FAR * v.nominal,
            v.max if math.isfinite(v.max) else v.start + FAR * v.nominal,
        ]
        for v in variables
    ]
    for corner in itertools.product(*ends):
        yield dict(zip((v.name for v in variables), corner, strict=True))


def _tables(expression: ca.SX) -> Iterator[tuple[ca.Function, ca.SX]]:
    """The tables of one argument that `expression` calls, each with its argument."""
    for function, node in calls(expression):
        if function.class_name() == "BSplineInterpolant" and node.n_dep() == 1:
            yield function, node.dep(0)
