"""Calvillo-Corona & Alamir's example, and Rössler's system, through the built FMUs and the master."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from build_fmus import FMUS, SYSTEMS
from cosim.results import Result
from observers.component import Component
from observers.instance import Instance
from observers.numerics.layout import Layout
from observers.status import CODE
from reference_models.calvillo_alamir import SAMPLE_TIME
from slave import Slave

OBSERVERS = [
    "van_der_pol_elementary",
    "van_der_pol_signed_elementary",
    "van_der_pol_known_elementary",
    "roessler_elementary",
]


def drive(observer: Instance | Slave, result: Result, name: str, steps: int) -> Iterator[int]:
    """Steps the system's observer with what the master drove the FMU with; gives the number of each step when it is done."""
    sources = [(start, end.split(".")[1]) for start, end in SYSTEMS[name].connections if end.startswith("observer.")]
    for k in range(steps):
        for source, name_in in sources:
            observer.set(name_in, result[source][k])
        observer.step(result.time[k], result.step)
        yield k


def replayed(result: Result, name: str) -> Instance:
    """The Python face of the system's observer, driven with what the FMU was driven with; its outputs are the FMU's at every step."""
    recipe = SYSTEMS[name]
    observer = Instance(FMUS[recipe.fmus["observer"]][0](), recipe.parameters.get("observer", {}))
    names = [f"observer.{port.name}" for port in observer.component.outputs]
    for k in drive(observer, result, name, len(result.time) - 1):
        expected = np.array([result[output][k + 1] for output in names if output in result.names])
        found = [v for v, output in zip(observer.outputs(), names, strict=True) if output in result.names]
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    return observer


def window_errors(result: Result, component: Component, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors of x2 (N) over the window of the last sample, and of the mean of v over its intervals (N - 1), by the state then."""
    N = int(next(port.start for port in component.constants if port.name == "structure.N"))
    layout = Layout(x=2, x_filtered=2, X=2 * N, W=N - 1, rest=component.n_z - 2 - 2 - 2 * N - (N - 1))
    parts = layout.unpack(z)
    true = result["v.y"][:N]
    return parts.X.reshape(N, 2)[:, 1] - result["plant.x.x2"][:N], parts.W - true[: N - 1]


@pytest.fixture(scope="session")
def batch(example: Callable[..., Result]) -> Result:
    return example("calvillo_alamir_full")


def test_the_batch_converges_as_the_errata_say_and_not_as_the_paper_claims(
    example: Callable[..., Result], batch: Result
) -> None:
    iterations = batch["observer.diagnostics.iterations"][-1]
    assert 23 <= iterations <= 27
    assert batch["observer.diagnostics.change"][-1] <= 1e-4
    earlier = example("calvillo_alamir_full", overrides={"observer.tuning.epsilon": 1e-3})
    assert 0.66 <= earlier["observer.diagnostics.contraction"][-1] <= 0.67


def test_the_batchs_error_is_a_shift_along_the_null_direction_and_says_so(batch: Result) -> None:
    observer = replayed(batch, "calvillo_alamir_full")
    x2, v = window_errors(batch, observer.component, observer.z)
    assert 0.40 <= math.sqrt(np.mean(x2**2)) <= 0.43
    assert np.mean(v) == pytest.approx(-np.mean(x2), abs=1e-3)
    assert np.std(x2) <= 0.1 * abs(np.mean(x2))
    assert batch["observer.diagnostics.status"][-1] == CODE.undetermined
    null = [batch[f"observer.diagnostics.null.{name}"][-1] for name in ("x1", "x2", "v")]
    assert null[2] == pytest.approx(-null[1], rel=0.01) and abs(null[0]) <= 1e-6


def test_the_batch_waits_for_a_full_window(batch: Result) -> None:
    assert set(batch["observer.diagnostics.status"][:-1]) == {CODE.propagated_guess}
    assert set(batch["observer.diagnostics.iterations"][:-1]) == {0}


def test_with_the_sign_of_v_known_the_shift_is_resolved(
    example: Callable[..., Result], catalogue_slave: Callable[..., Slave]
) -> None:
    """The last sample, whose iterations take half a minute in Python, is not the master's: the FMU takes it here, which shows its state."""
    name = "calvillo_alamir_full_signed"
    recipe = SYSTEMS[name]
    result = example(name, stop=recipe.stop - recipe.step)
    component = FMUS[recipe.fmus["observer"]][0]()
    slave = catalogue_slave(recipe.fmus["observer"]).initialize(recipe.parameters.get("observer", {}))
    for _ in drive(slave, result, name, len(result.time)):
        pass
    x2, v = window_errors(result, component, slave.z(component.n_z))
    assert abs(np.mean(x2)) <= 0.01 and abs(np.mean(v)) <= 0.01
    assert slave.get("diagnostics.status") == CODE.estimating


def test_the_moving_window_with_v_known_has_an_rms_error_below_1e_4(example: Callable[..., Result]) -> None:
    result = example("calvillo_alamir_horizon")
    full = result.time > 2.0
    for state in ("x1", "x2"):
        error = result[f"observer.estimate.{state}"] - result[f"plant.x.{state}"]
        assert math.sqrt(np.mean(error[full] ** 2)) <= 1e-4
    assert set(result["observer.diagnostics.status"][full]) == {CODE.estimating}


@pytest.mark.parametrize("name", ["calvillo_alamir_horizon", "roessler_elementary"])
def test_the_python_face_and_the_fmu_agree_over_a_whole_run(example: Callable[..., Result], name: str) -> None:
    replayed(example(name), name)


def test_roesslers_three_states_are_estimated_beside_the_pseudospectral_observer(
    example: Callable[..., Result],
) -> None:
    """The same data, from the same guess: both are exact to their discretisation, the pseudospectral observer's is the finer one."""
    largest = {}
    for method in ("elementary", "pseudospectral"):
        result = example(f"roessler_{method}")
        late = result.time > 15.0
        largest[method] = max(
            np.abs((result[f"observer.estimate.{s}"] - result[f"plant.x.{s}"])[late]).max() for s in ("x1", "x2", "x3")
        )
    assert largest["elementary"] <= 1e-4
    assert largest["pseudospectral"] <= largest["elementary"]


def test_the_communication_step_does_not_change_the_estimates(example: Callable[..., Result]) -> None:
    whole = example("roessler_elementary")
    cut = example("roessler_elementary", step=SAMPLE_TIME / 5)
    for state in ("x1", "x2", "x3"):
        gap = np.abs(cut[f"observer.estimate.{state}"][::5] - whole[f"observer.estimate.{state}"])
        assert gap.max() <= 1e-7


def test_a_saved_state_resumes_bit_for_bit_and_nan_is_counted_and_logged(catalogue_slave: Callable) -> None:
    slave = catalogue_slave("van_der_pol_known_elementary").initialize()

    def advance(first: int, count: int) -> None:
        for k in range(first, first + count):
            slave.set("u", math.sin(SAMPLE_TIME * k))
            slave.set("y", math.nan if k == 60 else 0.5 * math.cos(0.15 * k))
            slave.step(SAMPLE_TIME * k, SAMPLE_TIME)
            if k == 60:
                assert slave.get("diagnostics.status") == CODE.sample_rejected
                assert slave.get("diagnostics.rejected_samples") == 1

    advance(0, 50)
    saved = slave.fmu.getFMUState()
    advance(50, 40)
    once = slave.outputs()
    slave.fmu.setFMUState(saved)
    slave.fmu.freeFMUState(saved)
    advance(50, 40)
    assert slave.outputs() == once
    assert all(math.isfinite(value) for value in once.values())
    assert [text for _, category, text in slave.messages if category == "logStatusWarning" and "rejected" in text]


@pytest.mark.parametrize(
    ("name", "value", "word"), [("tuning.q.x1", 0.0, "0"), ("tuning.r.x1.x2", -1.0, "-1"), ("sample_time", 0.1, "")]
)
def test_a_tuning_out_of_range_is_refused_by_name(
    catalogue_slave: Callable, name: str, value: float, word: str
) -> None:
    slave = catalogue_slave("van_der_pol_known_elementary").initialize()
    message = slave.refuses(lambda: slave.set(name, value))
    assert name in message and word in message
