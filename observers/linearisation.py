"""A model linearised along a trajectory, its unknown parameters as states that do not move."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from observers.model import Model, ModelError, Variable
from observers.numerics.semilinear import unreachable


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
    def measure(self) -> ca.Function:
        return self._function("measure", self.h)

    @property
    def gradient(self) -> ca.Function:
        return self._function("gradient", self.C)


def linearisation(model: Model, method: str) -> Linearisation:
    """The linearisation of `model` for `method`, which names it in messages.

    Raises:
        ModelError: a state or unknown parameter that no output can ever see.
    """
    eq = model.equations
    m = ca.vertcat(eq.x, eq.theta)
    variables = (*model.states, *model.unknown_parameters)
    unseen = unreachable(eq.ode, eq.output, m, eq.x)
    if unseen:
        names = ", ".join(variables[i].name for i in unseen)
        raise ModelError(f"{method}: model '{model.name}' is not observable: no output ever sees {names}")
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
