"""What the parts of one pseudospectral observer share: its equations, its windowed problem, and what the solve is subject to."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from observers.model import Model
from observers.numerics import algebraic
from observers.numerics.equations import Equations
from observers.numerics.layout import Layout
from observers.pseudospectral.window.gauss_newton import Constraints
from observers.pseudospectral.window.problem import LeastSquares


@dataclass(frozen=True)
class Method:
    """An observer's structure: the model's equations with its inputs lifted, the windowed problem, and what the solve is subject to.

    `weighted`: the samples' weights are those of `tuning.measurement_noise`; `noise_given`: the user has said what it is.
    """

    model: Model
    equations: Equations
    lift: ca.Function
    problem: LeastSquares
    settings: Layout
    constraints: Constraints
    spline: bool
    arrival: bool
    weighted: bool
    noise_given: bool

    @property
    def samples(self) -> int:
        """L."""
        return self.problem.segment.samples * self.problem.count

    @cached_property
    def measure(self) -> ca.Function:
        """The outputs; one function, so that the generated code holds it once."""
        return algebraic.measurement(self.equations)

    @cached_property
    def path(self) -> ca.Function:
        """The path constraints of the model at (x, u, p, theta, t, z)."""
        eq = self.model.equations
        return ca.Function("path", [eq.x, eq.u, eq.p, eq.theta, eq.t, eq.z], [ca.densify(eq.constraint)])

    @property
    def sees_inputs(self) -> bool:
        """Whether an output depends on the inputs, itself or through the algebraic variables."""
        eq = self.equations
        through = ca.vertcat(eq.output, eq.algebraic) if ca.depends_on(eq.output, eq.z) else eq.output
        return bool(self.model.inputs) and bool(ca.depends_on(through, eq.u))
