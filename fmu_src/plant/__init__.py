"""A plant that exists only as an FMU becomes a Model."""

from fmu_src.plant.model import PlantFMU

__all__ = ["PlantFMU"]
