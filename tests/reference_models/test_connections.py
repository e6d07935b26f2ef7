"""What the systems connect fits together, as tools see it that take a unit at its word."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import fmpy

from build_fmus import SYSTEMS


def test_connected_ends_have_one_unit_unless_one_of_them_has_none(catalogue_fmu: Callable[[str], Path]) -> None:
    """OMSimulator refuses anything else, "1" at a source included."""

    @cache
    def units(fmu: str) -> dict[str, str | None]:
        """Of its Real variables, as its description says."""
        variables = fmpy.read_model_description(str(catalogue_fmu(fmu)), validate=False).modelVariables
        return {v.name: v.unit for v in variables if v.type == "Real"}

    checked = 0
    for name, recipe in SYSTEMS.items():
        for start, end in recipe.connections:
            ends = [path.partition(".")[::2] for path in (start, end)]
            found = {units(recipe.fmus[element]).get(variable) for element, variable in ends} - {None}
            assert len(found) <= 1, f"{name}: {start} to {end}: {found}"
            checked += 1
    assert checked > 50
