"""In which order values pass between elements within one instant."""

from __future__ import annotations

from collections.abc import Collection
from graphlib import CycleError, TopologicalSorter

from fmpy.model_description import ModelDescription

from cosim.errors import SystemFileError
from cosim.system.system import ResolvedSystem


def output_levels(resolved: ResolvedSystem) -> dict[tuple[str, str], int]:
    """The level of every output, by (element, variable).

    The outputs of a level are read together, then the inputs set that they drive, then the next level is read. Level 0
    needs no input of its instant; an output that depends directly on connected inputs lies one level above all the
    outputs that drive those.

    Raises:
        SystemFileError: an algebraic loop; the message lists its variables.
    """
    driver = {(c.target, c.input.name): (c.source, c.output.name) for c in resolved.connections}
    needs: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for element, description in resolved.descriptions.items():
        fed = [name for target, name in driver if target == element]
        for output, inputs in _direct_inputs(description, fed).items():
            needs[element, output] = [(element, name) for name in inputs]
    graph = needs | {goal: [source] for goal, source in driver.items()}
    try:
        order = list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        loop = " -> ".join(".".join(variable) for variable in error.args[1])
        raise SystemFileError(f"system '{resolved.system.name}' has an algebraic loop: {loop}") from None
    levels: dict[tuple[str, str], int] = {}
    for variable in order:
        if variable in driver:
            levels[variable] = levels[driver[variable]]
        else:
            levels[variable] = 1 + max((levels[goal] for goal in needs[variable]), default=-1)
    return {variable: levels[variable] for variable in needs}


def _direct_inputs(description: ModelDescription, fed: Collection[str]) -> dict[str, list[str]]:
    """The connected inputs `fed` that each output depends on directly.

    FMI 2.0, 2.2.8: without the attribute `dependencies` an output depends on all knowns.
    """
    declared = {unknown.variable.name: unknown.dependencies for unknown in description.outputs}
    direct: dict[str, list[str]] = {}
    for variable in description.modelVariables:
        if variable.causality == "output":
            dependencies = declared.get(variable.name)
            known = fed if dependencies is None else {d.name for d in dependencies}
            direct[variable.name] = [name for name in fed if name in known]
    return direct
