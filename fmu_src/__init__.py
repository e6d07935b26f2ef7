"""A component becomes an FMI 2.0 co-simulation FMU: native C, no Python on the target.

Its names are loaded when they are wanted: what only checks FMUs does without CasADi and all that comes with it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fmu_src.component_fmu import export
    from fmu_src.errors import ExportError, ExportWarning
    from fmu_src.plant import PlantFMU
    from fmu_src.platforms import PLATFORMS

__all__ = ["PLATFORMS", "ExportError", "ExportWarning", "PlantFMU", "export"]
_PLACES = {
    "PLATFORMS": "platforms",
    "ExportError": "errors",
    "ExportWarning": "errors",
    "PlantFMU": "plant",
    "export": "component_fmu",
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
