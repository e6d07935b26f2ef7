"""In which order values pass within an instant, by what the descriptions declare, or by the standard where they declare nothing."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from cosim.errors import SystemFileError
from cosim.master.schedule import output_levels


def description(inputs: list[str], outputs: dict[str, list[str] | None]) -> SimpleNamespace:
    """Outputs with the inputs they depend on directly; None: the attribute `dependencies` is not there."""
    variables = {name: SimpleNamespace(name=name, causality="input") for name in inputs}
    variables |= {name: SimpleNamespace(name=name, causality="output") for name in outputs}
    unknowns = [
        SimpleNamespace(variable=variables[name], dependencies=None if on is None else [variables[i] for i in on])
        for name, on in outputs.items()
    ]
    return SimpleNamespace(modelVariables=list(variables.values()), outputs=unknowns)


def system(descriptions: dict[str, SimpleNamespace], connections: list[tuple[str, str]]) -> SimpleNamespace:
    made = []
    for source, target in connections:
        (a, output), (b, goal) = source.split("."), target.split(".")
        names = SimpleNamespace(name=output), SimpleNamespace(name=goal)
        made.append(SimpleNamespace(source=a, output=names[0], target=b, input=names[1]))
    return SimpleNamespace(system=SimpleNamespace(name="made"), descriptions=descriptions, connections=made)


def test_an_output_lies_above_all_that_drive_the_inputs_it_depends_on() -> None:
    parts = {
        "source": description([], {"y": []}),
        "gain": description(["u"], {"y": ["u"], "clock": []}),
        "sum": description(["a", "b"], {"y": ["a", "b"], "first": ["a"]}),
    }
    wires = [("source.y", "gain.u"), ("source.y", "sum.a"), ("gain.y", "sum.b")]
    assert output_levels(system(parts, wires)) == {
        ("source", "y"): 0,
        ("gain", "y"): 1,
        ("gain", "clock"): 0,
        ("sum", "y"): 2,
        ("sum", "first"): 1,
    }


def test_without_declared_dependencies_an_output_depends_on_every_connected_input_and_on_no_other() -> None:
    parts = {
        "source": description([], {"y": None}),
        "silent": description(["u", "free"], {"y": None}),
        "declared": description(["u", "v"], {"y": ["v"]}),
    }
    levels = output_levels(system(parts, [("source.y", "silent.u"), ("silent.y", "declared.u")]))
    assert levels == {("source", "y"): 0, ("silent", "y"): 1, ("declared", "y"): 0}


def test_a_loop_through_an_output_that_declares_nothing_is_refused_by_name() -> None:
    parts = {"a": description(["u"], {"y": None}), "b": description(["u"], {"y": ["u"]})}
    wires = [("a.y", "b.u"), ("b.y", "a.u")]
    with pytest.raises(SystemFileError, match="system 'made' has an algebraic loop: ") as refused:
        output_levels(system(parts, wires))
    assert all(name in str(refused.value) for name in ("a.u", "a.y", "b.u", "b.y"))
    parts["b"] = description(["u"], {"y": []})
    assert output_levels(system(parts, wires)) == {("a", "y"): 1, ("b", "y"): 0}
