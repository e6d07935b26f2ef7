"""How a plant is tried: at which points, what counts as the same, which slopes are right; with plants that are functions here."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from fmu_src.plant import probe
from fmu_src.plant.probe import Refused

REQUEST: dict[str, Any] = {
    "states": [0, 1],
    "derivatives": [100, 101],
    "inputs": [300],
    "outputs": [400],
    "names": {"states": ["a", "b"], "derivatives": ["der(a)", "der(b)"], "outputs": ["y"]},
    "min": [-1e308, 0.0, -1e308],
    "max": [1e308, 1e308, 0.5],
    "unknown": [False, True],
    "parameter_nominals": [1.0, 2.0],
    "parameter_min": [-1e308, -1e308],
    "parameter_max": [1e308, 1e308],
    "directional": True,
    "completes_steps": True,
    "stop": 10.0,
}


class Function:
    """A plant by formulas: `call(v, t)` -> results; `slopes(v)` (results x variables), as it says them."""

    def __init__(self, call: Callable[[np.ndarray, float], Any], slopes: Callable[[np.ndarray], Any] | None = None):
        self.request, self.n, self.call, self.slopes = dict(REQUEST), 2, call, slopes
        self.v, self.t, self.asked, self.restarts = np.zeros(3), 0.0, [], 0
        self.slave = SimpleNamespace(getDirectionalDerivative=self.directional, completedIntegratorStep=self.completed)
        self.steps: list[float] = []
        self.event_after = 1000

    def at(self, v: np.ndarray, t: float) -> np.ndarray:
        self.set(v, t)
        return np.array(self.call(v, t), dtype=float)

    def set(self, v: np.ndarray, t: float) -> None:
        self.v, self.t = v.copy(), t
        self.asked.append((v.copy(), t))

    def restart(self) -> None:
        self.restarts += 1
        self.steps.clear()

    def directional(self, unknown: list[int], known: list[int], seed: list[float]) -> Any:
        assert known == [0, 1, 300] and self.slopes is not None
        rows = slice(0, 2) if unknown == [100, 101] else slice(2, 3)
        return (np.array(self.slopes(self.v)) @ seed)[rows]

    def completed(self) -> tuple[bool, bool]:
        self.steps.append(self.t)
        return len(self.steps) > self.event_after, False


def formulas(v: np.ndarray, t: float) -> list[float]:
    return [v[0] * v[1], np.sin(v[0]) + v[2], v[1] ** 2]


def gradients(v: np.ndarray) -> list[list[float]]:
    return [[v[1], v[0], 0], [np.cos(v[0]), 0, 1], [0, 2 * v[1], 0]]


START, NOMINAL = np.array([1.0, 2.0, 0.25]), np.array([1.0, 10.0, 0.5])


def test_points_lie_around_the_start_within_the_limits_and_reach_three_nominal_values() -> None:
    points, times, sets = probe._points(REQUEST, START, NOMINAL, np.array([5.0, 0.0]))
    assert len(points) == len(times) == 60 and len(sets) == 3
    assert np.array_equal(points[0], START) and times[0] == 0.0
    found = np.array(points)
    assert (
        np.all(found[:, 1] >= 0) and np.all(found[:, 2] <= 0.5) and found[:, 1].min() == 0 and found[:, 2].max() == 0.5
    )
    far = np.abs(found[1:, 0] - START[0])
    for k, reach in enumerate((0.3, 1.0, 3.0)):
        assert 0.7 * reach < far[k::3].max() <= reach
    assert found[1:, 0].min() < START[0] < found[1:, 0].max()
    assert min(times) >= 0 and 9.0 < max(times) <= 10.0
    assert np.array_equal(sets[0], [5.0, 0.0])
    for other in sets[1:]:  # known ones stay; the size of one that is 0 is its nominal value
        assert other[0] == 5.0 and 0 < abs(other[1]) <= 0.2 * 2.0
    assert not np.array_equal(sets[1], sets[2])


def test_sets_of_parameters_keep_to_their_limits() -> None:
    request = REQUEST | {"unknown": [True, True], "parameter_min": [5.0, -1e308], "parameter_max": [1e308, 0.0]}
    _, _, sets = probe._points(request, START, NOMINAL, np.array([5.0, 0.0]))
    assert all(5.0 <= values[0] <= 6.0 and -0.4 <= values[1] <= 0.0 for values in sets)


@pytest.mark.filterwarnings("ignore:All-NaN slice")
def test_results_are_the_same_to_eight_digits_of_the_largest() -> None:
    one = np.array([[1.0, 0.0, 4.0], [-100.0, 0.0, np.nan]])
    assert list(probe._compare(REQUEST, [one, one])) == [100.0, 1.0, 4.0]
    near, apart = one.copy(), one.copy()
    near[0, 0] += 0.9e-6
    apart[0, 0] += 1.1e-6
    assert list(probe._compare(REQUEST, [one, near])) == [100.0, 1.0, 4.0]
    with pytest.raises(Refused, match=r"remembers: der\(a\) at the same point is 1 or 1, by what was asked before"):
        probe._compare(REQUEST, [one, apart])
    refused = one.copy()
    refused[0, 2] = np.nan
    with pytest.raises(Refused, match="remembers: y at the same point is 4 or nan"):
        probe._compare(REQUEST, [one, refused])
    with pytest.raises(Refused, match="gives no derivatives at any of 2 points around its start"):
        probe._compare(REQUEST, [one * np.nan, one])


def test_slopes_are_those_of_the_formulas_to_eight_digits_and_nothing_where_there_is_none() -> None:
    v = np.array([0.7, 1.3, 0.2])
    found = probe._slopes(Function(formulas), v, 0.0, NOMINAL)  # type: ignore[arg-type]
    np.testing.assert_allclose(found, gradients(v), rtol=0, atol=1e-8)
    plant = Function(lambda v, t: [np.nan if v[0] > 0.7 else 0.0, v[1], v[2]])
    assert np.array_equal(probe._slopes(plant, v, 0.0, NOMINAL)[0], [0.0, 0.0, 0.0])  # type: ignore[arg-type]


def test_differences_are_taken_to_either_side_by_a_part_of_the_value_or_the_nominal_one() -> None:
    plant = Function(formulas)
    probe._slopes(plant, np.array([-4.0, 2.0, 0.0]), 3.0, NOMINAL)  # type: ignore[arg-type]
    moves = [(v - [-4.0, 2.0, 0.0], t) for v, t in plant.asked]
    assert {t for _, t in moves} == {3.0}
    sizes = [float(np.abs(d).max()) for d, _ in moves]
    np.testing.assert_allclose(sizes, np.repeat([6e-6 * 4, 6e-6 * 10, 6e-6 * 0.5], 2), rtol=0, atol=1e-14)
    for up, down in zip(moves[::2], moves[1::2], strict=True):
        np.testing.assert_allclose(up[0], -down[0], rtol=0, atol=1e-14)


def believed(slopes: Callable[[np.ndarray], Any] | None, **request: Any) -> tuple[tuple[bool, bool], int]:
    plant, v = Function(formulas, slopes), np.array([0.7, 1.3, 0.2])
    plant.request |= request
    J, scale = np.array(gradients(v)), np.array([10.0, 10.0, 10.0])
    return probe._directional(plant, v, 0.0, J, scale, NOMINAL), plant.restarts  # type: ignore[arg-type]


def changed(row: int, column: int, by: float) -> Callable[[np.ndarray], Any]:
    def slopes(v: np.ndarray) -> Any:
        J = np.array(gradients(v))
        J[row, column] += by
        return J

    return slopes


def test_directional_derivatives_are_believed_where_they_are_right_to_a_thousandth() -> None:
    assert believed(gradients) == ((True, True), 0)
    assert believed(gradients, directional=False) == ((False, False), 0)
    slope = 1.3
    assert believed(changed(0, 0, 0.9e-3 * slope)) == ((True, True), 0)
    assert believed(changed(0, 0, 1.1e-3 * slope)) == ((False, True), 0)
    assert believed(changed(0, 0, -1.1e-3 * slope)) == ((False, True), 0)
    assert believed(changed(2, 1, 1.1e-3 * 2 * slope)) == ((True, False), 0)
    # A slope that is 0 is compared with a hundredth of the result's size by the variable's nominal value.
    assert believed(changed(2, 0, 0.9e-3 * 0.1)) == ((True, True), 0)
    assert believed(changed(2, 0, 1.1e-3 * 0.1)) == ((True, False), 0)
    assert believed(lambda v: np.array(gradients(v)) * np.nan) == ((False, False), 0)


@pytest.mark.parametrize(("status", "restarts"), [(2, 0), (3, 2)])
def test_directional_derivatives_that_are_refused_are_not_believed(status: int, restarts: int) -> None:
    def refuse(_: np.ndarray) -> Any:
        raise FMICallException("fmi2GetDirectionalDerivative", status)

    assert believed(refuse) == ((False, False), restarts)


def stepped(call: Callable[[Function, np.ndarray], list[float]], **request: Any) -> Function:
    plant = Function(lambda v, t: call(plant, v))
    plant.request |= request
    probe._complete_steps(plant, START, np.ones(3), START)  # type: ignore[arg-type]
    return plant


def test_ten_completed_steps_to_the_stop_time_leave_nothing_behind() -> None:
    plant = stepped(lambda plant, v: [v[0], v[1], v[2]])
    assert plant.restarts == 1 and [t for _, t in plant.asked][:11] == [*(k * 1.0 for k in range(10)), 9.0]
    points = np.array([v for v, _ in plant.asked[:10]])
    assert len({tuple(point) for point in points}) == 10 and np.array_equal(plant.asked[-1][0], START)
    assert stepped(lambda plant, v: [0, 0, float(len(plant.steps))], completes_steps=False).asked == []
    with pytest.raises(
        Refused, match=r"keeps a memory between steps \(a delay\): y at the same point is 0, after steps 10"
    ):
        stepped(lambda plant, v: [0, 0, float(len(plant.steps))])
    stepped(lambda plant, v: [0, 0, 0.9e-9 * len(plant.steps)])
    with pytest.raises(Refused, match=r"der\(b\) at the same point is 0, after steps 1\.1e-08"):
        stepped(lambda plant, v: [0, 1.1e-9 * len(plant.steps), 0])


def test_an_event_that_a_step_wants_is_told_with_its_time() -> None:
    plant = Function(formulas)
    plant.event_after = 3
    with pytest.raises(Refused, match=r"it wants an event after the step to t = 3$"):
        probe._complete_steps(plant, START, np.ones(3), START)  # type: ignore[arg-type]


@pytest.mark.parametrize("resets", [True, False])
def test_after_an_error_the_plant_is_reset_or_made_anew_with_the_parameters_that_it_had(resets: bool) -> None:
    calls: list[object] = []

    def reset() -> None:
        calls.append("reset")
        if not resets:
            raise FMICallException("fmi2Reset", 3)

    slave = SimpleNamespace(
        reset=reset,
        component=77,
        fmi2FreeInstance=lambda component: calls.append(("free", component)),
        instantiate=lambda callbacks: calls.append(("instantiate", callbacks)),
    )
    plant = SimpleNamespace(slave=slave, callbacks="callbacks", values="values")
    plant.initialise = lambda values: calls.append(("initialise", values))
    probe.Plant.restart(plant)  # type: ignore[arg-type]
    anew = [] if resets else [("free", 77), ("instantiate", "callbacks")]
    assert calls == ["reset", *anew, ("initialise", "values")]


def asked(status: int | None = None, moves: float = 0.0, next_event: float = 5.0, t: float = 1.0) -> tuple[Any, int]:
    """What a plant of two states and one output answers at [1, 2, 3], and how often it was restarted; `status`: it refuses by that."""
    restarts: list[int] = []

    def derivatives(d: Any, n: int) -> None:
        if status is not None:
            raise FMICallException("fmi2GetDerivatives", status)
        d[:] = [10.0, 20.0]

    plant = SimpleNamespace(
        n=2,
        request=REQUEST,
        next_event=next_event,
        slave=SimpleNamespace(getDerivatives=derivatives),
        set=lambda v, t: None,
        read=lambda references: [30.0 for _ in references],
        states=lambda: np.array([1.0, 2.0 + moves]),
        restart=lambda: restarts.append(1),
    )
    return probe.Plant.at(plant, np.array([1.0, 2.0, 3.0]), t), len(restarts)  # type: ignore[arg-type]


def test_a_point_has_the_derivatives_and_outputs_or_as_many_that_are_no_numbers() -> None:
    found, restarts = asked()
    assert list(found) == [10.0, 20.0, 30.0] and restarts == 0
    for status, t, again in ((2, 1.0, 0), (3, 1.0, 1), (None, 5.001, 0)):
        found, restarts = asked(status, t=t)
        assert found.shape == (3,) and np.isnan(found).all() and restarts == again
    assert list(asked(t=5.0)[0]) == [10.0, 20.0, 30.0]


def test_a_point_that_ends_the_plant_or_moves_its_states_ends_the_trial() -> None:
    with pytest.raises(Refused, match="ends for good at a point near its start: fmi2GetDerivatives answers fmi2Fatal"):
        asked(4)
    with pytest.raises(Refused, match=r"changes its own states: 'b' was set to 2 and is 2\.5 once its derivatives"):
        asked(moves=0.5)
