"""Many states through few outputs: the window waits until it determines them, and converges from a guess that is wrong."""

from functools import cache

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares

from observers.instance import Instance
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from observers.status import CODE

TS = 0.1
HARDENING = 0.2
GUESSES = pytest.mark.parametrize("guess_error", [0.0, 0.3, 1.0, None], ids=["exact", "wrong", "far off", "at rest"])


def chain(n, outputs=2, hardening=HARDENING):
    """n oscillators with hardening springs, coupled to their neighbours; both ends are measured, or the first."""
    names = [f"q{i}" for i in range(n)] + [f"v{i}" for i in range(n)]

    def ode(x, u, p, t):
        q = [getattr(x, f"q{i}") for i in range(n)]
        v = [getattr(x, f"v{i}") for i in range(n)]
        pulled = [
            (q[i - 1] - q[i] if i else 0)
            + (q[i + 1] - q[i] if i < n - 1 else 0)
            - q[i]
            - hardening * q[i] ** 3
            - 0.05 * v[i]
            for i in range(n)
        ]
        return [*v, *pulled]

    return Model(
        name="chain",
        states=[Variable(name) for name in names],
        outputs=[Variable(f"y{i + 1}") for i in range(outputs)],
        ode=ode,
        output=lambda x, u, p, t: [x.q0, getattr(x, f"q{n - 1}")][:outputs],
    )


@cache
def observer(n, outputs=2, ts=TS, hardening=HARDENING, **structure):
    noise = {f"y{i + 1}": 1e-2 for i in range(outputs)} if structure.get("arrival_cost") else None
    return pseudospectral(chain(n, outputs, hardening), sample_time=ts, measurement_noise=noise, **structure)


def motion(x, n, samples, ts, hardening=HARDENING):
    """The chain's states at the sample instants (samples x 2 n), by small steps."""

    def rate(s):
        q, v = s[:n], s[n:]
        ends = np.concatenate([[0], np.diff(q), [0]])
        return np.concatenate([v, np.diff(ends) - q - hardening * q**3 - 0.05 * v])

    steps, found = 10, [x]
    h = ts / steps
    for _ in range(samples - 1):
        for _ in range(steps):
            k1 = rate(x)
            k2 = rate(x + h / 2 * k1)
            k3 = rate(x + h / 2 * k2)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3))
        found.append(x)
    return np.array(found)


def followed(made, x, y, guess_error, ts=TS):
    """(statuses, errors, iterations, run) of an observer whose guess is off, or at rest (None), along the motion x and its samples y."""
    rng = np.random.default_rng(1)
    guess = np.zeros(x.shape[1]) if guess_error is None else x[0] + guess_error * rng.normal(size=x.shape[1])
    names = [v.name for v in chain(x.shape[1] // 2).states]
    run = Instance(made, {f"guess.{name}": value for name, value in zip(names, guess, strict=True)})
    statuses, errors, iterations = [], [], []
    for k, values in enumerate(y):
        for i, value in enumerate(values):
            run.set(f"y{i + 1}", value)
        run.step(k * ts, ts)
        statuses.append(int(run.get("diagnostics.status")))
        iterations.append(int(run.get("diagnostics.iterations")))
        errors.append(np.abs([run.get(f"filtered.{name}") for name in names] - x[k]).max())
    return statuses, np.array(errors), iterations, run


def started(n):
    return np.random.default_rng(0).uniform(-1, 1, 2 * n)


@GUESSES
@pytest.mark.parametrize("outputs", [2, 1])
def test_eight_states(outputs, guess_error):
    """While the window does not determine them it does not iterate for long either."""
    x = motion(started(4), 4, 26, TS)
    made = observer(4, outputs, N=6, L=20, segments=10)
    statuses, errors, iterations, run = followed(made, x, x[:, [0, 3]][:, :outputs], guess_error)
    assert statuses[-5:] == [CODE.estimating] * 5 and errors[-5:].max() < 5e-6
    assert run.get("diagnostics.solver_failures") == 0 and max(iterations) <= 12


@GUESSES
def test_sixteen_states_through_two_outputs(guess_error):
    """They are hardly determined: the normal matrix's pivots spread over ten decades, which magnify the collocation's error to 1e-4. Until
    there are samples enough the status is `undetermined`, which is no failure."""
    x = motion(started(8), 8, 26, TS)
    statuses, errors, iterations, run = followed(observer(8, N=5, L=20, segments=10), x, x[:, [0, 7]], guess_error)
    assert statuses[-5:] == [CODE.estimating] * 5 and errors[-5:].max() < 1e-3
    assert CODE.undetermined in statuses[:15] and run.get("diagnostics.solver_failures") == 0
    assert max(iterations) <= 20


@pytest.mark.parametrize("guess_error", [1.0, None], ids=["far off", "at rest"])
def test_sixteen_states_under_noise_are_those_of_the_batch_least_squares(guess_error):
    """Of scipy, through the same samples of a window of 8 s, from the true state."""
    n, ts, L, samples = 8, 0.4, 20, 24
    x = motion(started(n), n, samples, ts)
    y = x[:, [0, n - 1]] + 1e-2 * np.random.default_rng(2).normal(size=(samples, 2))
    statuses, _, _, run = followed(observer(n, ts=ts, N=6, L=L, segments=L), x, y, guess_error, ts)
    seen = y[samples - 1 - L :]

    def residual(s):
        return (motion(s, n, L + 1, ts)[:, [0, n - 1]] - seen).ravel()

    batch = motion(least_squares(residual, x[samples - 1 - L], xtol=1e-10).x, n, L + 1, ts)[-1]
    found = [run.get(f"filtered.{v.name}") for v in chain(n).states]
    assert statuses[-3:] == [CODE.estimating] * 3
    np.testing.assert_allclose(found, batch, rtol=0, atol=2e-4)
    assert np.abs(batch - x[-1]).max() > 1e-2  # what the noise makes of it


def test_a_linear_chain_of_sixteen_states_is_solved_as_numpy_solves_it():
    n, ts, L = 8, 0.4, 20
    rates = np.diag(np.full(n, -3.0)) + np.eye(n, k=1) + np.eye(n, k=-1)
    rates[0, 0] = rates[-1, -1] = -2.0
    step = expm(ts * np.block([[np.zeros((n, n)), np.eye(n)], [rates, -0.05 * np.eye(n)]]))
    powers = [np.eye(2 * n)]
    for _ in range(L):
        powers.append(step @ powers[-1])
    x = np.array([power @ started(n) for power in powers])
    y = x[:, [0, n - 1]] + 1e-2 * np.random.default_rng(2).normal(size=(L + 1, 2))
    statuses, _, _, run = followed(observer(n, ts=ts, hardening=0.0, N=10, L=L, segments=L), x, y, None, ts)
    first = np.linalg.lstsq(np.vstack([power[[0, n - 1]] for power in powers]), y.ravel(), rcond=None)[0]
    found = [run.get(f"filtered.{v.name}") for v in chain(n).states]
    assert statuses[-1] == CODE.estimating
    np.testing.assert_allclose(found, powers[-1] @ first, rtol=0, atol=1e-7)


@pytest.mark.parametrize("n", [8, pytest.param(16, marks=pytest.mark.long)])
@pytest.mark.parametrize("guess_error", [1.0, None], ids=["far off", "at rest"])
def test_with_an_arrival_cost_many_states_have_a_solution_from_the_first_sample_on(n, guess_error):
    """No solve fails, and the standard deviations say how little is known."""
    x = motion(started(n), n, 30, TS)
    made = observer(n, N=5, L=20, segments=10, arrival_cost=True)
    statuses, errors, iterations, run = followed(made, x, x[:, [0, n - 1]], guess_error)
    stds = [run.get(f"diagnostics.std.{v.name}") for v in chain(n).states]
    assert run.get("diagnostics.solver_failures") == 0 and CODE.uncertain in statuses
    assert max(iterations) <= 10 and errors[-1] < 4 * max(stds)
