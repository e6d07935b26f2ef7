"""A plant natively moves as the equations do, whatever its inputs do between samples."""

from __future__ import annotations

import numpy as np
import pytest

from advice.streams.motion import Motion
from observers.model import Model, Variable
from reference_models.plant import plant

TS, N = 0.5, 12


@pytest.mark.parametrize("between", ["held", "linear"])
def test_a_motion_is_the_closed_form(between: str) -> None:
    """x' = -a x + u, y = x + u: over a sample u is u_k, or u_k + s t, which substeps follow to order 4."""
    model = Model(
        name="lag",
        states=[Variable("x", start=1.0)],
        inputs=[Variable("u")],
        unknown_parameters=[Variable("a", start=1.0)],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [-p.a * x.x + u.u],
        output=lambda x, u, p, t: [x.x + u.u],
        input_between_samples=between,
    )
    a, x = 0.7, -2.0
    motion = Motion(plant(model, max_step=TS / 4), TS, between == "linear")
    u = np.random.default_rng(0).standard_normal((N, 1))
    found = motion.outputs(np.array([x, a]), u, t0=3.0)
    assert motion.estimated == ["x", "a"]
    expected = []
    for k in range(N):
        expected.append(x + u[k, 0])
        slope = (u[k + 1, 0] - u[k, 0]) / TS if between == "linear" and k + 1 < N else 0.0
        rest, gone = u[k, 0] / a - slope / a**2, np.exp(-a * TS)
        x = rest + slope / a * TS + (x - rest) * gone
    np.testing.assert_allclose(found[:, 0], expected, rtol=0, atol=1e-12 if between == "held" else 3e-7)
