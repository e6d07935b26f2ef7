"""Points of a model's region, at which a method's assumptions are checked when the observer is built."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from observers.model import Model, ModelError, Variable
from observers.numerics.rank import kernel, unobservable

POINTS = 64


@dataclass(frozen=True)
class Region:
    """`points`: (states and unknown parameters, inputs, parameters, time) each, as columns."""

    model: Model
    points: tuple[tuple[np.ndarray, np.ndarray, np.ndarray, float], ...]

    def describe(self, point: tuple[np.ndarray, np.ndarray, np.ndarray, float]) -> str:
        """`x1 = 0.3, ..., u = 1`."""
        states, inputs = (*self.model.states, *self.model.unknown_parameters), self.model.inputs
        named = [*zip(states, point[0], strict=True), *zip(inputs, point[1], strict=True)]
        return ", ".join(f"{v.name} = {value:.4g}" for v, value in named)

    def require_rank(self, method: str, what: str, matrix: ca.Function, rank: int) -> None:
        """Raise a ModelError that names the first point at which `matrix` (of x, u, p, t) has not `rank`."""
        for point in self.points:
            value = matrix(*point).full()
            found = value.shape[1] - len(kernel(value))
            if found < rank:
                raise ModelError(
                    f"{method}: {what} of model '{self.model.name}' has rank {found}, not {rank}, at {self.describe(point)}"
                )

    def require_detectable(self, method: str, what: str, pair: ca.Function, alpha: float) -> None:
        """Raise a ModelError where an eigenvalue of A that C does not show has no real part below -`alpha`; `pair` gives (A, C).

        No gain K moves such an eigenvalue of A - K C: an infinite alpha demands that there is none.
        """
        for point in self.points:
            A, C = (value.full() for value in pair(*point))
            hidden = unobservable(A, C)
            if len(hidden) == 0:
                continue
            slowest = max(
                np.linalg.eigvals(hidden @ A @ hidden.T), key=lambda eigenvalue: (eigenvalue.real, eigenvalue.imag)
            )
            if not slowest.real < -alpha:
                n = len(A)
                limit = f", which is not left of {0 - alpha:g}" if math.isfinite(alpha) else ""
                raise ModelError(
                    f"{method}: {what} of model '{self.model.name}' is not observable at {self.describe(point)}: its observability "
                    f"matrix has rank {n - len(hidden)}, not {n}, and no gain moves its eigenvalue {shown(slowest)}{limit}"
                )


def shown(eigenvalue: complex) -> str:
    """`-1 +- 2 i`, or `-1`."""
    return f"{eigenvalue.real:.4g}" + (f" +- {abs(eigenvalue.imag):.4g} i" if abs(eigenvalue.imag) > 1e-9 else "")


def region(model: Model) -> Region:
    """POINTS points of Halton's sequence between the bounds of states, unknown parameters and inputs.

    A variable without a bound reaches one `nominal` beyond its start value there. Parameters stand at their start values, time at 0.
    Points outside the domain of the model's functions (the root of a negative level) are left out.

    Raises:
        ModelError: no point is left.
    """
    from scipy.stats import qmc  # which takes a second to load, and nothing else here wants

    states = (*model.states, *model.unknown_parameters)
    box = np.array([_range(v) for v in (*states, *model.inputs)])
    # The sequence's first point is the corner; it is left out.
    unit = qmc.Halton(len(box), scramble=False).random(POINTS + 1)[1:]
    values = box[:, 0] + unit * (box[:, 1] - box[:, 0])
    p = np.array([v.start for v in model.parameters])
    points = tuple((row[: len(states)], row[len(states) :], p, 0.0) for row in values)
    inside = tuple(point for point, there in zip(points, _in_domain(model, points), strict=True) if there)
    if not inside:
        raise ModelError(
            f"canonical_dae: the equations of model '{model.name}' are not finite anywhere between its bounds, or within a nominal "
            f"value of its start values, for example at {Region(model, points).describe(points[0])}"
        )
    return Region(model, inside)


def _in_domain(model: Model, points: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, float]]) -> list[bool]:
    """Whether the equations and their first derivatives are finite at each point."""
    eq = model.equations
    x, none = ca.vertcat(eq.x, eq.theta), ca.DM.zeros(eq.w.numel())
    equations = ca.substitute(ca.vertcat(eq.ode, eq.output), eq.w, none)
    everything = ca.densify(ca.vertcat(equations, ca.vec(ca.jacobian(equations, x))))
    function = ca.Function("everything", [x, eq.u, eq.p, eq.t], [everything])
    return [bool(np.all(np.isfinite(function(*point).full()))) for point in points]


def _range(v: Variable) -> Sequence[float]:
    low = v.min if math.isfinite(v.min) else v.start - v.nominal
    high = v.max if math.isfinite(v.max) else v.start + v.nominal
    return low, max(low, high)
