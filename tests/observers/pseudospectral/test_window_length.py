"""A window whose length changes at run time (Remark 3): `tuning.window_length` of its newest intervals count."""

import numpy as np
import pytest

from moving_window import linear, sampled
from observers.instance import Instance
from observers.pseudospectral import pseudospectral
from observers.status import CODE
from reference_models.duffing import DUFFING
from reference_models.plant import plant

TS, L = 0.1, 12
AS_IT_IS = {"tuning.gate": 1e30, "tuning.conditioning_limit": 0.0}  # the records are no samples of the model


@pytest.mark.parametrize(("segments", "N"), [(1, 14), (4, 8)])
def test_however_the_length_changes_the_estimate_is_the_least_squares_one_of_the_samples_that_count(segments, N):
    """Shrinking, growing again, growing from the start: against numpy's least squares on exactly these samples, at every sample."""
    rng = np.random.default_rng(0)
    lengths = [3] * 8 + [12] * 6 + [5] * 9 + [4] + [12] * 3 + [2] * 3 + [9] * 10
    y, u = rng.normal(size=(len(lengths), 2)), np.round(rng.normal(size=len(lengths)), 2)
    run, model = Instance(pseudospectral(linear(), sample_time=TS, N=N, L=L, segments=segments), AS_IT_IS), sampled(TS)
    y[17] = np.nan
    for k, length in enumerate(lengths):
        run.set("tuning.window_length", length)
        for i in (0, 1):
            run.set(f"y{i + 1}", y[k, i])
        run.set("u", u[k])
        run.step(TS * k, TS)
        window = slice(max(k - length, 0), k + 1)
        valid = np.isfinite(y[window])
        if valid.sum() < 6 or not valid[-1].any():  # few samples of noise, badly determined; no new one: the prediction
            continue
        expected = model.smoothed(np.nan_to_num(y[window]), u[window], valid)
        found = [run.get(f"filtered.x{i}") for i in (1, 2, 3)]
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-9 * max(np.abs(expected).max(), 1))


def test_a_shorter_window_forgets_a_jump_sooner():
    """theta jumps from 0.4 to 0.1 at 10 s; a window of 30 samples has forgotten the old value after 30, or after the 8 that count."""

    def found_after(length):
        run = Instance(pseudospectral(DUFFING, sample_time=TS, N=13, L=30, segments=3), {"tuning.gate": 1e30})
        true = Instance(plant(DUFFING))
        for k in range(150):
            if k == 100:
                true = Instance(plant(DUFFING), {f"start.{n}": true.get(f"x.{n}") for n in ("x1", "x2")}, t0=10.0)
                true.set("parameter.theta", 0.1)
                run.set("tuning.window_length", length)
            run.set("y", true.get("y"))
            true.step(TS * k, TS)
            run.step(TS * k, TS)
            if k > 100 and abs(run.get("filtered.theta") - 0.1) < 1e-6:
                return k - 100
        return None

    assert (found_after(30), found_after(8)) == (30, 8)


def test_settling_ends_when_the_samples_that_count_are_there():
    run = Instance(pseudospectral(DUFFING, sample_time=TS, N=15, L=20), {"tuning.window_length": 8})
    true = Instance(plant(DUFFING))
    told = []
    for k in range(12):
        run.set("y", true.get("y"))
        true.step(TS * k, TS)
        run.step(TS * k, TS)
        told.append(run.get("diagnostics.status"))
    assert CODE.settling in told[2:8] and CODE.settling not in told[8:]


def test_fewer_samples_than_unknowns_are_not_fitted():
    run, true = Instance(pseudospectral(DUFFING, sample_time=TS, N=15, L=8)), Instance(plant(DUFFING))
    for k in range(14):
        run.set("tuning.window_length", 1 if k > 10 else 8)
        run.set("y", true.get("y"))
        true.step(TS * k, TS)
        run.step(TS * k, TS)
    assert run.get("diagnostics.status") == CODE.propagated_guess and not run.get("diagnostics.trusted")


@pytest.mark.parametrize("more", [dict(arrival_cost=True), dict(cost="spline")])
def test_where_all_samples_are_wanted_there_is_no_such_parameter(more):
    component = pseudospectral(DUFFING, sample_time=TS, N=10, L=8, **more)
    assert "tuning.window_length" not in [port.name for port in component.parameters]


def test_the_length_starts_as_the_windows_and_is_between_1_and_that():
    component = pseudospectral(DUFFING, sample_time=TS, N=10, L=8)
    (port,) = [port for port in component.parameters if port.name == "tuning.window_length"]
    assert (port.start, port.min, port.max, port.kind, port.variability) == (8, 1, 8, "Integer", "tunable")
