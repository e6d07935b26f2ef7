"""What means the same is said the same to every observer: standard deviations by name, and which samples have arrived."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import fmpy
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

from fmu_src import export
from observers.canonical_dae import canonical_dae
from observers.component import Component
from observers.elementary import elementary
from observers.instance import Instance
from observers.least_squares import least_squares
from observers.model import Model, ModelError, Variable
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.status import CODE
from observers.ukf import ukf
from reference_models.duffing import DUFFING
from reference_models.motor import MOTOR
from slave import Slave

TS = 0.1
A = np.array([[-0.2, 1.0, 0.3], [-1.0, -0.1, 0.0], [0.0, 0.0, 0.0]])  # the last row: an unknown parameter
C = np.array([[1.0, 0.0, 0.0], [0.2, 1.0, -0.5]])
PLANE = Model(
    name="plane",
    states=[Variable("p", unit="m"), Variable("v", unit="m/s")],
    unknown_parameters=[Variable("c", unit="m/s2")],
    outputs=[Variable("y1", unit="m"), Variable("y2", unit="m/s")],
    ode=lambda x, u, p, t: [-0.2 * x.p + x.v + 0.3 * p.c, -x.p - 0.1 * x.v],
    output=lambda x, u, p, t: [x.p, 0.2 * x.p + x.v - 0.5 * p.c],
)
NAMES = ("p", "v", "c")
PROCESS = {"p": 0.05, "v": 0.1, "c": 0.02}
NOISE = {"y1": 0.3, "y2": 0.07}
INITIAL = {"p": 2.0, "v": 0.5, "c": 1.5}
GUESS = {"p": 0.3, "v": -0.2, "c": 0.1}
BY_NAME = {"process_noise": PROCESS, "measurement_noise": NOISE, "initial_std": INITIAL, "guess": GUESS}


def samples(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Measurements (count, 2) and which of them arrive; nothing that the filter's gain would know of."""
    rng = np.random.default_rng(3)
    return rng.normal(size=(count, 2)), rng.random((count, 2)) > 0.3


def kalman(count: int, *, forget: bool) -> Iterator[np.ndarray]:
    """Textbook Kalman filter: the prediction after each step, of samples of which only those that arrive act."""
    n, W = 3, np.diag([PROCESS[v] ** 2 * forget for v in NAMES])
    E = expm(TS * np.block([[-A, W], [np.zeros((n, n)), A.T]]))  # Van Loan
    Phi = E[n:, n:].T
    Wd = Phi @ E[:n, n:]
    m, P = np.array([GUESS[v] for v in NAMES]), np.diag([INITIAL[v] ** 2 for v in NAMES])
    R = np.diag([NOISE["y1"] ** 2, NOISE["y2"] ** 2])
    for y, there in zip(*samples(count), strict=True):
        H, S = C[there], R[np.ix_(there, there)]
        if there.any():
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + S)
            m, P = m + K @ (y[there] - H @ m), P - K @ H @ P
        m, P = Phi @ m, Phi @ P @ Phi.T + Wd
        yield m


TEXTBOOK = {"tuning.gate": 1e9}  # measurements of no motion act all the same


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Component], Path]:
    """The unpacked FMU of a component."""
    folder = tmp_path_factory.mktemp("signature")

    def make(component: Component) -> Path:
        path = export(component, folder)
        return Path(fmpy.extract(str(path), str(folder / path.stem)))

    return make


def driven(fmu: Slave, count: int) -> Iterator[np.ndarray]:
    for k, (y, there) in enumerate(zip(*samples(count), strict=True)):
        for i, name in enumerate(("y1", "y2")):
            # What stands at an input whose sample has not arrived does not matter, be it no number.
            fmu.set(name, y[i] if there[i] else [1e9, np.nan][k % 2])
            fmu.set(f"measurement_valid.{name}", bool(there[i]))
        fmu.step(k * TS, TS)
        yield np.array([fmu.get(f"estimate.{name}") for name in NAMES])


def test_the_riccati_observer_given_deviations_is_the_kalman_filter_with_samples_missing(
    made: Callable[[Component], Path],
) -> None:
    fmu = Slave(made(riccati(PLANE, sample_time=TS, **BY_NAME))).initialize(TEXTBOOK)
    assert_allclose(list(driven(fmu, 80)), list(kalman(80, forget=True)), rtol=0, atol=2e-13)
    assert fmu.get("diagnostics.rejected_samples") == 0  # a sample that never came is not a rejected one
    fmu.fmu.freeInstance()


def test_the_ukf_given_deviations_is_the_kalman_filter_with_samples_missing(made: Callable[[Component], Path]) -> None:
    """Process noise enters the UKF at the samples, not along the interval: without it the two are the same."""
    still = {**BY_NAME, "process_noise": dict.fromkeys(NAMES, 0.0)}
    fmu = Slave(made(ukf(PLANE, sample_time=TS, **still))).initialize(TEXTBOOK)
    assert_allclose(list(driven(fmu, 80)), list(kalman(80, forget=False)), rtol=0, atol=7e-13)
    fmu.fmu.freeInstance()


def test_least_squares_given_deviations_is_the_kalman_filter_without_process_noise_within_an_interval(
    made: Callable[[Component], Path],
) -> None:
    """The first sample of an interval weighs half (the trapezoidal rule): with it alone missing, the two are the same."""
    by_name = {name: BY_NAME[name] for name in ("measurement_noise", "initial_std", "guess")}
    fmu = Slave(made(least_squares(PLANE, sample_time=TS, T=100.0, **by_name))).initialize(TEXTBOOK)
    y, there = samples(80)
    Phi = expm(A * TS)
    m, P = np.array([GUESS[v] for v in NAMES]), np.diag([INITIAL[v] ** 2 for v in NAMES])
    R = np.diag([NOISE["y1"] ** 2, NOISE["y2"] ** 2])
    for k in range(80):
        for i, name in enumerate(("y1", "y2")):
            fmu.set(name, y[k, i])
            fmu.set(f"measurement_valid.{name}", bool(there[k, i]) and k > 0)
        fmu.step(k * TS, TS)
        if there[k].any() and k > 0:
            H = C[there[k]]
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R[np.ix_(there[k], there[k])])
            m, P = m + K @ (y[k, there[k]] - H @ m), P - K @ H @ P
        m, P = Phi @ m, Phi @ P @ Phi.T
        assert_allclose([fmu.get(f"estimate.{v}") for v in NAMES], m, rtol=0, atol=6e-13)
    fmu.fmu.freeInstance()


def test_after_a_reset_least_squares_trusts_its_estimate_by_the_initial_deviations_again() -> None:
    run = Instance(
        least_squares(PLANE, sample_time=TS, T=10 * TS, measurement_noise=NOISE, initial_std=INITIAL), TEXTBOOK
    )
    y, _ = samples(11)
    for k in range(10):
        run.set("y1", y[k, 0])
        run.set("y2", y[k, 1])
        run.step(k * TS, TS)
    before = np.array([run.get(f"estimate.{v}") for v in NAMES])
    # The sample of the reset: half of it ends the interval, half begins the next, from the initial deviations.
    run.set("y1", y[10, 0])
    run.set("measurement_valid.y2", 0)
    run.step(10 * TS, TS)
    P, H = np.diag([INITIAL[v] ** 2 for v in NAMES]), C[:1]
    ended = Instance(
        least_squares(PLANE, sample_time=TS, T=100.0, measurement_noise=NOISE, initial_std=INITIAL), TEXTBOOK
    )
    for k in range(10):
        ended.set("y1", y[k, 0])
        ended.set("y2", y[k, 1])
        ended.step(k * TS, TS)
    # After the first half the estimate is a little nearer to y1; the second half pulls with the gain of the prior alone.
    Phi_inverse = expm(-A * TS)
    filtered = np.array([run.get(f"filtered.{v}") for v in NAMES])
    K = P @ H.T / (H @ P @ H.T + 2 * NOISE["y1"] ** 2)
    middle = np.linalg.solve(np.eye(3) - K @ H, filtered - K[:, 0] * y[10, 0])
    assert abs(H @ middle - y[10, 0]) <= abs(H @ before - y[10, 0])
    assert_allclose(Phi_inverse @ [run.get(f"estimate.{v}") for v in NAMES], filtered, rtol=0, atol=1e-13)


SWING = Model(
    name="swing",
    states=[Variable("p"), Variable("v")],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [x.v, -x.p],
    output=lambda x, u, p, t: [x.p],
)
OBSERVERS: dict[str, Callable[[], Component]] = {
    "pseudospectral": lambda: pseudospectral(DUFFING, sample_time=0.1, N=6, L=4),
    "riccati": lambda: riccati(DUFFING, sample_time=0.1),
    "least_squares": lambda: least_squares(DUFFING, sample_time=0.1, T=1.0, linearise=True),
    "ukf": lambda: ukf(DUFFING, sample_time=0.1),
    "canonical_dae": lambda: canonical_dae(MOTOR, sample_time=0.1),
    "elementary": lambda: elementary(SWING, sample_time=0.1, N=5),
}


@pytest.mark.parametrize("kind", OBSERVERS)
def test_a_sample_that_has_not_arrived_changes_nothing_but_the_status(kind: str) -> None:
    """Whatever stands at the input: the estimate is the prediction, and no sample counts as rejected."""
    component = OBSERVERS[kind]()
    outputs = [port.name.removeprefix("measurement_valid.") for port in component.inputs if "valid" in port.name]
    runs = [Instance(component) for _ in range(2)]
    for k in range(8):
        for run, strange in zip(runs, (-7.5, float("nan")), strict=True):
            for name in outputs:
                run.set(name, 0.3 * k if k != 6 else strange)
                run.set(f"measurement_valid.{name}", float(k != 6))
            before = {p.name: run.get(p.name) for p in component.outputs if p.name.startswith("estimate.")}
            run.step(0.1 * k, 0.1)
            if k == 6:
                for name, value in before.items():
                    if f"filtered.{name[9:]}" in {p.name for p in component.outputs} and name[9:] not in ("force",):
                        assert_allclose(run.get(f"filtered.{name[9:]}"), value, rtol=1e-12, atol=1e-12)
                assert run.get("diagnostics.rejected_samples") == 0
                assert run.get("diagnostics.status") >= CODE.sample_rejected  # or what is graver, such as the start
        assert np.array_equal(runs[0].outputs(), runs[1].outputs(), equal_nan=True)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: riccati(PLANE, sample_time=TS, N=1.0, process_noise=PROCESS), ("N", "process_noise")),
        (lambda: riccati(PLANE, sample_time=TS, R=1.0, measurement_noise=NOISE), ("R", "measurement_noise")),
        (lambda: riccati(PLANE, sample_time=TS, Q0=1.0, initial_std=INITIAL), ("Q0", "initial_std")),
        (lambda: riccati(PLANE, sample_time=TS, N={"q": 1.0}), ("N of 'q'", "p, v, c")),
        (
            lambda: least_squares(PLANE, sample_time=TS, T=1, gamma=1.0, measurement_noise=NOISE),
            ("gamma", "measurement_noise"),
        ),
        (lambda: least_squares(PLANE, sample_time=TS, T=1, p0=1.0, initial_std=INITIAL), ("p0", "initial_std")),
        (lambda: least_squares(PLANE, sample_time=TS, T=1, process_noise=PROCESS), ("process_noise", "reset")),
        *(
            (lambda make=make, group=group: make(PLANE, sample_time=TS, **{group: {"q": 1.0}}), (group, "'q'"))
            for make in (ukf, riccati)
            for group in ("process_noise", "measurement_noise", "initial_std")
        ),
        (lambda: riccati(PLANE, sample_time=TS, process_noise={"p": -1.0}), ("tuning.process_noise.p", "-1")),
        (lambda: riccati(PLANE, sample_time=TS, measurement_noise={"y1": 0.0}), ("tuning.measurement_noise.y1", "0")),
    ],
)
def test_what_contradicts_itself_is_refused_by_name(make: Callable[[], Component], words: tuple[str, ...]) -> None:
    with pytest.raises((ValueError, ModelError)) as caught:
        make()
    assert all(word in str(caught.value) for word in words), caught.value


def test_deviations_have_their_variables_units_and_intensities_say_theirs_in_words() -> None:
    ports = {p.name: p for p in riccati(PLANE, sample_time=TS, **BY_NAME).parameters}
    assert ports["tuning.measurement_noise.y2"].unit == "m/s"
    assert ports["tuning.initial_std.c"].unit == "m/s2"
    assert ports["tuning.process_noise.c"].unit == ""
    assert ports["tuning.process_noise.c"].description.endswith("in m/s2 per sqrt(s)")
    paper = {p.name: p for p in riccati(PLANE, sample_time=TS, N=1.0).parameters}
    assert paper["tuning.Q0.c"].unit == "m2/s4"
    gains = {p.name: p for p in least_squares(DUFFING, sample_time=TS, T=1, linearise=True).parameters}
    assert (gains["tuning.gamma"].unit, gains["tuning.p0"].unit) == ("1/(m2.s)", "")  # p0 is of m, m/s and m/s2 at once
