"""Status, tuning and outputs of the Riccati observer beside those that every observer has, and its documentation page."""

from __future__ import annotations

from types import SimpleNamespace

from observers import ports, units
from observers.component import Enumeration, Port
from observers.linearisation import Linearisation
from observers.model import Model
from observers.riccati.certificates import Certificate
from observers.riccati.tuning import UNKNOWN

_STATUS = Enumeration(
    "RiccatiStatus",
    (
        ("propagated_guess", "no sample yet: the estimate is the propagated guess"),
        ("corrected", "the last sample corrected the estimate"),
        (
            "sample_rejected",
            "a measurement was missing or not finite: the estimate is the prediction, or rests on the other outputs",
        ),
        ("solver_failed", "a step was not finite: the estimate was held, Q starts again from Q0"),
    ),
)
CODE = SimpleNamespace(**{item: i for i, (item, _) in enumerate(_STATUS.items, start=1)})

STATUS = ports.status(_STATUS)


def initial_error(line: Linearisation) -> Port:
    """`tuning.initial_error`, in the unit of the states where they share one."""
    return Port(
        "tuning.initial_error",
        "bound on |x0 - m0| where it is known better than by the model's bounds",
        units.common(line.variables),
        UNKNOWN,
        min=0.0,
        variability="fixed",
    )


def covariance(line: Linearisation) -> tuple[Port, ...]:
    """`diagnostics.Q[i,j]`, row by row."""
    return tuple(
        Port(
            f"diagnostics.Q[{i},{j}]",
            "covariance-like matrix Q of the gain, now",
            units.product([(units.difference(v.unit), 1) for v in (row, column)]),
        )
        for i, row in enumerate(line.variables, start=1)
        for j, column in enumerate(line.variables, start=1)
    )


def documentation(model: Model, known: Certificate, stiff: bool) -> str:
    """The method in short and its certificates, as HTML."""
    how = "an exponential Rosenbrock step" if stiff else "Dormand and Prince's method of order 8"
    return (
        f"<p>At every sample instant the estimate of the model {model.name} is corrected with the gain of a Riccati equation along it "
        f"(James and Baras, University of Maryland, 1987); between samples the estimate moves by {how}. Connect the measurements and "
        "the known inputs, and step with at most the sample time.</p>"
        f"{known.html()}"
        "<p><code>diagnostics.status</code> says whether the estimate can be trusted; <code>estimate.*</code> is of the current time, "
        "<code>filtered.*</code> of the last sample instant.</p>"
        f"{ports.VALIDITY_HTML}"
    )
