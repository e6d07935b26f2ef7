"""Lists that the schema allows to be missing but not to be empty."""

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
