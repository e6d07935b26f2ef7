"""What a method cannot treat, or leaves aside, said by the names of what the model has."""

from __future__ import annotations

import casadi as ca

from observers.model import Model, ModelError
from observers.numerics.operations import is_opaque


def refuse(model: Model, method: str, *features: str) -> None:
    """Raise a ModelError that names the first of `features` (Model attributes) which the model has and `method` cannot treat."""
    for feature in features:
        variables = getattr(model, feature)
        if variables:
            names = ", ".join(v.name for v in variables)
            what = "algebraic variables" if feature == "algebraic" else feature.replace("_", " ")
            raise ModelError(f"{method}: model '{model.name}' has {what} ({names}), which this method does not treat")


def refuse_opaque(model: Model, method: str) -> None:
    """Raise a ModelError for a model whose rates or outputs are asked of code elsewhere, such as an FMU, for `method`, which takes them
    apart."""
    eq = model.equations
    if is_opaque(ca.vertcat(eq.ode, eq.algebraic, eq.output)):
        raise ModelError(
            f"{method}: model '{model.name}' is an FMU, and this method needs formulas, whose second derivatives it takes; ukf, riccati "
            "and pseudospectral do with what an FMU tells"
        )


def not_imposed(model: Model) -> str:
    """A paragraph (HTML) for the documentation of a method that leaves the model's path constraints aside; none without any."""
    if not model.constraints:
        return ""
    names = ", ".join(v.name for v in model.constraints)
    return (
        f"<p>The model's constraints ({names}) are not imposed by this method: the estimate may violate them. The pseudospectral observer "
        "imposes them.</p>"
    )
