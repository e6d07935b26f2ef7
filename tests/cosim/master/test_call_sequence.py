"""The call sequence of FMI 2.0 (4.2.4): FMUs run that refuse every other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.errors import SystemFileError
from cosim.master import run
from cosim.system import Element, System

Strict = Callable[..., Path]
TIMES = 0.1 * np.arange(11)


def chain(fmu: Path, n: int, **options: object) -> System:
    """`n` elements, each driven by the one before: e1.y -> e2.u -> ..."""
    elements = {f"e{i}": Element(fmu, {"gain": 2.0}) for i in range(1, n + 1)}
    return System("chain", elements, [(f"e{i}.y", f"e{i + 1}.u") for i in range(1, n)], stop=1.0, step=0.1, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("dependencies", [True, False])
def test_a_strict_fmu_runs_and_a_direct_output_comes_a_step_late(strict: Strict, dependencies: bool) -> None:
    result = run(chain(strict(dependencies=dependencies), 3), inputs={"e1.u": TIMES + 1})
    # In initialization mode values pass at once; each step then shows the inputs that were set before it.
    late = np.concatenate([[1.0], TIMES[:-1] + 1])
    np.testing.assert_allclose(result["e1.y"], 2 * late, rtol=1e-15)
    np.testing.assert_array_equal(result["e2.y"][2:], 2 * result["e1.y"][1:-1])
    np.testing.assert_array_equal(result["e3.y"][2:], 2 * result["e2.y"][1:-1])
    assert [result[f"e{i}.y"][0] for i in (1, 2, 3)] == [2.0, 4.0, 8.0]
    (note,) = result.notes
    assert "Jacobi" in note and "e1" in note and ("do not declare" in note) is not dependencies


def test_an_fmu_that_says_that_it_has_no_state_steps_last_and_is_not_late(strict: Strict) -> None:
    source, static = strict("source"), strict("static", static=True)
    elements = {"b": Element(static, {"gain": 3.0}), "a": Element(static, {"gain": 2.0}), "source": Element(source)}
    system = System("order", elements, [("source.y", "a.u"), ("a.y", "b.u")], stop=1.0, step=0.1)
    result = run(system, inputs={"source.u": TIMES + 1})
    np.testing.assert_array_equal(result["a.y"], 2 * result["source.y"])
    np.testing.assert_array_equal(result["b.y"], 3 * result["a.y"])
    assert "source.y" in result.notes[0] and "a.y" not in result.notes[0]


def test_a_static_fmu_driven_by_given_values_takes_those_of_the_same_row(strict: Strict) -> None:
    system = System("alone", {"a": Element(strict(static=True), {"gain": 2.0})}, stop=1.0, step=0.1)
    np.testing.assert_array_equal(run(system, inputs={"a.u": TIMES})["a.y"], 2 * TIMES)


def test_a_loop_of_fmus_that_declare_no_dependencies_runs_by_jacobi(strict: Strict) -> None:
    fmu = strict(dependencies=False)
    elements = {"a": Element(fmu, {"u": 1.0}), "b": Element(fmu, {"gain": 0.5})}
    result = run(System("loop", elements, [("a.y", "b.u"), ("b.y", "a.u")], stop=1.0, step=0.1))
    np.testing.assert_array_equal(result["b.y"][1:], 0.5 * result["a.y"][:-1])
    np.testing.assert_array_equal(result["a.y"][1:], result["b.y"][:-1])


def test_a_loop_of_declared_dependencies_is_refused_by_name(strict: Strict) -> None:
    elements = {"a": Element(strict()), "b": Element(strict("other"))}
    with pytest.raises(SystemFileError, match="algebraic loop: ") as caught:
        run(System("loop", elements, [("a.y", "b.u"), ("b.y", "a.u")], stop=1.0, step=0.1))
    assert all(name in str(caught.value) for name in ("a.u", "a.y", "b.u", "b.y"))


def test_static_elements_that_would_have_to_step_twice_run_by_jacobi(strict: Strict) -> None:
    # No loop of variables, for y follows u only and m follows n only; but each element waits for the other.
    fmu = strict(static=True)
    elements = {"a": Element(fmu), "b": Element(fmu)}
    result = run(System("knot", elements, [("a.y", "b.u"), ("b.m", "a.n")], stop=1.0, step=0.1), inputs={"a.u": TIMES})
    np.testing.assert_array_equal(result["b.y"][2:], result["a.y"][1:-1])
    assert "a.y" in result.notes[0]


def test_all_types_pass(strict: Strict) -> None:
    elements = {"a": Element(strict(), {"n": 7, "b": True, "e": "on"}), "b": Element(strict("b"))}
    result = run(System("types", elements, [("a.m", "b.n"), ("a.c", "b.b"), ("a.f", "b.e")], stop=1.0, step=0.1))
    assert [result[f"b.{name}"][-1] for name in ("m", "c", "f")] == [7, 1, 2]


def test_a_step_that_is_pending_is_waited_for(strict: Strict) -> None:
    system = System("pending", {"a": Element(strict(), {"failure": 5, "u": 2.0})}, stop=1.0, step=0.1)
    assert run(system)["a.y"].tolist() == [2.0] * 11


def test_the_tolerance_of_the_default_experiment_reaches_the_fmu(strict: Strict) -> None:
    for tolerance, expected in ((1e-7, 1e-7), (None, -1.0)):
        system = System("tolerance", {"a": Element(strict(tolerance=tolerance), {"failure": 9})}, stop=0.1, step=0.1)
        assert run(system)["a.y"][0] == expected
