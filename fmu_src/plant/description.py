"""A foreign FMU's description, as a plant is chosen from it: what there is, and what stands in the way of an observer.

FMI 2.0.4, "FMI for Model Exchange": the plant is asked for derivatives and outputs at points of the observer's choice, in Continuous-Time
Mode only. So it must be a function of states, inputs, parameters and time, without events and without a memory.
"""

from __future__ import annotations

import difflib
import math
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fmpy import read_model_description
from lxml import etree

from fmu_src.description import units
from fmu_src.errors import PlantError
from fmu_src.platforms import PLATFORMS, resolve

ATTRIBUTES = ("unit", "start", "nominal", "min", "max", "wrap", "description")
_FAR = 1e300  # tools write the largest double where there is no bound


@dataclass(frozen=True)
class Scalar:
    """A variable of the plant: its name, value reference and what the description says of it; `start` is None where it says nothing.

    `unit` is an expression of ours with the same meaning, "1" where there is none.
    """

    name: str
    reference: int
    kind: str  # Real, Integer, Boolean, String, Enumeration
    causality: str
    variability: str
    start: float | None
    nominal: float | None
    min: float
    max: float
    unit: str
    description: str


@dataclass(frozen=True)
class PlantDescription:
    """What the description of the FMU `file` says.

    `states`, `derivatives`: in the order of fmi2GetDerivatives. `dependencies`: by the name of a derivative or output the names of what
    it depends on, where the description says so. `platforms`: those of PLATFORMS for which it has a binary.
    """

    file: str
    identifier: str
    exchange: bool
    guid: str
    name: str
    tool: str
    license: str
    states: tuple[Scalar, ...]
    derivatives: tuple[Scalar, ...]
    outputs: tuple[Scalar, ...]
    variables: dict[str, Scalar]
    dependencies: dict[str, frozenset[str]]
    indicators: int
    directional: bool
    completes_steps: bool
    capabilities: dict[str, str]
    platforms: tuple[str, ...]
    step: float | None
    stop: float | None

    def find(self, name: str, what: str) -> Scalar:
        """The variable `name`, a Real.

        Raises:
            PlantError: there is none, or it is no Real; `what` it was asked for is in the message.
        """
        found = self.variables.get(name)
        if found is None:
            near = difflib.get_close_matches(name, self.variables, 3, 0.5) or list(self.variables)[:5]
            raise PlantError(f"plant '{self.file}': {what} '{name}' is no variable of it; near: {', '.join(near)}")
        if found.kind != "Real":
            raise PlantError(
                f"plant '{self.file}': {what} '{name}' is of type {found.kind}; an observer takes Real only"
            )
        return found

    def input(self, name: str) -> Scalar:
        """The continuous input `name`; a PlantError says what else it is."""
        found = self.find(name, "the input")
        if found.causality != "input" or found.variability != "continuous":
            known = _names(v for v in self.variables.values() if v.causality == "input" and v.kind == "Real")
            raise PlantError(
                f"plant '{self.file}': '{name}' is no continuous input but {found.variability}, {found.causality}; inputs: {known}"
            )
        return found

    def parameter(self, name: str) -> Scalar:
        """The parameter `name`, fixed or tunable; a PlantError says what else it is."""
        found = self.find(name, "the parameter")
        if found.causality != "parameter" or found.variability not in ("fixed", "tunable"):
            is_what = "calculated" if found.causality in ("calculatedParameter", "local", "output") else found.causality
            known = _names(v for v in self.variables.values() if v.causality == "parameter" and v.kind == "Real")
            raise PlantError(f"plant '{self.file}': '{name}' is {is_what}; take one of {known}")
        return found

    def output(self, name: str) -> Scalar:
        """What a sensor can show: a continuous variable that the plant calculates, or a state."""
        found = self.find(name, "the output")
        if found.causality not in ("output", "local") or found.variability != "continuous":
            known = _names((*self.outputs, *self.states))
            raise PlantError(
                f"plant '{self.file}': '{name}' is {found.variability}, {found.causality}, and no continuous output or local variable; "
                f"such as {known}"
            )
        return found


def read(path: Path) -> PlantDescription:
    """The description of the FMU at `path`.

    Raises:
        PlantError: it is no FMU of FMI 2.0, or cannot be read.
    """
    where = f"plant '{path.name}'"
    if not path.is_file():
        raise PlantError(f"{where}: {path} is {'a folder' if path.is_dir() else 'no file'}")
    try:
        with zipfile.ZipFile(path) as archive:  # the version first: fmpy expects what it asks for
            version = str(etree.fromstring(archive.read("modelDescription.xml")).get("fmiVersion"))
        if not version.startswith("2."):
            raise PlantError(f"{where} is FMI {version}; needed: 2.0 for model exchange")
        found = read_model_description(str(path), validate=False)
    except PlantError:
        raise
    except Exception as error:  # fmpy raises what it stumbles over, of many kinds
        raise PlantError(
            f"{where}: it cannot be read as an FMU: {str(error).splitlines()[0] if str(error) else error!r}"
        ) from None
    interface = found.modelExchange or found.coSimulation
    if interface is None:
        raise PlantError(f"{where}: its description has no ModelExchange element")
    table = {unit.name: unit.baseUnit for unit in found.unitDefinitions}
    scalars = {v.name: _scalar(v, table) for v in found.modelVariables}
    pairs = [(u.variable.derivative, u.variable) for u in found.derivatives]
    if any(state is None for state, _ in pairs):
        raise PlantError(
            f"{where}: a derivative of its ModelStructure does not say which state it is the derivative of"
        )
    said = [u for u in (*found.derivatives, *found.outputs) if u.dependencies is not None]
    return PlantDescription(
        file=path.name,
        identifier=interface.modelIdentifier,
        exchange=found.modelExchange is not None,
        guid=found.guid,
        name=found.modelName or interface.modelIdentifier,
        tool=found.generationTool or "",
        license="; ".join(text for text in (found.license, found.copyright) if text),
        states=tuple(scalars[state.name] for state, _ in pairs),
        derivatives=tuple(scalars[derivative.name] for _, derivative in pairs),
        outputs=tuple(scalars[u.variable.name] for u in found.outputs if u.variable.type == "Real"),
        variables=scalars,
        dependencies={u.variable.name: frozenset(v.name for v in u.dependencies) for u in said},
        indicators=int(found.numberOfEventIndicators or 0),
        directional=bool(interface.providesDirectionalDerivative),
        completes_steps=bool(getattr(interface, "needsCompletedIntegratorStep", False)),
        capabilities={
            flag: "true"
            for flag in ("needsExecutionTool", "canBeInstantiatedOnlyOncePerProcess")
            if getattr(interface, flag)
        },
        platforms=_platforms(path, interface.modelIdentifier),
        step=_number(getattr(found.defaultExperiment, "stepSize", None)),
        stop=_number(getattr(found.defaultExperiment, "stopTime", None)),
    )


def replaced(plant: PlantDescription, attributes: Mapping[str, Mapping[str, Any]]) -> PlantDescription:
    """The description with other attributes (ATTRIBUTES) of variables, by their names.

    Raises:
        PlantError: there is no such variable or attribute.
    """
    changed = dict(plant.variables)
    for name, given in attributes.items():
        variable = plant.find(name, "attributes of")
        unknown = sorted(set(given) - set(ATTRIBUTES))
        if unknown:
            known = ", ".join(ATTRIBUTES)
            raise PlantError(f"plant '{plant.file}': attributes of '{name}': '{unknown[0]}' is none; known: {known}")
        changed[name] = replace(variable, **{k: value for k, value in given.items() if k != "wrap"})
    states, outputs = (tuple(changed[v.name] for v in group) for group in (plant.states, plant.outputs))
    return replace(plant, variables=changed, states=states, outputs=outputs)


def obstacles(plant: PlantDescription) -> list[str]:
    """What the description alone says is in the way of an observer, a sentence each."""
    found = []
    if not plant.exchange:
        return ["is co-simulation only: FMI 2.0 gives no way to write its states; export it for model exchange"]
    if not plant.states:
        found.append("has no continuous states: there is nothing to estimate")
    if plant.indicators:
        found.append(
            f"has {plant.indicators} event indicator{'s' * (plant.indicators > 1)}: its modes would stay frozen; export it without "
            "events (noEvent, smooth)"
        )
    host = resolve(["host"])[0]
    if host not in plant.platforms:
        there = ", ".join(plant.platforms) or "none that is known here"
        found.append(f"has no binary for {host}, this machine, and so cannot be tried; it has {there}")
    return found


def _scalar(variable: Any, table: dict[str, Any]) -> Scalar:
    def said(attribute: str) -> str | None:
        own: str | None = getattr(variable, attribute)
        return own if own is not None else getattr(variable.declaredType, attribute, None)

    real = variable.type == "Real"
    low, high, nominal = (_number(said(bound)) if real else None for bound in ("min", "max", "nominal"))
    return Scalar(
        name=variable.name,
        reference=int(variable.valueReference),
        kind=variable.type,
        causality=variable.causality or "local",
        variability=variable.variability or ("continuous" if real else "discrete"),
        start=_number(variable.start) if real else None,
        nominal=abs(nominal) if nominal else None,
        min=-math.inf if low is None or low <= -_FAR else low,
        max=math.inf if high is None or high >= _FAR else high,
        unit=_unit(said("unit"), table) if real else "1",
        description=variable.description or "",
    )


def _unit(name: str | None, table: dict[str, Any]) -> str:
    """`name` where our grammar means the same by it as the plant's definition, else the product of SI units; "1" where neither says it."""
    if not name:
        return "1"
    base = table.get(name)
    defined = None
    if base is not None:
        exponents = {b: int(getattr(base, b) or 0) for b in units.BASE}
        defined = units.Unit({b: e for b, e in exponents.items() if e}, float(base.factor), float(base.offset))
    try:
        ours: units.Unit | None = units.parse(name)
    except ValueError:
        ours = None
    if ours is not None and (defined is None or _alike(ours, defined)):
        return name
    if defined is None or not math.isclose(defined.factor, 1, rel_tol=1e-12) or defined.offset:
        return "1"
    above = [f"{b}{e if e > 1 else ''}" for b, e in defined.exponents.items() if e > 0]
    below = [f"{b}{-e if e < -1 else ''}" for b, e in defined.exponents.items() if e < 0]
    text = ".".join(above) or "1"
    if below:
        text += f"/{below[0]}" if len(below) == 1 else f"/({'.'.join(below)})"
    return text


def _alike(one: units.Unit, other: units.Unit) -> bool:
    """Radians are a unit to some tools and none to others."""

    def plain(unit: units.Unit) -> dict[str, int]:
        return {base: e for base, e in unit.exponents.items() if base != "rad"}

    close = math.isclose(one.factor, other.factor, rel_tol=1e-9) and math.isclose(
        one.offset, other.offset, rel_tol=1e-9
    )
    return close and plain(one) == plain(other)


def _number(text: str | float | None) -> float | None:
    if text is None or text == "":
        return None
    value = float(text)
    return value if math.isfinite(value) else None


def _platforms(path: Path, identifier: str) -> tuple[str, ...]:
    with zipfile.ZipFile(path) as archive:
        names = set(archive.namelist())
    return tuple(p for p, target in PLATFORMS.items() if f"binaries/{p}/{identifier}{target.suffix}" in names)


def _names(variables: Iterable[Scalar], most: int = 8) -> str:
    names: Sequence[str] = list(dict.fromkeys(v.name for v in variables))
    return (", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")) or "none"
