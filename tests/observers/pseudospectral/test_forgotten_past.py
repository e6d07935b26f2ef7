"""Samples that contradict the estimate: what the arrival cost knew of the time before counts no longer."""

import numpy as np
import pytest

from observers.instance import Instance
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral

TS, L, RATE = 0.1, 3, 0.5
SIGMA, SPREAD = 0.1, 0.2  # of a measurement; of the guess, and of what is known when the past is forgotten
JUMP = 40  # sample at which the plant is elsewhere


def model(offset: bool) -> Model:
    """x' = -RATE x, measured, and with an `offset` x + b too, whose constant b is unknown."""
    return Model(
        name="decay",
        states=[Variable("x", start=1.0)],
        unknown_parameters=[Variable("b", start=0.5)] if offset else [],
        outputs=[Variable("y"), *([Variable("w")] if offset else [])],
        ode=lambda x, u, p, t: [-RATE * x.x],
        output=lambda x, u, p, t: [x.x, *([x.x + p.b] if offset else [])],
    )


def truth(k: int, offset: bool) -> np.ndarray:
    """[x, b] at the sample k."""
    x, b = (1.0, 0.5) if k < JUMP else (5.0, -2.5)
    return np.array([x * np.exp(-RATE * TS * (k - JUMP * (k >= JUMP))), *([b] if offset else [])])


def rows(i: int, offset: bool) -> np.ndarray:
    """What is measured i samples after a state, by that state."""
    decay = np.exp(-RATE * TS * i)
    return np.array([[decay, 0.0], [decay, 1.0]]) if offset else np.array([[decay]])


def batch(mean: np.ndarray, first: int, offset: bool) -> np.ndarray:
    """The least-squares estimate at the sample first + L: of the window's samples, and of `mean` at its first with the guess's spread."""
    A = [rows(i, offset) / SIGMA for i in range(L + 1)] + [np.eye(len(mean)) / SPREAD]
    b = [rows(0, offset) @ truth(first + i, offset) / SIGMA for i in range(L + 1)] + [mean / SPREAD]
    found = np.linalg.lstsq(np.vstack(A), np.concatenate(b), rcond=None)[0]
    found[0] *= np.exp(-RATE * TS * L)
    return found


@pytest.mark.parametrize("offset", [False, True], ids=["a state", "a state and an unknown parameter"])
def test_after_a_jump_of_the_plant_the_past_is_forgotten(offset: bool) -> None:
    """Then the estimate is the least-squares one of the window and of a guess with the first one's spread around the last estimate."""
    names = ["x", "b"][: 1 + offset]
    outputs = ["y", "w"][: 1 + offset]
    component = pseudospectral(
        model(offset),
        sample_time=TS,
        N=9,
        L=L,
        arrival_cost=True,
        measurement_noise=dict.fromkeys(outputs, SIGMA),
        initial_std=dict.fromkeys(names, SPREAD),
    )
    run, estimates, begun = Instance(component), [], []
    for k in range(JUMP + 2 * L + 1):
        for name, value in zip(outputs, rows(0, offset) @ truth(k, offset), strict=True):
            run.set(name, value)
        run.step(k * TS, TS)
        estimates.append(np.array([run.get(f"filtered.{name}") for name in names]))
        begun.append(run.get("diagnostics.restarts"))
    first = begun.index(1)  # the sample after which the past is forgotten, as long as one is far off
    assert first in (JUMP + 1, JUMP + 2) and begun[-1] == 1
    for k in (first + 1, first + 2):
        mean = estimates[k - 1].copy()
        mean[0] *= np.exp(RATE * TS * (L - 1))  # where the last window's trajectory begins this one
        np.testing.assert_allclose(estimates[k], batch(mean, k - L, offset), rtol=0, atol=1e-8)
    assert np.abs(estimates[-1] - truth(JUMP + 2 * L, offset)).max() < 0.05
