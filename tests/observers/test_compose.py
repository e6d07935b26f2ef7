"""A loop closed inside, without an FMU: what the feedback reads, when it acts, and what the observer gets of it."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import pytest

from observers.component import Component, Port
from observers.compose import compose
from observers.controller import controller
from observers.instance import Instance
from observers.model import ModelError, Variable


def tracker(sample_time: float | str = 0.1) -> Component:
    """Two levels, each the integral of its own known input, a third input between them; a jump writes down what it saw of them."""
    z, u, p, t, h = ca.SX.sym("z", 5), ca.SX.sym("u", 3), ca.SX.sym("p", 2), ca.SX.sym("t"), ca.SX.sym("h")
    a, b, seen_push, seen_y, seen_pull = ca.vertsplit(z)
    push, y, pull = ca.vertsplit(u)
    return Component(
        name="tracker",
        description="Tracks",
        start=ca.Function("start", [p, t], [ca.vertcat(p[1], 2, 0, 0, 0)]),
        flow=ca.Function(
            "flow", [z, u, p, t, h], [ca.vertcat(a + h * push, b + h * pull, seen_push, seen_y, seen_pull)]
        ),
        jump=ca.Function("jump", [z, u, p, t], [ca.vertcat(a, b, push, y, pull)]),
        output=ca.Function("output", [z, u, p, t], [z]),
        inputs=(Port("push", unit="m/s"), Port("y", unit="m"), Port("pull", unit="m/s")),
        parameters=(
            Port("sample_time", "sample time", "s", start=0.1, min=0.01, variability="fixed"),
            Port("start.a", "start", "m", start=1.0, variability="fixed"),
        ),
        outputs=(
            Port("estimate.a", unit="m"),
            Port("estimate.b", unit="m"),
            *(Port(n) for n in ("seen_push", "seen_y", "seen_pull")),
        ),
        sample_time=sample_time,
        samples_inputs=True,
    )


def law(**changes: object) -> Component:
    """Reads b, then a; puts out pull, then push, then a number of its own."""
    arguments: dict[str, object] = dict(
        inputs=[Variable("b", unit="m"), Variable("a", unit="m")],
        outputs=[Variable("pull", unit="m/s"), Variable("push", unit="m/s"), Variable("effort")],
        parameters=[Variable("gain", start=3.0, min=0.0, max=9.0)],
        law=lambda x, p, t: [-p.gain * x.b, 0.5 * x.a + t, x.a * x.b],
    )
    return controller("law", **(arguments | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize("sample_time", [0.1, "sample_time"])
def test_the_feedback_acts_at_the_sample_instants_on_the_estimate_of_that_time_and_is_held(
    sample_time: float | str,
) -> None:
    run = Instance(compose(tracker(sample_time), law()), t0=2.0)
    a, b = 1.0, 2.0
    for k in range(4):
        t = 2.0 + 0.1 * k
        pull, push, effort = -3 * b, 0.5 * a + t, a * b
        assert run.get("estimate.a") == pytest.approx(a, abs=1e-14)
        shown = [run.get(name) for name in ("pull", "push", "effort")]
        assert shown == pytest.approx([pull, push, effort], abs=1e-13)  # before the step, without delay
        run.set("y", 10.0 + k)
        run.step(t, 0.05)
        seen = [run.get(name) for name in ("seen_push", "seen_y", "seen_pull")]
        assert seen == pytest.approx([push, 10.0 + k, pull], abs=1e-13)
        assert [run.get(name) for name in ("pull", "push", "effort")] == pytest.approx([pull, push, effort], abs=1e-13)
        assert run.get("estimate.b") == pytest.approx(b + 0.05 * pull, abs=1e-14)  # moves, the control is held
        run.step(t + 0.05, 0.05)
        a, b = a + 0.1 * push, b + 0.1 * pull


def test_a_feedback_parameter_acts_at_the_next_sample() -> None:
    run = Instance(compose(tracker(), law()), {"feedback.gain": 1.0})
    assert run.get("pull") == -2.0
    run.step(0.0, 0.05)
    run.set("feedback.gain", 2.0)
    assert run.get("pull") == -2.0
    run.step(0.05, 0.05)
    b = 2.0 - 0.2
    assert run.get("pull") == pytest.approx(-2 * b, abs=1e-14)
    with pytest.raises(ValueError, match=r"feedback.gain = 9.5 lies outside \[0, 9\]"):
        run.set("feedback.gain", 9.5)


def test_what_remains_of_the_observer_and_of_the_feedback() -> None:
    made = compose(tracker(), law(description="a law"))
    assert made.name == "tracker_law" and compose(tracker(), law(), name="loop").name == "loop"
    assert [port.name for port in made.inputs] == ["y"]
    assert [port.name for port in made.parameters] == ["sample_time", "start.a", "feedback.gain"]
    names = ["estimate.a", "estimate.b", "seen_push", "seen_y", "seen_pull", "pull", "push", "effort"]
    assert [port.name for port in made.outputs] == names
    assert made.description == "Tracks, with the feedback law (a law)"
    assert made.sample_time == 0.1 and made.samples_inputs and made.n_z == 5 + 3 + 1


def test_a_feedback_that_drives_no_input_only_shows_what_it_makes() -> None:
    made = compose(tracker(), law(outputs=[Variable("effort")], law=lambda x, p, t: [x.a - x.b]))
    assert [port.name for port in made.inputs] == ["push", "y", "pull"]
    assert Instance(made).get("effort") == -1.0


def feedthrough(name: str) -> Component:
    """As tracker, but an output sees this input at once."""
    made = tracker()
    z, u, p, t = ca.SX.sym("z", 5), ca.SX.sym("u", 3), ca.SX.sym("p", 2), ca.SX.sym("t")
    k = [port.name for port in made.inputs].index(name)
    return replace(made, output=ca.Function("output", [z, u, p, t], [z + ca.vertcat(0, u[k], 0, 0, 0)]))


@pytest.mark.parametrize(
    ("observer", "changes", "words"),
    [
        (
            tracker(),
            dict(inputs=[Variable("c", unit="m")], law=lambda x, p, t: [x.c] * 3),
            "'estimate.c', which the observer does not",
        ),
        (
            tracker(),
            dict(inputs=[Variable("b", unit="s")], law=lambda x, p, t: [x.b] * 3),
            "'estimate.b' is in m, but .* 'b' in s",
        ),
        (
            tracker(),
            dict(outputs=[Variable("pull", unit="N")], law=lambda x, p, t: [x.b]),
            "'pull' is in N, but the observer takes 'pull' in m/s",
        ),
        (tracker(0.0), {}, "'tracker' has no sample time"),
        (feedthrough("y"), {}, "the output 'estimate.b' depends directly on the input 'y'"),
        (feedthrough("pull"), {}, "algebraic loop: the output 'estimate.b' depends directly on the input 'pull'"),
    ],
)
def test_what_does_not_fit_is_refused_by_the_variable(
    observer: Component, changes: dict[str, object], words: str
) -> None:
    with pytest.raises(ValueError, match=f"compose 'tracker' with 'law': .*{words}"):
        compose(observer, law(**changes))


def test_a_number_without_a_unit_fits_any_and_a_truth_value_none() -> None:
    compose(tracker(), law(inputs=[Variable("b"), Variable("a")]))
    made = tracker()
    flag = replace(made.outputs[1], kind="Boolean", variability="discrete")
    with pytest.raises(ValueError, match=r"'estimate.b' is of type Boolean, but .* 'b' as Real"):
        compose(replace(made, outputs=(made.outputs[0], flag, *made.outputs[2:])), law())


def test_a_sample_time_that_can_be_zero_and_a_feedback_with_states_are_refused() -> None:
    made = tracker("sample_time")
    lax = replace(made.parameters[0], min=0.0)
    with pytest.raises(ValueError, match=r"'sample_time' of 'tracker' can be 0 \(its min is 0\)"):
        compose(replace(made, parameters=(lax, made.parameters[1])), law())
    with pytest.raises(ValueError, match="the feedback has 5 states; only a static one"):
        compose(tracker(), tracker())


def test_a_law_that_fails_says_where() -> None:
    for wrong, words in (
        (lambda x, p, t: [x.c, 0, 0], "controller 'law', law, line .*: there is no input 'c'; known: b, a"),
        (lambda x, p, t: [p.k, 0, 0], "controller 'law', law, line .*: there is no parameter 'k'; known: gain"),
        (lambda x, p, t: [x.a, 1 / 0, 0], "controller 'law', law, line .*: ZeroDivisionError"),
        (lambda x, p, t: [x.a], "controller 'law', law: 1 expressions for 3 variables"),
    ):
        with pytest.raises(ModelError, match=words):
            law(law=wrong)


def test_a_controller_alone_answers_at_once_with_time_and_parameters() -> None:
    run = Instance(law(stop_time=7.0, step_size=0.5), t0=4.0, inputs={"a": 2.0, "b": 5.0})
    assert [run.get(name) for name in ("pull", "push", "effort")] == [-15.0, 5.0, 10.0]
    run.step(4.0, 1.5)
    assert run.get("push") == 0.5 * 2 + 5.5
    assert (run.component.stop_time, run.component.step_size) == (7.0, 0.5)
    port = run.component.parameters[0]
    assert (port.min, port.max, port.start, port.variability) == (0.0, 9.0, 3.0, "tunable")
