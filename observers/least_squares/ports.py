"""Status and diagnostics of the least-squares observer beside those that every observer has, and its documentation page."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

from observers import ports
from observers.component import Enumeration, Port
from observers.least_squares.tuning import Weight
from observers.model import Model

_STATUS = Enumeration(
    "LeastSquaresStatus",
    (
        ("propagated_guess", "no sample yet: the estimate is the propagated guess"),
        ("corrected", "the last sample corrected the estimate"),
        (
            "sample_rejected",
            "a measurement was missing or not finite: the estimate is the prediction, or rests on the other outputs",
        ),
        ("solver_failed", "a step was not finite: the estimate was held, a new interval begins"),
    ),
)
CODE = SimpleNamespace(**{item: i for i, (item, _) in enumerate(_STATUS.items, start=1)})

STATUS = ports.status(_STATUS)
_CONTRACTION = (
    Port(
        "diagnostics.contraction",
        "|Phi Y^-1| / p0 of the last whole interval: no error has grown by more",
        variability="discrete",
    ),
    Port(
        "diagnostics.certified_contraction",
        "mu / (1 + gamma p0 lmin(W)) of the last whole interval, the theorem's bound",
        variability="discrete",
    ),
)
INTERVALS = Port("diagnostics.intervals", "intervals completed so far", kind="Integer", variability="discrete")


def contraction(reset: Weight) -> tuple[Port, ...]:
    """`diagnostics.contraction` and `.certified_contraction`, of |e|, or with `initial_std` of |e / initial_std|, where p0 is 1."""
    if not reset.by_name:
        return _CONTRACTION
    return tuple(
        replace(port, description=f"{port.description}; errors and P_o in units of tuning.initial_std, p0 = 1")
        for port in _CONTRACTION
    )


def documentation(model: Model, linearise: bool) -> str:
    along = ", linearised along its estimate" if linearise else ""
    return (
        f"<p>Between two resets the samples fit the state of the model {model.name}{along} at the interval's start by recursive "
        "least squares; each reset forgets them (Chen and Yen, IEEE Trans. Automat. Contr., 1999). Connect the measurements and "
        "the known inputs, and step with at most the sample time.</p>"
        "<p><code>diagnostics.contraction</code> is the factor by which the error of the last interval can have grown or shrunk at most, "
        "<code>diagnostics.certified_contraction</code> the theorem's bound of it.</p>"
        "<p><code>diagnostics.status</code> says whether the estimate can be trusted; <code>estimate.*</code> is of the current time, "
        f"<code>filtered.*</code> of the last sample instant.</p>{ports.VALIDITY_HTML}"
    )
