"""Process noise inside the window: the Kalman filter of the same discrete model on linear models, whatever the window's length; bounds,
missing samples, algebraic variables and unknown disturbances with it."""

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

from components import COMPONENTS
from moving_window import A, linear, sampled
from observers.instance import Instance
from observers.model import Model, ModelError, Variable
from observers.pseudospectral import pseudospectral
from observers.status import CODE
from slave import Slave

TS = 0.1
NOISE = {"y1": 0.3, "y2": 0.5}
STD = {"x1": 1.0, "x2": 2.0, "x3": 0.7, "d": 1.5}
INTENSITY = {"x1": 0.2, "x2": 0.5, "d": 0.8}  # x3 has none

AS_IT_IS = {"tuning.gate": 1e30}  # the records are no samples of the model


def held_noise(F_rate, intensities, Ts=TS):
    """Covariance that rates with a constant of variance q^2 / Ts make over a sample."""
    n = len(F_rate)
    Gamma = expm(np.block([[F_rate, np.eye(n)], [np.zeros((n, 2 * n))]]) * Ts)[:n, n:]
    return Gamma @ np.diag(np.square(intensities)) @ Gamma.T / Ts


class Filter:
    """The textbook Kalman filter of s+ = F s + G u + noise of covariance Q, y = C s + D u."""

    def __init__(self, model, P, Q, R):
        self.model, self.x, self.P, self.Q, self.R = model, np.zeros(len(P)), P, Q, R

    def correct(self, y, u, valid):
        if valid.any():
            C, R = self.model.C[valid], self.R[np.ix_(valid, valid)]
            G = self.P @ C.T @ np.linalg.inv(C @ self.P @ C.T + R)
            self.x = self.x + G @ (y - self.model.D * u)[valid] - G @ C @ self.x
            left = np.eye(len(self.P)) - G @ C
            self.P = left @ self.P @ left.T + G @ R @ G.T

    def predict(self, u, u_next):
        F = self.model.F
        self.x = F @ self.x + self.model.G0 * u + self.model.G1 * u_next
        self.P = F @ self.P @ F.T + self.Q


def told(run, y, u, valid, k):
    for i in (0, 1):
        run.set(f"y{i + 1}", y[i] if valid[i] else 1e3)
        run.set(f"measurement_valid.y{i + 1}", float(valid[i]))
    run.set("u", u)
    run.step(k * TS, TS)


def record(samples, missing, seed=3):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(samples, 2)), rng.normal(size=samples + 1), rng.random((samples, 2)) >= missing


def reference(disturbed, held=True):
    names = ["x1", "x2", "x3", *(["d"] if disturbed else [])]
    Q = np.zeros((len(names), len(names)))
    Q[:3, :3] = held_noise(A, [INTENSITY.get(name, 0.0) for name in names[:3]])
    if disturbed:
        Q[3, 3] = INTENSITY["d"] ** 2 * TS
    P = np.diag([STD[name] ** 2 for name in names])
    return names, Filter(sampled(TS, held, disturbed), P, Q, np.diag([NOISE["y1"], NOISE["y2"]]) ** 2)


@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize("L", [1, 3, 8])
@pytest.mark.parametrize("kind", ["held", "linear"])
@pytest.mark.parametrize("disturbed", [False, True], ids=["states", "states and an unknown parameter"])
def test_on_a_linear_model_with_a_segment_a_sample_the_estimate_is_the_kalman_filters(L, missing, kind, disturbed):
    """From the first sample on, while the window grows, through two outputs, samples missing one by one and both at once."""
    y, u, valid = record(40, missing)
    names, kalman = reference(disturbed, kind == "held")
    run = Instance(
        pseudospectral(
            linear(disturbed=disturbed, input_between_samples=kind),
            sample_time=TS,
            N=8,
            L=L,
            segments=L,
            arrival_cost=True,
            measurement_noise=NOISE,
            initial_std={name: STD[name] for name in names},
            process_noise={name: INTENSITY[name] for name in names if name in INTENSITY},
        ),
        AS_IT_IS,
    )
    for k in range(40):
        told(run, y[k], u[k], valid[k], k)
        kalman.correct(y[k], u[k], valid[k])
        if kind == "held" or valid[k].any():
            found = [run.get(f"filtered.{name}") for name in names]
            np.testing.assert_allclose(found, kalman.x, rtol=0, atol=1e-13, err_msg=f"sample {k}")
        kalman.predict(u[k], u[k + 1])
        if kind == "held":
            np.testing.assert_allclose([run.get(f"estimate.{name}") for name in names], kalman.x, rtol=0, atol=2e-13)
        std = [run.get(f"diagnostics.std.{name}") for name in names]
        np.testing.assert_allclose(std, np.sqrt(np.diag(kalman.P)), rtol=1e-3, err_msg=f"sample {k}")
    assert run.get("diagnostics.solver_failures") == 0


def test_its_fmu_says_the_same(slave: Callable[..., Slave]) -> None:
    y, u, valid = record(40, 0.25)
    fmu, face = slave("linear_noise").initialize(AS_IT_IS), Instance(COMPONENTS["linear_noise"](), AS_IT_IS)
    names = [port.name for port in face.component.outputs]
    for k in range(40):
        for run in (fmu, face):
            told(run, y[k], u[k], valid[k], k)
        np.testing.assert_allclose([fmu.get(name) for name in names], face.outputs(), rtol=1e-9, atol=1e-11)


def test_many_states_are_worked_on_in_loops():
    """Twenty decoupled lags with noise on all of them: the same as one of them alone."""

    def lags(n):
        return Model(
            name="lags",
            states=[Variable(f"x{i}", start=1.0) for i in range(n)],
            outputs=[Variable(f"y{i}", start=1.0) for i in range(n)],
            ode=lambda x, u, p, t: [-getattr(x, f"x{i}") for i in range(n)],
            output=lambda x, u, p, t: [getattr(x, f"x{i}") for i in range(n)],
        )

    runs = []
    for n in (1, 20):
        noise = {f"x{i}": 0.3 for i in range(n)}
        measured = {f"y{i}": 0.2 for i in range(n)}
        component = pseudospectral(
            lags(n),
            sample_time=TS,
            N=4,
            L=3,
            segments=3,
            arrival_cost=True,
            measurement_noise=measured,
            process_noise=noise,
        )
        runs.append(Instance(component, AS_IT_IS))
    rng = np.random.default_rng(0)
    for k in range(12):
        value = rng.normal()
        for n, run in zip((1, 20), runs, strict=True):
            for i in range(n):
                run.set(f"y{i}", value)
            run.step(k * TS, TS)
        for what in ("estimate", "diagnostics.std"):
            alone = runs[0].get(f"{what}.x0")
            together = [runs[1].get(f"{what}.x{i}") for i in range(20)]
            np.testing.assert_allclose(together, alone, rtol=0, atol=1e-12)


def test_a_term_that_the_collocation_solves_for_changes_nothing():
    """A settable damping makes one entry of A no constant: its rates are among the unknowns."""
    y, u, valid = record(40, 0.2)
    runs = [
        Instance(
            pseudospectral(
                linear(damping=damping, disturbed=True),
                sample_time=TS,
                N=8,
                L=4,
                segments=4,
                arrival_cost=True,
                measurement_noise=NOISE,
                initial_std=STD,
                process_noise=INTENSITY,
            )
        )
        for damping in (None, 0.3)
    ]
    for k in range(40):
        for run in runs:
            told(run, y[k], u[k], valid[k], k)
        for what in ("estimate", "diagnostics.std"):
            a, b = ([run.get(f"{what}.{name}") for name in STD] for run in runs)
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-13)


def biased(as_disturbance=False):
    """A sensor whose bias wanders: the output sees the unknown parameter, or disturbance, itself."""
    wanders = [Variable("b", start=0.0)]
    return Model(
        name="biased",
        states=[Variable("p"), Variable("v")],
        unknown_parameters=[] if as_disturbance else wanders,
        unknown_disturbances=wanders if as_disturbance else [],
        outputs=[Variable("y1"), Variable("y2")],
        ode=lambda x, u, p, t: [x.v, -x.p - 0.2 * x.v],
        output=lambda x, u, p, t: [x.p + (u.b if as_disturbance else p.b), x.v],
    )


@pytest.mark.parametrize("as_disturbance", [False, True], ids=["parameter", "disturbance"])
@pytest.mark.parametrize("L", [1, 5])
@pytest.mark.parametrize("driven", [0.3, 0.0], ids=["with a state", "alone"])
def test_a_bias_that_wanders_is_the_kalman_filters_too(as_disturbance, L, driven):
    """The sample at a segment's end sees the parameter after its jump."""
    F = np.zeros((3, 3))
    F[:2, :2] = [[0, 1], [-1, -0.2]]
    Q = np.zeros((3, 3))
    Q[:2, :2] = held_noise(F[:2, :2], [0.0, driven])
    Q[2, 2] = 0.4**2 * TS
    model = sampled(TS)._replace(
        F=expm(F * TS), G0=np.zeros(3), G1=np.zeros(3), C=np.array([[1.0, 0, 1], [0, 1, 0]]), D=np.zeros(2)
    )
    kalman = Filter(model, np.diag([1.0, 1.0, 0.5]) ** 2, Q, np.diag([NOISE["y1"], NOISE["y2"]]) ** 2)
    run = Instance(
        pseudospectral(
            biased(as_disturbance),
            sample_time=TS,
            N=8,
            L=L,
            segments=L,
            arrival_cost=True,
            measurement_noise=NOISE,
            process_noise={"b": 0.4} | ({"v": driven} if driven else {}),
            initial_std={"p": 1.0, "v": 1.0, "b": 0.5},
        ),
        AS_IT_IS,
    )
    y = record(40, 0)[0]
    for k in range(40):
        run.set("y1", y[k][0])
        run.set("y2", y[k][1])
        run.step(k * TS, TS)
        kalman.correct(y[k], 0.0, np.ones(2, bool))
        found = [run.get(f"filtered.{name}") for name in ("p", "v", "b")]
        np.testing.assert_allclose(found, kalman.x, rtol=0, atol=1e-13, err_msg=f"sample {k}")
        kalman.predict(0.0, 0.0)
        std = [run.get(f"diagnostics.std.{name}") for name in ("p", "v", "b")]
        np.testing.assert_allclose(std, np.sqrt(np.diag(kalman.P)), rtol=3e-5)


@pytest.mark.parametrize(("L", "segments"), [(6, 3), (4, 1)])
@pytest.mark.parametrize("arrival", [False, True], ids=["first state free", "arrival cost"])
def test_with_several_samples_a_segment_it_is_the_windows_generalised_least_squares(arrival, L, segments):
    """The samples' errors and the segments' noise weighted by their variances, those of the segment that fills up by the part that is full;
    the arrival cost moves on as a Kalman filter's state."""
    m, q = L // segments, np.array([0.2, 0.5, 0.0])
    model = sampled(TS)
    Q = held_noise(A, q)
    run = Instance(
        pseudospectral(
            linear(),
            sample_time=TS,
            N=8,
            L=L,
            segments=segments,
            arrival_cost=arrival,
            measurement_noise=NOISE,
            initial_std={name: STD[name] for name in ("x1", "x2", "x3")} if arrival else None,
            process_noise={"x1": 0.2, "x2": 0.5},
        ),
        AS_IT_IS,
    )
    y, u, _ = record(30, 0)
    Gamma = expm(np.block([[A, np.eye(3)], [np.zeros((3, 6))]]) * TS)[:3, 3:]
    R = np.diag([NOISE["y1"], NOISE["y2"]]) ** 2
    behind = Filter(model, np.diag([STD[name] ** 2 for name in ("x1", "x2", "x3")]), Q, R)
    for k in range(30):
        told(run, y[k], u[k], np.ones(2, bool), k)
        place, first, n = min(k, L), max(k - L, 0), 3 + 3 * segments
        state, offset, rows, right = np.eye(3, n), np.zeros(3), [], []
        for i in range(place + 1):
            rows.append(model.C @ state / np.sqrt(np.diag(R))[:, None])
            right.append((y[first + i] - model.C @ offset - model.D * u[first + i]) / np.sqrt(np.diag(R)))
            if i < place:
                push, j = np.zeros((3, n)), i // m
                full = min(place - j * m, m)
                push[:, 3 + 3 * j : 6 + 3 * j] = Gamma * q / np.sqrt(full * TS)
                state, offset = model.F @ state + push, model.F @ offset + model.G0 * u[first + i]
        prior = np.zeros((3, n))
        if arrival:
            root = np.linalg.inv(np.linalg.cholesky(behind.P))
            prior[:, :3] = root
        stacked = np.vstack([*rows, np.eye(n)[3:], prior])
        aim = np.concatenate([*right, np.zeros(n - 3), root @ behind.x if arrival else np.zeros(3)])
        s, *_ = np.linalg.lstsq(stacked, aim, rcond=None)
        if arrival or k >= 3:
            found = [run.get(f"filtered.x{i}") for i in (1, 2, 3)]
            np.testing.assert_allclose(found, state @ s + offset, rtol=0, atol=2e-10, err_msg=f"sample {k}")
            P = model.F @ state @ np.linalg.inv(stacked.T @ stacked) @ state.T @ model.F.T + Q
            std = [run.get(f"diagnostics.std.x{i}") for i in (1, 2, 3)]
            np.testing.assert_allclose(std, np.sqrt(np.diag(P)), rtol=2e-4, err_msg=f"sample {k}")
        if k >= L:
            behind.correct(y[first], u[first], np.ones(2, bool))
            behind.predict(u[first], u[first + 1])


def test_an_intensity_of_zero_is_the_exact_model():
    y, u, valid = record(30, 0.1)
    arguments = dict(sample_time=TS, N=8, L=4, segments=4, arrival_cost=True, measurement_noise=NOISE)
    exact = Instance(pseudospectral(linear(), **arguments), AS_IT_IS)
    tuned = Instance(
        pseudospectral(linear(), **arguments, process_noise={"x2": 0.5}), {"tuning.process_noise.x2": 0.0} | AS_IT_IS
    )
    for k in range(30):
        for run in (exact, tuned):
            told(run, y[k], u[k], valid[k], k)
        a, b = ([run.get(f"estimate.x{i}") for i in (1, 2, 3)] for run in (exact, tuned))
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-13)


def tank(lowest=0.0):
    """A level that leaks as its root, and cannot be negative."""
    return Model(
        name="tank",
        states=[Variable("level", start=0.3, nominal=0.5, min=lowest)],
        inputs=[Variable("flow", start=0.0)],
        unknown_parameters=[Variable("leak", start=0.5, nominal=0.5, min=0.1, max=2.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [u.flow - p.leak * ca.sqrt(x.level + 0.01)],
        output=lambda x, u, p, t: [x.level],
    )


def test_bounds_hold_with_it():
    """Samples far below an empty tank: the estimate stays at the bound, and comes back."""
    arguments = dict(sample_time=TS, N=5, L=6, segments=6, arrival_cost=True, measurement_noise={"y": 0.02})
    noise = {"process_noise": {"level": 0.05, "leak": 0.05}, "initial_std": {"level": 0.2, "leak": 0.2}}
    bounded = Instance(pseudospectral(tank(), **arguments, **noise))
    levels, leaks = [], []
    rng = np.random.default_rng(0)
    level = 0.3
    for k in range(120):
        flow = 0.0 if k < 40 else 0.4
        bounded.set("flow", flow)
        bounded.set("y", level + 0.02 * rng.normal() - (0.05 if 25 < k < 40 else 0.0))
        bounded.step(k * TS, TS)
        for _ in range(10):
            level = max(level + TS / 10 * (flow - 0.5 * np.sqrt(level + 0.01)), 0.0)
        levels.append(bounded.get("filtered.level"))
        leaks.append(bounded.get("filtered.leak"))
    assert min(levels) >= 0.0 and min(leaks) >= 0.1 and max(leaks) <= 2.0
    assert min(levels) < 1e-3  # the bound was needed
    assert abs(levels[-1] - level) < 0.03 and abs(leaks[-1] - 0.5) < 0.15
    assert bounded.get("diagnostics.status") == CODE.estimating


@pytest.mark.parametrize("segments", [1, 4])
def test_algebraic_variables_go_on_working_with_it(segments):
    """Eliminated, or written into the equations: the same estimate."""

    def model(algebraic):
        arguments = dict(
            name="circuit",
            states=[Variable("v"), Variable("i")],
            outputs=[Variable("y")],
            output=(lambda x, z, u, p, t: [x.v]) if algebraic else (lambda x, u, p, t: [x.v]),
        )
        if not algebraic:
            return Model(**arguments, ode=lambda x, u, p, t: [x.i - x.v, -x.v - 0.5 * x.i - 0.3 * x.i])
        return Model(
            **arguments,
            algebraic=[Variable("drop")],
            algebraic_equations=lambda x, z, u, p, t: [z.drop - 0.3 * x.i],
            ode=lambda x, z, u, p, t: [x.i - x.v, -x.v - 0.5 * x.i - z.drop],
        )

    runs = [
        Instance(
            pseudospectral(
                model(algebraic),
                sample_time=TS,
                N=8,
                L=4,
                segments=segments,
                arrival_cost=True,
                measurement_noise={"y": 0.1},
                process_noise={"v": 0.1, "i": 0.3},
            )
        )
        for algebraic in (False, True)
    ]
    rng = np.random.default_rng(0)
    for k in range(30):
        value = rng.normal()
        for run in runs:
            run.set("y", value)
            run.step(k * TS, TS)
        for what in ("estimate", "diagnostics.std"):
            a, b = ([run.get(f"{what}.{name}") for name in ("v", "i")] for run in runs)
            np.testing.assert_allclose(a, b, rtol=0, atol=4e-12)


def test_an_unknown_disturbance_is_followed_and_says_how_sure_it_is():
    """A force that nobody measures, on a mass on a spring; a step in it is found within a second."""
    mass = Model(
        name="mass",
        states=[Variable("p"), Variable("v")],
        unknown_disturbances=[Variable("force", unit="N")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.v, -x.p - 0.2 * x.v - 0.1 * x.p**3 + u.force],
        output=lambda x, u, p, t: [x.p],
    )
    observer = pseudospectral(
        mass, sample_time=TS, N=5, L=10, segments=10, arrival_cost=True, measurement_noise={"y": 0.005}
    )
    assert "tuning.process_noise.force" in {port.name for port in observer.parameters}
    run, (x, v), rng = Instance(observer), (0.0, 0.0), np.random.default_rng(0)
    errors = []
    for k in range(150):
        force = 0.0 if k < 75 else 1.0
        run.set("y", x + 0.005 * rng.normal())
        run.step(k * TS, TS)
        for _ in range(100):
            v, x = v + TS / 100 * (-x - 0.2 * v - 0.1 * x**3 + force), x + TS / 100 * v
        errors.append((run.get("estimate.force") - force) / run.get("diagnostics.std.force"))
    assert np.abs(errors[30:75]).max() < 4 and np.abs(errors[90:]).max() < 4
    assert run.get("diagnostics.std.force") < 0.7


@pytest.mark.parametrize(
    ("more", "named"),
    [
        ({"noise_bound": 1.0, "process_noise": {"x1": 0.1}}, "noise_bound .*process_noise of x1 .*arrival_cost"),
        ({"cost": "spline", "process_noise": {"x1": 0.1}}, "spline cost .*process noise"),
        ({"process_noise": {"nothing": 0.1}}, "process_noise of 'nothing'"),
    ],
)
def test_what_does_not_go_with_it_is_refused_by_name(more, named):
    with pytest.raises((ModelError, ValueError), match=named):
        pseudospectral(linear(), sample_time=TS, N=8, L=4, **more)
