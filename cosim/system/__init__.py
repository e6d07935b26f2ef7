"""A system of FMUs, and its .ssp file."""

from cosim.system.ssp_reader import read_ssp
from cosim.system.ssp_writer import write_ssp
from cosim.system.system import Connector, Element, System

__all__ = ["Connector", "Element", "System", "read_ssp", "write_ssp"]
