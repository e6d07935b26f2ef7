"""The canonical DAE observer on a linear model, sample by sample, against numpy: missing samples, lambda, innovations, status."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_are

from moving_window import A, B, linear
from observers.canonical_dae import canonical_dae
from observers.component import Component
from observers.instance import Instance
from observers.model import Model, Variable
from observers.status import CODE
from reference_models.double_integrator import DOUBLE_INTEGRATOR, MASS_WITH_UNKNOWN_FORCE

TS, SAMPLES = 0.02, 68
C = np.array([[1, 0, 0], [1, 0, 0.5]])
GUESS = np.array([0.3, -0.2, 0.9])
P = solve_continuous_are((A + 4 * np.eye(3)).T, C.T, np.eye(3), np.eye(2))
GAMMA = (P @ C.T @ C / 2 - A) @ C.T  # (3.26) and (3.7)
PUBLISHED = {  # a_0, a_1, ... of backward differentiation
    1: [1, -1],
    2: [3 / 2, -2, 1 / 2],
    3: [11 / 6, -3, 3 / 2, -1 / 3],
}


class Reference:
    """What docs/canonical_dae.md says of a sample, for x' = A x + B u, y = C x: `w` by Runge-Kutta, `bdf` by one linear solve."""

    def __init__(self, form: str):
        self.form, self.k = form, 0
        self.u = 0.0, 0.0  # at the interval's two ends
        self.x, self.predicted, self.mu = GUESS, GUESS, np.zeros(2)
        self.ys: list[np.ndarray] = []  # newest first
        self.columns: list[np.ndarray] = []  # (x, mu), newest first
        M = np.zeros((4, 4))
        M[:3, :3], M[:3, 3] = A, B
        self.motion = expm(M * TS)

    def sample(self, y: np.ndarray, there: np.ndarray) -> None:
        y = np.where(there, y, C @ self.predicted)
        self.ys = [y, *self.ys][:4]
        if not there.any():
            self.x = self.predicted
        elif self.k == 0:
            self.x, self.mu = self._projected(self.predicted, y)
            self.mu = np.zeros(2)
        else:
            self.x, self.mu = self._by_runge_kutta() if self.form == "w" else self._by_differentiation(y)
        self.columns = [np.concatenate([self.x, self.mu]), *self.columns][:3]
        self.k += 1

    def move(self, u: float) -> None:
        """To the next sample, with the input held: what it will be then is not known yet."""
        self.predicted = (self.motion @ [*self.x, u])[:3]

    def _projected(self, w: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        mu = np.linalg.solve(C @ C.T, y - C @ w)
        return w + C.T @ mu, mu

    def _by_runge_kutta(self) -> tuple[np.ndarray, np.ndarray]:
        degree = len(self.ys) - 1
        polynomial = np.polyfit(-np.arange(degree + 1.0), np.array(self.ys), degree)
        between = [np.polyval(column, -0.5) for column in polynomial.T]

        def rate(x: np.ndarray, mu: np.ndarray, part: float) -> np.ndarray:
            return A @ x + B * (self.u[0] + part * (self.u[1] - self.u[0])) + GAMMA @ mu

        begin = self.x - C.T @ self.mu
        k1 = rate(self.x, self.mu, 0)
        k2 = rate(*self._projected(begin + TS / 2 * k1, np.array(between)), 0.5)
        k3 = rate(*self._projected(begin + TS / 2 * k2, np.array(between)), 0.5)
        k4 = rate(*self._projected(begin + TS * k3, self.ys[0]), 1)
        return self._projected(begin + TS / 6 * (k1 + 2 * k2 + 2 * k3 + k4), self.ys[0])

    def _by_differentiation(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a = PUBLISHED[min(self.k, 3)]
        older = sum(c * column for c, column in zip(a[1:], self.columns, strict=False))
        # a_0 x + ... - C' (a_0 mu + ...) = Ts (A x + B u + Gamma mu), C x = y
        left = np.block([[a[0] * np.eye(3) - TS * A, -a[0] * C.T - TS * GAMMA], [C, np.zeros((2, 2))]])
        right = TS * B * self.u[1] - older[:3] + C.T @ older[3:]
        solved = np.linalg.solve(left, np.concatenate([right, y]))
        return solved[:3], solved[3:]


class Detector:
    """`diagnostics.fault` as its tuning describes it, with counts of samples."""

    def __init__(self, threshold: float, persistence: int, settling: int):
        self.threshold, self.persistence, self.settling = threshold, persistence, settling
        self.state, self.above, self.below = "settling", 0, 0

    def sample(self, size: float) -> None:
        self.above, self.below = (self.above + 1, 0) if size > self.threshold else (0, self.below + 1)
        quiet = self.below >= self.settling
        if self.state == "settling":
            self.state = "quiet" if quiet else "settling"
        elif self.state != "detected" or quiet:
            found = "detected" if self.above >= self.persistence else "suspected"
            self.state = found if self.above else "quiet"


@functools.cache
def made(form: str, between: str) -> Component:
    states = [Variable("x1", start=0.6), Variable("x2", start=-0.3), Variable("x3", start=0.8)]
    model = linear(states=states, inputs=[Variable("u", start=0.7)], input_between_samples=between)
    options = {"gain": "regional", "alpha": 4.0, "order": 3, "measurement_noise": {"y1": 50.0, "y2": 50.0}}
    return canonical_dae(model, sample_time=TS, form=form, **options)


@pytest.mark.parametrize("form", ["w", "bdf"])
@pytest.mark.parametrize(("first", "between"), [(True, "held"), (False, "linear")])
def test_every_sample_is_that_of_the_equations_whatever_is_missing(form: str, first: bool, between: str) -> None:
    """To the last of 68 samples, a third of the first 30 missing, in part or all; with and without the first one."""
    rng = np.random.default_rng(5)
    there = rng.random((SAMPLES, 2)) > 0.3
    there[0], there[20:24], there[30:] = first, False, True
    detecting = {"tuning.fault_threshold": 1.2, "tuning.fault_persistence": 3 * TS, "tuning.fault_settling": 6 * TS}
    guess = {f"guess.x{i + 1}": x for i, x in enumerate(GUESS)}
    run, reference = (
        Instance(made(form, between), guess | detecting | {"tuning.singularity_guard": 1e-9}),
        Reference(form),
    )
    detector, states = Detector(1.2, 3, 6), ("settling", "quiet", "suspected", "detected")
    seen, gaps, true, last = set(), [], np.array([0.5, 0.4, -0.3]), 0.0
    for k in range(SAMPLES):
        u, off = np.sin(0.3 * k), 0.5 * (38 <= k < 40) + 0.5 * (50 <= k < 58)
        y = C @ true + [off, 0] + 1e-3 * rng.normal(size=2)
        run.set("u", u)
        for i in range(2):
            run.set(f"y{i + 1}", y[i] + 0.2 * u * i)
            run.set(f"measurement_valid.y{i + 1}", there[k, i])
        innovation = np.where(there[k], y - C @ reference.predicted, 0)
        reference.u = (last, last) if between == "held" else (last, u)
        last = u
        reference.sample(y, there[k])
        if there[k].any():
            detector.sample(np.abs(reference.mu).max())
        reference.move(u)
        true = (reference.motion @ [*true, u])[:3]
        run.step(k * TS, TS)
        found = [run.get(f"{part}.x{i}") for part in ("filtered", "estimate") for i in (1, 2, 3)]
        found += [run.get(f"diagnostics.{name}[{i}]") for name in ("lambda", "innovation") for i in (1, 2)]
        expected = [*reference.x, *reference.predicted, *reference.mu, *innovation]
        gaps.append(np.abs(np.array(found) - expected).max())
        assert states[int(run.get("diagnostics.fault")) - 1] == detector.state, k
        seen.add(detector.state)
        status = CODE.estimating if there[k].all() else CODE.sample_rejected
        status = {"settling": CODE.settling, "quiet": status}.get(detector.state, CODE.inconsistent)
        assert run.get("diagnostics.status") == status, k
    assert max(gaps) < 1e-9
    assert seen == set(states) and np.abs(reference.mu).max() > 1e-3
    assert run.get("diagnostics.rejected_samples") == 0 == run.get("diagnostics.solver_failures")
    assert run.get("diagnostics.singular_gains") == 0 == run.get("diagnostics.restarts")


@pytest.mark.parametrize("form", ["w", "bdf"])
def test_the_last_disturbance_moves_the_prediction_over_samples_that_are_missing(form: str) -> None:
    """A mass under a constant force of 2: closed form, through two gaps of eight samples."""
    run = Instance(canonical_dae(MASS_WITH_UNKNOWN_FORCE, sample_time=0.01, form=form, poles=[-5.0]))
    for k in range(120):
        t, there = 0.01 * k, not (60 <= k < 68 or 80 <= k < 88)
        for name, value in (("y1", 1 + t**2), ("y2", 2 * t)):
            run.set(name, value if there else 7.0)
            run.set(f"measurement_valid.{name}", there)
        run.step(t, 0.01)
        if k > 3:
            found = [run.get(f"{part}.{name}") for part in ("filtered", "estimate") for name in ("x1", "x2", "force")]
            expected = [1 + t**2, 2 * t, 2, 1 + (t + 0.01) ** 2, 2 * (t + 0.01), 2]
            np.testing.assert_allclose(found, expected, rtol=0, atol=5e-12, err_msg=str(k))


@pytest.mark.parametrize(
    ("options", "slowest"),
    [
        ({"poles": [-2.0, -5.0]}, 2.0),
        ({"poles": [-3 + 4j, -3 - 4j]}, 3.0),
        ({"poles": [-400.0, -500.0]}, 400.0),
        ({}, 10.0),
        ({"gain": "regional", "alpha": 0.5}, 0.5),
    ],
)
def test_the_fault_detector_waits_for_time_constants_of_the_slowest_pole(options: dict, slowest: float) -> None:
    """Five of them, and twenty samples at least, until it is armed; five samples until a fault is detected."""
    made = canonical_dae(DOUBLE_INTEGRATOR, sample_time=TS, **options)
    starts = {port.name: port.start for port in made.parameters}
    assert starts["tuning.fault_settling"] == pytest.approx(max(5 / slowest, 20 * TS), rel=1e-15, abs=0)
    assert starts["tuning.fault_persistence"] == pytest.approx(5 * TS, rel=1e-15, abs=0)


@pytest.mark.parametrize("form", ["w", "bdf"])
def test_five_samples_in_a_row_that_no_state_explains_start_it_again_from_the_guess(form: str) -> None:
    """Until then it keeps the prediction, and one sample in between that fits begins the count anew."""
    square = Model(
        name="square",
        states=[Variable("a", start=2.0, min=0.5, max=3.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [0 * x.a],
        output=lambda x, u, p, t: [x.a**2],
    )
    run = Instance(canonical_dae(square, sample_time=TS, form=form))
    for k in range(13):
        run.set("y", -1.0 if k in range(3, 7) or k >= 8 else 1.0)
        run.step(k * TS, TS)
        assert run.get("diagnostics.restarts") == (k == 12)
        assert run.get("estimate.a") == pytest.approx(2.0 if k == 12 else 1.0, rel=1e-14, abs=0)
    assert run.get("diagnostics.solver_failures") == 9
