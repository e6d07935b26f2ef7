"""The kernels that generated code is made of, against numpy and closed forms: every one, at sizes with a remainder too."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

from observers.model import Model, Variable
from observers.numerics import algebraic, linear, rank, semilinear, tiles
from observers.numerics.exact import TRUSTED, matrix, rounded, table
from observers.numerics.finite import finite, kept
from observers.numerics.index_one import algebraic_solver
from observers.numerics.layout import Layout
from observers.numerics.runge_kutta import DORMAND_PRINCE_8, stable_step


def of(function, *arrays):
    """`function` of symbols of the arrays' shapes, at the arrays."""
    symbols = [ca.SX.sym(f"a{i}", *np.shape(a)) for i, a in enumerate(arrays)]
    made = function(*symbols)
    results = ca.Function("f", symbols, list(made) if isinstance(made, tuple) else [made])(*arrays)
    return [r.full() for r in results] if isinstance(results, tuple) else results.full()


def regular(n: int, seed: int = 0) -> np.ndarray:
    return np.eye(n) * 3 + np.random.default_rng(seed).normal(size=(n, n))


@pytest.mark.parametrize("n", [1, 2, 5])
def test_triangular_solves_and_the_inverse_are_numpys(n: int) -> None:
    A, b = regular(n), np.random.default_rng(1).normal(size=(2, n))
    L = np.tril(A)
    np.testing.assert_allclose(of(linear.left_transposed, L, b), b @ np.linalg.inv(L), rtol=0, atol=1e-14)
    np.testing.assert_allclose(of(linear.inverse, A), np.linalg.inv(A), rtol=0, atol=1e-14)
    np.testing.assert_allclose(of(linear.qr_solve, A, b.T), np.linalg.solve(A, b.T), rtol=0, atol=1e-14)
    H = A @ A.T
    np.testing.assert_allclose(linear.solver(n, 2)(H, b.T).full(), np.linalg.solve(H, b.T), rtol=0, atol=1e-13)


@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 5), (4, 4)])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_a_square_root_is_choleskys_of_a_times_its_transpose(n: int, m: int, scale: float) -> None:
    A = scale * np.random.default_rng(2).normal(size=(n, m))
    np.testing.assert_allclose(of(linear.square_root, A), np.linalg.cholesky(A @ A.T), rtol=0, atol=1e-14 * scale)


def test_a_square_root_of_dependent_rows_has_a_zero_not_a_division_by_one() -> None:
    S = of(linear.square_root, np.array([[3.0, 4.0], [6.0, 8.0]]))
    np.testing.assert_array_equal(S, [[5, 0], [10, 0]])


@pytest.mark.parametrize("total", [1, 9, 10, 11, 23])
@pytest.mark.parametrize("columns", [1, 3])
def test_tiles_solve_what_numpy_solves_whatever_is_left_of_the_last_tile(total: int, columns: int) -> None:
    A, b = np.eye(total) + 0.3 * np.random.default_rng(3).normal(size=(total, total)) / total, regular(total)[:, :1]
    b = np.random.default_rng(4).normal(size=(total, columns))
    offsets = np.cumsum([0, *tiles.sizes(total, tiles.TILE)]).tolist()
    assert offsets[-1] == total and max(np.diff(offsets)) <= tiles.TILE
    blocks = [list(row) for row in ca.blocksplit(ca.DM(A), offsets, offsets)]
    found = ca.vertcat(*tiles.solve_tiles(blocks, list(ca.vertsplit(ca.DM(b), offsets)))).full()
    np.testing.assert_allclose(found, np.linalg.solve(A, b), rtol=0, atol=1e-14)


def test_tiles_of_zeros_need_not_be_there() -> None:
    """An arrow, whose elimination fills what was empty, and a tile that stands alone."""
    rng, n, each = np.random.default_rng(5), 5, 2
    there = np.eye(n, dtype=bool)
    there[0, :4] = there[:4, 0] = True
    A = np.eye(n * each) + 0.2 * rng.normal(size=(n * each, n * each)) * np.kron(there, np.ones((each, each)))
    b = rng.normal(size=(n * each, 3))
    of_tile = [slice(k * each, (k + 1) * each) for k in range(n)]
    grid = [[ca.DM(A[i, k]) if there[r, c] else None for c, k in enumerate(of_tile)] for r, i in enumerate(of_tile)]
    found = ca.vertcat(*tiles.solve_tiles(grid, [ca.DM(b[i]) for i in of_tile])).full()
    np.testing.assert_allclose(found, np.linalg.solve(A, b), rtol=0, atol=1e-14)


def test_groups_are_full_but_for_the_last() -> None:
    assert tiles.sizes(10, 10) == [10] and tiles.sizes(23, 10) == [10, 10, 3] and tiles.sizes(3, 10) == [3]
    assert tiles.sizes(0, 10) == []


def test_products_of_tiles_add_and_subtract() -> None:
    c, a, b = (np.random.default_rng(i).normal(size=shape) for i, shape in enumerate([(2, 3), (2, 4), (4, 3)]))
    np.testing.assert_allclose(tiles.multiply_add(2, 4, 3, 1.0)(c, a, b).full(), c + a @ b, rtol=0, atol=1e-15)
    np.testing.assert_allclose(tiles.multiply_add(2, 4, 3, -1.0)(c, a, b).full(), c - a @ b, rtol=0, atol=1e-15)
    np.testing.assert_allclose(tiles.product(2, 4)(a, b[:, 0]).full().ravel(), a @ b[:, 0], rtol=0, atol=1e-15)


def test_a_constant_is_rounded_only_where_it_is_known_well_enough() -> None:
    from flint import arb

    known, lost = arb(3.0, 0.9 * TRUSTED * 3), arb(3.0, 1.1 * TRUSTED * 3)
    assert rounded(np.array([known], dtype=object)).tolist() == [3.0]
    with pytest.raises(ValueError, match="largest 3"):
        rounded(np.array([lost], dtype=object))
    small = np.array([arb(1e-9, 0.9 * TRUSTED), arb(1e-9)], dtype=object)  # measured against 1 where all are smaller
    assert rounded(small).tolist() == [1e-9, 1e-9]
    values = np.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(rounded(table(matrix(values))), values)


def test_what_counts_as_finite_ends_at_1e150() -> None:
    value = ca.DM([1e150, -1e150, 1.1e150, -1.1e150, math.inf, math.nan, 0])
    assert finite(value).full().ravel().tolist() == [1, 1, 0, 0, 0, 0, 1]
    assert [float(kept(value[i], 7)) for i in range(7)] == [1e150, -1e150, 7, 7, 7, 7, 0]


def test_a_layout_packs_what_it_unpacks_and_refuses_the_rest() -> None:
    layout = Layout(a=2, nothing=0, b=1)
    z = ca.DM([1, 2, 3])
    parts = layout.unpack(z)
    assert layout.total == 3 and parts.a.full().ravel().tolist() == [1, 2] and parts.nothing.shape == (0, 1)
    assert layout.replace(z, b=9).full().ravel().tolist() == [1, 2, 9]
    with pytest.raises(ValueError, match=r"parts \['b'\] are missing or unknown"):
        layout.pack({"a": ca.DM(2, 1), "nothing": ca.DM(0, 1)})
    with pytest.raises(ValueError, match="part 'a' has 3 entries, expected 2"):
        layout.pack({"a": ca.DM(3, 1), "nothing": ca.DM(0, 1), "b": 1})


def test_the_kernel_of_a_matrix_is_measured_row_by_row() -> None:
    A = np.array([[1e-9, 2e-9, 0], [0, 0, 5e8]])  # rows of any size count alike
    (row,) = rank.kernel(A)
    np.testing.assert_allclose(np.abs(row), np.array([2, 1, 0]) / math.sqrt(5), rtol=0, atol=1e-15)
    assert rank.kernel(np.eye(3)).shape == (0, 3) and rank.kernel(np.zeros((2, 3))).shape == (3, 3)
    assert rank.kernel(np.zeros((0, 2))).shape == (2, 2) and rank.kernel(np.zeros((2, 0))).shape == (0, 0)
    for gap, found in ((1e-7, 0), (1e-9, 1)):
        assert len(rank.kernel(np.array([[1.0, 0.0], [1.0, gap]]))) == found


def test_what_an_output_never_shows_is_found_for_slow_and_fast_modes() -> None:
    A = np.array([[-1.0, 0, 0], [0, -1e6, 0], [1, 0, -2]])
    hidden = rank.unobservable(A, np.array([[1.0, 1.0, 0.0]]))
    np.testing.assert_allclose(np.abs(hidden), [[0, 0, 1]], rtol=0, atol=1e-9)
    assert len(rank.unobservable(A, np.array([[0.0, 1.0, 1.0]]))) == 0
    chain = np.diag(np.ones(3), 1)  # the last of a chain of integrators is seen through all others
    assert len(rank.unobservable(chain, np.eye(4)[:1])) == 0
    assert len(rank.unobservable(chain, np.eye(4)[1:2])) == 1


def test_an_input_through_a_settable_gain_becomes_an_input() -> None:
    made = Model(
        name="gains",
        states=[Variable("a"), Variable("b"), Variable("c")],
        inputs=[Variable("u"), Variable("v")],
        parameters=[Variable("k", start=2.0), Variable("g", start=3.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [p.k * u.u + p.g * u.v - x.a, u.u * x.a + 4 * u.v, p.k * ca.floor(u.u)],
        output=lambda x, u, p, t: [x.a + x.b + x.c],
    )
    eq, lift = semilinear.lift_inputs(made.equations)
    assert eq.u.numel() == 3  # only the first row's
    u, p, x = [0.7, -1.2], [2.0, 3.0], [0.1, 0.2, 0.3]
    lifted = lift(u, p).full().ravel()
    assert lifted.tolist() == pytest.approx([0.7, -1.2, 2 * 0.7 - 3 * 1.2], abs=1e-15)
    symbols = [eq.x, eq.u, eq.p, eq.t]
    moved = ca.Function("f", symbols, [eq.ode])(x, lifted, p, 0).full().ravel()
    old = made.equations
    before = ca.Function("f", [old.x, old.u, old.p, old.t], [old.ode])(x, u, p, 0).full().ravel()
    np.testing.assert_allclose(moved, before, rtol=0, atol=1e-15)
    parts = semilinear.split(eq.ode, eq.x, eq.u)
    assert parts.B[0].tolist() == [0, 0, 1] and parts.B[1].tolist() == [0, 4, 0]


@pytest.mark.parametrize("jump", [ca.floor, ca.ceil, ca.sign, lambda a: ca.fmod(a, 1), lambda a: ca.remainder(a, 1)])
def test_a_row_that_jumps_is_never_taken_for_a_linear_one(jump) -> None:
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u")
    parts = semilinear.split(ca.vertcat(2 * x[1] + jump(x[0]), 3 * x[0] - u), x, u)
    np.testing.assert_array_equal(parts.A, [[0, 0], [3, 0]])
    np.testing.assert_array_equal(parts.B, [[0], [-1]])
    assert (parts.rows, parts.states) == ([0], [0, 1])


def test_what_an_output_sees_through_a_chain_of_any_length_is_reached() -> None:
    n = 6
    x = ca.SX.sym("x", n)
    chain = ca.vertcat(*[x[i + 1] for i in range(n - 1)], 0)
    assert semilinear.unreachable(chain, x[0], x, x) == []
    assert semilinear.unreachable(chain, x[2], x, x) == [0, 1]


def implicit() -> Model:
    """Two algebraic variables with closed forms: q = exp(-x) by log q = -x, r = q + u + t."""
    return Model(
        name="implicit",
        states=[Variable("x", start=0.5)],
        algebraic=[Variable("q", start=0.5), Variable("r", start=1.0, nominal=2.0)],
        inputs=[Variable("u")],
        parameters=[Variable("k", start=2.0)],
        unknown_parameters=[Variable("theta", start=0.3)],
        outputs=[Variable("y")],
        ode=lambda x, z, u, p, t: [-p.k * z.r + p.theta],
        output=lambda x, z, u, p, t: [z.q + 3 * z.r + t],
        algebraic_equations=lambda x, z, u, p, t: [ca.log(z.q) + x.x, z.r - z.q - u.u - t],
    )


def test_algebraic_variables_are_eliminated_in_motion_and_measurement() -> None:
    eq = implicit().equations
    x, u, p, theta, t = 0.4, 0.2, 2.0, 0.3, 1.5
    q = math.exp(-x)
    r = q + u + t
    rate, z = algebraic.motion(eq)(x, u, p, theta, t, [q + 1e-3, r - 1e-3])
    assert float(rate) == pytest.approx(-p * r + theta, abs=1e-13)
    assert z.full().ravel().tolist() == pytest.approx([q, r], abs=1e-13)
    y, z = algebraic.measurement(eq)(x, u, p, theta, t, [q, r])
    assert float(y) == pytest.approx(q + 3 * r + t, abs=1e-13)
    z, lost = algebraic.followed(eq, [1.0, 2.0])(x, [q + 1e-3, r], u, p, theta, t)
    assert z.full().ravel().tolist() == pytest.approx([q, r], abs=1e-13) and float(lost) == 0


def test_newtons_method_takes_three_steps_of_second_order() -> None:
    z, a = ca.SX.sym("z"), ca.SX.sym("a")
    found = ca.Function("f", [z, a], [ca.substitute(algebraic.solution(z**2 - a, z, ca.SX(1.5)), ca.SX.sym("b"), 0)])
    by_hand = 1.5
    for _ in range(3):
        by_hand = (by_hand + 2 / by_hand) / 2
    assert float(found(0, 2)) == pytest.approx(by_hand, abs=1e-15)


def circle(follow: bool) -> ca.Function:
    """z1^2 + x^2 = 1, z2 = 2 z1: two branches that meet at x = 1; the first variable is the one that is lost."""
    made = Model(
        name="circle",
        states=[Variable("x")],
        algebraic=[Variable("z1", start=1.0), Variable("z2", start=2.0, nominal=2.0)],
        outputs=[Variable("y")],
        ode=lambda x, z, u, p, t: [z.z2],
        output=lambda x, z, u, p, t: [x.x],
        algebraic_equations=lambda x, z, u, p, t: [z.z1**2 + x.x**2 - 1, z.z2 - 2 * z.z1],
    )
    return algebraic_solver(made.equations, [1.0, 2.0], follow=follow)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_solution_is_followed_on_its_branch_and_lost_where_it_ends(sign: float) -> None:
    empty = np.zeros(0)
    z, failure, pivot = circle(True)(0.6, sign * np.array([0.85, 1.7]), empty, empty, empty, 0)
    assert z.full().ravel().tolist() == pytest.approx([sign * 0.8, sign * 1.6], abs=1e-14) and float(failure) == 0
    # g_z = [[2 z1, 0], [-2, 1]] at the known solution, by rotations: its smaller pivot is det / hypot(2 z1, 2)
    assert float(pivot) == pytest.approx(1.7 / math.hypot(1.7, 2), rel=1e-12)
    for x in (0.9999, 1.1):  # its slope falls to less than half, and there is none
        _, failure, _ = circle(True)(x, sign * np.array([0.8, 1.6]), empty, empty, empty, 0)
        assert float(failure) != 0
    z, failure, _ = circle(False)(0.6, sign * np.array([5.0, 1.0]), empty, empty, empty, 0)  # from any guess
    assert z.full().ravel().tolist() == pytest.approx([sign * 0.8, sign * 1.6], abs=1e-14) and float(failure) == 0
    _, failure, _ = circle(False)(1.5, sign * np.array([5.0, 1.0]), empty, empty, empty, 0)
    assert float(failure) != 0


def test_the_variable_whose_equation_is_singular_is_the_one_named() -> None:
    def solver(order: tuple[int, int]) -> ca.Function:
        z1, z2 = Variable("z1", start=1.0), Variable("z2", start=1.0)
        equations = [lambda z: z.z1 - 1, lambda z: z.z2**2]
        made = Model(
            name="singular",
            states=[Variable("x")],
            algebraic=[(z1, z2)[i] for i in order],
            outputs=[Variable("y")],
            ode=lambda x, z, u, p, t: [z.z2],
            output=lambda x, z, u, p, t: [x.x],
            algebraic_equations=lambda x, z, u, p, t: [equations[i](z) for i in order],
        )
        return algebraic_solver(made.equations, [1.0, 1.0], follow=False)

    empty = np.zeros(0)
    assert [float(solver(order)(0, [1.0, 1.0], empty, empty, empty, 0)[1]) for order in ((0, 1), (1, 0))] == [2, 1]


def test_a_stable_step_is_halved_until_the_fastest_mode_of_any_matrix_fits() -> None:
    assert stable_step([], 0.1) == 0.1
    assert stable_step([29.0], 0.1) == 0.1 and stable_step([31.0], 0.1) == 0.05
    assert stable_step([1.0, 130.0], 0.1) == 0.0125
    # At the limit the method is stable: its polynomial there, from the tableau.
    z, stages = -DORMAND_PRINCE_8.stable, []
    for row in DORMAND_PRINCE_8.a:
        stages.append(1 + z * sum(a * k for a, k in zip(row, stages, strict=False)))
    assert abs(1 + z * float(np.dot(DORMAND_PRINCE_8.b, stages))) < 1
    assert expm(np.array([[z]])) < 1
