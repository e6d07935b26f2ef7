"""Reference results inside the FMU, in FMI-LS-REF 1.0.0-alpha.1: the default experiment, its stimuli and its results.

Every importer can repeat the experiment and see whether it gets the same. The files are the layered standard's manifest with
checksums, an experiment in the format to which it refers (ma-hs-experiments), and two CSV tables.

The FMU's bytes must not depend on the machine that builds it, yet the last bits of cos and sin do. So values are rounded to
DIGITS digits of a column's largest value (or of the nominal value, where that is more: what is zero but for rounding errors
is written as zero). The stimuli are rounded first, and the results are those of the rounded stimuli. A machine's last bits
then show only where a value lies within them of a rounding boundary. Only continuous outputs are written: counters of
iterations and the residuals of a solver may differ from machine to machine in every digit.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
from collections.abc import Mapping

import numpy as np
from lxml import etree

from fmu_src.documentation.experiment import default_experiment, respond, steps_of
from observers.component import Component, Port

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
VERSION = "1.0.0-alpha.1"
NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"
MOST_STEPS = 100
DIGITS = 6
TOLERANCE = "1e-5"  # of a column's largest or its nominal value: ten times what rounding to DIGITS takes away

_TEXT = """\
The folder {folder} holds a reference experiment of this FMU (layered standard FMI-LS-REF {version}).

fmi-ls-manifest.xml     what there is, with checksums (SHA3-256)
default.exp             the experiment: start values, times, step size, tolerance (ma-hs-experiments)
{stimuli}default_results.csv     the continuous outputs at the communication points

At each communication point the inputs are set, then the outputs are read, then follows the step.
Values are rounded to {digits} digits of the column's largest or nominal value; the tolerance {tolerance} refers to the same.
"""


def reference_files(component: Component, driven_by: Component | None) -> dict[str, bytes]:
    """Contents by path in the FMU; none for a component without outputs to show.

    Raises:
        ExperimentFailed: the experiment fails.
    """
    shown = shown_outputs(component)
    if not shown:
        return {}
    times = np.arange(steps_of(component, MOST_STEPS) + 1) * component.step_size
    inputs: dict[str, np.ndarray] = {}
    if component.inputs:
        coupled = default_experiment(component, driven_by, MOST_STEPS).inputs
        inputs = {port.name: _rounded(port, coupled[port.name]) for port in component.inputs}
    outputs = respond(component, inputs, len(times) - 1)
    results = {p.name: _rounded(p, outputs[p.name]) for p in shown if np.all(np.isfinite(outputs[p.name]))}
    files = {
        "default.exp": _experiment(component, len(times) - 1, bool(inputs)),
        "default_results.csv": _table(times, results),
    }
    if inputs:
        files["default_stimuli.csv"] = _table(times, inputs)
    stimuli = "default_stimuli.csv     the inputs at the communication points, linear in between\n" if inputs else ""
    text = _TEXT.format(folder=FOLDER, version=VERSION, stimuli=stimuli, digits=DIGITS, tolerance=TOLERANCE)
    return {
        f"{FOLDER}/fmi-ls-manifest.xml": _manifest(files),
        **{f"{FOLDER}/{name}": content for name, content in files.items()},
        "documentation/fmi-ls-ref.txt": text.encode(),
    }


def shown_outputs(component: Component) -> list[Port]:
    """The outputs of which there are reference results: continuous ones."""
    return [p for p in component.outputs if p.kind == "Real" and p.variability == "continuous" and not p.local]


def _rounded(port: Port, values: np.ndarray) -> np.ndarray:
    """`values` (n) rounded to DIGITS digits of the largest of them, or of the nominal value."""
    scale = max(float(np.max(np.abs(values))), abs(port.nominal))
    decimals = DIGITS - 1 - math.floor(math.log10(scale))
    return np.array([round(float(value), decimals) + 0.0 for value in values])  # + 0.0: no negative zero


def _table(times: np.ndarray, columns: Mapping[str, np.ndarray]) -> bytes:
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")  # quotes names such as Q[1,2]
    writer.writerow(["time", *columns])
    writer.writerows([repr(float(cell)) for cell in row] for row in zip(times, *columns.values(), strict=True))
    return file.getvalue().encode()


def _experiment(component: Component, steps: int, has_stimuli: bool) -> bytes:
    root = etree.Element(
        "Experiments", name=component.name, description="What the FMU computes with its start values: a smoke test."
    )
    experiment = etree.SubElement(root, "Experiment", name="default", tolerance=TOLERANCE)
    etree.SubElement(
        experiment,
        "TransientSimulation",
        startTime="0",
        stopTime=repr(steps * component.step_size),
        stepSize=repr(float(component.step_size)),
    )
    if has_stimuli:
        etree.SubElement(experiment, "Stimuli", source="default_stimuli.csv")
    etree.SubElement(experiment, "References", source="default_results.csv")
    return _document(root)


_ROLES = {
    "default.exp": ("application/x-ma-hs-experiments", "experiment/smoke-test", "The experiment"),
    "default_results.csv": ("text/csv", "result", "Reference results of the experiment"),
    "default_stimuli.csv": ("text/csv", "other", "Stimuli of the experiment"),
}


def _manifest(files: Mapping[str, bytes]) -> bytes:
    root = etree.Element("fmiReferences", nsmap={"fmi-ls": NAMESPACE})
    for name, value in (
        ("name", "org.fmi-standard.fmi-ls-ref"),
        ("version", VERSION),
        ("description", "Layered Standard providing information on related files included in an FMU."),
    ):
        root.set(f"{{{NAMESPACE}}}fmi-ls-{name}", value)
    for name in sorted(files):
        kind, role, description = _ROLES[name]
        etree.SubElement(
            root,
            "Related",
            type=kind,
            source=name,
            role=role,
            description=description,
            checksum=hashlib.sha3_256(files[name]).hexdigest(),
            checksumType="SHA3-256",
        )
    return _document(root)


def _document(root: etree._Element) -> bytes:
    document: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return document
