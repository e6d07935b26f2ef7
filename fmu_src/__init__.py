"""A component becomes an FMI 2.0 co-simulation FMU: native C, no Python on the target."""

from fmu_src.errors import ExportError, ExportWarning
from fmu_src.export import export
from fmu_src.plant import PlantFMU
from fmu_src.platforms import PLATFORMS

__all__ = ["PLATFORMS", "ExportError", "ExportWarning", "PlantFMU", "export"]
