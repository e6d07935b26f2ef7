"""Tables in a model's equations: refused where an estimate can leave them, whatever the equations around them look like."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from observers.component import Component
from observers.model import Model, ModelError, Variable
from observers.riccati import riccati
from observers.tables import refuse_tables_that_end
from observers.ukf import ukf


def cell(table: str, **bounds: float) -> Model:
    grid = np.linspace(0, 1, 21)
    voltage = ca.interpolant("ocv", table, [grid], 3 + grid)
    return Model(
        name="cell",
        states=[Variable("soc", start=0.5, **bounds)],
        inputs=[Variable("i")],
        outputs=[Variable("v")],
        ode=lambda x, u, p, t: [-u.i / 3600],
        output=lambda x, u, p, t: [voltage(x.soc)],
    )


@pytest.mark.parametrize("make", [ukf, riccati])
def test_a_table_that_ends_is_refused_unless_bounds_hold_its_argument_within(make: Callable[..., Component]) -> None:
    make(cell("bspline", min=0.0, max=1.0), sample_time=1.0)
    make(cell("linear"), sample_time=1.0)
    for bounds, words in (
        ({}, "soc = "),
        ({"min": 0.0}, "soc = "),
        ({"min": 0.0, "max": 1.2}, "reaches 1.2 where soc = 1.2"),
    ):
        with pytest.raises(ModelError, match=f"'ocv' is 0 beyond its grid.*{words}"):
            make(cell("bspline", **bounds), sample_time=1.0)


def test_what_equations_share_is_looked_at_once() -> None:
    """An expression of 60 steps, each of which uses the one before twice: 2^60 ways through it, one table at its end."""
    table = ca.interpolant("ocv", "bspline", [np.linspace(0, 1, 21)], np.linspace(3, 4, 21))

    def shared(value: ca.SX) -> ca.SX:
        for _ in range(60):
            value = ca.sin(value) * value
        return value

    def model(**bounds: float) -> Model:
        return Model(
            name="shared",
            states=[Variable("soc", start=0.5, **bounds)],
            outputs=[Variable("v")],
            ode=lambda x, u, p, t: [-x.soc],
            output=lambda x, u, p, t: [shared(table(x.soc))],
        )

    refuse_tables_that_end(model(min=0.0, max=1.0), "m")
    with pytest.raises(ModelError, match="m: model 'shared', output of 'v': the table 'ocv' is 0 beyond its grid"):
        refuse_tables_that_end(model(), "m")
