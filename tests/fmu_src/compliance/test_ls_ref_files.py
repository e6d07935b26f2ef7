"""FMI-LS-REF: the manifest, its checksums, the files of experiments and their tables, and how an experiment is replayed."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from broken_fmus import Make, edited, loaded, told
from fmu_src.compliance.files.description import read
from fmu_src.compliance.library import ls_ref as rules
from fmu_src.compliance.library.calls import Subject
from fmu_src.compliance.library.ls_ref import FOLDER, MANIFEST, Experiment, Table, check_manifest, experiment_files
from test_ls_ref import RIGHT, ls_ref

TABLE = "time,u\n0,0\n0.2,1\n"


def written(folder: Path, changes: Mapping[str, str] | None = None, **files: str) -> Path:
    """The files of `ls_ref`, with changes of the manifest and others in their place."""
    for name, content in (ls_ref(RIGHT, changes) | {f"{FOLDER}/{n}": t.encode() for n, t in files.items()}).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        assert content is not None
        (folder / name).write_bytes(content)
    return folder


def manifest(folder: Path, changes: Mapping[str, str] | None = None) -> list[tuple[str, str, str]]:
    return told(check_manifest(written(folder, changes)))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, []),
        ({'role="other"': 'role="experiment/validation"'}, []),
        ({'role="other"': 'role="serialized-state/at-rest"'}, []),
        ({'role="other"': 'role="others"'}, [("ls-ref-manifest", "in.csv", "'others'")]),
        ({'role="other"': 'role="experiment/other"'}, [("ls-ref-manifest", "in.csv", "'experiment/other'")]),
        ({'source="in.csv"': 'source="none.csv"'}, [("ls-ref-manifest", "none.csv", "none")]),
        ({'source="in.csv"': 'source=""'}, [("ls-ref-manifest", "source", "none")]),
        ({'source="in.csv"': 'source="https://example.org/in.csv"'}, []),
        ({'source="in.csv"': 'source="i%6E.csv"'}, []),
        ({'source="in.csv"': 'source="../../../../outside"'}, [("ls-ref-manifest", "../../../../outside", "none")]),
        (
            {'type="text/csv" ': 'type="text/csv" checksumType="CRC" '},
            [("ls-ref-manifest", f"{n}.csv", "'CRC'") for n in ("in", "out")],
        ),
        (
            {"<fmiReferences": "<other", "</fmiReferences": "</other"},
            [("ls-ref-manifest", MANIFEST, "other with org.fmi-standard.fmi-ls-ref")],
        ),
        (
            {'"org.fmi-standard.fmi-ls-ref"': '"org.other"'},
            [("ls-ref-manifest", MANIFEST, "fmiReferences with org.other")],
        ),
    ],
)
def test_a_manifest_lists_files_that_are_there_in_roles_of_the_standard(
    tmp_path: Path, changes: Mapping[str, str], expected: list[tuple[str, str, str]]
) -> None:
    (tmp_path / "outside").write_text(TABLE)
    assert manifest(tmp_path / "fmu", changes) == expected


def test_a_manifest_that_is_not_well_formed_is_found_with_its_line(tmp_path: Path) -> None:
    ((rule, subject, found),) = manifest(tmp_path, {"</fmiReferences>": ""})
    assert (rule, subject) == ("ls-ref-manifest", MANIFEST) and found.startswith("line 1: ")
    assert experiment_files(tmp_path) == [] and experiment_files(tmp_path / "nowhere") == []


KINDS = {
    "SHA3-224": hashlib.sha3_224,
    "SHA3-256": hashlib.sha3_256,
    "SHA3-384": hashlib.sha3_384,
    "SHA3-512": hashlib.sha3_512,
    "SHA-224": hashlib.sha224,
    "SHA-256": hashlib.sha256,
    "SHA-384": hashlib.sha384,
    "SHA-512": hashlib.sha512,
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_checksum_is_of_its_kind_in_small_letters_or_capitals(tmp_path: Path, kind: str) -> None:
    old, new = hashlib.sha3_256(TABLE.encode()).hexdigest(), KINDS[kind](TABLE.encode()).hexdigest()
    said = f'{new.upper()}" checksumType="{kind}'
    assert manifest(tmp_path / "right", {old: said}) == []
    found = manifest(tmp_path / "wrong", {old: f'AB" checksumType="{kind}'})
    assert found == [("ls-ref-checksum", "in.csv", new)]
    assert manifest(tmp_path / "none", {f'checksum="{old}"': ""}) == []


@pytest.fixture
def subject(tmp_path: Path) -> Subject:
    description = read(edited("modelDescription.xml", {}))
    return Subject(description, "CoSimulation", "", "", 0.5, 1.0, 0.25, (), tmp_path)


def experiments(folder: Path, subject: Subject, text: str, **files: str) -> list[Experiment]:
    path = written(folder, None, **{"smoke.exp": f"<Experiments>{text}</Experiments>", **files})
    (file,) = experiment_files(path)
    return rules.read_experiments(path, file, subject)


OUT = '<References source="out.csv"/>'


def test_an_experiment_says_its_times_in_either_form_else_they_are_the_default_ones(
    tmp_path: Path, subject: Subject
) -> None:
    found = experiments(
        tmp_path,
        subject,
        f'<Experiment name="a" startTime="1" stopTime="3" stepSize="0.5" tolerance="1e-5">{OUT}</Experiment>'
        f'<Experiment name="b"><TransientSimulation startTime="2" stopTime="4" stepSize="1"/>{OUT}</Experiment>'
        f'<Experiment stepSize="0.1" startTime="0">{OUT}<Stimuli source="in.csv"/></Experiment>'
        f'<Experiment name="left out">{OUT}<Parameters/></Experiment><Experiment name="left out too"/>',
    )
    said = [(e.name, e.start, e.stop, e.step, e.tolerance, e.stimuli is None) for e in found]
    assert said == [
        ("a", 1.0, 3.0, 0.5, 1e-5, True),
        ("b", 2.0, 4.0, 1.0, 1e-3, True),
        ("experiment", 0.0, 0.2, 0.1, 1e-3, False),
    ]
    reference, stimuli = found[2].reference, found[2].stimuli
    assert stimuli is not None and list(stimuli.times) == [0.0, 0.2] and list(stimuli.columns["u"]) == [0.0, 1.0]
    assert list(reference.times) == [0.0, 0.1, 0.2] and list(reference.columns["x"]) == [1.0, 0.9, 0.96]


def test_an_experiment_without_times_has_the_default_start_and_step(tmp_path: Path, subject: Subject) -> None:
    (found,) = experiments(tmp_path, subject, f"<Experiment>{OUT}</Experiment>", **{"out.csv": "time,x\n0,1\n7,2\n"})
    assert (found.start, found.stop, found.step) == (0.5, 7.0, 0.25)


@pytest.mark.parametrize(
    ("stop", "runs"), [("-1", False), ("0", True), ("1000000", True), ("1000001", False), ("NaN", False)]
)
def test_an_experiment_has_a_million_steps_at_most_and_ends_after_its_start(
    tmp_path: Path, subject: Subject, stop: str, runs: bool
) -> None:
    text = f'<Experiment name="a" startTime="0" stopTime="{stop}" stepSize="1">{OUT}</Experiment>'
    if runs:
        assert experiments(tmp_path, subject, text)[0].stop == float(stop)
    else:
        with pytest.raises(ValueError, match=r"experiment a cannot be run from 0 to .* by 1"):
            experiments(tmp_path, subject, text)


@pytest.mark.parametrize("step", ["0", "-0.1", "NaN"])
def test_a_step_is_positive(tmp_path: Path, subject: Subject, step: str) -> None:
    text = f'<Experiment name="a" startTime="0" stopTime="1" stepSize="{step}">{OUT}</Experiment>'
    with pytest.raises(ValueError, match="experiment a cannot be run"):
        experiments(tmp_path, subject, text)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("time,x\n0,one\n", "out.csv: could not convert"),
        ("time,x\n0,1,2\n", "out.csv: no table of numbers"),
        ("time,x\n0\n", "out.csv: no table of numbers"),
        ("time,x\n", "out.csv: no table of numbers"),
        ("time,x\n0,1\n0.1\n", "out.csv: "),
        ("", "out.csv: "),
    ],
)
def test_a_table_is_one_of_numbers(tmp_path: Path, subject: Subject, table: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        experiments(tmp_path, subject, f"<Experiment>{OUT}</Experiment>", **{"out.csv": table})


def test_empty_lines_and_a_byte_order_mark_are_nothing(tmp_path: Path, subject: Subject) -> None:
    table = "\ufefftime,x\n0,1\n\n0.5,2\n\n"
    (found,) = experiments(tmp_path, subject, f"<Experiment>{OUT}</Experiment>", **{"out.csv": table})
    assert list(found.reference.times) == [0.0, 0.5] and list(found.reference.columns) == ["x"]


def test_other_tables_than_csv_missing_ones_and_larger_ones_are_refused(
    tmp_path: Path, subject: Subject, monkeypatch: pytest.MonkeyPatch
) -> None:
    for element, words in (
        (
            '<References source="out.csv" type="application/x-hdf"/>',
            "out.csv is of type application/x-hdf; text/csv is read here",
        ),
        ('<References source="none.csv"/>', "none.csv: No such file"),
        ('<References source="../../../x.csv"/>', r"\.\./\.\./\.\./x.csv is not in the FMU"),
    ):
        with pytest.raises(ValueError, match=words):
            experiments(tmp_path / "fmu", subject, f"<Experiment>{element}</Experiment>")
    whole = f'<Experiment startTime="0">{OUT}</Experiment>'
    for most, is_read in ((len(RIGHT), True), (len(RIGHT) - 1, False)):
        monkeypatch.setattr(rules, "MOST_BYTES", most)
        if is_read:
            assert len(experiments(tmp_path / "fmu", subject, whole)) == 1
        else:
            with pytest.raises(ValueError, match=r"out\.csv: larger than 0 MiB"):
                experiments(tmp_path / "fmu", subject, whole)


def experiment(times: list[float], stimuli: Table | None = None, tolerance: float = 1e-6, **columns: Any) -> Experiment:
    reference = Table(np.array(times), {name: np.array(values, dtype=float) for name, values in columns.items()})
    return Experiment("ramp", 0.0, 0.2, 0.1, tolerance, stimuli, reference)


RAMP = Table(np.array([0.0, 0.2]), {"u": np.array([0.0, 1.0])})


@pytest.mark.parametrize(
    ("of", "expected"),
    [
        (experiment([0, 0.1, 0.2], RAMP, x=[1, 0.9, 0.96]), []),
        (experiment([0.1, 0.2], RAMP, x=[0.9, 0.96]), []),
        (experiment([0, 0.05, 0.1], RAMP, x=[1, 77, 0.9]), []),
        (experiment([-0.1, 0, 0.3], RAMP, x=[77, 1, 77]), []),
        (experiment([0, 0.2], RAMP, x=[1, 0.96 + 0.9e-6]), []),
        (experiment([0, 0.2], RAMP, x=[1, 0.96 + 1.1e-6]), [("ls-ref-replay", "x", "0.96")]),
        (experiment([0, 0.2], RAMP, x=[1, 0.96 - 1.1e-6]), [("ls-ref-replay", "x", "0.96")]),
        (experiment([0, 0.2], RAMP, x=[1, float("nan")]), [("ls-ref-replay", "x", "0.96")]),
        (experiment([0, 0.2], RAMP, limit=[100, 100 + 0.9e-4]), []),
        (experiment([0, 0.2], RAMP, limit=[100, 100 + 1.1e-4]), [("ls-ref-replay", "limit", "100")]),
        (experiment([0.05, 0.15], RAMP, x=[1, 1]), [("ls-ref-replay", "ramp", "none")]),
        (experiment([0, 0.1, 0.2], RAMP, none=[1, 1, 1]), [("ls-ref-replay", "none", "a column of experiment ramp")]),
        (experiment([0, 0.1, 0.2], RAMP, count=[0, 1, 2], active=[1, 1, 1]), []),
        (experiment([0, 0.1, 0.2], x=[1, 1.05, 1.095]), []),
        (experiment([0, 0.1, 0.2], x=[2, 1.05, 1]), [("ls-ref-replay", "x", "1")]),
    ],
)
def test_reference_results_are_met_to_the_tolerance_at_communication_points(
    make: Make, tmp_path: Path, of: Experiment, expected: list[tuple[str, str, str]]
) -> None:
    """By hand x is 1, 0.9, 0.96 with the ramp, and with the start value 0.5 of the input 1, 1.05, 1.095."""
    assert told(rules.replay(loaded(make(), tmp_path), of)) == expected


def test_a_replay_says_where_it_differs_most(make: Make, tmp_path: Path) -> None:
    (found,) = rules.replay(loaded(make(), tmp_path), experiment([0, 0.1, 0.2], RAMP, x=[1, 0.91, 1.0]))
    assert str(found) == "ls-ref-replay [FMI-LS-REF 2.5.2] x: expected 1 at t = 0.2, to 1e-06; found 0.96"


def test_what_follows_an_input_at_once_is_compared_where_the_input_rests(make: Make, tmp_path: Path) -> None:
    """y = 3 u, read before u is set anew: after a step of u at t = 0.1 a legal sequence shows it at 0.2."""
    step = Table(np.array([0.0, 0.1]), {"u": np.array([0.0, 1.0])})
    fmu = loaded(
        make(edits={'causality="input" variability="continuous"': 'causality="input" variability="discrete"'}), tmp_path
    )
    assert told(rules.replay(fmu, experiment([0, 0.1, 0.2], step, y=[0, 3, 3]))) == []
    assert told(rules.replay(fmu, experiment([0, 0.1, 0.2], step, y=[0, 77, 3]))) == []
    assert told(rules.replay(fmu, experiment([0, 0.1, 0.2], step, y=[0, 3, 2]))) == [("ls-ref-replay", "y", "3")]
    assert told(rules.replay(fmu, experiment([0, 0.1, 0.2], step, y=[1, 3, 3]))) == [("ls-ref-replay", "y", "0")]


def test_a_continuous_input_is_interpolated_and_another_keeps_the_rows_value() -> None:
    u, count = (read(edited("modelDescription.xml", {})).variables[i] for i in (0, 5))
    times = np.array([-1.0, 0.0, 0.5, 1.0, 1.5, 2.0, 3.0])
    table = Table(np.array([0.0, 1.0, 2.0]), {"u": np.array([0.0, 4.0, 2.0]), "count": np.array([0.0, 4.0, 2.0])})
    assert list(rules._at(times, u, table)) == [0, 0, 2, 4, 3, 2, 2]
    assert list(rules._at(times, count, table)) == [0, 0, 0, 4, 4, 2, 2]
    late = np.array([1.0 - 1e-13])  # the communication point 1.0, by a sum
    assert list(rules._at(late, count, table)) == [4]
