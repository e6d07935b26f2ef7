"""What the window's functions say along a trajectory that scipy integrated: of a model whose every equation sees t, in segments."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from observers.model import Model, Variable
from observers.pseudospectral import structure
from observers.pseudospectral.window import condense, lgl, trajectory
from observers.pseudospectral.window.problem import LeastSquares, known_terms

TS, L, N, T0 = 0.1, 8, 11, 2.7
P, THETA = 1.3, 0.4
NO_NOISE = np.zeros(0)
START = np.array([0.7, -0.2, 0.5])


def model(kind: str, algebraic: bool) -> Model:
    """u1 does what it likes, for nothing nonlinear sees what it moves; u2 enters the nonlinear terms.

    Where there is a z, z + z^3 / 5 = a; else a stands for it.
    """

    def ode(x, *rest):
        z, u, p, t = rest if algebraic else (None, *rest)
        root = z.z if algebraic else x.a
        return [
            x.b,
            -p.k * ca.sin(root) - p.theta * x.b + 0.3 * ca.cos(2 * t),
            -0.5 * x.c + 0.4 * u.u2 * x.a + 0.2 * u.u1,
        ]

    def output(x, *rest):
        z, u, p, t = rest if algebraic else (None, *rest)
        root = z.z if algebraic else x.a
        return [root + 0.1 * ca.sin(t) * x.c, 2 * x.c + 0.5 * u.u1 + u.u2 * x.b + p.theta]

    return Model(
        name="driven",
        states=[Variable("a", nominal=2.0), Variable("b", nominal=0.5, min=-9.0), Variable("c", max=9.0)],
        inputs=[Variable("u1"), Variable("u2", start=1.0)],
        parameters=[Variable("k", start=P)],
        unknown_parameters=[Variable("theta", start=THETA, nominal=3.0)],
        outputs=[Variable("y1"), Variable("y2")],
        input_between_samples=kind,
        ode=ode,
        output=output,
        algebraic=[Variable("z", nominal=0.7)] if algebraic else [],
        algebraic_equations=(lambda x, z, u, p, t: [z.z + z.z**3 / 5 - x.a]) if algebraic else None,
    )


@dataclass
class Case:
    """A window's problem, and what scipy says of the trajectory from `s` = [x0; theta] on: x at any time since T0."""

    kind: str
    segments: int
    algebraic: bool = False

    def __post_init__(self) -> None:
        made = model(self.kind, self.algebraic)
        self.eq = made.equations
        self.problem: LeastSquares = structure.problem(made, made.equations, N, L, self.segments, TS, "samples")
        u1 = np.random.default_rng(3).normal(size=L + 2)
        u2 = 0.8 + 0.3 * np.arange(L + 2) if self.kind == "linear" else np.full(L + 2, 0.8)
        self.values = np.column_stack([u1, u2])  # at the samples 0 .. L + 1

    def u(self, t: float, left: bool = False) -> np.ndarray:
        """The inputs at t since T0; `left`: of the interval that ends there."""
        i = math.floor(t / TS + 1e-9) - (left and abs(t / TS - round(t / TS)) < 1e-9)
        if self.kind == "held":
            return self.values[i]
        i = min(i, L)
        return self.values[i] + (self.values[i + 1] - self.values[i]) * (t / TS - i)

    def root(self, a: float) -> float:
        return brentq(lambda z: z + z**3 / 5 - a, -9, 9, xtol=1e-15) if self.algebraic else a

    def rate(self, t: float, x: np.ndarray, u: np.ndarray, theta: float = THETA) -> np.ndarray:
        return np.array(
            [
                x[1],
                -P * math.sin(self.root(x[0])) - theta * x[1] + 0.3 * math.cos(2 * (T0 + t)),
                -0.5 * x[2] + 0.4 * u[1] * x[0] + 0.2 * u[0],
            ]
        )

    def output(self, t: float, x: np.ndarray, theta: float = THETA) -> list[float]:
        u = self.u(t)
        return [self.root(x[0]) + 0.1 * math.sin(T0 + t) * x[2], 2 * x[2] + 0.5 * u[0] + u[1] * x[1] + theta]

    def states(self, times: np.ndarray, s: np.ndarray) -> np.ndarray:
        """x at `times` >= 0, ascending (n x 3)."""
        x, found, done = s[:3], {}, 0.0
        stops = sorted({*np.round(times, 15), *(TS * np.arange(1, L + 2))})
        for stop in [t for t in stops if t <= max(times) + 1e-12]:
            if stop > done:
                i = math.floor(done / TS + 1e-9)
                line = self.values[min(i, L)], self.values[min(i + 1, L + 1)]

                def now(t, i=i, line=line):
                    return line[0] + (line[1] - line[0]) * (t / TS - i) if self.kind == "linear" else line[0]

                run = solve_ivp(
                    lambda t, y, now=now: self.rate(t, y, now(t), s[3]),
                    (done, stop),
                    x,
                    method="DOP853",
                    rtol=1e-12,
                    atol=1e-13,
                )
                x, done = run.y[:, -1], stop
            found[stop] = x
        return np.array([found[time] if time else s[:3] for time in np.round(times, 15)])

    def nodes(self, since: float = 0.0) -> np.ndarray:
        """Times of the segments' nodes 1..N, of the window that starts at `since`."""
        s = self.problem.segment
        return np.concatenate([since + j * s.length + s.node_times[1:] for j in range(self.segments)])

    def held(self, s: np.ndarray, since: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """V and Z at the nodes along the trajectory."""
        times, parts = self.nodes(since), self.problem.segment.split
        V, Z = [], []
        for t, x in zip(times, self.states(times, s), strict=True):
            u = self.u(t, left=True)
            V.append(parts.E.T @ (self.rate(t, x, u, s[3]) - parts.A @ x - parts.B @ u))
            Z.append(self.root(x[0]))
        return np.concatenate(V), np.array(Z) if self.algebraic else np.zeros(0)

    @property
    def U(self) -> np.ndarray:
        return self.values[: L + (self.kind == "linear")].ravel()

    def data(self, since: int = 0) -> ca.DM:
        U = self.values[since : since + L + (self.kind == "linear")].ravel()
        seen = self.values[since : since + L + 1].ravel()
        return known_terms(self.problem)(T0 + since * TS, U, seen, P)


CASES = [
    Case("held", 1),
    Case("held", 2),
    Case("held", 4),
    Case("linear", 1),
    Case("linear", 2),
    Case("held", 1, algebraic=True),
    Case("linear", 4, algebraic=True),
]
ids = [f"{c.kind}-{c.segments}{'-dae' if c.algebraic else ''}" for c in CASES]
along = pytest.mark.parametrize("case", CASES, ids=ids)
S = np.array([*START, THETA])


def samples() -> np.ndarray:
    return TS * np.arange(L + 1)


@along
def test_outputs_and_states_at_the_samples_are_those_of_the_trajectory(case: Case) -> None:
    V, Z = case.held(S)
    x = case.states(samples(), S)
    y = np.ravel([case.output(t, row) for t, row in zip(samples(), x, strict=True)])
    shown = condense.output_residual(case.problem)(V, Z, S, NO_NOISE, case.data(), P, np.zeros(len(y))).full().ravel()
    np.testing.assert_allclose(shown, y, rtol=0, atol=4e-12)
    less = (
        condense.output_residual(case.problem)(V, Z, S, NO_NOISE, case.data(), P, np.arange(float(len(y))))
        .full()
        .ravel()
    )
    np.testing.assert_allclose(less, shown - np.arange(len(y)), rtol=0, atol=1e-13)
    at = trajectory.state_at(case.problem)
    for place in range(L + 1):
        found, z = at(place, V, Z, START, case.U)
        np.testing.assert_allclose(found.full().ravel(), x[place], rtol=0, atol=4e-12)
        if case.algebraic:
            assert float(z) == pytest.approx(
                case.root(x[place][0]), abs=1e-10
            )  # degree N - 1, outside of its nodes at 0
    starts = trajectory.segment_starts(case.problem)(V, START, case.U).full().T
    np.testing.assert_allclose(starts, x[:: L // case.segments], rtol=0, atol=4e-12)


@along
def test_the_linearisation_is_the_derivative_of_the_trajectory(case: Case) -> None:
    V, Z = case.held(S)
    nodes, h = case.nodes(), 1e-4
    w = np.random.default_rng(5).uniform(0.2, 2.0, size=2 * (L + 1))
    y = np.random.default_rng(6).normal(size=2 * (L + 1))

    def everything(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = case.states(samples(), s)
        out = np.ravel([case.output(t, row, s[3]) for t, row in zip(samples(), x, strict=True)])
        return out, case.states(nodes, s)[:, list(case.problem.bounded)].ravel()

    columns = []
    for i in range(4):
        e = np.eye(4)[i] * h
        ahead, behind = everything(S + e), everything(S - e)
        columns.append([(a - b) / (2 * h) for a, b in zip(ahead, behind, strict=True)])
    M, G = (np.column_stack(part) for part in zip(*columns, strict=True))
    h0, bounded = everything(S)
    given = {"data": case.data(), "p": P, "y": y, "w": w, "active": np.ones(case.segments)}
    symbols = condense.symbols(case.problem, case.problem.kind)[:3]
    made = condense.linearise(case.problem, *symbols, {k: case.problem.kind(ca.DM(v)) for k, v in given.items()})
    parts = [
        made.normal,
        made.residual,
        made.sensitivity,
        made.nodes,
        made.node_sensitivity,
        ca.vertcat(*made.sol),
        made.Z,
    ]
    values = ca.Function("values", list(symbols), parts)(V, Z, S)
    normal, residual, sensitivity, at_nodes, by_nodes, sol, z = (value.full() for value in values)
    np.testing.assert_allclose(residual.ravel(), h0 - y, rtol=0, atol=4e-12)
    np.testing.assert_allclose(sensitivity[:, 0], 0, rtol=0, atol=4e-12)  # the equations are met: nothing to correct
    np.testing.assert_allclose(sensitivity[:, 1:], M, rtol=0, atol=2e-8)
    full = np.column_stack([residual.ravel() + sensitivity[:, 0], sensitivity[:, 1:]])
    np.testing.assert_allclose(normal, full.T @ (w[:, None] * full), rtol=0, atol=1e-11)
    np.testing.assert_allclose(at_nodes.ravel(), bounded, rtol=0, atol=4e-12)
    np.testing.assert_allclose(by_nodes[:, 1:], G, rtol=0, atol=2e-8)
    by_s = np.column_stack([(case.held(S + e)[0] - case.held(S - e)[0]) / (2 * h) for e in h * np.eye(4)])
    np.testing.assert_allclose(sol[:, 1:], by_s, rtol=0, atol=1e-8)
    np.testing.assert_allclose(z.ravel(), Z, rtol=0, atol=2e-12)


@pytest.mark.parametrize(
    "case", [c for c in CASES if c.segments > 1], ids=[i for i, c in zip(ids, CASES, strict=True) if c.segments > 1]
)
def test_a_segment_that_is_not_active_weighs_nothing_and_stays(case: Case) -> None:
    V, Z = case.held(S)
    active = np.array([1.0] * (case.segments - 1) + [0.0])
    n = 2 * (L + 1)
    given = {"data": case.data(), "p": P, "y": np.zeros(n), "w": np.ones(n), "active": active}
    symbols = condense.symbols(case.problem, case.problem.kind)[:3]
    made = condense.linearise(case.problem, *symbols, {k: case.problem.kind(ca.DM(v)) for k, v in given.items()})
    parts = [made.normal, made.residual, made.sensitivity, made.sol[-1], made.Z]
    normal, residual, sensitivity, sol, z = (
        value.full() for value in ca.Function("values", list(symbols), parts)(V, Z, S)
    )
    first = 2 * (1 + (L // case.segments) * (case.segments - 1))
    assert not residual[first:].any() and not sensitivity[first:].any() and not sol.any()
    assert np.all(residual[:first] != 0)
    full = np.column_stack([residual.ravel() + sensitivity[:, 0], sensitivity[:, 1:]])
    np.testing.assert_allclose(normal, full.T @ full, rtol=0, atol=1e-13)
    assert z.ravel().tolist() == pytest.approx(Z.tolist(), abs=1e-12)


@along
def test_the_first_samples_state_has_its_derivative(case: Case) -> None:
    V, Z = case.held(S)
    x, by_s = condense.first_sample(case.problem)(V, Z, S, NO_NOISE, case.data(), P, case.U)
    np.testing.assert_allclose(x.full().ravel(), case.states(np.array([TS]), S)[0], rtol=0, atol=4e-12)
    h = 1e-4
    expected = np.column_stack(
        [
            (case.states(np.array([TS]), S + e)[0] - case.states(np.array([TS]), S - e)[0]) / (2 * h)
            for e in h * np.eye(4)
        ]
    )
    np.testing.assert_allclose(by_s.full(), expected, rtol=0, atol=2e-8)


@along
def test_a_window_moved_on_by_a_sample_holds_the_same_trajectory(case: Case) -> None:
    V, Z = case.held(S)
    last, now = case.states(TS * np.array([L, L + 1.0]), S)
    z = case.root(now[0]) if case.algebraic else np.zeros(0)
    u = case.u(L * TS)
    made = trajectory.shift(case.problem, case.eq)
    V_new, Z_new, x0 = made(V, Z, START, case.U, last, now, z, THETA, P, case.data(1), u, T0 + (L + 1) * TS)
    V_true, Z_true = case.held(S, since=TS)
    np.testing.assert_allclose(x0.full().ravel(), case.states(np.array([TS]), S)[0], rtol=0, atol=4e-12)
    # Beyond the old window's end the chain is of fourth order, its input held, and its algebraic variable where it was.
    inside = case.nodes(TS) <= L * TS + 1e-12
    each = case.problem.rates.n
    near = 1e-6 if case.kind == "held" and not case.algebraic else 0.2
    error = np.abs(V_new.full().ravel() - V_true).reshape(-1, each)
    assert error[inside].max() < 4e-12 and error.max() < near
    assert error[-1].max() < (1e-12 if not case.algebraic else 1e-9)  # the last node is the prediction
    if case.algebraic:
        error = np.abs(Z_new.full().ravel() - Z_true)
        assert error[inside].max() < 4e-12 and error[-1] < 1e-12


@along
def test_the_residual_at_the_dropped_nodes_is_that_of_the_equations_there(case: Case) -> None:
    """(16) at node 0 of each segment, from the differentiation matrix; the rates at the nodes are anything."""
    V, Z = case.held(S)
    V = V + 0.01 * np.random.default_rng(8).normal(size=len(V))
    problem, s = case.problem, case.problem.segment
    parts, D = s.split, lgl.differentiation(N)
    starts = trajectory.segment_starts(problem)(V, START, case.U).full()
    worst = []
    for j, v in enumerate(problem.chop(V, problem.n_rates)):
        xs, t = starts[:, j], j * s.length
        Ph, Ps = s.at(s.node_times)
        X = (Ph @ xs + Ps @ v).reshape(N + 1, 3)  # without the response to the inputs, which is exact and apart
        free = case.rate(t, xs, case.u(t)) - parts.B @ case.u(t)
        worst.append(np.abs((D[0] @ X - s.length / 2 * free) / [2.0, 0.5, 1.0]).max())
    node0 = trajectory.node0(problem)
    if case.segments == 1:
        found, regular = node0(V, Z, START, THETA, P, T0, case.U)
        assert float(found) == pytest.approx(worst[0], rel=1e-5 if case.algebraic else 1e-9)
        assert math.isinf(regular) if not case.algebraic else float(regular) > 0.7
        return
    for active in (np.ones(case.segments), np.arange(case.segments) < 1, np.arange(case.segments) == case.segments - 1):
        found, regular = node0(V, Z, START, THETA, P, T0, case.U, active)
        largest = max(value for value, on in zip(worst, active, strict=True) if on)
        assert float(found) == pytest.approx(largest, rel=1e-4 if case.algebraic else 1e-9)


@along
def test_the_regularity_is_the_smallest_slope_of_the_algebraic_equations(case: Case) -> None:
    if not case.algebraic:
        return
    V, Z = case.held(S)
    arguments = [V, Z, START, THETA, P, T0, case.U] + ([np.ones(case.segments)] if case.segments > 1 else [])
    _, regular = trajectory.node0(case.problem)(*arguments)
    roots = [case.root(x[0]) for x in case.states(np.array([0.0, *case.nodes()]), S)]
    slope = min(1 + 0.6 * z**2 for z in roots)  # of z + z^3 / 5, by z in units of its nominal value
    assert float(regular) == pytest.approx(0.7 * slope, rel=1e-6)


@pytest.mark.parametrize("kind", ["held", "linear"])
def test_what_stands_in_for_rejected_samples_is_the_trajectorys_output(kind: str) -> None:
    case = Case(kind, 1)
    V, Z = case.held(S)
    eq = case.eq
    made = ca.Function("measurement", [eq.x, eq.u, eq.p, eq.theta, eq.t, ca.SX.sym("z", 0)], [eq.output, eq.z])
    found = trajectory.outputs_at_samples(case.problem, made)(V, Z, START, THETA, P, case.U, T0).full().reshape(-1, 2)
    x = case.states(samples(), S)
    expected = np.array([case.output(t, row) for t, row in zip(samples(), x, strict=True)])
    last = slice(None, -1) if kind == "held" else slice(None)  # the window's end belongs to its last interval
    np.testing.assert_allclose(found[last], expected[last], rtol=0, atol=4e-12)


@along
def test_under_a_flat_trajectory_the_nonlinear_states_stay(case: Case) -> None:
    if case.algebraic:
        return
    u = np.array([0.3, 0.8])
    V, _, x0 = trajectory.flat(case.problem)(START, np.zeros(0), u)
    parts = case.problem.segment.split
    rate = parts.A @ START + parts.B @ u + parts.E @ V.full().ravel()[: case.problem.rates.n]
    assert x0.full().ravel().tolist() == START.tolist()
    np.testing.assert_allclose(rate[parts.rows], 0, rtol=0, atol=1e-15)
    assert np.ptp(V.full().reshape(-1, case.problem.rates.n), axis=0).max() == 0


@along
def test_places_in_stacked_vectors_tile_them(case: Case) -> None:
    """Points, inputs and data of all segments: each place once, the shared point and the shared input of neighbours as they must be."""
    problem, each = case.problem, L // case.segments
    measured = np.concatenate([np.arange(2 * (L + 1))[problem.measured(j)] for j in range(case.segments)])
    assert measured.tolist() == list(range(2 * problem.n_measured)) and problem.n_measured == L + 1
    for j in range(case.segments):
        assert len(problem.points_of(j)) == each + (j == 0)
        at = problem.inputs(j)
        assert (at.start, at.stop) == (2 * j * each, 2 * ((j + 1) * each + (case.kind == "linear")))
        assert problem.data_of(j).stop - problem.data_of(j).start == problem.data(j).total
    data = np.concatenate([np.arange(problem.n_data)[problem.data_of(j)] for j in range(case.segments)])
    assert data.tolist() == list(range(problem.n_data))
    assert problem.rate_scale == pytest.approx(2 / (each * TS) * np.array([2.0, 0.5, 1.0])[problem.segment.split.rows])
    assert problem.scale.tolist() == [2.0, 0.5, 1.0, 3.0] and problem.bounded == (1, 2)


def test_a_segment_interpolates_polynomials_and_its_own_states_exactly() -> None:
    s = Case("held", 2).problem.segment
    times = np.array([0.0, 0.03, 0.17, 0.4])
    for degree in range(N):
        at_nodes = s.node_times[1:] ** degree
        np.testing.assert_allclose(s.from_nodes(times) @ at_nodes, times**degree, rtol=0, atol=1e-13)
    xs, v = np.array([0.3, -1.0, 2.0]), np.random.default_rng(1).normal(size=N * len(s.split.rows))
    Ph, Ps = s.at(times)
    some_Ph, some_Ps = s.at(times, [2, 0])
    np.testing.assert_array_equal((Ph @ xs + Ps @ v).reshape(-1, 3)[:, [2, 0]].ravel(), some_Ph @ xs + some_Ps @ v)
    np.testing.assert_array_equal(s.forced(times).reshape(4, 3, -1)[:, [2, 0]].reshape(8, -1), s.forced(times, [2, 0]))
    X = np.vstack([xs, (np.vstack([s.at(s.node_times[1:])[0]]) @ xs + s.at(s.node_times[1:])[1] @ v).reshape(N, 3)])
    phi = v.reshape(N, -1)
    D = lgl.differentiation(N)[1:]
    np.testing.assert_allclose(D @ X, s.length / 2 * (X[1:] @ s.split.A.T + phi @ s.split.E.T), rtol=0, atol=1e-13)
    R0, RV = s.node0
    expected = lgl.differentiation(N)[0] @ X - s.length / 2 * s.split.A @ xs
    np.testing.assert_allclose(R0 @ xs + RV @ v, expected, rtol=0, atol=2e-13)
