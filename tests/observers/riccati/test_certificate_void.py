"""What makes a certificate void, for good; and the radius and the rates of James & Baras (2.3), (2.6) of a model known in closed form."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator

import pytest

from observers.component import Component
from observers.instance import Instance
from observers.model import Model, Variable
from observers.riccati import riccati, suprema
from observers.riccati.certificates import ANYWHERE, INSIDE, NONE
from reference_models.james_baras_5_2 import JAMES_BARAS_5_2

N, R, Q0 = 1.2, 3.0, 0.5
# x in [-1, 1]: A = -k + 0.2 x, Dh = 1 + 0.1 x.
CURVED = Model(
    name="curved",
    states=[Variable("x", min=-1.0, max=1.0)],
    inputs=[Variable("u", min=-1.0, max=1.0)],
    parameters=[Variable("k", start=1.0)],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [-p.k * x.x + 0.1 * x.x**2 + u.u],
    output=lambda x, u, p, t: [x.x + 0.05 * x.x**2],
)


@pytest.fixture(autouse=True, scope="module")
def few_cells() -> Iterator[None]:
    """The suprema are at the ends of the region, whatever it is cut into; 256 cells take seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(suprema, "CELLS", 8)
        yield


@functools.cache
def made(design: float = 1.0) -> Component:
    return riccati(CURVED, sample_time=0.1, N=N, R=R * design, Q0=Q0)


def certificate(run: Instance) -> tuple[float, float]:
    return run.get("diagnostics.certified"), run.get("diagnostics.guaranteed_rate")


CAUSES = {
    "a missing sample": {"measurement_valid.y": 0.0},
    "a sample that is no number": {"y": math.nan},
    "an estimate beyond the bounds": {"y": 80.0},
    "an input beyond its bound": {"u": 1.01},
    "an input below its bound": {"u": -1.01},
    "a parameter": {"parameter.k": 1.1},
    "the tuning": {"tuning.N.x": N * 1.01},
}


@pytest.mark.parametrize("cause", [*CAUSES, "nothing"])
def test_a_certificate_that_is_void_does_not_come_back(cause: str) -> None:
    run = Instance(made(), {"guess.x": 0.95})
    first = certificate(run)
    assert first[0] != NONE and first[1] > 0
    for k in range(8):
        if k in (3, 4):
            usual = {
                "measurement_valid.y": 1.0,
                "y": 0.1,
                "u": 1.0 if k == 3 else -1.0,
                "parameter.k": 1.0,
                "tuning.N.x": N,
            }
            for name, value in (usual | (CAUSES.get(cause, {}) if k == 3 else {})).items():
                run.set(name, value)
        run.step(0.1 * k, 0.1)
        assert certificate(run) == (first if k < 3 or cause == "nothing" else (NONE, 0)), k


def test_the_radius_and_the_rates_are_the_papers_of_their_constants() -> None:
    """With the bounds of |P| and |Q| that were found: by hand."""
    for design in (1.0, 0.2):
        found = {port.name.removeprefix("certificate."): port.start for port in made(design).constants}
        A, Dh, D2f, D2h, R1, r0, P0 = 1.2, 1.1, 0.2, 0.1, (R * design) ** -2, N**2, 1 / Q0
        H = Dh / (R * design)
        for name, value in (("A", A), ("H", H), ("D2f", D2f), ("D2h", D2h)):
            assert found[name] == pytest.approx(value, rel=1e-8) and found[name] >= value
        assert found["p"] == pytest.approx(max(P0, (A + math.sqrt(A**2 + r0 * H**2)) / r0), rel=1e-7)
        for suffix in ("", "_paper"):
            q = found[f"q{suffix}"]
            C = math.sqrt(found["p"]) * D2f + math.sqrt(q) * R1 * Dh * D2h  # of (2.3)
            rho, delta = r0 / (q**2 * math.sqrt(P0) * C), r0 / q**2 - 4 * found["p"] * A - 4 * R1 * Dh**2
            assert found[f"rho{suffix}"] == pytest.approx(rho, rel=1e-7) and found[f"rho{suffix}"] <= rho
            assert found[f"delta{suffix}"] == pytest.approx(delta, rel=1e-7)
        for error in (0.01, 0.5, 0.99, 7.0):
            distance = min(error, 1.0)  # the bounds leave no more, from a guess in their middle
            rate = r0 / (2 * found["q"]) * (1 - distance / found["rho"])
            code, shown = certificate(Instance(made(design), {"tuning.initial_error": error}))
            assert code == INSIDE and shown == pytest.approx(rate, rel=1e-7)


def test_a_design_by_deviations_has_the_certificate_of_the_matrices_that_it_says() -> None:
    """N N' = diag(process_noise^2), R R' / Ts = diag(measurement_noise^2), Q0 = diag(initial_std^2)."""
    by_name = riccati(
        CURVED,
        sample_time=0.1,
        process_noise={"x": N},
        measurement_noise={"y": R / math.sqrt(0.1)},
        initial_std={"x": math.sqrt(Q0)},
    )
    found, expected = ({port.name: port.start for port in one.constants} for one in (by_name, made()))
    assert found == pytest.approx(expected, rel=2e-8)


def test_the_rate_from_anywhere_is_that_of_delta_where_it_is_the_faster_one() -> None:
    """Example 5.2 with the guess as far off as one likes: q delta / 2."""
    component = riccati(JAMES_BARAS_5_2, sample_time=0.01, N=math.sqrt(0.2), R=3.0, Q0=0.01)
    found = {port.name.removeprefix("certificate."): port.start for port in component.constants}
    for error in (0.1, 1e6):
        rate = max(0.2 / found["q"] ** 2 * (1 - error / found["rho"]), found["delta"]) * found["q"] / 2
        code, shown = certificate(Instance(component, {"tuning.initial_error": error}))
        assert code == ANYWHERE and shown == pytest.approx(rate, rel=1e-6)
