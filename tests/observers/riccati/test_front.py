"""The front of rate and radius of James & Baras: against the paper's formulas over the same grid, scipy, and how errors decay in runs."""

from __future__ import annotations

import math
from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_are

from observers.instance import Instance
from observers.model import Model, ModelError, Variable
from observers.riccati import fastest, riccati, trade_off, widest
from observers.riccati.certificates import INSIDE
from observers.riccati.front import N_SCALES, Q0_PARTS, Tried
from reference_models.james_baras_5_1 import JAMES_BARAS_5_1
from reference_models.plant import plant

PENDULUM = Model(
    name="pendulum",
    states=[Variable("angle"), Variable("rate")],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [x.rate, -ca.sin(x.angle) - 0.5 * x.rate],
    output=lambda x, u, p, t: [x.angle],
)


def pendulum(angle: float) -> np.ndarray:
    return np.array([[0.0, 1.0], [-math.cos(angle), -0.5]])


@cache
def front() -> tuple[Tried, ...]:
    return trade_off(PENDULUM)


def test_the_best_of_the_grid_is_that_of_the_papers_formulas() -> None:
    """x' = -x + 0.2 sin x, y = sin x: alpha0 = 0.8 with Lambda = 0, for Dh may vanish; a = 1.2."""
    model = Model(
        name="waves",
        states=[Variable("x")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-x.x + 0.2 * ca.sin(x.x)],
        output=lambda x, u, p, t: [ca.sin(x.x)],
    )
    N0, R = 0.7, 3.0
    N, part = np.meshgrid(N0 * N_SCALES, Q0_PARTS)
    r0, q = N**2, N**2 / 1.6  # (3.7) by comparison; Q0 is at most q
    Q0 = part * q
    p = np.maximum(1 / Q0, (1.2 + np.sqrt(1.44 + r0 / R**2)) / r0)
    near, rho = r0 / (2 * q), r0 * np.sqrt(Q0) / q**2 / (np.sqrt(p) * 0.2 + np.sqrt(q) / R**2)  # (2.3)
    assert (r0 / q**2 - 4 * p * 1.2 - 4 / R**2).max() < 0  # (2.6)
    found = trade_off(model, N=N0, R=R)
    for rate in (0.1, 0.4, 0.75):
        assert widest(found, rate).radius(rate) == pytest.approx((rho * (1 - rate / near)).max(), rel=1e-6)
    for radius in (0.01, 0.2, 0.9 * rho.max()):
        assert fastest(found, radius).rate(radius) == pytest.approx((near * (1 - radius / rho)).max(), rel=1e-6)


def bound_of_Q(N: np.ndarray, Q0: np.ndarray) -> float:
    """The least |c X|: X the solution of the pendulum's algebraic equation that forgets at the least rate that bounds Q, by scipy."""

    def excess(theta: float) -> tuple[float, np.ndarray]:
        mean = np.array([[0.0, 1.0], [0.0, -0.5]])
        C = np.array([[1.0, 0.0]])
        X = solve_continuous_are((mean + theta / 2 * np.eye(2)).T, C.T, N @ N.T, np.eye(1))
        left = [
            A @ X + X @ A.T - X @ C.T @ C @ X + N @ N.T for A in (pendulum(0.0), pendulum(math.pi))
        ]  # affine in the cosine
        return max(np.linalg.eigvalsh(M)[-1] for M in left), X

    low, high = 0.01, 100.0
    for _ in range(16):
        theta = math.sqrt(low * high)
        low, high = (low, theta) if excess(theta)[0] < 0 else (theta, high)
    X = excess(high)[1]
    root = np.linalg.inv(np.linalg.cholesky(X))
    return max(1.0, np.linalg.eigvalsh(root @ Q0 @ root.T)[-1]) * np.linalg.eigvalsh(X)[-1]


def test_the_certificates_of_the_pendulums_front_are_scipys() -> None:
    for one in front()[::3]:
        N, Q0 = np.diag(one.design["N"]), np.diag(one.design["Q0"])
        q = one.certificate.q
        least = bound_of_Q(N, Q0)
        assert least * (1 - 1e-5) <= q <= least * 1.4  # norms for eigenvalues
        # a = sup lmax(-(A + A') / 2) is at cos = -1, where A + A' = [[0, 2], [2, -1]].
        r0, a = N[0, 0] ** 2, np.linalg.eigvalsh(-(pendulum(math.pi) + pendulum(math.pi).T) / 2)[-1]
        a = max(a, np.linalg.eigvalsh(-(pendulum(0.0) + pendulum(0.0).T) / 2)[-1])
        p = max(1 / Q0[0, 0], (a + math.sqrt(a**2 + r0)) / r0)
        assert p <= one.certificate.p <= p * 1.02
        assert one.rate(0.0) == pytest.approx(r0 / (2 * q), rel=1e-7)
        rho = r0 * math.sqrt(Q0[0, 0]) / q**2 / math.sqrt(one.certificate.p)  # (2.3): |D2f| = 1, |D2h| = 0
        assert one.radius(0.0) == pytest.approx(rho, rel=1e-7)
        assert one.rate(rho / 3) == pytest.approx(r0 / (3 * q), rel=1e-6)
        assert one.rate(one.radius(0.2)) == pytest.approx(0.2, rel=1e-6)


def test_on_the_front_what_is_faster_is_narrower() -> None:
    rates, radii = [one.rate(0.0) for one in front()], [one.radius(0.0) for one in front()]
    assert len(rates) > 5 and np.all(np.diff(rates) > 0) and np.all(np.diff(radii) < 0)
    assert rates[-1] > 1.5 * rates[0] and radii[0] > 20 * radii[-1]


def test_a_common_factor_of_the_design_changes_no_certificate() -> None:
    """N, R by 4 and Q0 by 16: q by 16, p by 1/16; (2.3) and the rates stay."""
    for one in front()[::3]:
        scaled = {name: factor * one.design[name] for name, factor in (("N", 4.0), ("R", 4.0), ("Q0", 16.0))}
        ports = {port.name: port.start for port in riccati(PENDULUM, sample_time=0.01, **scaled).constants}
        # X has six digits.
        assert ports["certificate.rho"] == pytest.approx(one.radius(0.0), rel=1e-4)
        assert ports["certificate.q"] == pytest.approx(16 * one.certificate.q, rel=1e-4)


@pytest.mark.parametrize("radius", [0.02, 0.08])
def test_the_error_of_the_papers_observer_decays_as_the_chosen_design_guarantees(radius: float) -> None:
    """(2.1), (2.2) by scipy, from twelve guesses on the radius: e' P e <= e0' P0 e0 exp(-2 rate t)."""
    one = fastest(front(), radius)
    rate, NN, Q0 = one.rate(radius), np.diag(one.design["N"]) ** 2, np.diag(one.design["Q0"])

    def moving(t: float, z: np.ndarray) -> np.ndarray:
        x, m, Q = z[:2], z[2:4], z[4:].reshape(2, 2)
        A = pendulum(m[0])
        f = [np.array([v[1], -math.sin(v[0]) - 0.5 * v[1]]) for v in (x, m)]
        return np.concatenate([f[0], f[1] + Q[:, 0] * (x[0] - m[0]), (A @ Q + Q @ A.T - Q[:, :1] @ Q[:1] + NN).ravel()])

    times = np.linspace(0, 8, 81)
    for angle in np.arange(12) * math.pi / 6:
        x0 = np.array([2.0, -0.5])
        m0 = x0 - radius * np.array([math.cos(angle), math.sin(angle)])
        z = solve_ivp(moving, (0, 8), [*x0, *m0, *Q0.ravel()], t_eval=times, method="LSODA", rtol=1e-10, atol=1e-13).y
        V = np.array(
            [e @ np.linalg.solve(Q.reshape(2, 2), e) for e, Q in zip((z[:2] - z[2:4]).T, z[4:].T, strict=True)]
        )
        assert np.all(V[0] * np.exp(-2 * rate * times) * (1 + 1e-6) + 1e-15 >= V)


def test_the_sampled_observer_of_the_chosen_design_says_its_rate_and_keeps_it() -> None:
    """Through the Python face at Ts = 0.01, of which nothing is proven: |e(t)| <= sqrt(q |P0|) |e0| exp(-rate t)."""
    radius = 0.05
    one = fastest(front(), radius)
    x0 = {"angle": 2.0, "rate": -0.5}
    component = riccati(PENDULUM, sample_time=0.01, **one.design)
    for angle in np.arange(4) * math.pi / 2:
        guess = {"guess.angle": 2.0 - radius * math.cos(angle), "guess.rate": -0.5 - radius * math.sin(angle)}
        run = Instance(component, {**guess, "tuning.initial_error": radius})
        true = Instance(plant(PENDULUM), {f"start.{k}": v for k, v in x0.items()})
        assert run.get("diagnostics.certified") == INSIDE
        assert run.get("diagnostics.guaranteed_rate") == pytest.approx(one.rate(radius), rel=1e-8)
        bound = math.sqrt(one.certificate.q * one.certificate.P0) * radius
        for k in range(600):
            run.set("y", true.get("y"))
            for each in (run, true):
                each.step(0.01 * k, 0.01)
            error = math.hypot(*[run.get(f"estimate.{v}") - true.get(f"x.{v}") for v in x0])
            assert error <= bound * math.exp(-one.rate(radius) * 0.01 * (k + 1))


def test_other_matrices_than_the_identity_improve_the_guaranteed_rate_of_example_5_1() -> None:
    """As the paper says of it. The front has one design: a linear model has no radius."""
    [best] = trade_off(JAMES_BARAS_5_1)
    identity = {port.name: port.start for port in riccati(JAMES_BARAS_5_1, sample_time=0.01, N=1.0).constants}
    assert best.rate(math.inf) > 9 / (2 * identity["certificate.q"])
    assert fastest([best], math.inf) is best and widest([best], 0.05).radius(0.05) == math.inf
    with pytest.raises(ValueError, match="no design decays for certain with 1 1/s"):
        widest([best], 1.0)


def test_what_no_design_guarantees_is_refused_with_what_one_does() -> None:
    with pytest.raises(ValueError, match=r"fastest: no design converges for certain from 3 off; the farthest is 0\.1"):
        fastest(front(), 3.0)
    with pytest.raises(
        ValueError, match=r"widest: no design decays for certain with 2 1/s; the fastest decays with 0\.7"
    ):
        widest(front(), 2.0)
    cubic = Model(
        name="cubic",
        states=[Variable("x")],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-(x.x**3)],
        output=lambda x, u, p, t: [x.x],
    )
    with pytest.raises(ModelError, match=r"trade_off: no design of model 'cubic' has a certificate: .*no bound over x"):
        trade_off(cubic)
