"""More unknowns than are written out in scalars, with an input that is held and an unknown parameter: scipy's batch least squares."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from observers.instance import Instance
from observers.model import Model, Variable
from observers.numerics.semilinear import split, thinned
from observers.pseudospectral import pseudospectral
from observers.pseudospectral.window.rates import are_sparse

N_MASSES, TS, L, STEPS = 5, 0.3, 16, 12
NEIGHBOURS = np.eye(N_MASSES, k=1) + np.eye(N_MASSES, k=-1)
ALL = np.ones((N_MASSES, N_MASSES)) - np.eye(N_MASSES)
PAIRS = block_diag(*[np.ones((2, 2))] * 2, 1.0) - np.eye(N_MASSES)  # the last one hangs alone
SEEN = [*range(1, N_MASSES), 0]  # which position each output is
NAMES = [f"{letter}{i}" for letter in "qv" for i in range(N_MASSES)]


def masses(coupling):
    """Masses on hardening springs, pulled towards others by `coupling` (symmetric); the first is pushed. All positions but one are seen."""

    def ode(x, u, p, t):
        q, v = ([getattr(x, f"{letter}{i}") for i in range(N_MASSES)] for letter in "qv")
        pulled = []
        for i in range(N_MASSES):
            others = sum(coupling[i, j] * (q[j] - q[i]) for j in range(N_MASSES) if coupling[i, j])
            pulled.append(others - q[i] - p.hard * q[i] ** 3 - 0.1 * v[i] + (u.push if i == 0 else 0))
        return [*v, *pulled]

    return Model(
        name="masses",
        states=[Variable(name) for name in NAMES],
        unknown_parameters=[Variable("hard", start=0.3)],
        inputs=[Variable("push")],
        outputs=[Variable(f"y{i}") for i in range(1, N_MASSES)] + [Variable("y0")],
        ode=ode,
        output=lambda x, u, p, t: [*[getattr(x, f"q{i}") for i in range(1, N_MASSES)], x.q0],
    )


def motion(coupling, s, push):
    """Positions and velocities at the sample instants (samples x 2 N_MASSES) from s = [x; hard], by small Runge-Kutta steps."""
    laplacian = coupling - np.diag(coupling.sum(1))

    def rate(x, u):
        q, v = x[:N_MASSES], x[N_MASSES:]
        pulled = laplacian @ q - q - s[-1] * q**3 - 0.1 * v
        pulled[0] += u
        return np.concatenate([v, pulled])

    x, h, found = s[:-1], TS / STEPS, [s[:-1]]
    for u in push:
        for _ in range(STEPS):
            k1 = rate(x, u)
            k2 = rate(x + h / 2 * k1, u)
            k3 = rate(x + h / 2 * k2, u)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3, u))
        found.append(x)
    return np.array(found)


def followed(made, y, push):
    """The run of an observer along a whole window of samples."""
    run = Instance(made)
    for k in range(L + 1):
        for i, value in zip(SEEN, y[k], strict=True):
            run.set(f"y{i}", value)
        run.set("push", push[min(k, L - 1)])
        run.step(k * TS, TS)
    return run


@pytest.mark.parametrize("coupling", [NEIGHBOURS, PAIRS, ALL], ids=["neighbours", "pairs", "all"])
def test_a_full_window_is_that_of_the_batch_least_squares(coupling):
    """Whether each mass sees few of the others, or all."""
    rng = np.random.default_rng(3)
    push = rng.uniform(-1, 1, L)
    true = np.append(rng.uniform(-1, 1, 2 * N_MASSES), 0.4)
    y = motion(coupling, true, push)[:, SEEN] + 1e-2 * rng.normal(size=(L + 1, N_MASSES))
    run = followed(pseudospectral(masses(coupling), sample_time=TS, N=7, L=L, segments=L), y, push)
    batch = least_squares(lambda s: (motion(coupling, s, push)[:, SEEN] - y).ravel(), true, xtol=1e-12, ftol=1e-12).x
    found = [run.get(f"filtered.{name}") for name in NAMES]
    np.testing.assert_allclose(found, motion(coupling, batch, push)[-1], rtol=0, atol=5e-6)
    assert run.get("filtered.hard") == pytest.approx(batch[-1], abs=5e-6)
    assert abs(batch[-1] - true[-1]) > 1e-4  # what the noise makes of it


@pytest.mark.parametrize("coupling", [NEIGHBOURS, ALL], ids=["neighbours", "all"])
def test_process_noise_of_a_rate_is_what_the_batch_least_squares_finds(coupling):
    """A constant over each segment of standard deviation intensity / sqrt(Ts), beside the known push on the same rate."""
    rng, sigma, intensity = np.random.default_rng(4), 1e-2, 0.1
    push, noise = rng.uniform(-1, 1, L), intensity / np.sqrt(TS) * rng.normal(size=L)
    true = np.append(rng.uniform(-1, 1, 2 * N_MASSES), 0.4)
    y = motion(coupling, true, push + noise)[:, SEEN] + sigma * rng.normal(size=(L + 1, N_MASSES))
    given = {f"y{i}": sigma for i in range(N_MASSES)}
    made = pseudospectral(
        masses(coupling),
        sample_time=TS,
        N=7,
        L=L,
        segments=L,
        measurement_noise=given,
        process_noise={"v0": intensity},
    )
    run = followed(made, y, push)

    def residual(s):
        gap = motion(coupling, s[: len(true)], push + s[len(true) :])[:, SEEN] - y
        return np.append(gap.ravel() / sigma, s[len(true) :] * np.sqrt(TS) / intensity)

    batch = least_squares(residual, np.append(true, np.zeros(L)), xtol=1e-12, ftol=1e-12).x
    last = motion(coupling, batch[: len(true)], push + batch[len(true) :])[-1]
    np.testing.assert_allclose([run.get(f"filtered.{name}") for name in NAMES], last, rtol=0, atol=1e-5)
    assert np.abs(last - motion(coupling, true, push + noise)[-1]).max() > 1e-3


@pytest.mark.parametrize(("coupling", "sparse"), [(NEIGHBOURS, True), (PAIRS, True), (ALL, False)])
def test_few_neighbours_are_worked_on_by_rates_and_many_by_nodes(coupling, sparse):
    eq = masses(coupling).equations
    thin = thinned(split(eq.ode, eq.x, eq.u), eq.ode, eq.x, eq.u)
    assert are_sparse(thin, eq.x, 7) == sparse
    assert not are_sparse(thin, eq.x, 11)  # tiles of so many nodes are no better
