"""A model linearised along a trajectory, its unknown parameters as states that do not move."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np

from observers.free_motion import FreeMotion, explicit_step, free_motion
from observers.model import Model, ModelError, Variable
from observers.numerics.algebraic import solution
from observers.numerics.runge_kutta import CLASSICAL_4, DORMAND_PRINCE_8, Tableau, stable_step
from observers.numerics.semilinear import split, unreachable

MOST_SUBSTEPS = 256  # of the longest step, for the sake of a bound
# Error of a step of the prediction, in units of a state's largest value or of its nominal value; the next sample corrects it.
PREDICTED = 1e-4
TABLEAUX = {tableau.order: tableau for tableau in (CLASSICAL_4, DORMAND_PRINCE_8)}


@dataclass(frozen=True)
class Linearisation:
    """f and h of a model over m = (x, theta), n entries, with their derivatives.

    `variables`: the n states and unknown parameters. Symbols `m` (n x 1), `u`, `p`, `t`; expressions `f` (n x 1), `h` (ny x 1),
    `A` = df/dm, `C` = dh/dm, `f_t` = df/dt. Functions of (m, u, p, t): `rate`, `rate_t`, `jacobian`, `measure`, `gradient` of the same.
    """

    variables: tuple[Variable, ...]
    m: ca.SX
    u: ca.SX
    p: ca.SX
    t: ca.SX
    f: ca.SX
    h: ca.SX
    A: ca.SX
    C: ca.SX
    f_t: ca.SX

    def _function(self, name: str, expression: ca.SX) -> ca.Function:
        return ca.Function(name, [self.m, self.u, self.p, self.t], [ca.densify(expression)])

    @property
    def rate(self) -> ca.Function:
        return self._function("rate", self.f)

    @property
    def rate_t(self) -> ca.Function:
        return self._function("rate_t", self.f_t)

    @property
    def jacobian(self) -> ca.Function:
        return self._function("jacobian", self.A)

    @property
    def sparse_jacobian(self) -> ca.Function:
        """`jacobian` without the entries that are always zero."""
        return ca.Function("sparse_jacobian", [self.m, self.u, self.p, self.t], [self.A])

    @property
    def measure(self) -> ca.Function:
        return self._function("measure", self.h)

    @property
    def gradient(self) -> ca.Function:
        return self._function("gradient", self.C)

    @property
    def sparse_gradient(self) -> ca.Function:
        """`gradient` without the entries that are always zero."""
        return ca.Function("sparse_gradient", [self.m, self.u, self.p, self.t], [self.C])


def unseen(model: Model) -> list[int]:
    """Indices, in (x, theta), of what no output ever sees, not even through other states."""
    eq = model.equations
    ode, output = eq.ode, eq.output
    if model.algebraic:
        z = solution(eq.algebraic, eq.z, ca.SX.sym("z0", eq.z.numel()))
        ode, output = ca.substitute([ode, output], [eq.z], [z])
    return unreachable(ode, output, ca.vertcat(eq.x, eq.theta), eq.x)


def refuse_unobservable(model: Model, method: str) -> None:
    """Raise a ModelError that names what no output of `model` ever sees, for `method`."""
    names = [[*model.states, *model.unknown_parameters][i].name for i in unseen(model)]
    if names:
        raise ModelError(f"{method}: model '{model.name}' is not observable: no output ever sees {', '.join(names)}")


def refuse_undetectable(model: Model, method: str) -> None:
    """Raise a ModelError that names what no output of `model` ever sees, unless it decays by itself at the start values."""
    hidden = unseen(model)
    if not hidden:
        return
    line = linearisation(model)
    start = [[v.start for v in group] for group in (line.variables, model.inputs, model.parameters)]
    slowest = float(np.linalg.eigvals(line.jacobian(*start, 0.0).full()[np.ix_(hidden, hidden)]).real.max())
    if slowest >= 0:
        names = ", ".join(line.variables[i].name for i in hidden)
        raise ModelError(
            f"{method}: model '{model.name}' is not detectable: no output ever sees {names}, "
            f"whose slowest mode has the rate {slowest:g} 1/s at the start values, not below 0"
        )


def prediction_step(
    model: Model, longest: float, tableau: Tableau = DORMAND_PRINCE_8, tolerance: float = PREDICTED
) -> float:
    """The longest step of the prediction [s]: `longest`, halved until an explicit method follows the model where it is looked at.

    It is stable at the start values, one state at a time at its bounds and a nominal value to either side, and in the constant linear part;
    stable and accurate along the motion from the start values, inputs held (`observers.free_motion`). A model that is fast elsewhere wants
    a smaller `longest`, and so does one whose bounds would want more than MOST_SUBSTEPS of them: no motion is meant to come there.
    """
    return _step(_modes(model), free_motion(model, longest), longest, tableau, tolerance)


def chosen_step(model: Model, moving: FreeMotion | None, longest: float, order: int) -> tuple[Tableau, float]:
    """The method of the prediction, of this order (4 or 8), and its longest step [s], at most `longest`, with an error of PREDICTED along
    the model's motion `moving`.

    Raises:
        ValueError: another order.
    """
    if order not in TABLEAUX:
        raise ValueError(f"order = {order!r} must be 4 or 8")
    return TABLEAUX[order], _step(_modes(model), moving, longest, TABLEAUX[order], PREDICTED)


def fastest_rate(model: Model) -> float:
    """The largest |eigenvalue| of the rates' Jacobian [1/s], at the start values and one state at a time a nominal value to either side."""
    return max(mode.rate for mode in _modes(model, bounds=False))


@dataclass(frozen=True)
class _Mode:
    """The largest |eigenvalue| of a Jacobian [1/s] and its norm; whether it is that of a point `around` the start values."""

    rate: float
    norm: float
    around: bool


def _step(modes: list[_Mode], moving: FreeMotion | None, longest: float, tableau: Tableau, tolerance: float) -> float:
    near = tableau.stable * MOST_SUBSTEPS
    rates = [mode.rate for mode in modes if not mode.around or mode.norm * longest < near]
    step = stable_step(rates, longest, tableau)
    return step if moving is None else explicit_step(moving, step, tableau, tolerance)


def _modes(model: Model, bounds: bool = True) -> list[_Mode]:
    """Of df/dx: of its constant entries; where there are no algebraic variables that at the start values, then around them.

    What is not finite is left out.
    """
    eq = model.equations
    constant = split(eq.ode, eq.x, ca.vertcat(eq.u, eq.w)).A
    found = [(constant, False)]
    if not model.algebraic:
        jacobian = ca.Function("jacobian", [eq.x, eq.u, eq.w, eq.p, eq.theta, eq.t], [ca.jacobian(eq.ode, eq.x)])
        groups = (model.inputs, model.unknown_disturbances, model.parameters, model.unknown_parameters)
        others = [np.array([v.start for v in group]) for group in groups]
        start = np.array([v.start for v in model.states])
        found.append((jacobian(start, *others, 0.0).full(), False))
        for i, v in enumerate(model.states):
            for value in (*((v.min, v.max) if bounds else ()), v.start - v.nominal, v.start + v.nominal):
                if v.min <= value <= v.max and math.isfinite(value):
                    point = np.where(np.arange(len(start)) == i, value, start)
                    found.append((jacobian(point, *others, 0.0).full(), True))
    return [
        _Mode(float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)), float(np.linalg.norm(A)), around)
        for A, around in found
        if np.all(np.isfinite(A))
    ]


def linearisation(model: Model) -> Linearisation:
    """The linearisation of `model`."""
    eq = model.equations
    m = ca.vertcat(eq.x, eq.theta)
    variables = (*model.states, *model.unknown_parameters)
    f = ca.vertcat(eq.ode, ca.SX.zeros(eq.theta.numel()))
    return Linearisation(
        variables=variables,
        m=m,
        u=eq.u,
        p=eq.p,
        t=eq.t,
        f=f,
        h=eq.output,
        A=ca.jacobian(f, m),
        C=ca.jacobian(eq.output, m),
        f_t=ca.jacobian(f, eq.t),
    )
