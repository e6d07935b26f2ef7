"""FMUs of strict/mixer.c with any names of inputs, outputs and parameters; what they compute, in numpy."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fmu_src.platforms import PLATFORMS
from strict_fmu import HOST

MOST = 32  # inputs, outputs
PARAMETERS = ("drive", "pull", "direct")


@dataclass
class Mixer:
    """One FMU. `parameters` are the names of its three: drive, pull, direct; `others` those of Boolean and String ones.

    No dependencies are declared: every output may depend on every input.
    """

    inputs: Sequence[str]
    outputs: Sequence[str]
    parameters: Sequence[str] = PARAMETERS
    others: dict[str, str] = field(default_factory=dict)

    def description(self) -> str:
        def variable(name: str, reference: int, attributes: str, typed: str) -> str:
            return f'<ScalarVariable name="{name}" valueReference="{reference}" {attributes}>{typed}</ScalarVariable>'

        fixed, start = 'causality="parameter" variability="fixed"', '<Real start="0"/>'
        calculated = 'causality="output" initial="calculated"'
        found = [variable(n, i, calculated, "<Real/>") for i, n in enumerate(self.outputs, start=MOST)]
        found += [variable(n, i, 'causality="input"', start) for i, n in enumerate(self.inputs)]
        found += [variable(n, i, fixed, start) for i, n in enumerate(self.parameters, start=2 * MOST)]
        found += [variable(n, i, fixed, typed) for i, (n, typed) in enumerate(self.others.items())]
        unknowns = "".join(f'<Unknown index="{i}"/>' for i in range(1, len(self.outputs) + 1))
        # Ecos and libcosim take FMUs of one GUID for one FMU.
        guid = hashlib.sha256("".join(found).encode()).hexdigest()
        return (
            f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="mixer" guid="{guid}">'
            '<CoSimulation modelIdentifier="mixer" canHandleVariableCommunicationStepSize="true"/>'
            '<DefaultExperiment stopTime="1" stepSize="0.01"/>'
            f"<ModelVariables>{''.join(found)}</ModelVariables><ModelStructure><Outputs>{unknowns}</Outputs></ModelStructure>"
            "</fmiModelDescription>"
        )

    def write(self, path: Path, library: bytes) -> Path:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", self.description())
            archive.writestr(f"binaries/{HOST}/mixer{PLATFORMS[HOST].suffix}", library)
        return path

    def step(self, x: np.ndarray, u: np.ndarray, h: float, drive: float, pull: float, direct: float) -> np.ndarray:
        """States x (outputs,) a step on, in place; the outputs then, (outputs,). u (inputs,)."""
        s = np.arange(1, len(self.inputs) + 1) @ u if len(self.inputs) else 0.0
        x += h * (drive + pull * s / np.arange(1, len(self.outputs) + 1) - x)
        return x + direct * s
