"""Makes the pictures of riccati.md and least_squares.md from the built systems, and prints what they measure.

python docs/figures_linear_gain.py
"""

from __future__ import annotations

import math
from itertools import pairwise

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
from figures import BLUE, GREEN, GREY, ORANGE, save
from scipy.integrate import quad_vec
from scipy.linalg import expm

from cosim.master import run
from cosim.results import Result
from observers.instance import Instance
from observers.least_squares import least_squares
from observers.model import Model, Variable
from observers.riccati import fastest, riccati, trade_off
from reference_models.chen_yen import CHEN_YEN
from reference_models.james_baras_5_1 import JAMES_BARAS_5_1
from reference_models.james_baras_5_2 import JAMES_BARAS_5_2
from reference_models.plant import plant

TIMES = (1, 2, 3, 5, 10, 20, 40)
SUBSTEPS = (0.05, 0.02, 0.01, 0.005, 0.002, 0.001)  # [s]


def error(result: Result) -> np.ndarray:
    """|e| of the current estimate."""
    states = [name.removeprefix("observer.estimate.") for name in result.names if "estimate." in name]
    return np.linalg.norm([result[f"observer.estimate.{s}"] - result[f"plant.x.{s}"] for s in states], axis=0)


def norms_of_Q(result: Result) -> tuple[float, float]:
    """The largest |Q| and |P| = |Q^-1| along a run."""
    entries = [result[name] for name in result.names if name.startswith("observer.diagnostics.Q[")]
    n = math.isqrt(len(entries))
    eigenvalues = np.linalg.eigvalsh(np.array(entries).T.reshape(-1, n, n))
    return float(eigenvalues.max()), float(1 / eigenvalues.min())


def riccati_errors(runs: dict[str, Result]) -> None:
    figure, axis = plt.subplots(figsize=(7, 3))
    for (label, result), colour in zip(runs.items(), (GREEN, BLUE, ORANGE), strict=True):
        axis.semilogy(result.time, error(result), color=colour, label=label)
    axis.set_xlabel("time [s]")
    axis.set_ylabel("|e|")
    axis.legend(frameon=False)
    save(figure, "riccati_errors")


PENDULUM = Model(
    name="pendulum",
    states=[Variable("angle"), Variable("rate")],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [x.rate, -ca.sin(x.angle) - 0.5 * x.rate],
    output=lambda x, u, p, t: [x.angle],
)


def riccati_front() -> None:
    """The pendulum's designs: the rate that each guarantees against the distance of the guess, and the best of them."""
    front = trade_off(PENDULUM)
    distances = np.geomspace(1e-4, 0.15, 400)
    rates = np.array([[one.rate(d) for d in distances] for one in front])
    figure, axis = plt.subplots(figsize=(7, 3))
    axis.semilogx(distances, rates.T, color=GREY, linewidth=0.6)
    axis.semilogx(distances, rates.max(axis=0), color=BLUE)
    axis.set_xlabel("distance of the guess   (grey: each design, blue: the best)")
    axis.set_ylabel("guaranteed rate [1/s]")
    axis.set_ylim(0, None)
    save(figure, "riccati_front")
    for radius in (0.002, 0.01, 0.05, 0.1):
        one = fastest(front, radius)
        print(
            f"pendulum, {radius:g} off: N = {one.design['N'][0]:.3g}, Q0 = {one.design['Q0'][0]:.3g}, "
            f"guaranteed {one.rate(radius):.3g} 1/s, found {slowest_decay(one.design, radius):.3g}"
        )
    [best] = trade_off(JAMES_BARAS_5_1)
    print(f"5.1, N = {best.design['N'][0]:.3g}: guaranteed {best.rate(math.inf):.3g} 1/s")


def slowest_decay(design: dict[str, np.ndarray], radius: float, Ts: float = 0.01, stop: float = 5.0) -> float:
    """The least decay rate [1/s] of (e' P e)^(1/2) over `stop`, from eight guesses that are `radius` off, through the sampled observer."""
    component, found = riccati(PENDULUM, sample_time=Ts, expose=["Q"], **design), []
    for angle in np.arange(8) * math.pi / 4:
        guess = {"guess.angle": 2.0 - radius * math.cos(angle), "guess.rate": -0.5 - radius * math.sin(angle)}
        run, true = Instance(component, guess), Instance(plant(PENDULUM), {"start.angle": 2.0, "start.rate": -0.5})

        def measure(run: Instance = run, true: Instance = true) -> float:
            e = [run.get(f"estimate.{v}") - true.get(f"x.{v}") for v in ("angle", "rate")]
            Q = [[run.get(f"diagnostics.Q[{i},{j}]") for j in (1, 2)] for i in (1, 2)]
            return float(np.sqrt(e @ np.linalg.solve(Q, e)))

        first = measure()
        for k in range(round(stop / Ts)):
            run.set("y", true.get("y"))
            for one in (run, true):
                one.step(k * Ts, Ts)
        found.append(math.log(first / measure()) / stop)
    return min(found)


def riccati_order() -> None:
    """Example 5.2: the estimate at t = 1 s against the one at a sample time a hundredth as long."""

    def estimate(Ts: float) -> np.ndarray:
        design = dict(sample_time=Ts, N=math.sqrt(0.2), R=3.0, Q0=0.01, guess={"x1": 0.0, "x2": 0.0})
        observer, true = Instance(riccati(JAMES_BARAS_5_2, **design)), Instance(plant(JAMES_BARAS_5_2))
        for k in range(round(1 / Ts)):
            observer.set("y", true.get("y"))
            for one in (observer, true):
                one.step(k * Ts, Ts)
        return np.array([observer.get("estimate.x1"), observer.get("estimate.x2")])

    fine = 2 * estimate(0.0005) - estimate(0.001)
    sample_times = np.array([0.1, 0.05, 0.02, 0.01, 0.005])
    gaps = np.array([np.linalg.norm(estimate(Ts) - fine) for Ts in sample_times])
    slope = np.polyfit(np.log(sample_times), np.log(gaps), 1)[0]
    print(f"5.2, distance to the continuous observer at t = 1 s: order {slope:.2f}, {gaps[3]:.1e} at Ts = 0.01")
    figure, axis = plt.subplots(figsize=(4.5, 3))
    axis.loglog(sample_times, gaps, "o-", color=BLUE, markersize=3)
    axis.set_xlabel("sample time [s]")
    axis.set_ylabel("distance to the continuous observer")
    save(figure, "riccati_order")


def least_squares_errors(short: Result, long: Result) -> None:
    figure, (above, below) = plt.subplots(2, 1, figsize=(7, 4.5), sharex=True)
    for result, label, colour in ((short, "T = 0.25 s", BLUE), (long, "T = 2 s", ORANGE)):
        above.semilogy(result.time, error(result), color=colour, label=label)
        for name, style in (("contraction", "-"), ("certified_contraction", ":")):
            values = result[f"observer.diagnostics.{name}"]
            below.step(result.time[values > 0], values[values > 0], style, where="post", color=colour, linewidth=1)
    below.axhline(1.0, color=GREY, linewidth=0.8)
    above.set_ylabel("|e|")
    above.legend(frameon=False)
    below.set_ylabel("contraction of an interval")
    below.set_xlabel("time [s]   (solid: actual, dotted: certified)")
    save(figure, "least_squares_errors")


def varying_indices(result: Result) -> None:
    """Two outputs that see an oscillation in turn: who sees it, the error, the contraction of the intervals."""
    figure, (above, below) = plt.subplots(2, 1, figsize=(7, 4), sharex=True)
    for start in np.arange(0, result.time[-1], math.pi):
        first = round(start / math.pi) % 2 == 0
        label = ("indices 3, 1" if first else "indices 1, 3") if start < 6 else None
        end = min(start + math.pi, result.time[-1])
        above.axvspan(start, end, color=BLUE if first else ORANGE, alpha=0.12, linewidth=0, label=label)
    above.semilogy(result.time[::10], error(result)[::10], color=GREEN)
    above.set_ylabel("|e|")
    above.legend(frameon=False)
    for name, style in (("contraction", "-"), ("certified_contraction", ":")):
        values = result[f"observer.diagnostics.{name}"]
        below.step(
            result.time[values > 0][::50], values[values > 0][::50], style, where="post", color=GREEN, linewidth=1
        )
    below.axhline(1.0, color=GREY, linewidth=0.8)
    below.set_ylabel("contraction of an interval")
    below.set_xlabel("time [s]   (solid: actual, dotted: certified)")
    save(figure, "least_squares_indices")


def needed_gain(T: float, starts: np.ndarray) -> tuple[float, float]:
    """The gamma p0 that certifies all intervals from `starts` on: each by its own mu and lmin(W), and by the worst of both.

    mu and lmin(W) follow from the certified factor mu / (1 + gamma p0 lmin(W)) at two values of gamma p0.
    """

    def factors(product: float) -> np.ndarray:
        found = []
        for start in starts:
            observer = Instance(least_squares(CHEN_YEN, sample_time=0.01, T=T, gamma=product / 0.1, p0=0.1), t0=start)
            for k in range(round(T / 0.01) + 1):
                observer.step(start + 0.01 * k, 0.01)
            found.append(observer.get("diagnostics.certified_contraction"))
        return np.array(found)

    mu, high = factors(1e-9), 1e3
    least = (mu / factors(high) - 1) / high
    return float(((mu - 1) / least).max()), float((mu.max() - 1) / least.min())


def switching_error(max_step: float) -> float:
    """The largest relative error from 5 s on where A(t) switches every 0.37 s, Ts = 0.1 s."""
    period, Ts = 0.37, 0.1
    model = Model(
        name="switched",
        states=[Variable("x1", start=1.0), Variable("x2", start=-1.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [
            x.x2,
            ca.if_else(ca.fmod(t, 2 * period) < period, -4 * x.x1, 0.5 * x.x1) - 0.1 * x.x2,
        ],
        output=lambda x, u, p, t: [x.x1],
    )
    observer = Instance(
        least_squares(model, sample_time=Ts, T=1.0, gamma=20.0, max_step=max_step, guess={"x1": 3.0, "x2": 0.0})
    )
    x, largest = np.array([1.0, -1.0]), 0.0
    for k in range(200):
        observer.set("y", x[0])
        observer.step(Ts * k, Ts)
        switches = period * np.arange(60)
        cuts = [Ts * k, *switches[(switches > Ts * k + 1e-9) & (switches < Ts * (k + 1) - 1e-9)], Ts * (k + 1)]
        for begin, end in pairwise(cuts):
            stiffness = -4.0 if math.fmod((begin + end) / 2, 2 * period) < period else 0.5
            x = expm(np.array([[0, 1], [stiffness, -0.1]]) * (end - begin)) @ x
        if k >= 50:
            gap = np.hypot(observer.get("estimate.x1") - x[0], observer.get("estimate.x2") - x[1])
            largest = max(largest, gap / max(1.0, np.linalg.norm(x)))
    return largest


def bound_of_corollary_3_1() -> tuple[float, float]:
    """The smallest q of (3.14) for Example 5.1 over tau: as printed, and with the integral of its own decay bound, alpha1^2 / alpha0.

    With the Gramian at u = 0, which is not below the infimum over all controls, for s0 tau: a lower bound of what the corollary gives.
    """
    A, C = np.array([[0, 1, 0], [0, 0, 1], [-1, -2, -0.5]]), np.array([[1.0, 0, 0]])
    largest = next(
        port.start for port in riccati(JAMES_BARAS_5_1, sample_time=0.01).constants if port.name == "certificate.A"
    )
    printed, corrected = [], []
    for tau in np.geomspace(0.05, 5, 60):
        gramian = quad_vec(lambda s: expm(-A * s).T @ C.T @ C @ expm(-A * s), 0, tau, epsrel=1e-10)[0]
        grown = math.exp(2 * tau * largest)
        low, high = tau / grown / (1 + tau**2 * grown), tau * grown**2 * (1 + 1 / np.linalg.eigvalsh(gramian)[0])
        printed.append(low / high + (1 + high**2) / (2 * low))
        corrected.append(high / low + (1 + high**2) * high**2 / low)
    return min(printed), min(corrected)


def noisy_rms(products: tuple[float, ...]) -> dict[float, float]:
    """rms of both states' errors from t = 10 s on with Gaussian noise of 0.1, Ts = 0.05, against gamma p0."""
    found = {}
    for product in products:
        noisy = {
            "plant.sensor.noise_std": 0.1,
            "plant.sensor.sample_time": 0.05,
            "observer.sample_time": 0.05,
            "observer.tuning.gamma": product / 0.1,
        }
        squares = []
        for seed in range(4):
            result = run("systems/chen_yen_short.ssp", step=0.05, overrides=noisy | {"plant.sensor.seed": seed})
            gaps = [result[f"observer.estimate.{s}"] - result[f"plant.x.{s}"] for s in ("x1", "x2")]
            squares.append(np.mean(np.square(gaps)[:, result.time >= 10]))
        found[product] = math.sqrt(float(np.mean(squares)))
    return found


if __name__ == "__main__":
    systems = (
        "james_baras_5_1",
        "james_baras_5_2",
        "james_baras_5_2_far",
        "chen_yen_short",
        "chen_yen_long",
        "chen_yen_alternating",
    )
    results = {name: run(f"systems/{name}.ssp") for name in systems}
    for name, result in results.items():
        rows = [int(np.argmin(np.abs(result.time - t))) for t in TIMES if t <= result.time[-1] + 1e-9]
        print(name, "|e| at", ", ".join(f"{result.time[row]:g}: {error(result)[row]:.3g}" for row in rows))
    for name in systems[:3]:
        result, found = results[name], error(results[name])
        rows = [int(np.argmin(np.abs(result.time - t))) for t in (1.0, 10.0)]
        rate = math.log(found[rows[0]] / found[rows[1]]) / 9
        print(name, "largest |Q|, |P| along the run: {:.4g}, {:.4g}".format(*norms_of_Q(result)), end="; ")
        print(f"decay guaranteed {result['observer.diagnostics.guaranteed_rate'][0]:.3g} 1/s, found {rate:.3g} 1/s")
    for name in systems[3:]:
        factors = [results[name][f"observer.diagnostics.{f}contraction"].max() for f in ("", "certified_")]
        print(name, "largest contraction, actual and certified: {:.3f}, {:.3f}".format(*factors))
    for T in (0.25, 2.0):
        for what, starts in (("k T", np.arange(0, 20, T)), ("any phase", np.linspace(0, 20 - T, 400))):
            print(
                f"T = {T:g}, intervals from {what}: gamma p0 that certifies them: {{:.4g}}, {{:.4g}}".format(
                    *needed_gain(T, starts)
                )
            )
    print("A(t) that switches, error against max_step:", {h: f"{switching_error(h):.1e}" for h in SUBSTEPS})
    print("5.1, q by Corollary 3.1, as printed and corrected: {:.1e}, {:.1e}".format(*bound_of_corollary_3_1()))
    print("noise 0.1, rms error against gamma p0:", {k: f"{v:.4f}" for k, v in noisy_rms((0.5, 1, 2, 4, 8)).items()})
    labels = ("5.1", "5.2, x0 = (1, -1), m0 = 0", "5.2, x0 = (3, 2), m0 = (-3, -2)")
    riccati_errors(dict(zip(labels, (results[name] for name in systems[:3]), strict=True)))
    riccati_front()
    riccati_order()
    least_squares_errors(results["chen_yen_short"], results["chen_yen_long"])
    varying_indices(results["chen_yen_alternating"])
