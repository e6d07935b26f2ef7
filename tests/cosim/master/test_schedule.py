"""In which order values pass within an instant, by what the descriptions declare, or by the standard where they declare nothing."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from cosim.errors import SystemFileError
from cosim.master.schedule import schedule


def description(inputs: list[str], outputs: dict[str, list[str] | None]) -> SimpleNamespace:
    """Outputs with the inputs they depend on directly; None: the attribute `dependencies` is not there."""
    variables = {name: SimpleNamespace(name=name, causality="input") for name in inputs}
    variables |= {name: SimpleNamespace(name=name, causality="output") for name in outputs}
    unknowns = [
        SimpleNamespace(variable=variables[name], dependencies=None if on is None else [variables[i] for i in on])
        for name, on in outputs.items()
    ]
    return SimpleNamespace(modelVariables=list(variables.values()), outputs=unknowns)


def system(
    descriptions: dict[str, SimpleNamespace], connections: list[tuple[str, str]], static: frozenset[str] = frozenset()
) -> SimpleNamespace:
    made = []
    for source, target in connections:
        (a, output), (b, goal) = source.split("."), target.split(".")
        names = SimpleNamespace(name=output), SimpleNamespace(name=goal)
        made.append(SimpleNamespace(source=a, output=names[0], target=b, input=names[1]))
    whole = SimpleNamespace(name="made")
    return SimpleNamespace(system=whole, descriptions=descriptions, connections=made, static=static)


PARTS = {
    "sum": description(["a", "b"], {"y": ["a", "b"], "first": ["a"]}),
    "gain": description(["u"], {"y": ["u"], "clock": []}),
    "source": description([], {"y": []}),
}
WIRES = [("source.y", "gain.u"), ("source.y", "sum.a"), ("gain.y", "sum.b")]


def test_before_the_run_values_pass_in_the_order_of_what_depends_on_them() -> None:
    assert schedule(system(PARTS, WIRES)).settling == ["source", "gain", "sum"]
    loop = {"a": description(["u"], {"y": []}), "b": description(["u"], {"y": ["u"]})}
    assert schedule(system(loop, [("a.y", "b.u"), ("b.y", "a.u")])).settling == ["a", "b"]


def test_outputs_that_depend_on_inputs_are_said_to_come_a_step_late() -> None:
    made = schedule(system(PARTS, WIRES))
    assert made.stepping == ["sum", "gain", "source"] and not made.following
    (note,) = made.notes
    assert (
        all(name in note for name in ("sum.y", "sum.first", "gain.y")) and "clock" not in note and "source" not in note
    )


def test_elements_without_a_state_step_last_in_the_order_of_their_values() -> None:
    made = schedule(system(PARTS, WIRES, frozenset({"sum", "gain"})))
    assert made.stepping == ["source", "gain", "sum"] and made.following == {"gain", "sum"} and made.notes == []
    mixed = schedule(system(PARTS, WIRES, frozenset({"gain"})))
    assert mixed.stepping == ["sum", "source", "gain"] and mixed.following == {"gain"}
    assert "sum.y" in mixed.notes[0] and "gain" not in mixed.notes[0]


def test_what_declares_no_dependencies_is_said_by_its_element_and_no_loop_of_it_is_refused() -> None:
    silent = {"a": description(["u"], {"y": None}), "b": description(["u"], {"y": ["u"]})}
    made = schedule(system(silent, [("a.y", "b.u"), ("b.y", "a.u")]))
    assert made.stepping == ["a", "b"] and len(made.notes) == 2
    assert "b.y" in made.notes[0] and made.notes[1].endswith(": 'a'" if "'" in made.notes[1] else ": a")
    alone = schedule(system({"a": silent["a"]}, []))  # nothing feeds it
    assert alone.notes == []


def test_an_input_whose_values_are_known_beforehand_feeds_its_element() -> None:
    made = schedule(system({"gain": PARTS["gain"]}, []), [("gain", "u")])
    assert "gain.y" in made.notes[0] and "clock" not in made.notes[0]


def test_a_loop_of_declared_dependencies_is_refused_by_name() -> None:
    parts = {"a": description(["u"], {"y": ["u"]}), "b": description(["u"], {"y": ["u"]})}
    wires = [("a.y", "b.u"), ("b.y", "a.u")]
    with pytest.raises(SystemFileError, match="system 'made' has an algebraic loop: ") as refused:
        schedule(system(parts, wires))
    assert all(name in str(refused.value) for name in ("a.u", "a.y", "b.u", "b.y"))
