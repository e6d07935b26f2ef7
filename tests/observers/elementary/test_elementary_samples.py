"""The observer by elementary problems where its window is a weighted least-squares problem: against numpy, whatever is missing."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from observers.elementary import elementary
from observers.elementary.identifiability import describe, least_visible
from observers.instance import Instance
from observers.model import Model, Variable
from observers.status import CODE

S, N, RATE, SAMPLES = 0.05, 8, -0.7, 40
PHI = math.exp(RATE * S)
BY_MIDPOINT = (1 + S / 2 * RATE) / (
    1 - S / 2 * RATE
)  # how a trajectory moves with its start, in the problem's constraint
GAINS, NOMINAL = np.array([1.0, 2.0]), np.array([1.0, 4.0])
# Without controls the problem is one of the first state alone: the sum of squares, by the trapezoidal rule, of what it predicts.
MODEL = Model(
    name="decay",
    states=[Variable("x", nominal=3.0)],
    inputs=[Variable("u")],
    outputs=[Variable("y1"), Variable("y2", nominal=4.0)],
    ode=lambda x, u, p, t: [RATE * x.x + u.u],
    output=lambda x, u, p, t: [x.x, 2 * x.x + 0.3 * t],
)


def fitted(y: np.ndarray, there: np.ndarray, u: np.ndarray) -> tuple[float, float, float]:
    """(the state at the last of the samples y (m, 2), the cost, the visibility) of a window of m samples with the inputs u (m - 1)."""
    m = len(y)
    moved, forced = np.ones(m), np.zeros(m)  # of the last state, back to every sample
    for i in reversed(range(m - 1)):
        moved[i] = moved[i + 1] / PHI
        forced[i] = (forced[i + 1] - u[i] * (PHI - 1) / RATE) / PHI
    weight = np.ones(m)
    weight[[0, -1]] = 0.5
    rows, right = np.outer(moved, GAINS), y - np.outer(forced, GAINS)
    slopes = weight[:, None] * there * np.outer(BY_MIDPOINT ** np.arange(1.0 - m, 1.0), GAINS)
    last = np.sum(slopes * right) / np.sum(slopes * rows)
    residual = there * (right - rows * last) / NOMINAL
    seen = there * np.outer(BY_MIDPOINT ** np.arange(1.0 - m, 1.0), GAINS) * 3.0 / NOMINAL
    return last, np.sum(residual**2), math.sqrt(np.sum(seen**2) / there.sum())


@pytest.mark.parametrize("first", [True, False])
def test_every_sample_is_the_least_squares_solution_of_what_has_arrived(first: bool) -> None:
    """In the window that grows and in the one that is full, to the last of 40 samples; with and without the first one."""
    made = elementary(MODEL, sample_time=S, N=N, K=60, measurement_noise={"y1": 50.0, "y2": 50.0})
    run, rng = Instance(made, {"tuning.epsilon": 0.0, "guess.x": 5.0}), np.random.default_rng(3)
    there = rng.random((SAMPLES, 2)) > 0.25
    there[0], there[1:3], there[20:22], there[27] = first, True, False, [True, False]
    y, u = 1 + rng.normal(size=(SAMPLES, 2)), rng.normal(size=SAMPLES)
    predicted, gaps, visible = 5.0, [], []
    for k in range(SAMPLES):
        for i in range(2):
            run.set(f"y{i + 1}", y[k, i] + 0.3 * k * S * i if there[k, i] else 1e6)
            run.set(f"measurement_valid.y{i + 1}", there[k, i])
        run.set("u", u[k])
        run.step(k * S, S)
        innovation = np.where(there[k], y[k] - GAINS * predicted, 0)
        window = slice(max(0, k - N + 1), k + 1)
        x, cost, visibility = fitted(y[window], there[window], u[window][:-1]) if k else (5.0, 0, 0)
        if there[k].any() and k:
            found = [run.get(f"diagnostics.{name}") for name in ("cost", "visibility", "null.x")]
            np.testing.assert_allclose(found[0], cost, rtol=1e-8)
            visible.append(abs(found[1] / visibility - 1))
            assert found[2] == 3.0
        if not there[k].any():
            x = predicted
        predicted = PHI * x + u[k] * (PHI - 1) / RATE
        found = [run.get(f"{part}.x") for part in ("filtered", "estimate")]
        found += [run.get(f"diagnostics.innovation[{i}]") for i in (1, 2)]
        gaps.append(np.abs(np.array(found) - [x, predicted, *innovation]).max())
        status = CODE.estimating if there[k].all() else CODE.sample_rejected
        status = CODE.propagated_guess if k == 0 else CODE.settling if k < N - 1 else status
        assert run.get("diagnostics.status") == status, k
    assert max(gaps) < 1e-9 and max(visible) < 1e-12
    assert run.get("diagnostics.rejected_samples") == 0 == run.get("diagnostics.solver_failures")


def test_a_changed_parameter_is_said_while_an_interval_of_the_window_obeys_the_old_value() -> None:
    """Of N samples there are N - 1 intervals, the last of which ends at the sample of the change."""
    model = Model(
        name="tuned",
        states=[Variable("x", start=1.0)],
        parameters=[Variable("k", start=0.5), Variable("l")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [p.l - p.k * x.x],
        output=lambda x, u, p, t: [x.x],
    )
    run = Instance(elementary(model, sample_time=S, N=N, measurement_noise={"y": 50.0}))
    run.set("y", 1.0)
    found = []
    for k in range(60):
        if k in (20, 40, 43):
            run.set("parameter.l" if k == 43 else "parameter.k", 0.01 * k)
        run.step(k * S, S)
        found.append(run.get("diagnostics.status") == CODE.parameter_changed)
    assert [k for k, said in enumerate(found) if said] == [*range(20, 20 + N - 1), *range(40, 43 + N - 1)]


def test_the_visibility_is_that_along_the_inputs_and_the_time_of_the_window() -> None:
    """x' = (u + sin t) x by the midpoint rule, y = 3 x + t of nominal value 4, a sample that is missing: closed form."""
    model = Model(
        name="grown",
        states=[Variable("x", nominal=2.0)],
        inputs=[Variable("u")],
        outputs=[Variable("y", nominal=4.0)],
        ode=lambda x, u, p, t: [(u.u + ca.sin(t)) * x.x],
        output=lambda x, u, p, t: [3 * x.x + t],
    )
    u0, u1, t = np.linspace(-1, 2, N - 1), np.linspace(0.5, -1, N - 1), 1.3
    there, starts = np.ones(N), t + S * np.arange(1 - N, 0)
    there[3] = 0
    rates = (u0 + u1) / 2 + np.sin(starts + S / 2)
    moved = np.cumprod([1.0, *((1 - S / 2 * rates) / (1 + S / 2 * rates))[::-1]])[::-1]  # of the last state, back
    blank = [np.ones((1, N)), np.zeros((0, N - 1)), np.zeros((1, N)), there[None]]
    inputs = [u0[None], u1[None], np.zeros((1, N)), np.ones((1, N - 1)), t, S, []]
    visibility, direction = least_visible(model, N)(*blank, *inputs)
    expected = math.sqrt(np.sum(there * (3 * 2.0 / 4.0 * moved) ** 2) / (N - 1))
    assert float(visibility) == pytest.approx(expected, rel=1e-13) and float(direction) == 2.0


@pytest.mark.parametrize("first", [True, False], ids=["first", "last"])
def test_the_windows_samples_are_at_their_times(first: bool) -> None:
    """A state that the output shows at one end of the window only is determined; one that it shows outside the window is not."""
    N, s = 11, 0.1
    end = 0.0 if first else (N - 1) * s

    def seen(border: float) -> str:
        model = Model(
            name="gated",
            states=[Variable("a", start=1.0), Variable("b", start=1.0)],
            outputs=[Variable("y")],
            ode=lambda x, u, p, t: [-0.1 * x.a, -0.1 * x.b],
            output=lambda x, u, p, t: [x.a + ca.if_else(t < border if first else t > border, x.b, 0)],
        )
        return describe(model, N, s)

    outward = -s if first else s
    assert seen(end - outward / 2) == "" and seen(end + outward / 2) == "b + c"
