"""Corollary 2.1 of Nikoukhah: the eigenvalues of (2.56) over the region, by hand in numpy; what is unstable is refused."""

from __future__ import annotations

import re

import numpy as np
import pytest

from build_fmus import FMUS
from domain_models import MODELS
from observers.canonical_dae import canonical_dae
from observers.canonical_dae.dae import relaxed
from observers.canonical_dae.gain import given
from observers.canonical_dae.region import region
from observers.canonical_dae.stability import spectrum
from observers.instance import Instance
from observers.model import Model, ModelError, Variable
from reference_models.double_integrator import DOUBLE_INTEGRATOR
from reference_models.plant import plant

BENT = Model(
    name="bent",
    states=[Variable("x1", min=-0.5, max=0.5), Variable("x2", min=-0.5, max=0.5)],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [x.x2, -x.x1 - x.x2],
    output=lambda x, u, p, t: [x.x1 + 0.5 * x.x2**2],
)
GAMMA = np.array([[2.0], [-0.5]])


def said(documentation: str) -> list[float]:
    """The range of real parts in a documentation."""
    found = re.search(r"Corollary 2\.1: .* real parts from (\S+) to (\S+) 1/s", documentation)
    assert found
    return [float(one) for one in found.groups()]


def by_hand(x: np.ndarray) -> np.ndarray:
    """(2.56) to (2.58), corrected, of `BENT`: h_x = (1, x2), which moves with x2' = -x1 - x2."""
    A, C, C_dot = np.array([[0, 1], [-1, -1]]), np.array([[1, x[1]]]), np.array([[0, -x[0] - x[1]]])
    H = -C / (1 + x[1] ** 2)
    return A @ (np.eye(2) + C.T @ H) - C_dot.T @ H + GAMMA @ H


def test_where_the_outputs_gradient_moves_the_eigenvalues_are_those_of_2_56() -> None:
    dae, where = relaxed(BENT), region(BENT)
    found = spectrum(dae, given(dae, BENT, lambda x, u, p, t: GAMMA.tolist()), where)
    real = np.array([np.linalg.eigvals(by_hand(point[0].ravel())).real for point in where.points])
    assert found is not None and found.points == len(where.points) == 64
    assert [found.fastest, found.slowest] == pytest.approx([real.min(), real.max()], rel=1e-9)
    assert found.where == where.describe(where.points[int(np.argmax(real.max(axis=1)))])


def test_an_eigenvalue_that_only_the_motion_of_the_gradient_makes_positive_is_shown_and_refuses_nothing() -> None:
    """y = log c: h_x = 1 / c moves fast near c = 0, the poles with c held are those that are placed."""
    fastest, slowest = said(canonical_dae(MODELS["log_sensor"], sample_time=0.1, poles=[-1.0, -1.0]).documentation)
    assert fastest < -10 and slowest > 10


def test_near_an_equilibrium_the_observers_error_decays_with_the_slowest_of_them() -> None:
    """-0.634 and -2.366 1/s at x = 0."""
    slowest = np.linalg.eigvals(by_hand(np.zeros(2))).real.max()
    run = Instance(canonical_dae(BENT, sample_time=0.01, gain=lambda x, u, p, t: GAMMA.tolist(), guess={"x2": 1e-3}))
    true, errors = Instance(plant(BENT)), []
    for k in range(1200):
        run.set("y", true.get("y"))
        for one in (run, true):
            one.step(0.01 * k, 0.01)
        errors.append(np.hypot(run.get("estimate.x1"), run.get("estimate.x2")))
    assert np.log(errors[900] / errors[500]) / 4 == pytest.approx(slowest, rel=2e-3)


def test_the_documentation_says_what_the_gains_of_the_papers_examples_give() -> None:
    """Example 2.3: the poles. Example 2.1: s^2 + 2 s + u^2, the smallest u of Halton's 64 points between 0 and 2 being 0.016."""
    assert said(FMUS["double_integrator_canonical_dae"][0]().documentation) == [-10, -10]
    assert said(FMUS["pushed_mass_canonical_dae"][0]().documentation) == [-10, -10]
    roots = np.roots([1, 2, 0.015873**2])
    modulated = FMUS["modulated_canonical_dae"][0]()
    assert said(modulated.documentation) == pytest.approx(sorted(roots), rel=0.03)
    assert "u = 0.016" in modulated.documentation


def test_a_gain_with_which_errors_grow_or_stay_is_refused_with_the_eigenvalue_and_the_place() -> None:
    """Gamma = J, s^2 + j1 s + j2: -1 +- 2i for (2, 5), 1 +- 2i for (-2, 5)."""
    assert said(canonical_dae(DOUBLE_INTEGRATOR, sample_time=0.1, gain=lambda *_: [[2], [5]]).documentation) == [-1, -1]
    with pytest.raises(
        ModelError, match=r"a given gain .* \(2\.56\) .* eigenvalue 1 \+- 2 i at x1 = .*: an error does not decay there"
    ):
        canonical_dae(DOUBLE_INTEGRATOR, sample_time=0.1, gain=lambda *_: [[-2], [5]])
    with pytest.raises(ModelError, match=r"eigenvalue -?0 at x1 = .*"):  # s^2 + 2 s
        canonical_dae(DOUBLE_INTEGRATOR, sample_time=0.1, gain=lambda *_: [[2], [0]])
    with pytest.raises(ModelError, match=r"model 'bent' have the eigenvalue [\d.]+.* at x1 = "):
        canonical_dae(BENT, sample_time=0.1, gain=lambda *_: [[-2], [1]])
