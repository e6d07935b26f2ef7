"""In which order elements step, and what passes between them when, within the call sequence of FMI 2.0 (4.2.4).

Once initialised, an FMU is never asked for an output after an input was set and before it made a step. So all outputs are
read, all inputs set, and all elements step (Jacobi): an output that depends directly on inputs shows those of the step
before. Only an element without any state can do better: it steps last, with the others' outputs of the step's end as its
inputs, and so its outputs belong to these.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import networkx as nx
from fmpy.model_description import ModelDescription

from cosim.errors import SystemFileError
from cosim.system.resolved import ResolvedSystem, listed


@dataclass(frozen=True)
class Schedule:
    """The order of things.

    Attributes:
        settling: the elements in the order in which values pass in initialization mode, as far as there is one.
        stepping: the elements in the order of their steps.
        following: those that step with inputs of the step's end.
        notes: which outputs come a step late.
    """

    settling: list[str]
    stepping: list[str]
    following: frozenset[str]
    notes: list[str]


def schedule(resolved: ResolvedSystem, given: Collection[tuple[str, str]] = ()) -> Schedule:
    """The schedule of a system; `given` are inputs, as (element, variable), whose values are known beforehand.

    Raises:
        SystemFileError: an algebraic loop of declared dependencies; the message lists its variables.
    """
    fed: dict[str, list[str]] = {name: [] for name in resolved.descriptions}
    for element, name in (*((c.target, c.input.name) for c in resolved.connections), *given):
        fed[element].append(name)
    direct = {name: _direct_inputs(d, fed[name]) for name, d in resolved.descriptions.items()}
    _refuse_loops(resolved, direct)
    static = {name for name in resolved.static if any(direct[name].values())}
    following, last = _following(resolved, static)
    stepping = [name for name in resolved.descriptions if name not in following]
    late = [f"{e}.{o}" for e in stepping for o, inputs in direct[e].items() if inputs and o in _declared(resolved, e)]
    silent = [e for e in stepping if any(inputs and o not in _declared(resolved, e) for o, inputs in direct[e].items())]
    return Schedule(_settling(resolved, direct), stepping + last, following, _notes(late, silent))


def _direct_inputs(description: ModelDescription, fed: Collection[str]) -> dict[str, list[str]]:
    """Those of the inputs `fed` that each output depends on directly, or may.

    FMI 2.0, 2.2.8: without the attribute `dependencies` an output depends on all knowns.
    """
    declared = {unknown.variable.name: unknown.dependencies for unknown in description.outputs}
    found: dict[str, list[str]] = {}
    for variable in description.modelVariables if fed else ():
        if variable.causality == "output":
            dependencies = declared.get(variable.name)
            known = None if dependencies is None else {d.name for d in dependencies}
            found[variable.name] = [name for name in fed if known is None or name in known]
    return found


def _declared(resolved: ResolvedSystem, element: str) -> set[str]:
    """The outputs whose dependencies the FMU declares."""
    return {u.variable.name for u in resolved.descriptions[element].outputs if u.dependencies is not None}


def _refuse_loops(resolved: ResolvedSystem, direct: dict[str, dict[str, list[str]]]) -> None:
    graph = nx.DiGraph()
    for element, outputs in direct.items():
        declared = _declared(resolved, element) if any(outputs.values()) else ()
        for output, inputs in outputs.items():
            if output in declared:
                graph.add_edges_from(((element, name), (element, output)) for name in inputs)
    graph.add_edges_from(((c.source, c.output.name), (c.target, c.input.name)) for c in resolved.connections)
    if not nx.is_directed_acyclic_graph(graph):
        edges = nx.find_cycle(graph)
        loop = " -> ".join(".".join(variable) for variable in (*(start for start, _ in edges), edges[-1][1]))
        raise SystemFileError(f"system '{resolved.system.name}' has an algebraic loop: {loop}")


def _following(resolved: ResolvedSystem, static: set[str]) -> tuple[frozenset[str], list[str]]:
    """Those of the `static` elements that can step last, as a set and in the order in which they step.

    One that gets a value of its own back, through static elements only, would have to step twice.
    """
    graph = nx.DiGraph()
    graph.add_nodes_from(name for name in resolved.descriptions if name in static)
    graph.add_edges_from((c.source, c.target) for c in resolved.connections if {c.source, c.target} <= static)
    for part in list(nx.strongly_connected_components(graph)):
        if len(part) > 1 or any(graph.has_edge(name, name) for name in part):
            graph.remove_nodes_from(part)
    order = list(nx.lexicographical_topological_sort(graph))
    return frozenset(order), order


def _settling(resolved: ResolvedSystem, direct: dict[str, dict[str, list[str]]]) -> list[str]:
    """An element after those whose outputs its own may depend on; within a loop in the system's order."""
    graph = nx.DiGraph()
    graph.add_nodes_from(resolved.descriptions)
    passing = {(e, name) for e, outputs in direct.items() for inputs in outputs.values() for name in inputs}
    graph.add_edges_from((c.source, c.target) for c in resolved.connections if (c.target, c.input.name) in passing)
    place = {name: i for i, name in enumerate(resolved.descriptions)}
    parts = nx.condensation(graph)
    members: Iterable[set[str]] = (parts.nodes[n]["members"] for n in nx.topological_sort(parts))
    return [name for part in members for name in sorted(part, key=place.__getitem__)]


def _notes(late: list[str], silent: list[str]) -> list[str]:
    notes = []
    if late:
        notes.append(
            f"outputs that depend directly on inputs show those of the step before (Jacobi exchange): {listed(late)}; an observer of them "
            "pairs measurement and input wrongly where an input jumps at a sample instant: let it jump between two, with two steps a sample"
        )
    if silent:
        notes.append(
            "elements that do not declare on which inputs their outputs depend: where they do directly, they show those of the "
            f"step before (Jacobi exchange): {listed(silent)}"
        )
    return notes
