"""The unscented filter made of loops: the same numbers as the unrolled one, and the Kalman filter's on a large linear model."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

from fmu_src.native.sources import functions
from observers.instance import Instance
from observers.model import Model, Variable
from observers.ukf import parts, ukf

TS = 0.1


def coupled(n: int, outputs: list[Any], called: bool = False, **bounds: float) -> Model:
    """A ring of n nonlinear states; `outputs`: of x0, x1, ...; `called`: the rate is a function that stays one."""
    x = ca.SX.sym("x", n)
    ring = ca.vertcat(*[-x[i] + 0.5 * ca.sin(x[(i + 1) % n]) - 0.3 * x[i - 1] ** 2 for i in range(n)])
    rate = ca.Function("rate", [x], [ring], {"never_inline": called})

    def ode(x: Any, u: Any, p: Any, t: Any) -> list[Any]:
        return [value + u.u for value in ca.vertsplit(rate(ca.vertcat(*[getattr(x, f"x{i}") for i in range(n)])))]

    return Model(
        name="coupled",
        states=[Variable(f"x{i}", start=0.1 * (i % 5), **bounds) for i in range(n)],
        inputs=[Variable("u")],
        outputs=[Variable("y0", wrap=2 * np.pi), *(Variable(f"y{i}") for i in range(1, len(outputs)))],
        ode=ode,
        output=lambda x, u, p, t: [h(x) for h in outputs],
    )


def estimates(observers: list[Instance], samples: int) -> list[np.ndarray]:
    """All outputs after each step; a sample is missing, one is an outlier, two in a row are absurd."""
    rng, found = np.random.default_rng(4), []
    ny = sum(port.name.startswith("measurement_valid") for port in observers[0].component.inputs)
    for k in range(samples):
        y = 0.3 * rng.normal(size=ny)
        y[0] = np.nan if k == 20 else y[0]
        y[-1] = {40: 1e3, 60: 1e200, 61: 1e200}.get(k, y[-1])
        for run in observers:
            for i, value in enumerate(y):
                run.set(f"y{i}", value)
            run.set("u", np.sin(k))
            run.step(TS * k, TS)
        found.append(np.array([run.outputs() for run in observers]))
    return found


@pytest.mark.parametrize(
    ("n", "outputs", "bounds"),
    [
        (3, [lambda x: x.x0 + x.x1**2], {}),
        (5, [lambda x: x.x0, lambda x: x.x2, lambda x: x.x0 * x.x4], {}),
        (3, [lambda x: x.x0, lambda x: x.x1 + x.x2], {"min": -0.4, "max": 0.5}),
        (4, [lambda x: x.x1, lambda x: ca.log(1.5 + x.x0)], {}),
    ],
    ids=["one output", "three outputs", "bounds", "logarithm"],
)
def test_loops_and_scalars_are_the_same_filter(
    n: int, outputs: list[Any], bounds: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    model = coupled(n, outputs, **bounds)
    made = [Instance(ukf(model, sample_time=TS))]
    monkeypatch.setattr(parts, "UNROLLED", 0)
    made.append(Instance(ukf(model, sample_time=TS)))
    for unrolled, looped in estimates(made, 90):
        assert_allclose(looped, unrolled, rtol=1e-12, atol=1e-12)


def test_on_a_linear_model_of_thirty_states_it_is_the_kalman_filter() -> None:
    n, ny = 30, 3
    rng = np.random.default_rng(3)
    A = np.where(rng.random((n, n)) < 0.2, rng.normal(size=(n, n)), 0) - 2 * np.eye(n)
    C = rng.normal(size=(ny, n))
    names = [f"x{i}" for i in range(n)]
    model = Model(
        name="large",
        states=[Variable(name) for name in names],
        outputs=[Variable(f"y{i}") for i in range(ny)],
        ode=lambda x, u, p, t: ca.vertsplit(ca.DM(A) @ ca.vertcat(*[getattr(x, name) for name in names])),
        output=lambda x, u, p, t: ca.vertsplit(ca.DM(C) @ ca.vertcat(*[getattr(x, name) for name in names])),
    )
    deviations = {"process_noise": dict.fromkeys(names, 0.3), "measurement_noise": {f"y{i}": 0.2 for i in range(ny)}}
    run = Instance(ukf(model, sample_time=0.02, **deviations), {"tuning.gate": 1e9})
    x, P, F = np.zeros(n), np.eye(n), expm(0.02 * A)
    for k in range(60):
        y = rng.normal(size=ny)
        y[rng.random(ny) < 0.2] = np.nan
        for i, value in enumerate(y):
            run.set(f"y{i}", value)
        run.step(0.02 * k, 0.02)
        there = np.isfinite(y)
        H = C[there]
        P = P + 0.3**2 * 0.02 * np.eye(n)
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + 0.2**2 * np.eye(len(H)))
        x, P = x + K @ (y[there] - H @ x), P - K @ H @ P
        x, P = F @ x, F @ P @ F.T
        assert_allclose([run.get(f"estimate.{name}") for name in names], x, rtol=0, atol=1e-9)
    std = np.sqrt(np.diag(P) + 0.3**2 * 0.02)
    assert_allclose([run.get(f"diagnostics.std.{name}") for name in names], std, rtol=0, atol=1e-9)


def test_a_rate_that_is_a_function_of_its_own_is_called_not_taken_apart() -> None:
    outputs = [lambda x: x.x0, lambda x: x.x5]
    inline, called = (Instance(ukf(coupled(12, outputs, kind), sample_time=TS)) for kind in (False, True))
    for a, b in estimates([inline, called], 10):
        assert_allclose(a, b, rtol=1e-12, atol=1e-12)


def test_the_c_of_fifty_states_is_no_longer_than_that_of_ten_unrolled() -> None:
    """Unrolled, ten states took 1.1 MB, and the length grows with the third power."""
    assert len(functions(ukf(coupled(50, [lambda x: x.x0]), sample_time=TS))["functions.c"]) < 1e6
