"""The interior point method against an active set solver (daqp), closed forms, and its own generated C."""

import functools
import os
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from fmu_src.native import compiler as native
from observers.pseudospectral.window import quadratic_program as module

WEIGHT = 1e3
quadratic_program = functools.cache(module.quadratic_program)
INF = np.inf


def solve(H, g, A, b, mask=None, lower=None, upper=None, weight=WEIGHT):
    """(s, t, iterations, ok) of the program; without mask all rows are there, without bounds there are none."""
    rows, ns = np.shape(A)
    mask = np.ones(rows) if mask is None else mask
    lower = np.full(ns, -INF) if lower is None else lower
    upper = np.full(ns, INF) if upper is None else upper
    arguments = [np.asarray(value, dtype=float) for value in (H, g, A, b, mask, lower, upper, weight)]
    s, t, iterations, ok = quadratic_program(ns, rows)(*arguments)
    return s.full().ravel(), float(t), int(iterations), bool(ok)


@functools.cache
def active_set(ns, rows):
    n = ns + 1
    shapes = {"h": ca.Sparsity.dense(n, n), "a": ca.Sparsity.dense(rows, n)}
    return ca.conic("active_set", "daqp", shapes, {"daqp": {"primal_tol": 1e-12, "dual_tol": 1e-12}})


def random_program(rng):
    """A program with unit scales: H, g, A, b, mask, lower, upper."""
    ns, rows = int(rng.integers(1, 15)), int(rng.choice([1, 3, 10, 40]))
    R = rng.standard_normal((ns + 1, ns))
    g = rng.standard_normal(ns) * 10 ** rng.uniform(-2, 2)
    b = rng.standard_normal(rows) + rng.uniform(-1, 2)
    lower = np.where(rng.random(ns) < 0.5, -INF, -rng.random(ns))
    upper = np.where(rng.random(ns) < 0.5, INF, rng.random(ns))
    mask = (rng.random(rows) < 0.9).astype(float)
    mask[0] = 1
    return R.T @ R + 1e-3 * np.eye(ns), g, rng.standard_normal((rows, ns)), b, mask, lower, upper


def check(program, columns, weights):
    """Solves it scaled by `columns` of s and `weights` of the rows, and compares with the active set method on the unit scales."""
    H, g, A, b, mask, lower, upper = program
    ns = A.shape[1]
    s, t, _, ok = solve(
        H / np.outer(columns, columns),
        g / columns,
        A * weights[:, None] / columns,
        b * weights,
        mask,
        lower * columns,
        upper * columns,
    )
    there = mask > 0
    penalised = np.block([[H, np.zeros((ns, 1))], [np.zeros((1, ns)), np.eye(1)]])
    reference = active_set(ns, int(there.sum()))(
        h=penalised,
        g=np.append(g, WEIGHT),
        a=np.hstack([A[there], -1 / weights[there, None]]),
        lba=-INF,
        uba=b[there],
        lbx=np.append(lower, 0),
        ubx=np.append(upper, INF),
    )["x"]
    expected = reference.full().ravel()

    def value(s, t):
        return s @ H @ s / 2 + g @ s + WEIGHT * t + t**2 / 2

    assert ok
    assert np.all((s >= lower * columns) & (s <= upper * columns))
    size = 1 + abs(value(expected[:-1], expected[-1]))
    assert value(s / columns, t) == pytest.approx(value(expected[:-1], expected[-1]), abs=1e-8 * size)
    np.testing.assert_allclose(s / columns, expected[:-1], rtol=0, atol=2e-7 * (1e-3 + np.abs(expected[:-1]).max()))


@pytest.mark.parametrize("seed", range(4))
def test_random_programs_have_the_active_set_solvers_solution(seed):
    rng = np.random.default_rng(seed)
    for _ in range(50):
        program = random_program(rng)
        check(program, np.ones(program[0].shape[0]), np.ones(program[2].shape[0]))


@pytest.mark.parametrize("seed", range(10, 14))
def test_scales_from_1e_minus_6_to_1e6_do_not_change_the_solution(seed):
    rng = np.random.default_rng(seed)
    for _ in range(50):
        program = random_program(rng)
        ns, rows = program[0].shape[0], program[2].shape[0]
        check(program, 10.0 ** rng.uniform(-6, 6, ns), 10.0 ** rng.uniform(-3, 3, rows))


def test_a_free_step_that_satisfies_everything_is_the_solution_at_once():
    H, g, A = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([-1.0, 0.3]), np.array([[1.0, 1.0], [-1.0, 2.0]])
    free = -np.linalg.solve(H, g)
    s, t, iterations, ok = solve(H, g, A, A @ free, lower=free, upper=free + 1)
    assert ok and iterations == 0 and t == 0
    np.testing.assert_allclose(s, free, rtol=1e-14)


def test_a_row_in_the_way_is_met_exactly_where_the_penalty_allows():
    s, t, _, ok = solve([[1.0]], [-4.0], [[1.0]], [0.5])
    assert ok and s[0] == pytest.approx(0.5, abs=1e-13) and t == pytest.approx(0, abs=1e-13)


def test_rows_that_contradict_each_other_are_missed_by_the_same_slack():
    # s <= -1 and s >= 1: by symmetry s = 0, t = 1
    s, t, _, ok = solve([[1.0]], [0.0], [[1.0], [-1.0]], [-1.0, -1.0])
    assert ok and s[0] == pytest.approx(0, abs=1e-8) and t == pytest.approx(1, abs=1e-8)


def test_a_small_weight_buys_slack():
    # s = (4 - lam), t = lam - w = s - 1: lam = w + t, so that s = 4 - w - t and t = (3 - w) / 2
    s, t, _, ok = solve([[1.0]], [-4.0], [[1.0]], [1.0], weight=1.0)
    assert ok and t == pytest.approx(1.0, abs=1e-8) and s[0] == pytest.approx(2.0, abs=1e-8)


def test_repeated_and_dependent_rows_are_no_trouble():
    A = np.array([[1.0, 1.0]] * 5 + [[2.0, 2.0], [1.0, 0.0], [0.0, 1.0]])
    s, t, _, ok = solve(np.eye(2), [-3.0, -3.0], A, [1.0] * 5 + [2.0, 0.5, 0.5])
    assert ok and t == pytest.approx(0, abs=1e-8)
    np.testing.assert_allclose(s, [0.5, 0.5], rtol=0, atol=1e-6)  # a vertex where all eight rows meet


def test_rows_that_are_off_may_hold_anything():
    A, b = np.array([[np.nan, INF], [1.0, 0.0], [1.0, 1.0]]), [np.nan, 0.25, INF]
    s, _, _, ok = solve(np.eye(2), [-1.0, -1.0], A, b, mask=[0, 1, 1])
    assert ok
    np.testing.assert_allclose(s, [0.25, 1.0], rtol=0, atol=5e-15)
    s, t, iterations, ok = solve(np.eye(2), [-1.0, -1.0], A, b, mask=[0, 0, 0])
    assert ok and iterations == 0 and t == 0
    np.testing.assert_allclose(s, [1.0, 1.0], rtol=0, atol=1e-15)


def test_the_box_alone_is_honoured_and_may_leave_a_single_value():
    A, b, off = np.zeros((1, 2)), [0.0], [0.0]
    s, _, _, ok = solve(np.array([[1.0, 0.9], [0.9, 1.0]]), [-1.0, -1.0], A, b, off, [-INF, 0.0], [0.1, INF])
    assert ok
    np.testing.assert_allclose(s, [0.1, 1 - 0.09], rtol=0, atol=5e-15)
    s, _, _, ok = solve(np.array([[1.0, 0.9], [0.9, 1.0]]), [-1.0, -1.0], A, b, off, [0.2, -INF], [0.2, INF])
    assert ok and s[0] == 0.2 and s[1] == pytest.approx(1 - 0.18, abs=1e-13)


@pytest.mark.parametrize(
    "changed",
    [
        {"lower": [1.0, 0.0], "upper": [0.0, 1.0]},
        {"H": -np.eye(2)},
        {"H": np.zeros((2, 2))},
        {"H": np.full((2, 2), np.nan)},
        {"g": [np.nan, 0.0]},
        {"g": [INF, 0.0]},
        {"A": [[np.nan, 1.0]]},
        {"A": [[INF, 1.0]]},
        {"b": [np.nan]},
        {"b": [-INF]},
        {"weight": 0.0},
        {"weight": np.nan},
        {"lower": [np.nan, 0.0]},
    ],
    ids=str,
)
def test_what_cannot_be_solved_says_so_and_returns_numbers(changed):
    program = {"H": np.eye(2), "g": [-1.0, -1.0], "A": [[1.0, 1.0]], "b": [0.5]} | changed
    s, t, _, ok = solve(**program)
    assert not ok and np.all(np.isfinite(s)) and t >= 0


def test_a_box_without_inside_returns_the_free_step_cut_to_it():
    s, _, _, ok = solve(np.eye(2), [-1.0, -5.0], [[1.0, 1.0]], [0.5], upper=[2.0, 3.0], lower=[4.0, 0.0])
    assert not ok
    np.testing.assert_array_equal(s, [2.0, 3.0])


def test_sizes_without_anything_to_solve_are_refused():
    with pytest.raises(ValueError, match="of 0 variables and 5 rows"):
        module.quadratic_program(0, 5)
    with pytest.raises(ValueError, match="of 2 variables and 0 rows"):
        module.quadratic_program(2, 0)


def test_the_generated_c_compiles_without_a_warning_and_gives_the_interpreters_numbers(tmp_path: Path):
    function = quadratic_program(3, 10)
    generator = ca.CodeGenerator("program", {"with_header": False})
    generator.add(function)
    generator.generate(f"{tmp_path}/")
    code = (tmp_path / "program.c").read_text()
    assert "malloc" not in code and "#error" not in code
    flags = [flag for flag in native.FLAGS if flag != "-fvisibility=hidden"]
    command = [sys.executable, "-m", "ziglang", "cc", *flags, "-Wno-unused-parameter", *native.LINK]
    cache = str(native.cache_folder())
    environment = os.environ | {"ZIG_GLOBAL_CACHE_DIR": cache, "ZIG_LOCAL_CACHE_DIR": cache}
    subprocess.run([*command, "-o", "program.so", "program.c", "-lm"], cwd=tmp_path, env=environment, check=True)
    compiled = ca.external("quadratic_program", str(tmp_path / "program.so"))
    rng = np.random.default_rng(5)
    kinds = set()
    for level in (-1.0, 0.1, 0.5, 20.0) * 5:
        R, A = rng.standard_normal((4, 3)), rng.standard_normal((10, 3))
        arguments = [R.T @ R + np.eye(3), rng.standard_normal(3), A, np.full(10, level), np.ones(10)]
        arguments += [np.full(3, -INF), np.array([0.5, INF, 2.0]), WEIGHT]
        found, expected = compiled(*arguments), function(*arguments)
        for a, b in zip(found, expected, strict=True):
            np.testing.assert_allclose(a.full(), b.full(), rtol=0, atol=1e-12)
        kinds.add((int(found[2]) > 0, float(found[1]) > 1e-6))
    assert kinds == {(False, False), (True, False), (True, True)}  # the free step, rows met, rows missed
