"""The unscented Kalman filter's structure: what its state holds, its symbols, its sigma points.

Up to UNROLLED estimates every function is one expression of scalars. Beyond, it is made of loops over matrices, `loops`: C whose length
does not grow with the third power of n.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers import innovation_covariance, ports
from observers.bounds import bounded, projected
from observers.model import Model, Variable
from observers.numerics.layout import Layout
from observers.ukf import loops
from observers.vigilance import SETTINGS, Watch

UNROLLED = 8  # estimates up to which the algebra is one expression of scalars


@dataclass(frozen=True)
class Parts:
    """The filter's structure, and its symbols: state z, inputs u, parameters p, time t, step h; `s`, `q`, `read` are z, p, u by name.

    `looped`: the algebra is made of loops over matrices (MX), not of scalars (SX).
    """

    model: Model
    watch: Watch
    state: Layout
    z: Any
    u: Any
    p: Any
    t: Any
    h: Any
    s: SimpleNamespace
    q: SimpleNamespace
    read: ports.Inputs
    looped: bool

    @property
    def even(self) -> bool:
        """Whether the points that are drawn lie as far from their mean to either side: none is cut to a bound."""
        return self.looped and not bounded(self.variables)

    @property
    def variables(self) -> tuple[Variable, ...]:
        """What is estimated: states and unknown parameters."""
        return (*self.model.states, *self.model.unknown_parameters)

    @property
    def n(self) -> int:
        return len(self.variables)

    @property
    def n_points(self) -> int:
        return 2 * self.n + 1

    @property
    def points(self) -> Any:
        """The sigma points now, (n x n_points)."""
        return ca.reshape(self.s.points, self.n, self.n_points)

    @property
    def weights(self) -> Any:
        n, kappa = self.n, self.q.kappa
        return ca.vertcat(kappa / (n + kappa), ca.repmat(1 / (2 * (n + kappa)), 2 * n, 1))

    def around(self, mean: Any, watch: Any) -> Any:
        """The points of a mean that is as uncertain as the guess; `watch`, what the watch keeps."""
        return self.drawn(mean, self.first(watch))

    def first(self, watch: Any) -> Any:
        """The root of the guess's covariance."""
        return ca.diag(ca.sqrt(self.watch.again(watch)) * self.q.spread)

    def drawn(self, mean: Any, root: Any) -> Any:
        """The sigma points (n x n_points) of mean (n) and root (n x n), P = root root', within the bounds."""
        wide = ca.sqrt(self.n + self.q.kappa) * root
        center = ca.repmat(mean, 1, self.n)
        return projected(self.variables, ca.horzcat(mean, center + wide, center - wide))

    @property
    def mean(self) -> Any:
        """The estimate now (n): the mean of the points, and while they stand where they were drawn, what they were drawn around.

        Points that were cut to the bounds have another mean.
        """
        return ca.if_else(self.s.elapsed == 0, self.s.filtered, ca.mtimes(self.points, self.weights))

    def deviations(self, s: SimpleNamespace) -> Any:
        """The standard deviations (n) of the estimate in the state `s`, with the process noise since the last sample.

        The points take that in at the next sample only.
        """
        variances = self.variances(ca.reshape(s.points, self.n, self.n_points)) + self.q.noise**2 * s.elapsed
        return self.watch.deviations(s.watch, variances)

    def variances(self, points: Any) -> Any:
        """Those (n) of the points (n x n_points)."""
        return ca.mtimes(off_mean(points, self.weights) ** 2, self.weights)

    def each(self, body: Callable[..., Any], points: Any, *given: Any) -> Any:
        """body(x, *given) at each of the points (n x N), a column each."""
        if self.looped:
            return loops.each(body, points, *given)
        return ca.horzcat(*[body(points[:, i], *given) for i in range(points.shape[1])])

    def at(self, function: ca.Function) -> Callable[..., Any]:
        """`function` of the model's arguments as one of (x, known inputs, parameters, t), x (n) a point."""
        nx = len(self.model.states)

        def body(x: Any, known: Any, parameters: Any, time: Any) -> Any:
            part = Layout(x=nx, theta=self.n - nx).unpack(x)
            return function(part.x, part.theta, known, parameters, time)

        return body


def parts(model: Model, noise_known: bool) -> Parts:
    n, ny = len(model.states) + len(model.unknown_parameters), len(model.outputs)
    watch = Watch(model, n, known=noise_known)
    state = Layout(
        points=n * (2 * n + 1), elapsed=1, filtered=n, before=n, undoable=1, innovation=ny,
        covariance=innovation_covariance.size(ny), watch=watch.state.total, status=1, rejected=1, failures=1, restarts=1,
    )  # fmt: skip
    settings = Layout(
        guess=n, model=len(model.parameters), noise=n, sensor=ny, spread=n, kappa=1, **SETTINGS, sample_time=1,
    )  # fmt: skip
    looped = n > UNROLLED
    sym = ca.MX.sym if looped else ca.SX.sym
    z, u, p = sym("z", state.total), sym("u", ports.n_inputs(model)), sym("p", settings.total)
    t, h = sym("t"), sym("h")
    return Parts(model, watch, state, z, u, p, t, h, state.unpack(z), settings.unpack(p), ports.read(model, u), looped)


def off_mean(points: Any, weights: Any) -> Any:
    """The points (n x n_points) less their mean."""
    return points - ca.repmat(ca.mtimes(points, weights), 1, points.shape[1])
