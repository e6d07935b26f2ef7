"""Makes the pictures of elementary.md (like the paper's Figures 4 to 10) and prints what they measure.

python docs/figures_elementary.py
"""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
from figures import BLUE, GREEN, GREY, ORANGE, save

from cosim.master import run
from cosim.results import Result
from observers.elementary.iteration import elementary_solution, iteration, mean_rates, symbols, tuning_layout
from observers.elementary.problems import decompose
from observers.instance import Instance
from observers.model import Model
from reference_models.calvillo_alamir import SAMPLE_TIME, SIGNED_SAMPLE_TIME
from reference_models.plant import plant
from reference_models.van_der_pol import VAN_DER_POL, VAN_DER_POL_ERRONEOUS, VAN_DER_POL_SIGNED

TUNING = [10, 1e-3, 1e-3, 5e-4, 10, 1, 1, 1, 1, 1]
MOST = 400  # iterations
NODES = 81
GRIDS = (11, 21, 41, 81)


@dataclass
class Batch:
    """The paper's batch of 10 s: truth x (2 x N), v (N - 1), what each iteration made of X, W, and its change."""

    time: np.ndarray
    x: np.ndarray
    v: np.ndarray
    X: list[np.ndarray] = field(default_factory=list)
    W: list[np.ndarray] = field(default_factory=list)
    first: list[np.ndarray] = field(default_factory=list)
    second: list[np.ndarray] = field(default_factory=list)
    changes: list[float] = field(default_factory=list)


def motion(model: Model, time: np.ndarray, v: np.ndarray, x2: float) -> np.ndarray:
    """(2, N): states of `model` from (0.5, x2), with u = sin t, mu = 0.1 sin t and v held over each interval."""
    one, states = Instance(plant(model), {"start.x2": x2}), []
    for k, t in enumerate(time):
        states.append([one.get("x.x1"), one.get("x.x2")])
        for name, value in (("u", np.sin(t)), ("mu", 0.1 * np.sin(t)), ("v", v[min(k, len(v) - 1)])):
            one.set(name, float(value))
        one.step(float(t), float(time[1]))
    return np.array(states).T


def batch(model: Model, s: float, levels: dict[str, str], keep: int = 0) -> Batch:
    """All iterations down to epsilon = 1e-4; the elementary problems' own solutions of the first `keep`."""
    N = round(10 / s) + 1
    time = s * np.arange(N)
    v = 0.5 * np.clip(time[:-1] - 1, 0, 1)
    found = Batch(time, motion(VAN_DER_POL, time, v, -0.3), v)
    problems = decompose(model, levels)
    once = iteration(model, problems, N, NODES)
    u = np.vstack([np.sin(time), 0.1 * np.sin(time)])
    data = [found.x[:1], np.ones((1, N)), u[:, :-1], u[:, :-1], u, np.ones((1, N - 1)), time[-1], s, []]
    X, W = motion(VAN_DER_POL_ERRONEOUS, time, 0 * v, 0.0), np.zeros((1, N - 1))
    X[0] = found.x[0]
    found.X.append(X)
    found.W.append(W)
    names = symbols(model, N, tuning_layout(model, problems).total)
    along = [names.X, names.W, names.u0, names.u1, names.p, names.t, names.s]
    rates = ca.Function("rates", along, [mean_rates(model, names)])
    for k in range(MOST):
        if k < keep:
            rate = rates(X, W, u[:, :-1], u[:, :-1], [], time[-1], s)
            for problem, tuning, into in zip(
                problems, ([10, 1e-3, 5e-4], [1e-3, 10]), (found.first, found.second), strict=True
            ):
                solution = elementary_solution(model, problem, N, NODES)
                xi, nu = solution(X, W, *data, tuning, rate[problem.index, :])
                into.append(np.vstack([xi.full()[:, :-1], nu.full()]))
        X, W, change = (value.full() for value in once(X, W, *data, TUNING))
        found.X.append(X)
        found.W.append(W)
        found.changes.append(float(change[0, 0]))
        if found.changes[-1] <= 1e-4:
            break
    return found


def elementary_problems(found: Batch) -> None:
    """The paper's Figures 4, 6, 8 (EP1) and 5, 7 (EP2)."""
    figure, axes = plt.subplots(3, 2, figsize=(9, 5.5), sharex=True)
    t = found.time[:-1]
    for row, k in enumerate((0, 1, 4)):
        middle = (found.X[k][1, :-1] + found.X[k][1, 1:]) / 2
        left, right = axes[row]
        left.plot(t, found.x[1, :-1], color=GREY, linewidth=2, alpha=0.5, label="true $x_2$")
        left.plot(t, middle, ":", color=BLUE, linewidth=1, label=r"$\nu_1^{ref}$")
        left.plot(t, found.first[k][1], color=BLUE, linewidth=1, label=r"EP1: $\hat\nu_1$ ($x_2$)")
        left.plot(t, found.second[k][0], color=GREEN, linewidth=1, label=r"EP2: $\hat\xi$ ($x_2$)")
        right.plot(t, found.v, color=GREY, linewidth=2, alpha=0.5, label="true $v$")
        right.plot(t, found.first[k][2], color=ORANGE, linewidth=1, label=r"EP1: $\hat\nu_2$ ($v$)")
        left.set_ylabel(f"iteration {k + 1}")
    for axis in axes[0]:
        axis.legend(frameon=False, fontsize=7, ncols=4, loc="lower left", bbox_to_anchor=(0, 1))
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    save(figure, "elementary_problems")


def processed(found: Batch) -> None:
    """The paper's Figure 9, with the last iteration."""
    figure, axes = plt.subplots(2, 1, figsize=(7, 4), sharex=True)
    for row, axis in enumerate(axes):
        axis.plot(found.time, found.x[row], color=GREY, linewidth=2, alpha=0.5, label="true")
        for k, colour in ((2, ORANGE), (5, GREEN), (len(found.changes), BLUE)):
            axis.plot(found.time, found.X[k][row], color=colour, linewidth=1, label=f"iteration {k}")
        axis.set_ylabel(f"$x_{row + 1}$")
    axes[0].legend(frameon=False, ncols=4, fontsize=7)
    axes[1].set_xlabel("time [s]")
    save(figure, "elementary_processed")


def convergence(free: Batch, signed: Batch) -> None:
    """The paper's Figure 10, for v free and bounded; and what is left of the shift."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.5, 3))
    for found, label, colour in ((free, "v free", BLUE), (signed, "0 <= v <= 0.5", ORANGE)):
        count = np.arange(1, len(found.changes) + 1)
        left.loglog(count, found.changes, color=colour, label=label)
        right.loglog(count, [abs(np.mean(X[1] - found.x[1])) for X in found.X[1:]], color=colour)
    left.axhline(1e-4, color=GREY, linewidth=0.8)
    left.set_ylabel("largest change of $x_2$")
    right.set_ylabel("|mean error of $x_2$|")
    left.legend(frameon=False)
    for axis in (left, right):
        axis.set_xlabel("iteration")
    figure.tight_layout()
    save(figure, "elementary_convergence")


def family(free: Batch, signed: Batch) -> None:
    """What the window does not determine: v and v - c fit the same y."""
    figure, (above, below) = plt.subplots(2, 1, figsize=(7, 4), sharex=True)
    above.plot(free.time, free.x[1], color=GREY, linewidth=2, alpha=0.5)
    below.step(free.time[:-1], free.v, where="post", color=GREY, linewidth=2, alpha=0.5, label="true")
    for found, label, colour in ((free, "v free", BLUE), (signed, "0 <= v <= 0.5", ORANGE)):
        above.plot(found.time, found.X[-1][1], color=colour, linewidth=1)
        below.step(found.time[:-1], found.W[-1][0], where="post", color=colour, linewidth=1, label=label)
    above.set_ylabel("$x_2$")
    below.set_ylabel("v")
    below.set_xlabel("time [s]")
    below.legend(frameon=False)
    save(figure, "elementary_family")


def grid_orders(found: Batch) -> None:
    """EP2 of the first iteration on grids, against Gauss-Newton's solution of it."""
    s, N = found.time[1], len(found.time)
    u = np.vstack([np.sin(found.time), 0.1 * np.sin(found.time)])
    data = [found.x[:1], np.ones((1, N)), u[:, :-1], u[:, :-1], u, np.ones((1, N - 1)), found.time[-1], s, []]
    names = symbols(VAN_DER_POL, N, 0)
    along = [names.X, names.W, names.u0, names.u1, names.p, names.t, names.s]
    rates = ca.Function("rates", along, [mean_rates(VAN_DER_POL, names)])
    rate = rates(found.X[0], found.W[0], u[:, :-1], u[:, :-1], [], found.time[-1], s)[1, :]
    problem = decompose(VAN_DER_POL, {"x2": "grid"})[1]
    gaps = []
    for nodes in GRIDS:
        xi, _ = elementary_solution(VAN_DER_POL, problem, N, nodes)(found.X[0], found.W[0], *data, [1e-3, 10], rate)
        gaps.append(np.abs(xi.full()[0, :-1] - found.second[0][0]).max())
    orders = np.log2(np.divide(gaps[:-1], gaps[1:]))
    print(f"EP2 on {GRIDS} nodes: x2 differs by {np.array(gaps)}, orders {orders.round(1)}")


def errors(result: Result, since: float) -> dict[str, float]:
    """rms of each state's error from `since` on."""
    names = [name.removeprefix("observer.estimate.") for name in result.names if "observer.estimate." in name]
    late = result.time > since
    return {
        name: float(np.sqrt(np.mean((result[f"observer.estimate.{name}"] - result[f"plant.x.{name}"])[late] ** 2)))
        for name in names
        if f"plant.x.{name}" in result.names
    }


def describe(label: str, found: Batch) -> None:
    ratios = np.divide(found.changes[1:], found.changes[:-1])
    error = found.X[-1][1] - found.x[1]
    print(
        f"{label}: {len(found.changes)} iterations, ratios {ratios[4:16].min():.3f} to {ratios[4:16].max():.3f}, "
        f"x2 rms {np.sqrt(np.mean(error**2)):.3f}, mean {np.mean(error):.4f}, v mean {np.mean(found.W[-1][0] - found.v):.4f}"
    )


if __name__ == "__main__":
    free = batch(VAN_DER_POL, SAMPLE_TIME, {}, keep=5)
    describe("batch, v free", free)
    for k in (2, 5):
        rms = np.sqrt(np.mean((free.X[k][1] - free.x[1]) ** 2))
        print(f"  after iteration {k}: x2 rms {rms:.3f}, change {free.changes[k - 1]:.3f}")
    for s in (0.02, 0.1):
        describe(f"batch, v free, s = {s:g}", batch(VAN_DER_POL, s, {}))
    grid_orders(free)
    on_grid = batch(VAN_DER_POL, SAMPLE_TIME, {"x1": "grid", "x2": "grid"})
    print(f"all on the grid: x2 differs by {np.abs(on_grid.X[-1][1] - free.X[-1][1]).max():.1e}")
    signed = batch(VAN_DER_POL_SIGNED, SIGNED_SAMPLE_TIME, {})
    describe("batch, 0 <= v <= 0.5", signed)
    elementary_problems(free)
    processed(free)
    convergence(free, signed)
    family(free, signed)
    for name in ("calvillo_alamir_full", "calvillo_alamir_full_signed"):
        result = run(f"systems/{name}.ssp")
        last = {
            d: f"{result[f'observer.diagnostics.{d}'][-1]:.4g}"
            for d in ("iterations", "status", "visibility", "null.x2", "null.v")
        }
        print(name, last, "x2 error", f"{result['observer.filtered.x2'][-1] - result['plant.x.x2'][-2]:.4f}")
    for name, since in (("calvillo_alamir_horizon", 2), ("roessler_elementary", 15), ("roessler_pseudospectral", 15)):
        rms = errors(run(f"systems/{name}.ssp"), since)
        print(name, f"rms from {since} s on:", {state: f"{value:.1e}" for state, value in rms.items()})
