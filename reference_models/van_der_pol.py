"""The modified Van der Pol system of Calvillo-Corona & Alamir, (4) to (6), with the external signal v unknown or absent."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from observers.model import Model, Names, Variable

_EXTERNAL = Variable("v", "external signal", nominal=0.5)


def _rates(x: Names, u: Names, v: Any) -> list[Any]:
    return [x.x2 + u.u + v, -9 * x.x1 + u.mu * (1 - x.x1**2) * x.x2]


def _erroneous(x: Names, u: Names) -> list[Any]:
    first, second = _rates(x, u, u.v)
    return [first, second / 0.5]


def _model(name: str, disturbances: list[Variable], text: str) -> Model:
    return Model(
        name=name,
        description=f"Modified Van der Pol system, {text} (Calvillo-Corona & Alamir, (4) to (6))",
        states=[
            Variable("x1", "first state", start=0.5, min=-3.0, max=3.0),
            Variable("x2", "second state", start=-0.3, min=-6.0, max=6.0),
        ],
        inputs=[Variable("u", "known input"), Variable("mu", "known damping", nominal=0.1)],
        unknown_disturbances=disturbances,
        outputs=[Variable("y", "measured first state")],
        ode=lambda x, u, p, t: _rates(x, u, u.v if disturbances else 0),
        output=lambda x, u, p, t: [x.x1],
    )


VAN_DER_POL = _model("van_der_pol", [_EXTERNAL], "external signal v unknown")
VAN_DER_POL_SIGNED = _model(
    "van_der_pol_signed", [replace(_EXTERNAL, min=0.0, max=0.5)], "external signal v unknown within 0 and 0.5"
)
VAN_DER_POL_KNOWN = _model("van_der_pol_known", [], "without external signal")
# Section 5.2: what the paper makes its first trajectories from, (5) divided by 0.5.
VAN_DER_POL_ERRONEOUS = replace(VAN_DER_POL, ode=lambda x, u, p, t: _erroneous(x, u))
