"""Unknown disturbances as unknown parameters that wander: held over a segment, with jumps penalised by the disturbance's intensity."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from observers.model import Model

FREE = 1.0  # intensity of a disturbance of which nothing is said, in nominal values per sqrt(s)


def wandering(model: Model, process_noise: Mapping[str, float] | None) -> tuple[Model, dict[str, float] | None]:
    """`model` with its unknown disturbances among the unknown parameters, and the process noise with an intensity for each of them."""
    disturbances = model.unknown_disturbances
    if not disturbances:
        return model, None if process_noise is None else dict(process_noise)

    def with_inputs(equations: Callable[..., Iterable[Any]]) -> Callable[..., Iterable[Any]]:
        def evaluate(*arguments: Any) -> Iterable[Any]:
            *variables, u, p, t = arguments
            known = {v.name: getattr(u, v.name) for v in model.inputs}
            unknown = {v.name: getattr(p, v.name) for v in disturbances}
            return equations(*variables, SimpleNamespace(**known, **unknown), p, t)

        return evaluate

    algebraic, constraint = model.algebraic_equations, model.constraint
    changed = replace(
        model,
        ode=with_inputs(model.ode),
        output=with_inputs(model.output),
        algebraic_equations=with_inputs(algebraic) if algebraic is not None else None,
        constraint=with_inputs(constraint) if constraint is not None else None,
        unknown_parameters=(*model.unknown_parameters, *disturbances),
        unknown_disturbances=(),
    )
    return changed, {v.name: FREE * v.nominal for v in disturbances} | dict(process_noise or {})
