"""FMI-LS-REF: the manifest of related files, their checksums, and the experiments with reference results in them.

The layered standard (1.0.0-alpha.1) has the manifest and the checksums; the experiments are in the harmonised format to which
it refers (ma-hs-experiments). Both its forms are read: times as attributes of Experiment, and of its TransientSimulation.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
from lxml import etree

from fmu_src.compliance.files.description import Variable
from fmu_src.compliance.finding import Finding
from fmu_src.compliance.library.calls import Subject
from fmu_src.compliance.library.fmu import Fmu
from fmu_src.compliance.library.instance import Instance
from fmu_src.compliance.rules import finding

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = f"{FOLDER}/fmi-ls-manifest.xml"
NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"
NAME = "org.fmi-standard.fmi-ls-ref"
EXPERIMENTS = "application/x-ma-hs-experiments"
TOLERANCE = 1e-3  # of a column's largest or its nominal value, where the experiment names none
MOST_STEPS = 1_000_000  # of an experiment
MOST_BYTES = 16 << 20  # of a table
_SAME_TIME = 1e-6  # of a step

_ROLES = re.compile(
    r"(document|requirement|specification|model|parameter|system|testcase|experiment(/(smoke-test|validation|uncertainty-analysis))?"
    r"|result|method|rationale|report|request|delivery|configuration|signature|serialized-state(/.*)?|meta-data|other)\Z"
)
_DIGESTS = {
    f"SHA{family}-{bits}": name.format(bits)
    for family, name in (("3", "sha3_{}"), ("", "sha{}"))
    for bits in (224, 256, 384, 512)
}


@dataclass(frozen=True)
class Table:
    """A CSV file: `times` (n) [s] from its first column, the other columns by name, each (n)."""

    times: np.ndarray
    columns: dict[str, np.ndarray]


@dataclass(frozen=True)
class Experiment:
    """One run that can be repeated; parameter sets are not read, an experiment with one is left out with a note."""

    name: str
    start: float
    stop: float
    step: float
    tolerance: float
    stimuli: Table | None
    reference: Table


def check_manifest(directory: Path) -> Iterator[Finding]:
    """ls-ref-manifest and ls-ref-checksum, of the FMU unpacked in `directory`."""
    path = directory / MANIFEST
    try:
        root = etree.parse(str(path)).getroot()
    except etree.XMLSyntaxError as error:
        yield finding("ls-ref-manifest", MANIFEST, "well-formed XML", f"line {error.lineno}: {error.msg}")
        return
    name = root.get(f"{{{NAMESPACE}}}fmi-ls-name")
    if root.tag != "fmiReferences" or name != NAME:
        yield finding(
            "ls-ref-manifest", MANIFEST, f"fmiReferences with fmi-ls-name = {NAME}", f"{root.tag} with {name}"
        )
        return
    for related in root.iterfind("Related"):
        source, role = related.get("source", ""), related.get("role", "")
        if not _ROLES.match(role):
            yield finding("ls-ref-manifest", source, "a role of the standard", f"'{role}'")
        if urlsplit(source).scheme:  # an absolute URI: what it leads to is not in the FMU
            continue
        file = _file_of(directory, source)
        if file is None:
            yield finding("ls-ref-manifest", source or "source", "a file in the FMU", "none")
        else:
            yield from _check_digest(related, source, file)


def experiment_files(directory: Path) -> list[Path]:
    """The files of experiments that the manifest lists; none where there is no manifest that can be read."""
    path = directory / MANIFEST
    if not path.is_file():
        return []
    try:
        root = etree.parse(str(path)).getroot()
    except etree.XMLSyntaxError:  # the rule ls-ref-manifest says so
        return []
    sources = [
        related.get("source", "")
        for related in root.iterfind("Related")
        if related.get("role", "").startswith("experiment") and related.get("type") == EXPERIMENTS
    ]
    return [file for file in (_file_of(directory, source) for source in sources) if file is not None]


def _file_of(directory: Path, source: str) -> Path | None:
    """The file that a relative URI in the manifest leads to; None if it is not in the FMU."""
    file = (directory / FOLDER / unquote(source)).resolve()
    return file if source and file.is_relative_to(directory.resolve()) and file.is_file() else None


def _check_digest(related: etree._Element, source: str, file: Path) -> Iterator[Finding]:
    checksum, kind = related.get("checksum"), related.get("checksumType", "SHA3-256")
    if checksum is None:
        return
    if kind not in _DIGESTS:
        yield finding("ls-ref-manifest", source, f"a checksumType of {', '.join(_DIGESTS)}", f"'{kind}'")
        return
    with file.open("rb") as content:
        digest = hashlib.file_digest(content, _DIGESTS[kind]).hexdigest()
    if digest != checksum.lower():
        yield finding("ls-ref-checksum", source, f"the {kind} {checksum.lower()}", digest)


def read_experiments(directory: Path, file: Path, subject: Subject) -> list[Experiment]:
    """The experiments of a file, of the FMU unpacked in `directory`, that have reference results.

    Raises:
        ValueError: not such a file, or one of the files that it names is missing or no CSV table.
    """
    try:
        root = etree.parse(str(file)).getroot()
    except etree.XMLSyntaxError as error:
        raise ValueError(f"line {error.lineno}: {error.msg}") from None
    directory = directory.resolve()
    found = []
    for element in root.iterfind("Experiment"):
        if element.find("References") is not None and element.find("Parameters") is None:
            simulation = element.find("TransientSimulation")
            settings = dict(element.attrib) | (dict(simulation.attrib) if simulation is not None else {})
            reference = _table(directory, file, element.find("References"))
            stimuli = element.find("Stimuli")
            experiment = Experiment(
                name=settings.get("name", "experiment"),
                start=float(settings.get("startTime", subject.start)),
                stop=float(settings.get("stopTime", reference.times[-1])),
                step=float(settings.get("stepSize", subject.step)),
                tolerance=float(settings.get("tolerance", TOLERANCE)),
                stimuli=None if stimuli is None else _table(directory, file, stimuli),
                reference=reference,
            )
            steps = (experiment.stop - experiment.start) / experiment.step if experiment.step > 0 else math.inf
            if not 0 <= steps <= MOST_STEPS:
                times = f"{experiment.start:g} to {experiment.stop:g} by {experiment.step:g}"
                raise ValueError(f"experiment {experiment.name} cannot be run from {times}")
            found.append(experiment)
    return found


def _table(directory: Path, file: Path, element: etree._Element) -> Table:
    source, kind = element.get("source", ""), element.get("type", "text/csv")
    if kind != "text/csv":
        raise ValueError(f"{source} is of type {kind}; text/csv is read here")
    table = (file.parent / unquote(source)).resolve()
    if not table.is_relative_to(directory):
        raise ValueError(f"{source} is not in the FMU")
    try:
        if table.stat().st_size > MOST_BYTES:
            raise ValueError(f"larger than {MOST_BYTES >> 20} MiB")
        rows = list(csv.reader(io.StringIO(table.read_text(encoding="utf-8-sig"))))
        values = np.array([[float(cell) for cell in row] for row in rows[1:] if row], dtype=float)
        if values.ndim != 2 or values.shape[1] != len(rows[0]):
            raise ValueError("no table of numbers")
    except OSError as error:
        raise ValueError(f"{source}: {error.strerror}") from None
    except (ValueError, IndexError, csv.Error) as error:
        raise ValueError(f"{source}: {error}") from None
    return Table(values[:, 0], dict(zip(rows[0][1:], values[:, 1:].T, strict=True)))


def replay(fmu: Fmu, experiment: Experiment) -> Iterator[Finding]:
    """Runs the experiment: get the outputs of t_k, set the inputs of t_k, step to t_{k+1}; compares where both have t_k.

    Inputs are set before outputs are read in initialization mode alone: afterwards the standard (section 4.2.4) wants a step in
    between. So an output that may depend on an input without a step is compared only where this input has not changed since t_{k-1}.
    """
    by_name = {variable.name: variable for variable in fmu.subject.variables}
    stimuli, reference = experiment.stimuli, experiment.reference
    strangers = [name for name in [*reference.columns, *(stimuli.columns if stimuli else ())] if name not in by_name]
    if strangers:
        yield finding(
            "ls-ref-replay", strangers[0], "a variable of the FMU", f"a column of experiment {experiment.name}"
        )
        return
    watched = [by_name[name] for name in reference.columns]
    steps = round((experiment.stop - experiment.start) / experiment.step)
    times = experiment.start + np.arange(steps + 1) * experiment.step
    inputs = {} if stimuli is None else {by_name[name]: _at(times, by_name[name], stimuli) for name in stimuli.columns}
    instance = fmu.new()
    instance.legal("fmi2SetupExperiment", 0, 0.0, experiment.start, 0, 0.0)
    instance.legal("fmi2EnterInitializationMode")
    _apply(instance, inputs, 0)
    instance.legal("fmi2ExitInitializationMode")
    rows = [list(instance.read(watched).values())]
    for k in range(steps):
        if k > 0:
            _apply(instance, inputs, k)
        instance.legal("fmi2DoStep", times[k], experiment.step, 1, about=f"experiment {experiment.name}")
        rows.append(list(instance.read(watched).values()))
    places = np.rint((reference.times - experiment.start) / experiment.step).astype(int)
    near = np.abs(reference.times - experiment.start - places * experiment.step) <= _SAME_TIME * experiment.step
    shared = near & (places >= 0) & (places <= steps)
    if not shared.any():
        yield finding("ls-ref-replay", experiment.name, "reference results at communication points", "none")
        return
    got = np.array(rows, dtype=float)
    for column, variable in enumerate(watched):
        expected, found = reference.columns[variable.name][shared], got[places[shared], column]
        known = _is_comparable(fmu.subject, variable, inputs, steps)[places[shared]]
        error = np.where(known, np.abs(found - expected), 0.0)
        limit = experiment.tolerance * max(np.abs(expected).max(), abs(variable.nominal))
        worst = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
        if not error[worst] <= limit:
            expectation = f"{expected[worst]:.9g} at t = {reference.times[shared][worst]:.9g}, to {limit:.2g}"
            yield finding("ls-ref-replay", variable.name, expectation, f"{found[worst]:.9g}")


def _is_comparable(subject: Subject, variable: Variable, inputs: dict[Variable, np.ndarray], steps: int) -> np.ndarray:
    """(steps + 1): is what a legal sequence reads at t_k the value for the inputs of t_k?"""
    known = np.ones(steps + 1, dtype=bool)
    if variable.causality == "parameter" or variable.variability == "constant":
        return known
    # A local variable declares no dependencies at all.
    direct = subject.description.direct.get(variable.index)
    for other, values in inputs.items():
        if direct is None or other.index in direct:
            known[1:] &= values[1:] == values[:-1]
    return known


def _at(times: np.ndarray, variable: Variable, stimuli: Table) -> np.ndarray:
    """The stimulus at `times` (n): a continuous input is interpolated linearly between the rows, another keeps the row's value."""
    values = stimuli.columns[variable.name]
    if variable.variability == "continuous":
        return np.interp(times, stimuli.times, values)
    rows = np.searchsorted(stimuli.times, times * (1 + 1e-12), side="right") - 1
    return values[np.maximum(rows, 0)]


def _apply(instance: Instance, inputs: dict[Variable, np.ndarray], k: int) -> None:
    for variable, values in inputs.items():
        instance.set(variable, float(values[k]) if variable.type == "Real" else int(values[k]))
