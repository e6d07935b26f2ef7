"""The four other papers on the page of the claims: what computes each number."""

from __future__ import annotations

import math
import sys
from functools import lru_cache
from typing import Any

import matplotlib
import numpy as np
import pytest
from claims import CALVILLO, CHEN, JAMES, NIKOUKHAH, Runs, gap_at_samples, norm, said
from scipy.linalg import expm
from scipy.optimize import minimize_scalar

from build_fmus import FMUS
from cosim.master import run
from observers.canonical_dae.fault_detector import DETECTED
from observers.instance import Instance
from observers.least_squares import least_squares
from reference_models.calvillo_alamir import SAMPLE_TIME, SIGNED_SAMPLE_TIME
from reference_models.chen_yen import CHEN_YEN
from reference_models.van_der_pol import VAN_DER_POL, VAN_DER_POL_SIGNED
from tools import ROOT


@said(JAMES, "Example 5.1 converges from anywhere", "certified, error {} after 20 s")
def _(runs: Runs) -> Any:
    return [norm(runs.example("james_baras_5_1"), 20)]


@said(JAMES, "Example 5.2 converges from anywhere", "{} after 10 s")
def _(runs: Runs) -> Any:
    return [norm(runs.example("james_baras_5_2"), 10)]


@said(JAMES, "5.2: delta = 7.82", "{}", rel=0.0)
def _(runs: Runs) -> Any:
    observer = FMUS["james_baras_5_2_riccati"][0]()
    assert constant(observer, "delta_paper") == pytest.approx(0.2 / 0.11**2 - 4 / 9, rel=1e-6)  # (2.6), q of (3.7)
    return [constant(observer, "delta_paper")]


def constant(observer: Any, name: str) -> float:
    return next(port.start for port in observer.constants if port.name == f"certificate.{name}")


@said(JAMES, "(3.8), bound of P", "corrected: p = {} against {} found")
def _(runs: Runs) -> Any:
    result = runs.example("james_baras_5_1")
    entries = [result[f"observer.diagnostics.Q[{i},{j}]"] for i in (1, 2, 3) for j in (1, 2, 3)]
    least = np.linalg.eigvalsh(np.array(entries).T.reshape(-1, 3, 3))[:, 0].min()
    return [constant(FMUS["james_baras_5_1_riccati"][0](), "p"), 1 / least]


@said(JAMES, "5.1: q by Corollary 3.1", "{}; here {}, found {}", long=True)
def _(runs: Runs) -> Any:
    observer = FMUS["james_baras_5_1_riccati"][0]()
    A, C = np.array([[0, 1, 0], [0, 0, 1], [-1, -2, -0.5]]), np.array([[1.0, 0, 0]])
    fastest = constant(observer, "A")

    def bound(exponent: float) -> float:
        """(3.14), with the Gramian of u = 0: by a matrix exponential (Van Loan), where docs/figures_linear_gain.py integrates."""
        tau = math.exp(exponent)
        blocks = expm(tau * np.block([[A.T, C.T @ C], [np.zeros((3, 3)), -A]]))
        gramian = blocks[3:, 3:].T @ blocks[:3, 3:]
        grown = math.exp(2 * tau * fastest)
        low, high = tau / grown / (1 + tau**2 * grown), tau * grown**2 * (1 + 1 / np.linalg.eigvalsh(gramian)[0])
        return math.log(low / high + (1 + high**2) / (2 * low))

    best = minimize_scalar(bound, bounds=(math.log(0.05), math.log(5)), method="bounded")
    return [math.exp(best.fun), constant(observer, "q"), switched(A, C)]


def switched(A: np.ndarray, C: np.ndarray) -> float:
    """The largest Q of 5.1 that random switching of its controls was found to reach."""
    B = np.array([[[0.3, 0, 0], [0.2, -0.3, 0], [0, 0.2, 0.4]], [[-0.2, 0, 0], [0, 0.4, 0], [0.3, 0, -0.3]]])
    vertices = [A + a * B[0] + b * B[1] for a in (-1, 1) for b in (-1, 1)]
    found, rng = 0.0, np.random.default_rng(0)
    for hold in (0.2, 0.5, 1.0, 3.0):
        moves = []
        for F in vertices:  # of the Riccati equation by its Hamiltonian matrix
            moves.append(expm(hold * np.block([[-F.T, C.T @ C], [np.eye(3), F]])))
        Q = np.eye(3)
        for _ in range(500):
            M = moves[rng.integers(4)]
            Q = (M[3:, :3] + M[3:, 3:] @ Q) @ np.linalg.inv(M[:3, :3] + M[:3, 3:] @ Q)
            found = max(found, float(np.linalg.eigvalsh((Q + Q.T) / 2).max()))
    return found


@said(JAMES, "exponential rate", "found {} 1/s where {} is guaranteed")
def _(runs: Runs) -> Any:
    result = runs.example("james_baras_5_1")
    return [math.log(norm(result, 1) / norm(result, 10)) / 9, result["observer.diagnostics.guaranteed_rate"][0]]


@said(CHEN, "converges with T = 0.25", "{} after 20 s")
def _(runs: Runs) -> Any:
    return [norm(runs.example("chen_yen_short"), 20)]


@said(CHEN, "T = 2: no major change", "{} times smaller after 20 s", rel=0.03)
def _(runs: Runs) -> Any:
    return [norm(runs.example("chen_yen_short"), 20) / norm(runs.example("chen_yen_long"), 20)]


@said(CHEN, "gamma and p0 large enough certify it", "{} is needed, {} is used")
def _(runs: Runs) -> Any:
    """mu and lmin(W) of the certified factor mu / (1 + gamma p0 lmin(W)) follow from it at two values of gamma p0."""

    def factors(product: float) -> np.ndarray:
        observer, found = least_squares(CHEN_YEN, sample_time=0.01, T=0.25, gamma=product / 0.1, p0=0.1), []
        for start in 0.25 * np.arange(80):
            one = Instance(observer, t0=start)
            for k in range(26):
                one.step(start + 0.01 * k, 0.01)
            found.append(one.get("diagnostics.certified_contraction"))
        return np.array(found)

    mu = factors(1e-9)
    return [((mu - 1) / (mu / factors(1e3) - 1) * 1e3).max(), 20 * 0.1]


@said(NIKOUKHAH, "the motor's field with poles at -10", "error {}, {}, {} after 0.5, 1, 2 s")
def _(runs: Runs) -> Any:
    return np.abs(gap_at_samples(runs.example("nikoukhah_motor"), "x3"))[[500, 1000, 2000]]


@said(NIKOUKHAH, "Example 2.1 converges, but not with u = 0", "{} after 20 s; {}", rel=0.1)
def _(runs: Runs) -> Any:
    found = []
    for offset in (1.0, 0.0):
        held = {"source.amplitude": 0.0, "source.offset": offset}
        result = runs.example("nikoukhah_example_2_1", stop=20.0, overrides=held)
        found.append(abs(gap_at_samples(result, "x1")[-1]))
    return found


FAULT = {"plant.parameter.actuator_fault_jump_time[1]": 4.0, "plant.parameter.actuator_fault_jump_value[1]": 2.0}


@said(
    NIKOUKHAH,
    "lambda is a residual that shows failures",
    "its peak of {} comes after {} s; detected after {} to {} ms under noise",
)
def _(runs: Runs) -> Any:
    result = runs.example("nikoukhah_motor", overrides=FAULT)
    residual = np.abs(result["observer.diagnostics.lambda[2]"][4001:])
    noise = {f"plant.sensor.noise_std.{y}": 1e-3 for y in ("y1", "y2")} | {"plant.sensor.sample_time": 1e-3}
    times = []
    for seed in range(8):
        noisy = run(runs.system("nikoukhah_motor"), overrides=noise | FAULT | {"plant.sensor.seed": seed}, stop=5.0)
        times.append(1e3 * (noisy.time[np.argmax(noisy["observer.diagnostics.fault"] == DETECTED)] - 4.0))
    return [residual.max(), result.time[4001 + np.argmax(residual)] - 4.0, min(times), max(times)]


@lru_cache
def batch(signed: bool) -> Any:
    sys.path.append(str(ROOT / "docs"))
    with matplotlib.rc_context():  # the style of the project's pictures is not that of the FMUs' own
        import figures_elementary as figures

    if signed:
        figures.NODES = 41  # as in the FMU
        return figures.batch(VAN_DER_POL_SIGNED, SIGNED_SAMPLE_TIME, {})
    return figures.batch(VAN_DER_POL, SAMPLE_TIME, {}, keep=1)


@said(CALVILLO, "iterations 1 and 2 as in Figures 4 to 7", "x1 to {} after the first")
def _(runs: Runs) -> Any:
    found = batch(False)
    return [np.abs(found.X[1][0] - found.x[0]).max()]


@said(CALVILLO, "x2 and v found after 5 iterations", "x2 off by {}: the window does not determine it")
def _(runs: Runs) -> Any:
    found = batch(False)
    return [np.mean(found.X[5][1] - found.x[1])]


@said(CALVILLO, "five iterations to 1e-4", "{}, at the ratio {}/{}", rel=0.0)
def _(runs: Runs) -> Any:
    changes = batch(False).changes
    ratios = np.divide(changes[5:17], changes[4:16])
    np.testing.assert_allclose(ratios, 2 / 3, rtol=0, atol=5e-3)
    return [len(changes), 2, 3]


@said(CALVILLO, "x2 found with bounds", "with the bounds {} <= v <= {} x2 is found to {}", rel=0.05, long=True)
def _(runs: Runs) -> Any:
    found = batch(True)
    return [0.0, 0.5, np.mean(found.X[-1][1] - found.x[1])]
