"""The whole check of one FMU: the file first, then what it does."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

from fmu_src.compliance.files.binaries import check_binaries, host_library
from fmu_src.compliance.files.description import Description, read
from fmu_src.compliance.files.package import check_archive, open_package
from fmu_src.compliance.files.structure import check_document, check_fmpy, check_schema, check_structure
from fmu_src.compliance.files.variables import check_variables
from fmu_src.compliance.finding import Report
from fmu_src.compliance.library.dynamic import check_dynamic
from fmu_src.compliance.library.fmu import Subject
from fmu_src.compliance.library.ls_ref import MANIFEST, Experiment, check_manifest, experiment_files, read_experiments
from fmu_src.compliance.rules import STATIC, finding

_ARCHIVE = ("zip-sound", "zip-method", "zip-path", "xml-schema")
_UNUSABLE = ("binary-format", "exports", "undefined-symbols")  # not needed-libraries: here they may well be
_LAYERED = ("ls-ref-manifest", "ls-ref-checksum")


def check(fmu: Path, progress: Callable[[str], None] = lambda rule: None) -> Report:
    """The report on the FMU at `fmu`; `progress` hears which rule is at work.

    Raises:
        NotAnFmu: the file cannot be checked.
    """
    package = open_package(fmu)
    report = Report(fmu, checked=list(_ARCHIVE))
    report.findings += check_archive(package)
    archive_is_sound = not report.findings
    report.findings += check_schema(package.root)
    if any(found.rule == "xml-schema" for found in report.findings):
        report.notes.append("modelDescription.xml is not valid, so no further rule was applied")
        return report
    description = read(package.root)
    progress("static")
    report.checked += [rule for rule in STATIC if rule not in _ARCHIVE + _LAYERED]
    report.findings += check_document(description)
    report.findings += check_variables(package.root, description)
    report.findings += check_structure(package.root, description)
    report.findings += check_fmpy(package, already_found=bool(report.findings))
    if not archive_is_sound:
        report.notes.append("the archive is not sound, so the FMU was not unpacked")
        return report
    with tempfile.TemporaryDirectory(prefix="compliance-") as folder:
        directory = Path(folder)
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(directory)
        _check_unpacked(directory, description, report, progress)
    return report


def _check_unpacked(directory: Path, description: Description, report: Report, progress: Callable[[str], None]) -> None:
    report.findings += check_binaries(directory, description)
    if (directory / MANIFEST).is_file():
        report.checked += _LAYERED
        report.findings += check_manifest(directory)
    library = host_library(description)
    if not description.is_cosimulation:
        report.notes.append("no co-simulation: the FMU was not driven")
    elif library is None or not (directory / library).is_file():
        report.notes.append(f"no binary for this machine ({library or 'unknown to FMI'}): the FMU was not driven")
    elif any(found.subject == library and found.rule in _UNUSABLE for found in report.findings):
        report.notes.append(f"{library} is not sound: the FMU was not driven")
    else:
        subject = _subject(directory, description, library)
        experiments: list[Experiment] = []
        for file in experiment_files(directory):
            try:
                experiments += read_experiments(file, subject)
            except ValueError as error:
                report.findings.append(finding("ls-ref-manifest", file.name, "an experiments file", str(error)))
        check_dynamic(subject, experiments, report, progress)


def _subject(directory: Path, description: Description, library: str) -> Subject:
    """The default experiment; where it says no step size, a hundredth of it; where it says nothing, 10 ms."""
    experiment = description.experiment
    start, stop = experiment.get("startTime", 0.0), experiment.get("stopTime")
    step = experiment.get("stepSize") or ((stop - start) / 100 if stop is not None and stop > start else 0.01)
    path = directory.resolve()
    return Subject(description, str(path / library), (path / "resources").as_uri(), start, stop, step)
