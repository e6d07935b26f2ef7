"""A plant that exists only as an FMU, as the Model that observers are made for."""

from __future__ import annotations

import keyword
import math
import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import casadi as ca

from fmu_src.errors import ExportWarning, PlantError
from fmu_src.plant.description import Scalar, obstacles, read, replaced
from fmu_src.plant.examine import Selection, examine
from fmu_src.plant.guest import Guest, invite, unpacked
from fmu_src.plant.sources import nominal
from observers.model import Model, Variable


class PlantFMU(Model):
    """The Model of a plant that exists only as an FMU 2.0 for model exchange: its rates and outputs are asked of the FMU.

    An observer of it is one self-contained FMU, with the plant's files in `resources/plant/`. Names are the plant's with underscores for
    what no identifier has; units, nominal values, bounds, descriptions are those of its description, start values of states those that it
    computes.

    Args:
        path: the FMU.
        outputs: what is measured: outputs or local variables, by the plant's names.
        inputs: known inputs; the others stay at their start values.
        parameters: known parameters that the observer's FMU can set; the others stay at the plant's values.
        unknown_parameters: what is estimated beside the states. One that is `fixed` costs an initialisation each time it changes.
        name: of the model, hence of the files made of it; the plant's own if absent.
        input_between_samples: as of a Model.
        attributes: by the plant's names, what replaces the description's: `{"spring.c": {"min": 0.0, "nominal": 100.0}}`.
        redistribute: the plant's owner allows that its files travel in other FMUs; asked for where the plant says whose it is.

    Raises:
        PlantError: no FMU for model exchange of FMI 2.0; a variable that is not there, or no input, parameter, output; names that
            become one; events, discrete inputs, a memory; a binary for this machine is missing or ends the process.
    """

    guest: Guest

    def __init__(
        self,
        path: str | Path,
        *,
        outputs: Sequence[str],
        inputs: Sequence[str] = (),
        parameters: Sequence[str] = (),
        unknown_parameters: Sequence[str] = (),
        name: str | None = None,
        input_between_samples: str = "held",
        attributes: Mapping[str, Mapping[str, Any]] | None = None,
        redistribute: bool = False,
    ):
        given = dict(attributes or {})
        plant = replaced(read(Path(path)), given)
        where = f"plant '{plant.file}'"
        for obstacle in obstacles(plant):
            raise PlantError(f"{where} {obstacle}")
        groups = {
            "outputs": outputs,
            "inputs": inputs,
            "parameters": parameters,
            "unknown_parameters": unknown_parameters,
        }
        for group, names in groups.items():
            if isinstance(names, str):
                raise PlantError(f"{where}: {group} is the text {names!r}, where a list is wanted: {group}=[{names!r}]")
        chosen = Selection(
            tuple(plant.input(n) for n in inputs),
            tuple(plant.parameter(n) for n in parameters),
            tuple(plant.parameter(n) for n in unknown_parameters),
            tuple(plant.output(n) for n in outputs),
        )
        if "requires license" in (plant.license + plant.tool).lower() or "needsExecutionTool" in plant.capabilities:
            warnings.warn(
                f"{where} needs its tool, or a licence of it, wherever the observer's FMU runs",
                ExportWarning,
                stacklevel=2,
            )
        folder = unpacked(Path(path), plant.file)
        behaviour = examine(folder / "plant", plant, chosen)
        guest = invite(Path(path), folder, plant, chosen, behaviour, redistribute)
        named = _Named(where, given)
        values = iter(behaviour.parameters)
        states = [
            named.variable(v, start, size)
            for v, start, size in zip(plant.states, behaviour.start, behaviour.nominal, strict=True)
        ]
        known_inputs = [named.variable(v, v.start or 0.0, v.nominal or 1.0) for v in chosen.inputs]
        known = [named.variable(v, start, nominal(v, start)) for v, start in zip(chosen.known, values, strict=False)]
        unknown = [named.variable(v, start, nominal(v, start)) for v, start in zip(chosen.unknown, values, strict=True)]
        measured = [named.variable(v, 0.0, v.nominal or 1.0, is_output=True) for v in chosen.outputs]
        named.finish()
        functions = [ca.external(f"{guest.name}_{what}", str(guest.library)) for what in ("rate", "measure")]

        def asked(function: ca.Function) -> Any:
            def equations(x: Any, u: Any, p: Any, t: Any) -> list[Any]:
                columns = [_column(x, states), _column(u, known_inputs), _column(p, known), _column(p, unknown)]
                return list(ca.vertsplit(function(*columns, t)))

            return equations

        super().__init__(
            name=name or identifier(plant.name),
            states=states,
            outputs=measured,
            ode=asked(functions[0]),
            output=asked(functions[1]),
            inputs=known_inputs,
            parameters=known,
            unknown_parameters=unknown,
            input_between_samples=input_between_samples,
            description=f"{plant.name} of {plant.file}",
        )
        object.__setattr__(self, "guest", guest)


class _Named:
    """Variables of the model by the plant's; two that would have one name are refused."""

    def __init__(self, where: str, attributes: dict[str, Mapping[str, Any]]):
        self.where = where
        self.attributes = attributes
        self.taken: dict[str, str] = {}

    def variable(self, v: Scalar, start: float, size: float, is_output: bool = False) -> Variable:
        name = identifier(v.name)
        if self.taken.setdefault(name, v.name) != v.name:
            raise PlantError(f"{self.where}: '{self.taken[name]}' and '{v.name}' would both be called '{name}'")
        given = self.attributes.get(v.name, {})
        said: dict[str, Any] = {
            "description": v.description or v.name,
            "unit": v.unit,
            "start": start,
            "nominal": size if math.isfinite(size) and size > 0 else 1.0,
            "min": v.min,
            "max": v.max,
        }
        if is_output:  # a sensor may show anything
            said |= {"min": -math.inf, "max": math.inf, "start": 0.0}
        return Variable(name, **(said | {k: given[k] for k in ("start", "wrap") if k in given}))

    def finish(self) -> None:
        used = sorted(self.taken.values())
        for name in self.attributes:
            if name not in used:
                raise PlantError(
                    f"{self.where}: attributes of '{name}', which is no state and not chosen; there are {', '.join(used)}"
                )


def identifier(name: str) -> str:
    """The plant's name as an identifier: `mass.s` becomes mass_s, `body[1].v` body_1_v."""
    plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "_"
    if plain[0].isdigit():
        plain = f"_{plain}"
    return f"{plain}_" if keyword.iskeyword(plain) else plain


def _column(names: Any, variables: Sequence[Variable]) -> Any:
    return ca.vertcat(*(getattr(names, v.name) for v in variables)) if variables else ca.SX(0, 1)
