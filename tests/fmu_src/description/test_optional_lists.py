"""Lists that the schema allows to be missing but not to be empty; and the first line, which the schema cannot see."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import fmpy
import pytest
from lxml import etree

from fmu_src.description.model_description import describe
from observers.component import Component, Enumeration, Port
from observers.units import NONE
from toys import sampled_toy


def without_units(*outputs: Port) -> Component:
    """A static component of these outputs, whose numbers stand for anything."""
    z, u, p, t, h = ca.SX(0, 1), ca.SX(0, 1), ca.SX(0, 1), ca.SX.sym("t"), ca.SX.sym("h")
    return Component(
        name="bare",
        description="No units",
        start=ca.Function("start", [p, t], [z]),
        flow=ca.Function("flow", [z, u, p, t, h], [z]),
        output=ca.Function("output", [z, u, p, t], [ca.repmat(t, len(outputs))]),
        outputs=outputs,
    )


MODE = Enumeration("Mode", (("Off", ""), ("On", "")))
COUNT, LEVEL = Port("count", kind="Integer", variability="discrete"), Port("level", unit=NONE)
CHOICE = Port("choice", kind="Enumeration", start=1, enumeration=MODE, variability="discrete")


@pytest.mark.parametrize(
    ("component", "lists"),
    [
        (without_units(COUNT, LEVEL), set()),
        (without_units(CHOICE), {"TypeDefinitions"}),
        (sampled_toy(), {"UnitDefinitions", "TypeDefinitions"}),
    ],
    ids=["none", "enumeration alone", "all"],
)
def test_a_list_without_members_is_left_out_as_the_schema_demands(component: Component, lists: set[str]) -> None:
    root = etree.fromstring(describe(component, "{0}", ["a.c"]))
    schema = Path(fmpy.__file__).parent / "schema" / "fmi2" / "fmi2ModelDescription.xsd"
    etree.XMLSchema(etree.parse(str(schema))).assertValid(root)
    assert {child.tag for child in root} & {"UnitDefinitions", "TypeDefinitions"} == lists


def test_the_first_line_says_the_encoding_that_the_text_has() -> None:
    """FMI 2.0, section 2.2: UTF-8."""
    document = describe(without_units(Port("level", "Füllhöhe in °", unit=NONE)), "{0}", ["a.c"])
    first, _, rest = document.partition(b"\n")
    assert first.replace(b"'", b'"') == b'<?xml version="1.0" encoding="UTF-8"?>'
    assert "Füllhöhe in °" in rest.decode("utf-8")
