"""What a user gets wrong in a model file is one sentence: the name, what was given, what is wanted, and the line of an equation."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from observers.canonical_dae import canonical_dae
from observers.component import estimated
from observers.controller import controller
from observers.elementary import elementary
from observers.least_squares import least_squares
from observers.model import Model, ModelError, Variable
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.ukf import ukf
from observers.variable import unscaled
from reference_models.plant import plant

METHODS = (canonical_dae, elementary, least_squares, pseudospectral, riccati, ukf)


def pendulum(**changes: Any) -> Model:
    given: dict[str, Any] = {
        "name": "pendulum",
        "states": [Variable("angle", start=1.0), Variable("rate")],
        "inputs": [Variable("torque")],
        "parameters": [Variable("stiffness", start=9.81)],
        "outputs": [Variable("y")],
        "ode": lambda x, u, p, t: [x.rate, -p.stiffness * ca.sin(x.angle) + u.torque],
        "output": lambda x, u, p, t: [x.angle],
    }
    return Model(**(given | changes))


def message(make: Callable[[], Any]) -> str:
    with pytest.raises(ModelError) as caught:
        make()
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


BRANCHES: dict[str, Callable[..., Any]] = {
    "if": lambda x, u, p, t: [x.rate, u.torque if x.angle > 0 else 0],
    "and": lambda x, u, p, t: [x.rate, ca.if_else(x.angle > 0 and x.rate > 0, 1, 0)],
    "or": lambda x, u, p, t: [x.rate, ca.if_else(x.angle > 0 or x.rate > 0, 1, 0)],
    "not": lambda x, u, p, t: [x.rate, ca.if_else(not x.angle > 0, 1, 0)],
    "a chain": lambda x, u, p, t: [x.rate, ca.if_else(0 < x.angle < 1, 1, 0)],
    "min": lambda x, u, p, t: [x.rate, min(x.angle, 1.0)],
    "max": lambda x, u, p, t: [x.rate, max(x.angle, 1.0)],
    "sorted": lambda x, u, p, t: sorted([x.rate, x.angle]),
}


@pytest.mark.parametrize("kind", BRANCHES)
def test_a_branch_of_python_is_named_with_what_casadi_has_for_it(kind: str) -> None:
    said = message(lambda: pendulum(ode=BRANCHES[kind]))
    line = inspect.getsourcelines(BRANCHES[kind])[1]
    assert said.startswith(f"model 'pendulum', ode, line {line} of test_mistakes.py: Python's if, while, and, or")
    assert "ca.if_else(condition, a, b), ca.logic_and(a, b)" in said


def test_a_branch_on_an_array_of_numbers_is_numpys_affair() -> None:
    said = message(lambda: pendulum(ode=lambda x, u, p, t: [x.rate, 1.0 if np.array([1.0, 2.0]) > 0 else x.angle]))
    assert "truth value of an array" in said and "ca.if_else" not in said


MATHS: dict[str, Callable[..., Any]] = {
    "sin": lambda x, u, p, t: [x.rate, -math.sin(x.angle)],
    "sqrt": lambda x, u, p, t: [x.rate, math.sqrt(x.angle + 1)],
    "exp": lambda x, u, p, t: [x.rate, math.exp(-t)],
}


@pytest.mark.parametrize("name", MATHS)
def test_a_function_of_the_module_math_is_named_and_never_a_nan(name: str) -> None:
    said = message(lambda: pendulum(ode=MATHS[name]))
    line = inspect.getsourcelines(MATHS[name])[1]
    assert said.startswith(f"model 'pendulum', ode, line {line} of test_mistakes.py: math.{name} wants a number")
    assert said.endswith(f"write ca.{name}")


def test_float_of_a_symbol_is_refused_in_equations_and_as_casadi_has_it_elsewhere() -> None:
    assert "float(), or a function of the module math, wants a number" in message(
        lambda: pendulum(output=lambda x, u, p, t: [float(x.angle)])
    )
    assert math.isnan(float(ca.SX.sym("s"))) and float(ca.SX(2.0)) == 2.0


def test_a_number_is_still_one_in_an_equation() -> None:
    made = pendulum(ode=lambda x, u, p, t: [x.rate, -math.sin(0.5) * x.angle + float(ca.SX(2.0)) + np.float32(0.5)])
    assert float(ca.evalf(ca.substitute(made.equations.ode[1], made.equations.x, ca.DM.zeros(2)))) == 2.5


@pytest.mark.filterwarnings("error")
def test_numpy_on_symbols_is_what_casadi_makes_of_it_and_says_nothing() -> None:
    by_numpy = pendulum(ode=lambda x, u, p, t: np.array([x.rate, -p.stiffness * np.sin(x.angle) + np.abs(u.torque)]))
    by_casadi = pendulum(ode=lambda x, u, p, t: [x.rate, -p.stiffness * ca.sin(x.angle) + ca.fabs(u.torque)])
    for made in (by_numpy, by_casadi):
        eq = made.equations
        rates = ca.Function("f", [eq.x, eq.u, eq.p], [eq.ode])([0.3, 0.2], -2.0, 9.81)
        np.testing.assert_allclose(rates.full().ravel(), [0.2, -9.81 * math.sin(0.3) + 2], rtol=0, atol=1e-15)


def test_python_s_abs_is_casadi_s() -> None:
    eq = pendulum(ode=lambda x, u, p, t: [x.rate, abs(x.angle)]).equations
    assert float(ca.Function("f", [eq.x], [eq.ode[1]])([-0.3, 0])) == 0.3


def test_an_index_that_is_a_symbol_is_refused() -> None:
    said = message(lambda: pendulum(ode=lambda x, u, p, t: [x.rate, [1, 2][x.angle]]))
    assert "only CasADi's functions take it" in said


@pytest.mark.parametrize(
    ("equations", "wanted"),
    [
        ([1, 2], "ode: a function of (x, u, p, t) is wanted, lambda x, u, p, t: [...], not a list"),
        (lambda x, u: [x.rate, u.torque], "a function of (x, u, p, t) is wanted"),
        (lambda x, u, p, t: x.rate, "ode: a list of expressions is wanted, [...], not one by itself"),
        (lambda x, u, p, t: None, "a list of expressions is wanted, [...], not None"),
        (lambda x, u, p, t: {"angle": x.rate}, "a list of expressions is wanted, [...], not a dict"),
        (lambda x, u, p, t: [x.rate, "0"], "the expression for 'rate' is the text '0', not a scalar"),
        (lambda x, u, p, t: [x.rate, ca.vertcat(x.angle, 1)], "'rate' is not a scalar, its shape is (2, 1)"),
        (lambda x, u, p, t: [x.rate, p.k], "line"),
    ],
)
def test_equations_of_another_form_say_which_is_wanted(equations: Any, wanted: str) -> None:
    assert wanted in message(lambda: pendulum(ode=equations))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Variable("k", start="9.81"), "variable 'k': start is a number, not the text '9.81'"),  # type: ignore[arg-type]
        (lambda: Variable("k", nominal=None), "variable 'k': nominal is a number, not None"),  # type: ignore[arg-type]
        (lambda: Variable("k", min=[0]), "variable 'k': min is a number, not a list"),  # type: ignore[arg-type]
        (lambda: Variable("k", max=True), "variable 'k': max is a number, not the number True"),
        (lambda: Variable("k", 0.2), "variable 'k': description is a text, not the number 0.2"),  # type: ignore[arg-type]
        (lambda: Variable("k", unit=1), "variable 'k': unit is a text, not the number 1"),  # type: ignore[arg-type]
        (lambda: Variable(3), "a variable's name is a text, not the number 3"),  # type: ignore[arg-type]
        (lambda: Variable("k", start=0.2, min=0.5, max=0.1), "variable 'k': min = 0.5 is greater than max = 0.1"),
        (
            lambda: pendulum(states=["angle", "rate"]),
            "entry 1 of states is the text 'angle', where a Variable is wanted",
        ),
        (
            lambda: pendulum(states={"angle": 1.0}),
            "states is a dict, where a list is wanted: states=[Variable(...), ...]",
        ),
        (lambda: pendulum(outputs=Variable("y")), "outputs is a Variable, where a list is wanted"),
        (lambda: pendulum(inputs="torque"), "inputs is the text 'torque', where a list is wanted"),
        (lambda: pendulum(parameters=None), "parameters is None, where a list is wanted"),
        (lambda: pendulum(name=7), "model name 7 is not an identifier"),
    ],
)
def test_a_value_of_another_kind_is_refused_by_the_name_of_its_variable(make: Callable[[], Any], said: str) -> None:
    assert said in message(make)


@pytest.mark.parametrize("method", METHODS)
def test_an_argument_of_another_kind_is_refused_by_its_name(method: Callable[..., Any]) -> None:
    name = method.__name__
    assert f"{name}: sample_time = the text '50 ms', where a number is wanted" in message(
        lambda: method(pendulum(), sample_time="50 ms")
    )
    assert f"{name}: model = the text 'pendulum', where a Model is wanted" in message(
        lambda: method("pendulum", sample_time=0.1)
    )
    assert f"{name}: guess of 'angle' = the text '1', where a number is wanted" in message(
        lambda: method(pendulum(), sample_time=0.1, guess={"angle": "1"})
    )


def test_whole_numbers_texts_and_truths_are_told_apart() -> None:
    assert "pseudospectral: N = the number 12.5, where a whole number is wanted" in message(
        lambda: pseudospectral(pendulum(), sample_time=0.1, N=12.5)  # type: ignore[arg-type]
    )
    assert "plant: max_step = the number True, where a number is wanted" in message(
        lambda: plant(pendulum(), max_step=True)
    )
    assert "controller: name = the number 3, where a text is wanted" in message(
        lambda: controller(3, inputs=[], outputs=[Variable("u")], law=lambda x, p, t: [0.0])  # type: ignore[arg-type]
    )


def test_a_controller_s_law_says_the_same() -> None:
    said = message(
        lambda: controller("law", inputs=[Variable("y")], outputs=[Variable("u")], law=lambda x, p, t: [math.sin(x.y)])
    )
    assert said.startswith("controller 'law', law, line") and said.endswith("write ca.sin")


def test_sizes_that_would_build_for_hours_are_refused_with_what_to_take_instead() -> None:
    many = pendulum(
        states=[Variable(f"x{i}") for i in range(200)],
        ode=lambda x, u, p, t: [u.torque - getattr(x, f"x{i}") for i in range(200)],
        output=lambda x, u, p, t: [x.x0],
    )
    with pytest.raises(ModelError, match=r"has 200 states .* more than 100 .* take riccati"):
        ukf(many, sample_time=0.1)
    with pytest.raises(ValueError, match=r"N = 500 is more than 200, .* or several segments of it"):
        pseudospectral(pendulum(), sample_time=0.05, N=500, L=20)


def test_a_guess_is_named_as_one_with_its_bounds_and_with_the_names_there_are() -> None:
    bounded = pendulum(states=[Variable("angle", start=1.0, max=2.0), Variable("rate")])
    assert (
        message(lambda: ukf(bounded, sample_time=0.1, guess={"angle": 40}))
        == "guess of 'angle' = 40 lies outside [-inf, 2]"
    )
    assert message(lambda: ukf(bounded, sample_time=0.1, guess={"h5": 4})).endswith("; known: angle, rate")


def test_a_name_that_python_has_for_itself_is_told_apart_from_no_name() -> None:
    assert "'lambda' is a word of Python's own: take another" in message(
        lambda: pendulum(parameters=[Variable("stiffness"), Variable("lambda")])
    )
    assert "'a b' is not an identifier" in message(
        lambda: pendulum(parameters=[Variable("stiffness"), Variable("a b")])
    )


TABLES: dict[str, tuple[str, Any, list[float]]] = {
    "a value too few": ("linear", [[0.0, 1.0, 2.0]], [1.0, 2.0]),
    "no order": ("linear", [[0.0, 2.0, 1.0]], [1.0, 2.0, 3.0]),
    "no list of grids": ("linear", [0.0, 1.0, 2.0], [1.0, 2.0, 3.0]),
    "an unknown kind": ("cubic", [[0.0, 1.0, 2.0]], [1.0, 2.0, 3.0]),
}


@pytest.mark.parametrize("kind", TABLES)
def test_a_table_that_casadi_refuses_is_one_sentence_with_the_form_that_it_takes(kind: str) -> None:
    said = message(lambda: pendulum(output=lambda x, u, p, t: [ca.interpolant("ocv", *TABLES[kind])(x.angle)]))
    assert "test_mistakes.py: " in said and "ca.interpolant('ocv', 'linear', [grid], values), or 'bspline'" in said
    assert "casadi/" not in said and len(said) < 400


def test_a_function_of_scipys_on_a_symbol_names_the_users_line() -> None:
    spline = CubicSpline([0, 1, 2, 3], [0, 1, 2, 4])
    said = message(lambda: pendulum(output=lambda x, u, p, t: [spline(x.angle)]))
    assert "test_mistakes.py: " in said and said.endswith("for a table, ca.interpolant")


@pytest.mark.parametrize(("start", "noted"), [(324.5, True), (0.02, True), (-40.0, True), (0.0, False), (29.0, False)])
def test_an_estimate_far_from_its_nominal_value_of_1_is_noted(start: float, noted: bool) -> None:
    made = ukf(pendulum(states=[Variable("angle", start=start), Variable("rate")]), sample_time=0.1)
    (note,) = unscaled(estimated(made)) or [""]
    assert note.startswith("nominal of 'angle' is 1") == noted
    assert unscaled([Variable("angle", start=start, nominal=2.0)]) == []
