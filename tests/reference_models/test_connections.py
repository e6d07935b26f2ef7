"""What the systems connect fits together, as tools see it that take a unit at its word."""

from __future__ import annotations

from build_fmus import FMUS, SYSTEMS
from observers.component import Port


def test_connected_ends_have_one_unit_unless_one_of_them_has_none() -> None:
    """OMSimulator refuses anything else, "1" at a source included."""
    made = {fmu: FMUS[fmu][0]() for recipe in SYSTEMS.values() for fmu in recipe.fmus.values()}
    checked = 0
    for name, recipe in SYSTEMS.items():
        for start, end in recipe.connections:
            ends: list[Port] = []
            for path, group in ((start, "outputs"), (end, "inputs")):
                element, _, variable = path.partition(".")
                ends.append(next(p for p in getattr(made[recipe.fmus[element]], group) if p.name == variable))
            units = {port.unit for port in ends if port.kind == "Real"} - {""}
            assert len(units) <= 1, f"{name}: {start} to {end}: {units}"
            checked += 1
    assert checked > 50
