"""A tree of systems as one flat system: connections followed from output to input through the connectors between."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from cosim.errors import SystemFileError, suggest
from cosim.fmu import Value
from cosim.system.resolved import listed
from cosim.system.route import Hop, Quantity, Route
from cosim.system.ssp_parameters import Values
from cosim.system.ssp_structure import End, Node, Wire
from cosim.system.system import Connector, Element
from cosim.system.units import Unit

Port = tuple[str, str]  # path of an element or a system ("" for the top), name of its connector

_GIVES = {"output", "calculatedParameter", "local", "constant"}  # an element's connectors that values come from
_TAKES = {
    "input",
    "parameter",
    "structuralParameter",
}  # and those that they go to; of the system itself it is the other way


@dataclass
class Flat:
    """What a tree comes to, as `System` has it."""

    elements: dict[str, Element] = field(default_factory=dict)
    connections: list[tuple[str, str]] = field(default_factory=list)
    connectors: dict[str, Connector] = field(default_factory=dict)
    routes: dict[str, Route] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def flatten(root: Node, label: str) -> Flat:
    """The flat system; `label` is what messages call the file.

    Raises:
        SystemFileError: a connection between connectors that do not exist or do not fit, an input driven twice.
    """
    nodes = dict(_walk(root, ""))
    drivers = _drivers(nodes, label)
    flat = Flat(connectors=dict(root.connectors))
    reached: dict[Port, list[tuple[Port, tuple[Hop, ...]]]] = {}  # from connectors of systems to variables of FMUs
    for port in drivers:
        path, name = port
        if nodes[path].fmu is None and path:
            continue  # a connector between
        start, hops = _trace(port, drivers, nodes, reached, label)
        if nodes[start[0]].fmu is None and start[0]:
            continue  # a connector of a nested system that nothing drives
        if nodes[start[0]].fmu is None and not path:
            raise SystemFileError(
                f"{label}: connection {start[1]} -> {name}: from the system's input straight to its output"
            )
        end = _written(port)
        flat.connections.append((_written(start), end))
        unit = _unit(nodes, start) if start[0] else None
        if unit is not None or any(hop != Hop() for hop in hops):
            flat.routes[end] = Route(unit, hops)
    values: dict[Port, Value | Quantity] = {}
    unknown: list[str] = []
    for path, node in reversed(nodes.items()):  # from the innermost to the outermost, which count more
        for name, value in node.values.items():
            targets = list(_targets(nodes, reached, path, name))
            if not targets:
                unknown.append(_written((path, name)))
            for target, way in targets:
                values[target] = _along(value, way)
    if unknown:
        flat.notes.append(f"parameters of which the system knows nothing are left out: {listed(unknown)}")
    bound: dict[str, Values] = {path: {} for path in nodes}
    for (path, name), value in values.items():
        bound[path][name] = value
    for path, node in nodes.items():
        if node.fmu is not None:
            flat.elements[path] = Element(node.fmu, bound[path], dict(node.connectors), lenient=True)
    return flat


def _walk(node: Node, path: str) -> Iterator[tuple[str, Node]]:
    yield path, node
    for name, child in node.children.items():
        yield from _walk(child, f"{path}.{name}" if path else name)


def _written(port: Port) -> str:
    return ".".join(part for part in port if part)


def _unit(nodes: dict[str, Node], port: Port) -> Unit | None:
    connector = nodes[port[0]].connectors.get(port[1])
    return connector.unit if connector else None


def _drivers(nodes: dict[str, Node], label: str) -> dict[Port, tuple[Port, Hop]]:
    """What each connector gets its value from, and how."""
    drivers: dict[Port, tuple[Port, Hop]] = {}
    for path, node in nodes.items():
        for wire in node.wires:
            source, target = _directed(nodes, path, node, wire, label)
            if target in drivers:
                raise SystemFileError(
                    f"{label}: input '{_written(target)}' is driven by '{_written(drivers[target][0])}' and by '{_written(source)}'"
                )
            drivers[target] = (source, replace(wire.hop, unit=_unit(nodes, target)))
    return drivers


def _directed(nodes: dict[str, Node], path: str, node: Node, wire: Wire, label: str) -> tuple[Port, Port]:
    """Source and target of a connection: start and end of the file, or the other way round where the kinds say so."""
    ports = tuple(_port(path, node, end, wire, label) for end in (wire.start, wire.end))
    gives, takes = [], []
    for end, port in zip((wire.start, wire.end), ports, strict=True):
        connector = nodes[port[0]].connectors.get(port[1])
        kind = connector.kind if connector else None
        if kind in ("inout", "calculatedParameter", "structuralParameter"):
            raise SystemFileError(
                f"{label}: connection {wire.start} -> {wire.end}: '{end}' is of the kind {kind}, not supported"
            )
        outside = (
            kind
            if end.element is not None
            else {"input": "output", "output": "input", "parameter": "output"}.get(kind or "")
        )
        gives.append(outside is None or outside in _GIVES)
        takes.append(outside is None or outside in _TAKES)
    if gives[0] and takes[1]:
        return ports[0], ports[1]
    if gives[1] and takes[0]:
        return ports[1], ports[0]
    wrong = f"'{wire.start}' is no output" if not gives[0] else f"'{wire.end}' is no input"
    raise SystemFileError(f"{label}: connection {wire.start} -> {wire.end}: {wrong}")


def _port(path: str, node: Node, end: End, wire: Wire, label: str) -> Port:
    where = f"{label}: connection {wire.start} -> {wire.end}"
    if end.element is None:
        if end.connector not in node.connectors:
            raise SystemFileError(
                f"{where}: the system has no connector '{end.connector}'; {suggest(end.connector, node.connectors)}"
            )
        return path, end.connector
    child = node.children.get(end.element)
    if child is None:
        raise SystemFileError(f"{where}: there is no element '{end.element}'; {suggest(end.element, node.children)}")
    if child.fmu is None and end.connector not in child.connectors:
        raise SystemFileError(
            f"{where}: element '{end.element}' has no connector '{end.connector}'; {suggest(end.connector, child.connectors)}"
        )
    return (f"{path}.{end.element}" if path else end.element), end.connector


def _trace(
    port: Port,
    drivers: dict[Port, tuple[Port, Hop]],
    nodes: dict[str, Node],
    reached: dict[Port, list[tuple[Port, tuple[Hop, ...]]]],
    label: str,
) -> tuple[Port, tuple[Hop, ...]]:
    """Where the value at `port` comes from, and the hops from there; what connectors lie between learn what they reach."""
    hops: tuple[Hop, ...] = ()
    here, seen = port, {port}
    while here in drivers:
        here, hop = drivers[here]
        hops = (hop, *hops)
        if here in seen:
            raise SystemFileError(f"{label}: '{_written(here)}' is connected to itself through connectors of systems")
        seen.add(here)
        if nodes[here[0]].fmu is None and nodes[port[0]].fmu is not None:
            reached.setdefault(here, []).append((port, hops))
    return here, hops


def _targets(
    nodes: dict[str, Node], reached: dict[Port, list[tuple[Port, tuple[Hop, ...]]]], path: str, name: str
) -> Iterator[tuple[Port, tuple[Hop, ...] | None]]:
    """The variables of FMUs that the hierarchical `name` at `path` means, and the hops to them (None: it is itself one)."""
    node = nodes[path]
    if node.fmu is not None:
        yield (path, name), None
        return
    if name in node.connectors:
        for target, hops in reached.get((path, name), ()):
            yield target, (Hop(node.connectors[name].unit), *hops)
    parts = name.split(".")
    for i in range(1, len(parts)):
        child = ".".join(parts[:i])
        if child in node.children:
            yield from _targets(nodes, reached, f"{path}.{child}" if path else child, ".".join(parts[i:]))


def _along(value: Value | Quantity, hops: tuple[Hop, ...] | None) -> Value | Quantity:
    """`value` with the way that it has still to go."""
    if hops is None or all(hop == Hop() for hop in hops):
        return value
    if isinstance(value, Quantity):
        return Quantity(
            value.value, Route(value.route.unit, (*value.route.hops[:-1], *_joined(value.route.hops[-1], hops)))
        )
    return Quantity(value, Route(None, hops))


def _joined(last: Hop, hops: tuple[Hop, ...]) -> tuple[Hop, ...]:
    """A mapping leads to the connector that the first hop stands for."""
    return (replace(last, unit=hops[0].unit), *hops[1:])
