"""The ports of the canonical DAE observer beside those that every observer has, and its documentation page."""

from __future__ import annotations

from observers import ports
from observers.canonical_dae.dae import Dae
from observers.canonical_dae.gain import Gain
from observers.canonical_dae.stability import Spectrum
from observers.component import Port
from observers.model import Model

SINGULAR = Port(
    "diagnostics.singular_gains", "samples with a singular gain so far", kind="Integer", variability="discrete"
)


def lambdas(model: Model, dae: Dae) -> tuple[Port, ...]:
    """`diagnostics.lambda`, or `diagnostics.lambda[i]` for several: one for each output, less the unknown disturbances."""
    several = dae.n_lambda > 1
    return tuple(
        Port(
            f"diagnostics.lambda[{i}]" if several else "diagnostics.lambda",
            "relaxation, 0 where model and measurements agree"
            + (f"; of {model.outputs[i - 1].name}" if dae.n_disturbances == 0 else ""),
            variability="discrete",
        )
        for i in range(1, dae.n_lambda + 1)
    )


def disturbances(model: Model) -> tuple[Port, ...]:
    """`estimate.<disturbance>`, then `filtered.<disturbance>`: both the mean over the last sample interval."""
    made = []
    for group, variability in (("estimate", "continuous"), ("filtered", "discrete")):
        for v in model.unknown_disturbances:
            text = f"unknown {v.description or v.name}, mean over the last sample interval"
            made.append(Port(f"{group}.{v.name}", text, v.unit, nominal=v.nominal, variability=variability))
    return tuple(made)


def structure(form: str, order: int, degree: int) -> tuple[Port, ...]:
    """`structure.order` and `structure.degree`, of which one is 0."""
    return (
        Port(
            "structure.order",
            "order of the backward differentiation; 0: w-form",
            start=order if form == "bdf" else 0,
            kind="Integer",
            variability="constant",
            local=True,
        ),
        Port(
            "structure.degree",
            "degree of the polynomial through past measurements; 0: backward differentiation, which needs none",
            start=0 if form == "bdf" else degree,
            kind="Integer",
            variability="constant",
            local=True,
        ),
    )


def documentation(model: Model, gain: Gain, stable: Spectrum | None, form: str, order: int, degree: int) -> str:
    """The method in short, as HTML."""
    how = (
        f"by Runge-Kutta steps of its w-form, with a polynomial of degree {degree} through the last {degree + 1} samples"
        if form == "w"
        else f"by backward differentiation of order {order}, as in the report"
    )
    return (
        f"<p>The model {model.name} and its measurements, relaxed by lambda to a differential-algebraic equation of index 1 "
        f"(Nikoukhah, INRIA RR-2677, 1995), are integrated {how}; gain: {gain.description}. Connect the measurements and the known "
        f"inputs, and step with at most the sample time.</p>{stable.html() if stable else ''}"
        "<p>The outputs of <code>filtered.*</code> satisfy the last measurement exactly; <code>estimate.*</code> follows the model "
        "from there to the current time. <code>diagnostics.lambda</code> is a residual, <code>diagnostics.fault</code> a threshold "
        "with persistence on it. <code>diagnostics.status</code> says whether the estimate can be trusted.</p>"
        f"{ports.VALIDITY_HTML}"
    )
