"""What every observer says beside its estimate, against what it must be: innovations, counters, the estimate of a lost sample."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from swing import CONVERGENT, EXACT, SWING, T0, TS

from observers.elementary import elementary
from observers.instance import Instance
from observers.least_squares import least_squares
from observers.model import ModelError, Variable
from observers.pseudospectral import pseudospectral
from observers.status import CODE
from observers.ukf import ukf
from reference_models.plant import plant

KINDS = {name: made[0] for name, made in (EXACT | CONVERGENT).items()}
GUESS = {"guess.a": 0.7, "guess.b": -0.1}


def noisy(kind: str, lost: dict[int, float], samples: int = 30):
    """Yields (k, observer before the sample, y) and steps; `lost`: what stands in for some samples, None: it has not arrived."""
    made, rng = KINDS[kind](TS), np.random.default_rng(4)
    observer, true = Instance(made, GUESS, t0=T0), Instance(plant(SWING), t0=T0)
    for k in range(samples):
        for one in (observer, true):
            one.set("u", math.cos(0.3 * k))
        y = lost.get(k, true.get("y") + 0.003 * rng.normal())
        observer.set("measurement_valid.y", y is not None)
        observer.set("y", 77.0 if y is None else y)
        yield k, observer, y
        true.step(T0 + k * TS, TS)


def output(observer: Instance, t: float) -> float:
    return (1 + 0.2 * math.sin(1.3 * t)) * observer.get("estimate.a") + 0.1 * t


@pytest.mark.parametrize("kind", [kind for kind in KINDS if not kind.startswith("canonical_dae")])
def test_the_innovation_is_the_sample_less_the_output_of_the_estimate_before_it(kind: str) -> None:
    found, expected = [], []
    for k, observer, y in noisy(kind, {}):
        expected.append(y - output(observer, T0 + k * TS))
        observer.step(T0 + k * TS, TS)
        found.append(observer.get("diagnostics.innovation"))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
    assert min(np.abs(expected[1:])) > 1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_before_the_first_sample_everything_is_the_guess_and_nothing_has_happened(kind: str) -> None:
    run = Instance(KINDS[kind](TS), GUESS, t0=T0)
    shown = dict(zip([port.name for port in run.component.outputs], run.outputs(), strict=True))
    for name, value in GUESS.items():
        last = name.removeprefix("guess.")
        assert shown[f"estimate.{last}"] == value == shown[f"filtered.{last}"]
        # The default deviation of a guess is its nominal value.
        if kind in ("ukf", "riccati", "riccati, stiff", "least_squares"):
            assert shown[f"diagnostics.std.{last}"] == pytest.approx(1, rel=1e-14)
    assert (shown["diagnostics.status"], shown["diagnostics.trusted"]) == (CODE.propagated_guess, 0)
    for name, value in shown.items():
        if name.rsplit(".")[-1] in (
            "innovation",
            "rejected_samples",
            "solver_failures",
            "restarts",
            "intervals",
            "cost",
        ):
            assert value == 0, name


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_called_after_its_model_and_its_method(kind: str) -> None:
    method = {"segments": "pseudospectral", "arrival cost": "pseudospectral", "spline": "pseudospectral"}.get(
        kind, kind
    )
    assert KINDS[kind](TS).name == f"swing_{method.split(',')[0]}"


@pytest.mark.parametrize("kind", KINDS)
def test_a_lost_sample_leaves_the_prediction_and_counts_if_it_came_and_was_none(kind: str) -> None:
    lost = {3: math.nan, 9: None, 10: math.inf, 17: -math.inf, 18: None, 25: math.nan}
    counted = 0
    for k, observer, y in noisy(kind, lost):  # type: ignore[arg-type]
        before = [observer.get(f"estimate.{name}") for name in "ab"]
        observer.step(T0 + k * TS, TS)
        counted += y is not None and not math.isfinite(y)
        assert observer.get("diagnostics.rejected_samples") == counted
        assert observer.get("diagnostics.solver_failures") == 0
        after = [observer.get(f"filtered.{name}") for name in "ab"]
        if k in lost:
            np.testing.assert_allclose(after, before, rtol=0, atol=1e-14)
            if "diagnostics.innovation" in [port.name for port in observer.component.outputs]:
                assert observer.get("diagnostics.innovation") == 0
        elif k > 8 and kind != "spline":  # which waits until a window has been full
            assert np.abs(np.array(after) - before).max() > 1e-9
    assert counted == 4


@pytest.mark.parametrize("kind", KINDS)
def test_the_estimate_moves_on_from_the_filtered_one_as_the_model_does(kind: str) -> None:
    """Over the last step: the plant, started from what is `filtered`, comes to what is the `estimate`."""
    for k, observer, _ in noisy(kind, {}, 20):
        observer.step(T0 + k * TS, TS)
        t = T0 + k * TS
        start = {f"start.{name}": observer.get(f"filtered.{name}") for name in "ab"}
        moved = Instance(plant(SWING), start, t0=t, inputs={"u": math.cos(0.3 * k)})
        moved.step(t, TS)
        found = [observer.get(f"estimate.{name}") for name in "ab"]
        expected = [moved.get(f"x.{name}") for name in "ab"]
        limit = 1e-3 if "stiff" in kind or "canonical" in kind else 1e-9
        np.testing.assert_allclose(found, expected, rtol=0, atol=limit)


@pytest.mark.parametrize("kind", ["pseudospectral", "segments", "arrival cost", "spline"])
@pytest.mark.parametrize("part", [0.5, 1.5])
def test_the_status_is_uncertain_where_a_standard_deviation_exceeds_its_limit(kind: str, part: float) -> None:
    """The limit is half the largest deviation of the last sample, or half as much again, in units of nominal values (here 1).

    The status judges the deviations at the sample, what is shown are those of the current time.
    """
    made = KINDS[kind](TS)
    first = Instance(made, GUESS, t0=T0)

    def follow(run: Instance) -> list[tuple[float, float, float]]:
        true, rng, rows = Instance(plant(SWING), t0=T0), np.random.default_rng(4), []
        for k in range(45):  # an unknown noise is known after 20 samples beyond the window
            run.set("y", true.get("y") + 0.003 * rng.normal())
            run.step(T0 + k * TS, TS)
            true.step(T0 + k * TS, TS)
            deviation = max(run.get(f"diagnostics.std.{name}") for name in "ab")
            rows.append((deviation, run.get("diagnostics.status"), run.get("diagnostics.trusted")))
        return rows

    largest = follow(first)[-1][0]
    rows = follow(Instance(made, GUESS | {"tuning.deviation_limit": part * largest}, t0=T0))
    assert rows[-1][1:] == ((CODE.uncertain, 0) if part < 1 else (CODE.estimating, 1))


@pytest.mark.parametrize("kind", ["ukf", "least_squares", "pseudospectral", "elementary"])
def test_a_state_that_no_output_ever_sees_is_refused_by_name(kind: str) -> None:
    hidden = replace(
        SWING,
        states=[*SWING.states, Variable("c")],
        ode=lambda x, u, p, t: [x.b, u.u - x.a, x.a - x.c],
        output=lambda x, u, p, t: [x.a],
    )
    make = {"ukf": ukf, "least_squares": least_squares, "pseudospectral": pseudospectral, "elementary": elementary}[
        kind
    ]
    more = {"pseudospectral": {"N": 5}, "elementary": {"N": 5}, "least_squares": {"T": 1.0}}.get(kind, {})
    with pytest.raises(ModelError, match=f"{kind}: model 'swing' is not observable: no output ever sees c"):
        make(hidden, sample_time=TS, **more)
