"""A system from an .ssp file, our own or another tool's: SSP 1.0, and of SSP 2.0 what SSP 1.0 has, too."""

from __future__ import annotations

from pathlib import Path

from lxml import etree

from cosim.archive import opened
from cosim.errors import SystemFileError, number
from cosim.system.flatten import flatten
from cosim.system.ssp_files import NAMESPACES, OSP_ANNOTATION, STRUCTURE, Package
from cosim.system.ssp_structure import read_structure
from cosim.system.system import System


def read_ssp(path: Path, directory: Path) -> System:
    """The system in the .ssp file at `path`; its FMUs are written to `directory`, where the system refers to them.

    Nested systems become one flat system. What is not supported is refused, never skipped; docs/masters.md lists SSP element
    by element. Names are looked up in the FMUs by `cosim.system.resolve`.

    Raises:
        SystemFileError: no such file, not a zip, too large, no or invalid SystemStructure.ssd (with its line), a missing
            resource, something that is not supported.
    """
    with opened(path, "an SSP file") as archive:
        root, top = read_structure(Package(archive, str(path), directory))
        flat = flatten(top, str(path))
        experiment = root.find("ssd:DefaultExperiment", NAMESPACES)
        attributes = {} if experiment is None else experiment.attrib
        return System(
            name=root.get("name"),
            elements=flat.elements,
            connections=flat.connections,
            start=float(attributes.get("startTime", 0.0)),
            stop=float(attributes["stopTime"]) if "stopTime" in attributes else None,
            step=_step_size(path, experiment),
            description=root.find("ssd:System", NAMESPACES).get("description", ""),
            connectors=flat.connectors,
            routes=flat.routes,
            notes=flat.notes,
        )


def _step_size(path: Path, experiment: etree._Element | None) -> float | None:
    if experiment is None:
        return None
    xpath = f"ssd:Annotations/ssc:Annotation[@type='{OSP_ANNOTATION}']//osp:FixedStepAlgorithm"
    found = experiment.find(xpath, NAMESPACES)
    if found is None or found.get("baseStepSize") is None:
        return None
    try:
        return number(found.get("baseStepSize"))
    except ValueError:
        text = found.get("baseStepSize")
        raise SystemFileError(
            f"{path}: {STRUCTURE}, line {found.sourceline}: baseStepSize '{text}' is not a number"
        ) from None
