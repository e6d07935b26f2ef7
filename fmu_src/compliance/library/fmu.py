"""The FMU as the probes have it: its library, and instances of it."""

from __future__ import annotations

import ctypes
from ctypes import c_void_p

from fmpy import fmi2

from fmu_src.compliance.library.calls import Broken, Library
from fmu_src.compliance.library.exchange import ExchangeInstance
from fmu_src.compliance.library.instance import Instance
from fmu_src.compliance.rules import finding


class Fmu(Library):
    """Makes instances by the interface that the FMU is driven by."""

    def instantiate(self, name: str = "instance", guid: str | None = None, logging: bool = False) -> Instance | None:
        """A new instance, or None where the FMU refuses."""
        is_exchange = self.subject.interface == "ModelExchange"
        instance = ExchangeInstance(self, name) if is_exchange else Instance(self, name)
        call = self.function("fmi2Instantiate", c_void_p)
        instance.pointer = call(
            name.encode(),
            fmi2.fmi2ModelExchange if is_exchange else fmi2.fmi2CoSimulation,
            (self.subject.description.guid if guid is None else guid).encode(),
            self.subject.resources.encode(),
            ctypes.byref(instance.callbacks),
            fmi2.fmi2False,
            fmi2.fmi2True if logging else fmi2.fmi2False,
        )
        if instance.pointer is None:
            self.refusal = instance.reason
            return None
        instance.pointer = c_void_p(instance.pointer)
        return instance

    def new(self, name: str = "instance", logging: bool = False) -> Instance:
        """A new instance; Broken where the FMU refuses."""
        instance = self.instantiate(name, logging=logging)
        if instance is None:
            raise Broken(finding("instantiate", "fmi2Instantiate", "an instance", f"a null pointer{self.refusal}"))
        return instance

    def initialized(self, name: str = "instance", logging: bool = False) -> Instance:
        """A new instance, initialized."""
        return self.new(name, logging).initialize()
