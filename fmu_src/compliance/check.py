"""The whole check of one FMU: the file first, then what it does."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from fmu_src.compliance.files import fmi3
from fmu_src.compliance.files.binaries import check_binaries, host_library
from fmu_src.compliance.files.description import INTERFACES, Description, read, schema
from fmu_src.compliance.files.names import check_names
from fmu_src.compliance.files.package import Package, check_archive, open_package, unpack
from fmu_src.compliance.files.structure import check_document, check_fmpy, check_schema, check_structure
from fmu_src.compliance.files.variables import check_variables
from fmu_src.compliance.finding import CannotCheck, Report, by_cause
from fmu_src.compliance.library.calls import Subject
from fmu_src.compliance.library.dynamic import check_dynamic
from fmu_src.compliance.library.ls_ref import MANIFEST, Experiment, check_manifest, experiment_files, read_experiments
from fmu_src.compliance.library.process import Case, prepare, run
from fmu_src.compliance.rules import RULES, STATIC, finding

_ARCHIVE = ("zip-sound", "zip-method", "zip-path", "zip-link", "xml-schema")
_UNUSABLE = ("binary-format", "exports", "undefined-symbols")  # not needed-libraries: here they may well be
_LAYERED = ("ls-ref-manifest", "ls-ref-checksum")
_MOST_WATCHED = 1000  # computed variables that are compared; of more, the outputs and then the first others


def check(fmu: Path, progress: Callable[[str], None] = lambda rule: None) -> Report:
    """The report on the FMU at `fmu`; `progress` hears which rule is at work.

    Raises:
        CannotCheck: the file cannot be checked (NotAnFmu), or the check's own processes failed.
    """
    package = open_package(fmu)
    report = Report(fmu, package.version)
    try:
        _check_package(package, report, progress)
    except OSError as error:
        place = f"{Path(error.filename).name[:60]}: " if isinstance(error.filename, str) else ""
        raise CannotCheck(f"{fmu}: cannot be checked: {place}{error.strerror or error}") from None
    except CannotCheck as error:
        text = str(error)
        raise CannotCheck(text if text.startswith(str(fmu)) else f"{fmu}: cannot be checked: {text}") from None
    report.findings = by_cause(report.findings)
    if package.version == "3.0":
        report.findings = [replace(found, section=RULES[found.rule].section3) for found in report.findings]
    return report


def _check_package(package: Package, report: Report, progress: Callable[[str], None]) -> None:
    report.checked += _ARCHIVE
    report.findings += check_archive(package)
    archive_is_sound = not report.findings
    is_fmi3 = package.version == "3.0"
    report.findings += check_schema(package.root, fmi3.schema() if is_fmi3 else schema())
    if any(found.rule == "xml-schema" for found in report.findings):
        report.notes.append("modelDescription.xml is not valid, so no further rule was applied")
        return
    progress("static")
    prepare()
    skipped = _ARCHIVE + _LAYERED
    report.checked += [name for name, rule in STATIC.items() if name not in skipped and (rule.section3 or not is_fmi3)]
    description = fmi3.read(package.root) if is_fmi3 else read(package.root)
    names = fmi3.names(package.root) if is_fmi3 else [variable.name for variable in description.variables]
    report.findings += check_document(description)
    report.findings += check_names(description.convention, names)
    if is_fmi3:
        report.findings += fmi3.check_definitions(package.root)
        report.findings += fmi3.check_ranges(package.root, description)
        report.findings += fmi3.check_structure(package.root, description)
    else:
        report.findings += check_variables(package.root, description)
        report.findings += check_structure(package.root, description)
    if archive_is_sound and is_fmi3:
        report.findings += fmi3.check_documents(package)
    if not any(found.rule == "xml-schema" for found in report.findings):
        report.findings += check_fmpy(package, set(names), already_found=bool(report.findings))
    if not archive_is_sound:
        report.notes.append("the archive is not sound, so the FMU was not unpacked")
        return
    with tempfile.TemporaryDirectory(prefix="compliance-", ignore_cleanup_errors=True) as folder:
        directory = Path(folder).resolve() / "fmu"
        unpack(package, directory)
        # In a process of its own: a damaged library may lead its reader a long way.
        case = Case("binary-format", "binaries", check_binaries, (directory, description), "libraries", drives=False)
        report.findings += run(case).findings
        if is_fmi3:
            report.notes.append("of FMI 3.0: the file was checked, the library was not driven")
        else:
            _check_library(directory, description, report, progress)


def _check_library(directory: Path, description: Description, report: Report, progress: Callable[[str], None]) -> None:
    if (directory / MANIFEST).is_file():
        report.checked += _LAYERED
        report.findings += check_manifest(directory)
    for interface in description.interfaces:
        name = INTERFACES[interface]
        library = host_library(description.identifiers[interface])
        if library is None or not (directory / library).is_file():
            report.notes.append(f"no binary for this machine ({library or 'no name for it'}): {name} was not driven")
        elif any(found.subject == library and found.rule in _UNUSABLE for found in report.findings):
            report.notes.append(f"{library} is not sound: {name} was not driven")
        elif interface == "ModelExchange" and any(found.rule == "structure-index" for found in report.findings):
            report.notes.append(f"ModelStructure does not say what the states are: {name} was not driven")
        else:
            subject = _subject(directory, description, interface, library)
            experiments = _experiments(directory, subject, report) if interface == "CoSimulation" else []
            check_dynamic(subject, experiments, report, progress)


def _experiments(directory: Path, subject: Subject, report: Report) -> list[Experiment]:
    experiments: list[Experiment] = []
    for file in experiment_files(directory):
        try:
            experiments += read_experiments(directory, file, subject)
        except ValueError as error:
            report.findings.append(finding("ls-ref-manifest", file.name, "an experiments file", str(error)))
    return experiments


def _subject(directory: Path, description: Description, interface: str, library: str) -> Subject:
    """The default experiment; where it says no step size, a hundredth of it; where it says nothing, 10 ms."""
    experiment = {name: value for name, value in description.experiment.items() if math.isfinite(value)}
    start, stop = experiment.get("startTime", 0.0), experiment.get("stopTime")
    step = experiment.get("stepSize", 0.0)
    if not step > 0:
        step = (stop - start) / 100 if stop is not None and stop > start else 0.01
    scratch = directory.parent / f"working directory for {interface}"
    scratch.mkdir()
    shown = ("output", "local", "calculatedParameter", "independent")
    computed = [variable for variable in description.variables if variable.causality in shown]
    computed.sort(key=lambda variable: (shown.index(variable.causality), variable.index))
    return Subject(
        description,
        interface,
        str(directory / library),
        (directory / "resources").as_uri(),
        start,
        stop,
        step,
        tuple(computed[:_MOST_WATCHED]),
        scratch,
    )
