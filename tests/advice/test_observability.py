"""What the outputs tell: the empirical Gramian is the linear system's, and what cannot be told apart is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_lyapunov

from advice.observability import deviation, gramians, named, observability
from advice.region import noise_of, region
from advice.sampling import nice, sample_time
from advice.streams.motion import Motion
from advice.streams.streams import Scenario, Streams
from advice.trajectories import Trajectories
from observers.model import Model, Variable
from reference_models.plant import plant

A, C = np.array([[0.0, 1.0], [-4.0, -1.0]]), np.array([[1.0, 0.5]])
SCALES, NOISE, TS = np.array([2.0, 5.0]), np.array([0.1]), 0.05


def linear() -> Model:
    return Model(
        name="linear",
        states=[Variable("a", nominal=SCALES[0]), Variable("b", nominal=SCALES[1])],
        inputs=[Variable("u")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.b, -4 * x.a - x.b + u.u],
        output=lambda x, u, p, t: [x.a + 0.5 * x.b],
    )


def cart(output: str) -> Model:
    """A cart whose friction and offset force are unknown."""
    return Model(
        name="cart",
        states=[Variable("speed", unit="m/s", start=1.0)],
        inputs=[Variable("force", unit="m/s2", start=1.0)],
        unknown_parameters=[Variable("friction", unit="1/s", start=1.0), Variable("offset", unit="m/s2")],
        outputs=[Variable("y", unit="m/s")],
        ode=lambda x, u, p, t: [
            u.force - p.friction * (1.0 if output == "twins" else x.speed) - p.offset,
        ],
        output=lambda x, u, p, t: [x.speed],
    )


def along(model: Model, Ts: float, seeds: int) -> tuple[Motion, dict]:
    true_system, noise = plant(model, max_step=Ts), noise_of(model, {})
    scenario = Scenario(model.name, true_system, Ts, 120, noise, 30)
    made = Trajectories(model, region(model), scenario)
    return Motion(true_system, Ts), {seed: made.streams(seed) for seed in range(seeds)}


def test_the_empirical_gramian_of_a_linear_system_is_that_of_scipy() -> None:
    """Of n samples: the infinite sum less what is left of it after n."""
    model = linear()
    motion, n = Motion(plant(model, max_step=TS), TS), 40
    rng = np.random.default_rng(0)
    found = gramians(motion, SCALES, NOISE, rng.standard_normal(2), rng.standard_normal((n, 1)), t0=3.0)
    step, weighted = expm(A * TS), C / NOISE
    whole = solve_discrete_lyapunov(step.T, weighted.T @ weighted)
    left = np.linalg.matrix_power(step, n)
    expected = np.diag(SCALES) @ (whole - left.T @ whole @ left) @ np.diag(SCALES)
    np.testing.assert_allclose(found[-1], expected, rtol=1e-8)
    assert deviation(found[-1]) == pytest.approx(np.linalg.norm(np.linalg.inv(expected), 2) ** 0.5, rel=1e-7)


def test_a_gramian_without_a_direction_leaves_it_undetermined() -> None:
    assert deviation(np.diag([4.0, 1.0])) == 1.0
    assert deviation(np.array([[1.0, 1.0], [1.0, 1.0]])) == np.inf


def test_two_parameters_that_act_alike_are_told_by_names() -> None:
    found = observability(cart("twins"), *along(cart("twins"), 0.1, 1))
    assert found.window is None
    assert found.said == ("friction and offset cannot be told apart",)


def test_two_parameters_that_act_alike_at_constant_speed_only_are_told_with_that() -> None:
    motion, streams = along(cart("drag"), 0.1, 1)
    still = {seed: _held(made, 60) for seed, made in streams.items()}
    found = observability(cart("drag"), motion, still)
    assert found.said == ("friction and offset cannot be told apart while speed is constant",)


def _held(made: Streams, samples: int) -> Streams:
    """The same streams, whose inputs stay where they are for the first samples, at the speed that the force keeps."""

    def inputs(seed: int, n: int) -> dict[str, np.ndarray]:
        rng = np.random.default_rng(seed)
        force = np.repeat(rng.uniform(0, 2, n // 6 + 1), 6)[:n]
        force[:samples] = 1.0
        return {"force": force}

    start = {"start.speed": 1.0, "parameter.friction": 1.0, "parameter.offset": 0.0}
    return Streams(replace(made.scenario, inputs=inputs, start=start))


def test_a_direction_is_named_by_its_large_parts() -> None:
    assert named(np.array([0.05, -0.8, 0.6]), [Variable("a"), Variable("b"), Variable("c")]) == ["b", "c"]


@pytest.mark.parametrize(("value", "expected"), [(0.2, 0.2), (0.19, 0.1), (4.99, 2.0), (1234.0, 1000.0), (7e-6, 5e-6)])
def test_sample_times_are_nice_numbers(value: float, expected: float) -> None:
    assert nice(value) == pytest.approx(expected, rel=1e-12)


def test_the_sample_time_follows_the_fastest_mode_that_an_output_shows() -> None:
    """Modes at 1, 20 and 2000 1/s; the last one moves the output by less than the noise of 0.01."""

    def chain(gain: float) -> Model:
        return Model(
            name="chain",
            states=[Variable("slow"), Variable("fast"), Variable("parasitic")],
            outputs=[Variable("y")],
            ode=lambda x, u, p, t: [-x.slow, -20 * x.fast, -2000 * x.parasitic],
            output=lambda x, u, p, t: [x.slow + x.fast + gain * x.parasitic],
        )

    for gain, rate in ((1e-3, 20.0), (1.0, 2000.0)):
        model = chain(gain)
        Ts, found = sample_time(model, region(model), noise_of(model, {}))
        assert found == pytest.approx(rate, rel=1e-9)
        assert 0.1 <= Ts * rate <= 0.2
