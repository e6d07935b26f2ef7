"""What one would use instead of the observer: the same problem, solved at each sample by CasADi's nlpsol with IPOPT.

The collocation at nodes 1..N, the cost at the sample instants, the unknown parameters and the warm start are the
observer's (`observers/pseudospectral.py`). Unlike it, IPOPT starts with the first full window.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter_ns
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.errors import BenchmarkError
from observers.model import Model
from observers.numerics.runge_kutta import CLASSICAL_4, runge_kutta
from observers.pseudospectral.window import lgl

# Warm start from the previous solution and its multipliers; what nobody reads is not computed. Each makes it faster.
OPTIONS: dict[str, Any] = {
    "print_time": False,
    "calc_lam_x": False,
    "calc_lam_p": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-8,
    "ipopt.warm_start_init_point": "yes",
}


@dataclass(frozen=True)
class Estimator:
    """The solver and what it needs between two samples.

    `solver`: unknowns are the states at the nodes 0..N, then theta; parameters L + 1 samples, then its start [s].
    `shift(unknowns, t)`: the warm start of the next window, from the solution of the one that ends at t. `first`: the
    first guess. `samples`: L. `sample_time`: Ts [s]. `estimated`: nx + nt.
    """

    solver: ca.Function
    shift: ca.Function
    first: np.ndarray
    samples: int
    sample_time: float
    estimated: int


@dataclass(frozen=True)
class Solved:
    """`ns` per sample; `estimates` at the samples L, L + 1, ..., (n - L, nx + nt); `iterations` of each, (n - L,)."""

    ns: float
    estimates: np.ndarray
    iterations: np.ndarray


def estimator(model: Model, guess: Mapping[str, float], *, sample_time: float, N: int, L: int) -> Estimator:
    """The moving-horizon problem of `model` with its known parameters and inputs at their start values.

    Args:
        guess: first guess of the states and unknown parameters by name.
        sample_time: Ts [s]. N: order of the polynomial. L: length of the window in sample intervals.
    """
    eq = model.equations
    nx = len(model.states)
    u, p = [v.start for v in model.inputs], [v.start for v in model.parameters]
    ode = ca.Function("ode", [eq.x, eq.theta, eq.t], [ca.substitute(eq.ode, ca.vertcat(eq.u, eq.p), ca.DM(u + p))])
    measure = ca.Function(
        "measure", [eq.x, eq.theta, eq.t], [ca.substitute(eq.output, ca.vertcat(eq.u, eq.p), ca.DM(u + p))]
    )
    delta = L * sample_time
    times = (lgl.nodes(N) + 1) / 2 * delta

    X, theta = ca.SX.sym("X", nx, N + 1), ca.SX.sym("theta", eq.theta.numel())
    y, start = ca.SX.sym("y", len(model.outputs), L + 1), ca.SX.sym("start")
    unknowns = ca.vertcat(ca.vec(X), theta)
    rates = ca.horzcat(*[ode(X[:, j], theta, start + times[j]) for j in range(1, N + 1)])
    collocation = X @ ca.DM(lgl.differentiation(N)[1:]).T - delta / 2 * rates
    at_samples = X @ ca.DM(lgl.interpolation(N, 2 * np.arange(L + 1) / L - 1)).T
    cost = sample_time * sum(
        ca.sumsqr(measure(at_samples[:, i], theta, start + i * sample_time) - y[:, i]) for i in range(L + 1)
    )
    problem = {"x": unknowns, "p": ca.vertcat(ca.vec(y), start), "f": cost, "g": ca.vec(collocation)}
    return Estimator(
        solver=ca.nlpsol("window", "ipopt", problem, OPTIONS),
        shift=_shift(ode, X, theta, times, sample_time),
        first=np.concatenate(
            [np.tile([guess[v.name] for v in model.states], N + 1), [guess[v.name] for v in model.unknown_parameters]]
        ),
        samples=L,
        sample_time=sample_time,
        estimated=nx + eq.theta.numel(),
    )


def _shift(ode: ca.Function, X: ca.SX, theta: ca.SX, times: np.ndarray, sample_time: float) -> ca.Function:
    """As the observer does: the old polynomial inside its window, beyond it a Runge-Kutta chain from node to node."""
    t = ca.SX.sym("t")
    N, delta = len(times) - 1, times[-1]
    inside = [time for time in times + sample_time if time <= delta * (1 + 1e-12)]
    columns: list[Any] = [X @ ca.DM(lgl.interpolation(N, 2 * np.array(inside) / delta - 1)).T]
    x, since = X[:, N], 0.0
    for time in times[len(inside) :] + sample_time:
        ahead = float(time - delta)
        x = runge_kutta(lambda state, now: ode(state, theta, now), x, t + since, ahead - since, CLASSICAL_4)
        columns.append(x)
        since = ahead
    unknowns = ca.vertcat(ca.vec(X), theta)
    return ca.Function("shift", [unknowns, t], [ca.vertcat(ca.vec(ca.horzcat(*columns)), theta)])


def solve_all(e: Estimator, y: np.ndarray) -> Solved:
    """Estimate at every sample of `y` (n,) from the first full window on. The time is that of solver and shift.

    Raises:
        BenchmarkError: IPOPT failed at a sample.
    """
    L, Ts = e.samples, e.sample_time
    guess, multipliers = ca.DM(e.first), ca.DM.zeros(e.solver.size1_in("lam_g0"))
    estimates, iterations = np.empty((len(y) - L, e.estimated)), np.empty(len(y) - L)
    total = 0
    for k in range(L, len(y)):
        data = np.append(y[k - L : k + 1], (k - L) * Ts)
        begin = perf_counter_ns()
        found = e.solver(x0=guess, lam_g0=multipliers, p=data, lbg=0, ubg=0)
        guess, multipliers = e.shift(found["x"], k * Ts), found["lam_g"]
        total += perf_counter_ns() - begin
        stats = e.solver.stats()
        if not stats["success"]:
            raise BenchmarkError(f"IPOPT failed at sample {k}: {stats['return_status']}")
        estimates[k - L] = found["x"].full().ravel()[-e.estimated :]
        iterations[k - L] = stats["iter_count"]
    return Solved(total / (len(y) - L), estimates, iterations)
