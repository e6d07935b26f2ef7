"""Sensors that are perfect, or nearly: the estimate is what they say, and its deviation what is left."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from observers.instance import Instance
from observers.model import Model, Variable
from observers.ukf import ukf

TS = 0.1
CART = Model(
    name="cart",
    states=[Variable("p", unit="m"), Variable("v", unit="m/s")],
    outputs=[Variable("y1", unit="m"), Variable("y2", unit="m")],
    ode=lambda x, u, p, t: [x.v, 0],
    output=lambda x, u, p, t: [x.p, x.p],
)
LEVEL = Model(
    name="level",
    states=[Variable("p", unit="m")],
    outputs=[Variable("y", unit="m")],
    ode=lambda x, u, p, t: [0],
    output=lambda x, u, p, t: [x.p],
)


def test_a_perfect_sensor_of_a_quiet_state_gives_its_value_at_every_sample() -> None:
    run = Instance(ukf(LEVEL, sample_time=TS, process_noise={"p": 0}, measurement_noise={"y": 0}, guess={"p": 7}))
    for k in range(20):
        run.set("y", 1.0)
        run.step(TS * k, TS)
        assert_allclose(run.get("estimate.p"), 1.0, rtol=0, atol=1e-15)
        assert run.get("diagnostics.solver_failures") == 0
        assert run.get("diagnostics.std.p") < 1e-15


def test_two_perfect_sensors_of_one_state_agree_with_it_and_give_the_velocity() -> None:
    noise = {"p": 0.01, "v": 0.01}
    run = Instance(ukf(CART, sample_time=TS, process_noise=noise, measurement_noise={"y1": 0, "y2": 0}, guess={"p": 7}))
    for k in range(10):
        for name in ("y1", "y2"):
            run.set(name, 1 + 2 * TS * k)
        run.step(TS * k, TS)
        assert_allclose(run.get("filtered.p"), 1 + 2 * TS * k, rtol=0, atol=1e-14)
        if k >= 1:  # the second sample tells the velocity, to what its process noise leaves
            assert_allclose(run.get("estimate.p"), 1 + 2 * TS * (k + 1), rtol=0, atol=3e-4)
    assert run.get("diagnostics.solver_failures") == 0


@pytest.mark.parametrize("scale", [1.0, 10.0, 1e4, 1e7])
@pytest.mark.parametrize("part", [2.0, 0.3, -7.1])
def test_a_perfect_sensor_that_the_others_determine_adds_nothing_however_far_from_zero(
    scale: float, part: float
) -> None:
    """Rounding of an output grows with the output, what is left of its deviation does not."""
    oscillator = Model(
        name="oscillator",
        states=[Variable("p"), Variable("v")],
        outputs=[Variable("y1"), Variable("y2"), Variable("y3")],
        ode=lambda x, u, p, t: [x.v, -x.p],
        output=lambda x, u, p, t: [x.p, x.v, x.p + part * x.v],
    )
    perfect = {"y1": 0, "y2": 0, "y3": 0}
    run = Instance(
        ukf(oscillator, sample_time=TS, process_noise={"p": 0.01, "v": 0.01}, measurement_noise=perfect),
        {"guess.p": 7.0},
    )
    for k in range(60):
        p, v = scale * np.cos(k * TS + 0.3), -scale * np.sin(k * TS + 0.3)
        for name, value in (("y1", p), ("y2", v), ("y3", p + part * v)):
            run.set(name, value)
        run.step(k * TS, TS)
        assert_allclose([run.get("filtered.p"), run.get("filtered.v")], [p, v], rtol=0, atol=2e-13 * scale)
    assert run.get("diagnostics.solver_failures") == 0


@pytest.mark.parametrize(
    ("noise", "tolerance"),
    [((1e-6, 1e-6), 1e-13), ((1e-9, 1e-3), 1e-13), ((1e-9, 1e-9), 1e-11), ((1e-12, 1e-2), 1e-13), ((1e-12, 1e-12), 1e-5)],
)  # fmt: skip
def test_the_deviation_is_the_kalman_filters_in_60_digits_however_far_the_noise_lies_below_the_prior(
    noise: tuple[float, float], tolerance: float
) -> None:
    """Outputs p and p + v / 1000: the less noise, the worse conditioned. The mean does not matter, P does not depend on it."""
    oscillator = Model(
        name="oscillator",
        states=[Variable("p"), Variable("v")],
        outputs=[Variable("y1"), Variable("y2")],
        ode=lambda x, u, p, t: [x.v, -x.p],
        output=lambda x, u, p, t: [x.p, x.p + 1e-3 * x.v],
    )
    drift = {"p": 1e-3, "v": 1e-3}
    run = Instance(
        ukf(
            oscillator,
            sample_time=TS,
            process_noise=drift,
            measurement_noise=dict(zip(("y1", "y2"), noise, strict=True)),
        )
    )
    with mp.workdps(60):
        c, s = mp.cos(mp.mpf(TS)), mp.sin(mp.mpf(TS))
        A, C = mp.matrix([[c, s], [-s, c]]), mp.matrix([[1, 0], [1, mp.mpf(1e-3)]])
        R, Q = mp.diag([mp.mpf(r) ** 2 for r in noise]), mp.eye(2) * mp.mpf(1e-3) ** 2 * mp.mpf(TS)
        P = mp.eye(2)
        for k in range(12):
            run.step(TS * k, TS)
            P = P + Q
            K = P * C.T * (C * P * C.T + R) ** -1
            P = A * (P - K * C * P) * A.T
            found = [run.get(f"diagnostics.std.{name}") for name in ("p", "v")]
            now = P + Q  # the last interval's process noise is in it
            assert_allclose(found, [float(mp.sqrt(now[i, i])) for i in range(2)], rtol=tolerance, atol=0)


def test_a_spike_that_makes_a_step_fail_leaves_the_prediction() -> None:
    stiff = Model(
        name="cubic",
        states=[Variable("x", start=0.5)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x**3 - x.x],
        output=lambda x, u, p, t: [x.x],
    )
    for size in (1e5, 1e7, 1e12, 1e100):
        for gate, failures in ((10.0, 0), (1e120, 1)):  # an outlier does not act, unless all may
            run = Instance(ukf(stiff, sample_time=TS, measurement_noise={"y": 0.1}), {"tuning.gate": gate})
            for k in range(12):
                predicted = run.get("estimate.x")
                run.set("y", size if k == 6 else 0.3)
                run.step(TS * k, TS)
                if k == 6:
                    assert run.get("diagnostics.solver_failures") == failures
                    assert_allclose(run.get("filtered.x"), predicted, rtol=1e-12)
                    assert abs(run.get("estimate.x") - predicted) < 0.05
            assert abs(run.get("estimate.x") - 0.3) < 0.25
            assert np.all(np.isfinite(run.z))
