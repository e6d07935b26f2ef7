"""Closed loops: an observer and a feedback as one FMU, and the same feedback as an FMU of its own."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest

from cosim.master import run as master
from cosim.master.slave import RunError
from cosim.report.estimates import pairs
from cosim.results import Result
from cosim.system import Element, System
from fmu_src import export
from observers.component import Component
from observers.compose import compose
from observers.controller import controller
from observers.instance import Instance
from observers.model import ModelError, Variable
from observers.ukf import ukf
from reference_models import gong_2007
from reference_models.closed_loop import MOTOR_GAINS
from reference_models.duffing import DUFFING
from reference_models.motor import MOTOR
from reference_models.plant import plant
from toys import feedthrough_toy, growing_toy, sampled_toy

Example = Callable[..., Result]
LEVEL = Variable("level", unit="m")
RATE = Variable("rate", unit="m/s")
# On the toy of the shell's tests: `rate` is its known input, `estimate.level` what it estimates.
PULL = controller("pull", inputs=[LEVEL], outputs=[RATE], law=lambda x, p, t: [-x.level])


def size(
    result: Result, element: str, names: tuple[str, ...] = ("x1", "x2"), at: tuple[float, ...] = (0, 0)
) -> np.ndarray:
    """The distance of the plant's true state from the point `at`, at every instant."""
    errors = [result[f"{element}.x.{name}"] - value for name, value in zip(names, at, strict=True)]
    return np.asarray(np.linalg.norm(errors, axis=0))


def cost(result: Result, element: str) -> float:
    """The integral of x1^2 + x2^2."""
    return float(np.sum(size(result, element) ** 2) * result.step)


@pytest.mark.parametrize(("element", "bound"), [("plant", 0.03), ("plant_ukf", 0.03), ("plant_true", 1e-3)])
def test_every_duffing_loop_settles_at_the_origin(example: Example, element: str, bound: float) -> None:
    result = example("closed_loop_duffing")
    assert size(result, element)[0] > 2
    assert size(result, element)[result.time >= 20].max() < bound


def test_each_observer_is_rated_against_the_plant_in_its_own_loop(example: Example) -> None:
    found = {(pair.estimate, pair.truth) for pair in pairs(example("closed_loop_duffing"))}
    states = ("x1", "x2", "theta")
    loops = (("observer", "plant"), ("observer_ukf", "plant_ukf"))
    assert found == {(f"{o}.estimate.{v}", f"{plant}.x.{v}") for o, plant in loops for v in states}


def test_without_control_the_oscillator_stays_away_from_the_origin() -> None:
    free = Instance(gong_2007.duffing(), gong_2007.START)
    away = []
    for k in range(400):
        free.step(0.1 * k, 0.1)
        away.append(np.hypot(free.get("x.x1"), free.get("x.x2")))
    assert min(away[200:]) > 0.2
    assert max(away[200:]) > 1


def test_the_loops_with_an_observer_cost_little_more_than_the_one_with_the_true_state(example: Example) -> None:
    result = example("closed_loop_duffing")
    best = cost(result, "plant_true")
    assert cost(result, "plant") / best == pytest.approx(1.09, abs=0.02)
    assert cost(result, "plant_ukf") / best == pytest.approx(1.05, abs=0.02)


def test_the_observer_in_the_loop_finds_the_unknown_parameter(example: Example) -> None:
    result = example("closed_loop_duffing")
    late = result.time >= 20
    assert np.abs(result["observer.estimate.theta"] - 0.4)[late].max() < 0.05
    assert np.abs(result["observer_ukf.estimate.theta"] - 0.4)[late].max() < 0.05


def test_the_motor_settles_at_its_angle_by_the_observer_and_by_the_true_state(example: Example) -> None:
    result = example("closed_loop_motor")
    angle, p = 0.8, {v.name: v.start for v in MOTOR.parameters}
    field = (p["B1"] - 0.5 * p["B2"] * np.sin(2 * angle)) / (p["A2"] * np.sin(angle))  # where x2' = 0 there
    for element, bound in (("plant", 0.02), ("plant_true", 1e-4)):
        away = size(result, element, ("x1", "x2", "x3"), (angle, 0.0, field))
        assert away[0] > 2
        assert away[result.time >= 8].max() < bound


def test_the_motors_gains_place_the_eigenvalues_that_they_claim() -> None:
    eq, angle = MOTOR.equations, 0.8
    p = [v.start for v in MOTOR.parameters]
    named = dict(zip([v.name for v in MOTOR.parameters], p, strict=True))
    field = (named["B1"] - 0.5 * named["B2"] * np.sin(2 * angle)) / (named["A2"] * np.sin(angle))
    slopes = ca.Function("slopes", [eq.x, eq.u, eq.p], [ca.jacobian(eq.ode, eq.x), ca.jacobian(eq.ode, eq.u)])
    A, B = (np.array(ca.DM(part)) for part in slopes([angle, 0, field], [1.0], p))
    closed = A - B @ np.array([list(MOTOR_GAINS.values())])
    eigenvalues = sorted(np.linalg.eigvals(closed), key=lambda value: value.imag)
    assert eigenvalues == pytest.approx([-2 - 8j, -2 + 0j, -2 + 8j], abs=1e-3)


@pytest.mark.parametrize(("name", "u"), [("closed_loop_duffing", "plant.x.x1"), ("closed_loop_motor", "plant.x.x3")])
def test_a_controller_of_its_own_gives_our_masters_composed_loop(example: Example, name: str, u: str) -> None:
    composed, separate = example(name), example(f"{name}_controller")
    assert separate["controller.u"] == pytest.approx(composed["observer.u"], abs=1e-11)
    assert separate[u] == pytest.approx(composed[u], abs=1e-11)


def test_smaller_steps_run_the_same_loop_and_the_control_is_held_between_samples(example: Example) -> None:
    coarse, fine = example("closed_loop_duffing"), example("closed_loop_duffing", step=0.02)
    for element in ("plant", "plant_ukf", "plant_true"):
        assert fine[f"{element}.x.x1"][::5] == pytest.approx(coarse[f"{element}.x.x1"], abs=1e-8)
    held = fine["observer.u"][:-1].reshape(-1, 5)
    assert np.array_equal(held, np.repeat(held[:, :1], 5, axis=1))
    assert np.unique(held[:, 0]).size > 100


@pytest.mark.parametrize(
    "name", ["duffing_pseudospectral_controller", "duffing_ukf_controller", "motor_canonical_dae_controller"]
)
def test_nothing_that_is_composed_depends_directly_on_an_input(catalogue_fmu: Callable[[str], Path], name: str) -> None:
    description = fmpy.read_model_description(str(catalogue_fmu(name)))
    assert {unknown.variable.name for unknown in description.outputs} >= {"estimate.x1", "u"}
    assert all(unknown.dependencies == [] for unknown in description.outputs)


def test_the_controller_of_its_own_declares_its_direct_feedthrough(catalogue_fmu: Callable[[str], Path]) -> None:
    description = fmpy.read_model_description(str(catalogue_fmu("duffing_controller")))
    (unknown,) = description.outputs
    assert [variable.name for variable in unknown.dependencies] == ["x1", "x2", "theta"]


def test_the_composed_component_keeps_what_the_observer_has_and_drives_its_known_input() -> None:
    toy = sampled_toy()
    whole = compose(toy, PULL)
    assert whole.name == "sampled_toy_pull"
    assert [port.name for port in whole.inputs] == ["y"]
    assert [port.name for port in whole.outputs] == [*(port.name for port in toy.outputs), "rate"]
    run, alone = Instance(whole), Instance(toy)
    for k in range(20):
        level = alone.get("estimate.level")
        assert run.get("estimate.level") == pytest.approx(level, abs=1e-15)
        assert run.get("rate") == -run.get("estimate.level")
        run.set("y", np.sin(k))
        alone.set("y", np.sin(k))
        alone.set("rate", -level)
        run.step(0.1 * k, 0.1)
        alone.step(0.1 * k, 0.1)


def test_a_composed_dae_plant_says_where_its_branch_ends_as_alone(tmp_path: Path) -> None:
    alone = gong_2007.rlc()
    sampled = replace(
        alone,
        parameters=tuple(
            replace(port, start=0.2, min=1e-6) if port.name == "sensor.sample_time" else port
            for port in alone.parameters
        ),
    )
    flux = Variable("x2", unit="Wb")
    shown = controller("shown", inputs=[flux], outputs=[Variable("u")], law=lambda x, p, t: [x.x2])
    whole = compose(sampled, shown, source="x")
    words = []
    for component in (alone, whole):
        run = Instance(component)
        with pytest.raises(ValueError, match=r"do not determine 'x3' \(singular.* at t = 4\.09") as refused:
            for k in range(30):
                run.step(0.2 * k, 0.2)
        words.append(str(refused.value).partition(": ")[2])
    assert words[0] == words[1]
    system = System("loop", {"plant": Element(export(whole, tmp_path))}, stop=6.0, step=0.2)
    with pytest.raises(RunError, match=re.escape(words[0])):
        master(system)


def ukf_of_duffing() -> Component:
    noise = {"x1": 1e-4, "x2": 1e-4, "theta": 0.03}
    return ukf(DUFFING, sample_time=0.1, process_noise=noise, measurement_noise={"y": 0.006}, guess=gong_2007.GUESS)


def _seeing(component: Component) -> Component:
    """The toy with an output that shows its input `rate` at once."""
    z, u, p, t = ca.SX.sym("z", 4), ca.SX.sym("u", 2), ca.SX.sym("p", 6), ca.SX.sym("t")
    shown = component.output(z, u, p, t) + ca.vertcat(u[1], 0, 0, 0, 0)
    return replace(component, output=ca.Function("output", [z, u, p, t], [shown]))


@pytest.mark.parametrize(
    ("observer", "feedback", "words"),
    [
        (sampled_toy(), feedthrough_toy(), "reads 'estimate.position', which .* known: estimate.level"),
        (
            sampled_toy(),
            replace(PULL, inputs=(replace(PULL.inputs[0], unit="s"),)),
            "'estimate.level' is in m, .* in s",
        ),
        (sampled_toy(), replace(PULL, outputs=(replace(PULL.outputs[0], unit="m"),)), "'rate' is in m, .* in m/s"),
        (sampled_toy(), replace(growing_toy(), name="growing"), "the feedback has 2 states; only a static one"),
        (
            _seeing(sampled_toy()),
            PULL,
            "algebraic loop: the output 'estimate.level' depends directly on the input 'rate'",
        ),
        (feedthrough_toy(), controller("none", inputs=[], outputs=[RATE], law=lambda x, p, t: [1]), "depends directly"),
        (growing_toy(), controller("none", inputs=[], outputs=[RATE], law=lambda x, p, t: [1]), "has no sample time"),
        (
            plant(MOTOR),
            controller("none", inputs=[], outputs=[RATE], law=lambda x, p, t: [1]),
            r"the sample time 'sensor.sample_time' of 'motor' can be 0 \(its min is 0\)",
        ),
    ],
)
def test_what_does_not_fit_together_is_refused_by_name(observer: Component, feedback: Component, words: str) -> None:
    with pytest.raises(ValueError, match=rf"compose '{observer.name}' with '{feedback.name}': .*{words}"):
        compose(observer, feedback)


def test_a_law_of_the_wrong_size_or_with_an_unknown_name_is_refused() -> None:
    with pytest.raises(ModelError, match=r"controller 'pull', law: 2 expressions for 1 variables \(rate\)"):
        controller("pull", inputs=[LEVEL], outputs=[RATE], law=lambda x, p, t: [x.level, 0])
    with pytest.raises(
        ModelError,
        match=r"controller 'pull', law, line \d+ of test_closed_loop\.py: there is no input 'height'; known: level",
    ):
        controller("pull", inputs=[LEVEL], outputs=[RATE], law=lambda x, p, t: [x.height])
    with pytest.raises(ModelError, match="controller 'pull', law: the expression for 'rate' is not a scalar"):
        controller("pull", inputs=[LEVEL], outputs=[RATE], law=lambda x, p, t: [ca.vertcat(x.level, x.level)])
    with pytest.raises(ModelError, match="controller 'pull', law: a list of expressions is wanted"):
        controller("pull", inputs=[LEVEL], outputs=[RATE], law=lambda x, p, t: x.level)


def test_a_constant_feedback_drives_a_known_input() -> None:
    still = controller("still", inputs=[], outputs=[RATE], law=lambda x, p, t: [0])
    observer = ukf_of_duffing()
    off = controller("off", inputs=[], outputs=[Variable("u", unit="m/s2")], law=lambda x, p, t: [0])
    assert [port.name for port in compose(sampled_toy(), still).inputs] == ["y"]
    run, alone = Instance(compose(observer, off)), Instance(observer)
    for k in range(20):
        for each in (run, alone):
            each.set("y", np.sin(k))
            each.set("measurement_valid.y", k % 3 > 0)
            each.step(0.1 * k, 0.1)
        assert run.get("estimate.theta") == pytest.approx(alone.get("estimate.theta"), abs=1e-12)


def test_a_truth_value_is_no_number_to_drive() -> None:
    switch = controller("switch", inputs=[], outputs=[Variable("measurement_valid.y")], law=lambda x, p, t: [1])
    with pytest.raises(
        ValueError, match=r"'measurement_valid.y' is of type Real, but the observer takes .* as Boolean"
    ):
        compose(ukf_of_duffing(), switch)
