"""Plants with algebraic variables: against scipy and closed forms, up to the singularity and no further."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from scipy.integrate import solve_ivp

from components import COMPONENTS
from observers.instance import Instance
from observers.model import Model, Variable
from reference_models.plant import plant
from rlc_branches import STARTS
from slave import Slave

Make = Callable[..., Slave]

STEP = 0.05


def reduced(x1: float, x2: float, guess: float):
    """scipy's solution of (41) with the algebraic equation differentiated, until |dg/dx3| is 1e-5; x3 at the start by numpy's roots."""
    roots = np.roots([1, 0, -1, 1 - x1])
    real = roots[abs(roots.imag) < 1e-9].real + 1
    x3 = real[np.argmin(abs(real - guess))]

    def slope(t: float, s: np.ndarray) -> list[float]:
        return [s[1], -s[1] - s[2] + 1, s[1] / (3 * (s[2] - 1) ** 2 - 1)]

    def singular(t: float, s: np.ndarray) -> float:
        return abs(3 * (s[2] - 1) ** 2 - 1) - 1e-5

    singular.terminal = True  # type: ignore[attr-defined]
    return solve_ivp(
        slope, (0, 20), [x1, x2, x3], method="DOP853", rtol=1e-13, atol=1e-14, events=singular, dense_output=True
    )


def run_to_the_end(step: Callable[[float, float], object], read: Callable[[], list[float]]) -> list[list[float]]:
    """Rows [x1, x2, x3] at 0, STEP, 2 STEP, ... until a step is refused."""
    rows = [read()]
    with pytest.raises((FMICallException, ValueError)):
        for k in range(400):
            step(k * STEP, STEP)
            rows.append(read())
    return rows


@pytest.mark.parametrize("start", STARTS, ids=str)
def test_every_branch_of_the_circuit_is_followed_to_its_singularity(
    slave: Make, start: tuple[float, float, float]
) -> None:
    names = dict(zip(("start.x1", "start.x2", "start.x3"), start, strict=True))
    expected = reduced(*start)
    fmu = slave("rlc").initialize(names)
    rows = run_to_the_end(fmu.step, lambda: [fmu.get("x.x1"), fmu.get("x.x2"), fmu.get("z.x3")])
    end = expected.t[-1]
    assert 2.8 < end < 5.7  # the errata's times
    assert len(rows) == math.floor(end / STEP) + 1  # the step that would cross the singularity is refused
    times = STEP * np.arange(len(rows))
    regular = times < end - 2 * STEP
    np.testing.assert_allclose(np.array(rows)[regular], expected.sol(times[regular]).T, rtol=0, atol=2e-11)
    x1, _, x3 = np.array(rows).T
    np.testing.assert_allclose(-x1 + (x3 - 1) ** 3 - (x3 - 1) + 1, 0, rtol=0, atol=3e-14)

    status, category, text = fmu.messages[-1]
    assert (status, category) == (3, "logStatusError")
    found = re.fullmatch(
        r"rlc: the algebraic equations do not determine 'x3' \(singular, or no solution nearby\) at t = (\S+), "
        r"where the smallest pivot of dg/dz is (\S+)\.",
        text,
    )
    assert found is not None, text
    assert float(found[1]) == pytest.approx(end, abs=1e-3) and 0 < float(found[2]) < 0.1


def test_both_faces_end_at_the_singularity_with_the_same_words_and_the_last_good_state(slave: Make) -> None:
    fmu, face = slave("rlc").initialize(), Instance(COMPONENTS["rlc"]())
    run_to_the_end(fmu.step, lambda: [fmu.get("z.x3")])
    rows = run_to_the_end(face.step, lambda: [face.get("z.x3")])
    before, t = fmu.state(), STEP * (len(rows) - 1)
    with pytest.raises(ValueError) as caught:
        face.step(t, STEP)
    assert fmu.refuses(lambda: fmu.step(t, STEP)) == f"{caught.value}."
    assert fmu.state() == before and face.get("z.x3") == fmu.get("z.x3") == rows[-1][0]


def test_a_draining_tank_follows_torricellis_law_until_it_is_empty(slave: Make) -> None:
    fmu = slave("draining_toy").initialize({"start.level": 1.44})
    assert (fmu.get("z.outflow"), fmu.get("z.head")) == pytest.approx((1.2, 1.44), rel=1e-15, abs=0)
    for k in range(23):
        fmu.step(0.1 * k, 0.1)
        left = 1.2 - 0.05 * (k + 1)
        assert (fmu.get("x.level"), fmu.get("y")) == pytest.approx((left**2, left), abs=4e-15)
    message = fmu.refuses(lambda: fmu.step(2.3, 0.1))  # empty at 2.4
    assert re.search(r"the algebraic equations do not determine 'outflow' .* at t = 2\.39\d", message)


def test_algebraic_variables_follow_an_input_at_once(slave: Make) -> None:
    fmu = slave("draining_toy").initialize()
    fmu.step(0.0, 0.1)
    level = fmu.get("x.level")
    fmu.set("lift", 8.0)
    assert fmu.get("y") == pytest.approx(math.sqrt(level + 8), rel=1e-15, abs=0)
    fmu.step(0.1, 0.1)
    assert fmu.get("x.level") + 8 == pytest.approx((math.sqrt(level + 8) - 0.05) ** 2, rel=2e-15, abs=0)


def test_start_values_without_a_solution_are_refused_by_both_faces(slave: Make) -> None:
    fmu = slave("draining_toy")
    fmu.set("start.level", -1.0)
    fmu.fmu.setupExperiment()
    fmu.fmu.enterInitializationMode()
    words = "the algebraic equations do not determine 'outflow'"
    message = fmu.refuses(fmu.fmu.exitInitializationMode)
    assert words in message and "for the start values" in message
    fmu.set("start.level", 1.0)
    fmu.fmu.exitInitializationMode()
    with pytest.raises(ValueError, match=words):
        Instance(COMPONENTS["draining_toy"](), {"start.level": -1.0})


def test_an_input_that_is_not_a_number_is_named_not_the_equation(slave: Make) -> None:
    fmu = slave("draining_toy").initialize()
    fmu.set("lift", math.nan)
    assert "where the input lift is nan" in fmu.refuses(lambda: fmu.step(0.0, 0.1))
    fmu.set("lift", 0.0)
    fmu.step(0.0, 0.1)


# z^3 - 3 z = x with x = t: the lowest of three branches ends at x = 2, where the highest still has a solution.
FOLD = Model(
    name="fold",
    states=[Variable("x")],
    algebraic=[Variable("z")],
    outputs=[Variable("y")],
    ode=lambda x, z, u, p, t: [1],
    output=lambda x, z, u, p, t: [x.x],
    algebraic_equations=lambda x, z, u, p, t: [z.z**3 - 3 * z.z - x.x],
)


@pytest.mark.parametrize(("guess", "end"), [(-1.7, 2.0), (0.1, None), (1.7, None)])
def test_a_branch_of_the_algebraic_equations_is_followed_to_its_end_and_never_left_for_another(guess, end) -> None:
    run = Instance(plant(FOLD, max_step=0.05), {"start.z": guess})
    branch = {-1.7: 0, 0.1: 1, 1.7: 2}[guess]
    steps = 19 if end else 18
    for k in range(steps):
        x = 0.1 * k
        roots = np.sort(np.roots([1, 0, -3, -x]).real)
        assert run.get("z.z") == pytest.approx(roots[branch], abs=2e-14)
        run.step(x, 0.1)
    if end:
        with pytest.raises(ValueError, match=r"fold: the algebraic equations do not determine 'z' .* at t = (1\.9|2)"):
            for k in range(steps, 25):
                run.step(0.1 * k, 0.1)
        assert run.get("z.z") < -1


def test_of_a_step_whose_substeps_all_fail_the_first_failure_is_told() -> None:
    """The branch ends at t = 0.7, in the fourteenth of a hundred substeps."""
    run = Instance(plant(FOLD, max_step=0.05), {"start.x": 1.3, "start.z": np.sort(np.roots([1, 0, -3, -1.3]).real)[0]})
    with pytest.raises(ValueError, match=r"'z' .* at t = 0\.(6[5-9]|7)"):
        run.step(0.0, 5.0)


def test_an_input_that_leaves_no_solution_fails_at_the_time_from_which_it_holds() -> None:
    """t = 0 here, the first of ten substeps that all fail."""
    root = Model(
        name="root",
        states=[Variable("x")],
        algebraic=[Variable("z", start=1.0)],
        inputs=[Variable("u", start=1.0)],
        outputs=[Variable("y")],
        ode=lambda x, z, u, p, t: [z.z],
        output=lambda x, z, u, p, t: [x.x],
        algebraic_equations=lambda x, z, u, p, t: [z.z**2 - u.u],
    )
    run = Instance(plant(root, max_step=0.05), inputs={"u": 1.0})
    run.set("u", -1.0)
    with pytest.raises(ValueError, match=r"root: .* 'z' .* at t = 0,"):
        run.step(0.0, 0.5)


def test_no_step_leaps_over_the_end_of_a_branch_to_another_wherever_it_begins() -> None:
    """Newton's method, left to itself, finds the other branch from some of these beginnings."""
    fold = plant(FOLD, max_step=0.5)
    for x in np.linspace(0.5, 1.95, 30):
        run = Instance(fold, {"start.x": x, "start.z": np.sort(np.roots([1, 0, -3, -x]).real)[0]})
        with pytest.raises(ValueError, match="fold: the algebraic equations do not determine 'z'"):
            for k in range(4):
                run.step(0.5 * k, 0.5)
        assert run.get("z.z") < -1
