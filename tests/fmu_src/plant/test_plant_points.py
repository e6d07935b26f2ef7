"""A plant at points and in directions of an observer's choice: what it answers is what its formulas do, whatever was asked before."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from functools import cache

import casadi as ca
import numpy as np
import pytest

import plant_fmu
from fmu_src import PlantFMU
from fmu_src.errors import ExportWarning
from observers.model import Model
from once import compiled_once

Modelled = Callable[..., PlantFMU]


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], PlantFMU]:
    """plant(kind) -> its Model, tried and compiled once."""
    folder = tmp_path_factory.mktemp("plants")

    @cache
    def model(kind: str) -> PlantFMU:
        path = plant_fmu.write(folder / f"{kind}.fmu", plant_fmu.library(), kind)
        with compiled_once():
            return PlantFMU(path, outputs=["y"], inputs=["force"], unknown_parameters=["mu"])

    return model


def rates(model: Model) -> ca.Function:
    """(x, u, known p, unknown p, t) -> dx/dt"""
    e = model.equations
    return ca.Function("rates", [e.x, e.u, e.p, e.theta, e.t], [ca.densify(e.ode)])


def directly(model: PlantFMU) -> ca.Function:
    """The same of the plant's library, with each argument at a place of its own in memory."""
    return ca.external(f"{model.guest.name}_rate", str(model.guest.library))


def van_der_pol(x: list[float], u: float, mu: float) -> list[float]:
    return [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0] + u]


def asked(model: Model, x: list[float], u: float = 0.3, mu: float = 1.5, t: float = 0.0) -> list[float]:
    return [float(value) for value in rates(model)(x, u, [], mu, t).full().ravel()]


@pytest.mark.parametrize("kind", ["discard", "error"])
def test_a_point_that_is_none_or_refused_gives_no_number_and_spoils_no_other(
    plant: Callable[[str], PlantFMU], kind: str
) -> None:
    nan, inf, f = math.nan, math.inf, rates(plant(kind))
    bad = [([nan, 0.5], 0.3, 1, 0.0), ([1, inf], 0.3, 1, 0.0), ([1, 0.5], nan, 1, 0.0), ([1, 0.5], 0.3, nan, 0.0)]
    for mu in (1.5, 2.5):
        for x, u, factor, t in [*bad, ([1, 0.5], 0.3, 1, inf), ([3.0, 0.5], 0.3, 1, 0.0)]:
            assert np.isnan(f(x, u, [], factor * mu, t).full()).all()
            found = f([1.2, 0.5], 0.3, [], mu, 0.0).full().ravel()
            np.testing.assert_allclose(found, van_der_pol([1.2, 0.5], 0.3, mu), rtol=0, atol=1e-14)


def test_time_goes_back_and_before_the_first_one_as_it_goes_on(plant: Callable[[str], PlantFMU]) -> None:
    model = plant("explicit_time")
    for mu, t in ((1.5, 3.0), (1.5, 1.0), (2.0, 4.0), (2.0, -2.0), (1.0, -3.0), (1.0, 0.5), (1.5, -4.0), (1.5, 6.0)):
        wanted = van_der_pol([1.0, 0.5], 0.3, mu)
        wanted[1] += math.sin(3 * t)
        np.testing.assert_allclose(asked(model, [1.0, 0.5], mu=mu, t=t), wanted, rtol=0, atol=1e-14)


def test_a_plant_is_a_function_up_to_its_next_event_and_none_beyond(plant: Callable[[str], PlantFMU]) -> None:
    model = plant("late_event")
    wanted = van_der_pol([1.0, 0.5], 0.3, 2.0)
    asked(model, [1.0, 0.5], mu=2.0)  # from the first change of its parameter on it has one, at t = 15
    for t in (0.0, 14.0, 15.0, 1.0):
        np.testing.assert_allclose(asked(model, [1.0, 0.5], mu=2.0, t=t), wanted, rtol=0, atol=1e-14)
        assert np.isnan(asked(model, [1.0, 0.5], mu=2.0, t=15.001)).all()


def along(model: Model, at: list[object], seeds: list[object]) -> np.ndarray:
    f = rates(model)
    found: np.ndarray = f.forward(1)(*at, f(*at), *seeds).full().ravel()
    return found


@pytest.mark.parametrize("slopes", [True, False])
def test_a_derivative_in_any_direction_is_that_of_the_formulas(modelled: Modelled, slopes: bool) -> None:
    """Seeds of states, input, both parameters and time at once: of like sizes, of sizes eight decades apart, of one alone, of none."""
    model, twin = modelled("pendulum", slopes=slopes), plant_fmu.pendulum()
    for mass, stiffness in ((2.0, 40.0), (3.0, 40.0), (3.0, 50.0), (2.0, 50.0), (2.0, 40.0)):
        point = [[1.1, 0.4, 0.2, -0.3], [0.3], [mass], [stiffness], [1.0]]
        wanted = rates(twin)(*point).full()
        for f in (directly(model), rates(model)):
            np.testing.assert_allclose(f(*point).full(), wanted, rtol=0, atol=1e-13)
    random = np.random.default_rng(2)
    at = [[1.1, 0.4, 0.2, -0.3], [0.3], [2.0], [40.0], [1.0]]
    sizes = [
        np.ones(8),
        10.0 ** np.array([-4, 4, 0, -2, 4, -4, 3, 0]),
        np.eye(8)[0],
        np.eye(8)[4],
        np.eye(8)[5],
        np.eye(8)[6],
    ]
    for size in [*sizes, np.eye(8)[5] + np.eye(8)[6], np.zeros(8)]:
        seed = size * random.uniform(0.5, 1.0, 8) * random.choice([-1, 1], 8)
        parts: list[object] = [seed[:4], seed[4], seed[5], seed[6], seed[7]]
        found, wanted = along(model, at, parts), along(twin, at, parts)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-8 * max(1.0, np.abs(wanted).max()))


def test_a_plant_of_which_neither_input_nor_parameter_is_chosen_has_their_start_values(modelled: Modelled) -> None:
    model = modelled("van_der_pol", inputs=[], unknown_parameters=[])
    found = rates(model)([1.0, 0.5], [], [], [], 0.0).full().ravel()
    np.testing.assert_allclose(found, van_der_pol([1.0, 0.5], 0.0, 1.5), rtol=0, atol=1e-14)
    slope = along(model, [[1.2, 0.5], [], [], [], 0.0], [[1.0, 0.0], [], [], [], 0.0])
    np.testing.assert_allclose(slope, [0.0, -2 * 1.5 * 1.2 * 0.5 - 1], rtol=0, atol=1e-8)


def test_at_the_edge_of_what_the_plant_answers_the_difference_is_to_the_other_side(
    plant: Callable[[str], PlantFMU],
) -> None:
    model, at, seed = plant("discard"), [[2.5, 0.5], [0.3], [], [1.5], [0.0]], [[1.0, 0.0], 0.0, [], 0.0, 0.0]
    found = along(model, at, seed)
    np.testing.assert_allclose(found, [0.0, -2 * 1.5 * 2.5 * 0.5 - 1], rtol=0, atol=1e-4)
    back = along(model, at, [[-1.0, 0.0], 0.0, [], 0.0, 0.0])
    np.testing.assert_allclose(back, -found, rtol=0, atol=1e-12)
    assert np.isnan(along(model, [[2.6, 0.5], *at[1:]], seed)).all()


class Tried(Exception):
    """The plant is about to be tried."""


def test_a_plant_that_needs_its_tool_is_told_of_and_no_other(
    modelled: Modelled, monkeypatch: pytest.MonkeyPatch
) -> None:
    def tried(*_: object) -> None:
        raise Tried

    monkeypatch.setattr("fmu_src.plant.model.examine", tried)
    with (
        pytest.warns(ExportWarning, match=r"plant 'tool\.fmu' needs its tool, or a licence of it, wherever"),
        pytest.raises(Tried),
    ):
        modelled("tool")
    with pytest.warns(ExportWarning, match="needs its tool"), pytest.raises(Tried):
        modelled("van_der_pol", copyright="Requires License of its maker")
    with warnings.catch_warnings(), pytest.raises(Tried):
        warnings.simplefilter("error")
        modelled("van_der_pol", copyright="Its maker")


def test_what_is_chosen_has_the_attributes_that_are_given(modelled: Modelled) -> None:
    given = {
        "y": {"unit": "V", "min": -1.0, "start": 3.0},
        "x0": {"start": 7.0, "min": -5.0, "nominal": 4.0, "wrap": 2.0},
        "force": {"start": 0.25, "nominal": 9.0},
        "mu": {"max": 9.0},
    }
    model = modelled("van_der_pol", attributes=given)
    x0, x1 = model.states
    assert (x0.start, x0.min, x0.nominal, x0.wrap) == (7.0, -5.0, 4.0, 2.0)
    assert (x1.start, x1.min, x1.max, x1.nominal) == (0.5, -math.inf, math.inf, 1.0)
    (force,), (mu,), (y,) = model.inputs, model.unknown_parameters, model.outputs
    assert (force.start, force.nominal, mu.start, mu.max, mu.nominal) == (0.25, 9.0, 1.5, 9.0, 1.5)
    assert (y.unit, y.min, y.max, y.start) == ("V", -math.inf, math.inf, 3.0)  # a sensor may show anything
    assert model.description == "van_der_pol of van_der_pol.fmu" and model.name == "van_der_pol"
