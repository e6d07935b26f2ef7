"""FMUs that belong together by the names of their inputs and outputs: a plant, its observer, the source of their inputs."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Ports:
    """The names of an element's inputs and outputs."""

    inputs: Sequence[str]
    outputs: Sequence[str]


@dataclass(frozen=True)
class Connected:
    """Connections (an output, then the input of the same name), and what stayed open: inputs, each with the reason."""

    connections: list[tuple[str, str]]
    open: dict[str, str]


def role(ports: Ports) -> str:
    """What an element of these ports is: "observer", "plant", "source" (of the inputs of others), or "" for anything else."""
    branches = {name.partition(".")[0] for name in ports.outputs if "." in name}
    if "estimate" in branches:
        return "observer"
    if "x" in branches:
        return "plant"
    return "" if ports.inputs else "source"


def element_names(ports: Mapping[str, Ports]) -> dict[str, str]:
    """A name for each FMU (by its own): its role where it is the only one of it, else its own."""
    roles = {name: role(one) for name, one in ports.items()}
    alone = {
        name: one for name, one in roles.items() if one and list(roles.values()).count(one) == 1 and one not in ports
    }
    return {name: alone.get(name, name) for name in ports}


def connect(elements: Mapping[str, Ports]) -> Connected:
    """Each input with the one output of its name in another element. A missing `measurement_valid.*` is nothing to speak of."""
    outputs: dict[str, list[str]] = {}
    for element, ports in elements.items():
        for name in ports.outputs:
            outputs.setdefault(name, []).append(element)
    connections, left = [], {}
    for element, ports in elements.items():
        for name in ports.inputs:
            owners = [owner for owner in outputs.get(name, ()) if owner != element]
            if len(owners) == 1:
                connections.append((f"{owners[0]}.{name}", f"{element}.{name}"))
            elif owners:
                left[f"{element}.{name}"] = f"{' and '.join(owners)} have an output '{name}'"
            elif not name.startswith("measurement_valid."):
                left[f"{element}.{name}"] = _nobody(name)
    return Connected(connections, left)


def _nobody(name: str) -> str:
    return f"no other has an output '{name}'"


def undriven(system: str, made: Connected, sources: Mapping[str, Sequence[str]]) -> list[str]:
    """A sentence for each name of inputs that stay open, and its reason: where nothing drives it, an output of the `sources` (by FMU) that
    may be meant.
    """
    by_input: dict[tuple[str, str], list[str]] = {}
    for end, reason in made.open.items():
        by_input.setdefault((end.partition(".")[2], reason), []).append(end)
    free = {name: fmu for fmu, outputs in sources.items() for name in outputs}
    found = []
    for (name, reason), ends in by_input.items():
        nobody = reason == _nobody(name)
        near = difflib.get_close_matches(name, list(free), n=1, cutoff=0.5) if nobody else []
        meant = f": is it '{near[0]}' of {free[near[0]]}?" if near else ""
        verb = "keeps its start value" if len(ends) == 1 else "keep their start values"
        why = f"no source puts out '{name}'" if nobody else reason
        found.append(f"system {system}: {why}; {' and '.join(ends)} {verb}{meant}")
    return found
