"""A function of the component that cannot be evaluated, wherever in a step: an error that says which and when, nothing else happened."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from components import COMPONENTS
from observers.instance import Instance
from slave import Slave

Make = Callable[..., Slave]

# A step of 0.1 s: samples at 0, 0.04 and 0.08, a break at 0.06, substeps of 0.01 s in each of the four pieces between.
SUBSTEPS = [0.01 * i for i in range(10)]
SAMPLES = [0.0, 0.04, 0.08]


@pytest.mark.parametrize(
    ("parameter", "value", "what", "t"),
    [
        *(("stuck_at", begin + 0.005, "the motion", begin) for begin in SUBSTEPS),
        *(("blind_at", tick, "the sample", tick) for tick in SAMPLES),
        ("highest", 1.05, "the outputs", 0.1),
    ],
)
def test_what_cannot_be_evaluated_is_named_and_the_step_not_taken(
    slave: Make, parameter: str, value: float, what: str, t: float
) -> None:
    fmu, face = slave("guarded_toy").initialize(), Instance(COMPONENTS["guarded_toy"]())
    free = fmu.get(parameter)
    for one in (fmu, face):
        one.set(parameter, value)
    before = fmu.state()
    with pytest.raises(ValueError) as refused:
        face.step(0.0, 0.1)
    for said in (fmu.refuses(lambda: fmu.step(0.0, 0.1)).rstrip("."), str(refused.value)):
        words, _, when = said.rpartition(" ")
        assert words == f"guarded_toy: {what} could not be evaluated at t ="
        assert float(when) == pytest.approx(t, abs=1e-15)
    assert fmu.state() == before and face.time == 0
    for one in (fmu, face):
        one.set(parameter, free)
        one.step(0.0, 0.1)
        assert one.get("level") == pytest.approx(1.1, abs=1e-15)


def test_start_values_that_cannot_be_evaluated_are_refused_and_can_be_mended(slave: Make) -> None:
    fmu = slave("guarded_toy")
    fmu.set("start.level", -1.0)
    fmu.fmu.setupExperiment(startTime=2.5)
    fmu.fmu.enterInitializationMode()
    words = "guarded_toy: the start values give no finite state at t = 2.5"
    assert fmu.refuses(fmu.fmu.exitInitializationMode) == f"{words}."
    with pytest.raises(ValueError) as refused:
        Instance(COMPONENTS["guarded_toy"](), {"start.level": -1.0}, t0=2.5)
    assert str(refused.value) == words
    fmu.set("start.level", 3.0)
    fmu.fmu.exitInitializationMode()
    assert fmu.get("level") == 3.0


def test_outputs_that_cannot_be_evaluated_between_steps_are_an_error_of_the_read(slave: Make) -> None:
    fmu = slave("guarded_toy").initialize()
    fmu.set("highest", 0.5)
    message = fmu.refuses(lambda: fmu.get("level"))
    assert message == "guarded_toy: the outputs could not be evaluated at t = 0."
    fmu.set("highest", 2.0)
    assert fmu.get("level") == 1.0
