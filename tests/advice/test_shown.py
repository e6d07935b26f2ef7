"""What advise's report shows of its choice: rows, truths and innovations lie at their times, as in the record of an FMU's run."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.linalg import expm

from advice.shown import shown
from advice.streams.native import sampled
from advice.streams.verdicts import Tried
from cosim.report.estimates import pairs
from cosim.report.figures import figures
from cosim.report.observed import known_inputs, measurements
from cosim.results import Result
from observers.model import Model, Variable
from observers.ukf import ukf

A, TS, COUNT = np.array([[0.0, 1.0], [-1.0, -0.4]]), 0.2, 80
OSCILLATOR = Model(
    name="oscillator",
    states=[Variable("a", unit="m", start=0.5), Variable("b", unit="m/s")],
    inputs=[Variable("u")],
    outputs=[Variable("y", unit="m")],
    ode=lambda x, u, p, t: [x.b, -x.a - 0.4 * x.b + u.u],
    output=lambda x, u, p, t: [x.a],
)


def record(ended_at: int | None = None) -> Result:
    """A filter over an exact oscillation without noise, from a guess that is wrong by 0.5."""
    truth = np.array([np.linalg.matrix_power(expm(A * TS), k) @ [1.0, 0.0] for k in range(COUNT + 1)])
    given = {"y": truth[:-1, 0], "u": np.zeros(COUNT)}
    component = ukf(OSCILLATOR, sample_time=TS, measurement_noise={"y": 0.01})
    tried = Tried(component, {}, sampled(component, TS))
    if ended_at is not None:
        taken = tried.sample
        tried = dataclasses.replace(
            tried,
            sample=lambda z, u, p, t: (
                taken(z, u, p, t)[0] * (np.nan if t > ended_at * TS else 1),
                taken(z, u, p, t)[1],
            ),
        )
    return shown(tried, "a run", given, {"x.a": truth[:, 0], "x.b": truth[:, 1]}, COUNT, TS)


def test_estimates_lie_beside_the_truth_of_their_time() -> None:
    result = record()
    np.testing.assert_allclose(result.time, TS * np.arange(COUNT + 1), rtol=0, atol=1e-12)
    assert [(p.estimate, p.truth) for p in pairs(result)] == [(f"observer.estimate.{v}", f"plant.x.{v}") for v in "ab"]
    for pair in pairs(result):
        assert pair.error(result)[COUNT // 2 :].max() < 2e-3  # a sample late would be an error of 0.1
    assert result["observer.estimate.a"][0] == 0.5
    assert result.units["plant.x.b"] == result.units["observer.estimate.b"] == "m/s"


def test_a_prediction_is_what_the_observer_put_out_for_the_time_of_the_sample() -> None:
    result = record()
    (one,) = measurements(result)
    assert (one.name, one.unit, len(one.measured)) == ("observer.y", "m", COUNT + 1) and one.deviation is not None
    np.testing.assert_allclose(one.predicted, result["observer.estimate.a"][one.sampled], rtol=0, atol=1e-12)
    assert list(known_inputs(result)) == ["observer.u"]


def test_its_figures_are_those_of_a_run_without_times_of_steps_and_a_run_that_ends_has_the_rows_up_to_there() -> None:
    titles = [figure.title.text.removesuffix(" (cut: zoom out)") for figure in figures(record())]
    wanted = ["a", "b", "Errors of the estimates", "observer.y", "Innovation of observer.y", "Known inputs"]
    assert titles == [*wanted, "Status (observer.diagnostics.status)"]
    ended = record(ended_at=10)
    assert len(ended.time) == len(ended.values) == 12
    figures(ended)
