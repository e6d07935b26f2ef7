"""A case runs in a process of its own: what it finds and returns arrives, and so does how it ends, whatever it does there."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import time
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from broken_fmus import told
from fmu_src.compliance.finding import CannotCheck, Finding
from fmu_src.compliance.library import process
from fmu_src.compliance.library.calls import status_name
from fmu_src.compliance.library.process import Case, Outcome
from fmu_src.compliance.rules import finding


def run(probe: Any, *arguments: Any, **more: Any) -> Outcome:
    return process.run(Case("load", "a case", probe, arguments, drives=False, **more))


def one(word: str) -> Finding:
    return finding("load", word, f"{word} expected", "ä 'b'\n\"c\" d")


def finds(*words: str) -> Generator[Finding, None, dict[str, Any]]:
    for word in words:
        yield one(word)
    return {"pid": os.getpid(), "words": words}


def test_findings_and_the_value_that_is_kept_come_from_another_process(tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    outcome = run(finds, "first", "second", keep=kept)
    assert outcome.findings == [one("first"), one("second")] and outcome.complete and not outcome.hung
    value = json.loads(kept.read_text())
    assert value["words"] == ["first", "second"] and value["pid"] not in (os.getpid(), None)
    again = run(finds, keep=kept)
    assert again.findings == [] and again.complete and json.loads(kept.read_text())["pid"] != value["pid"]


def measures(text: str, numbers: list[int]) -> Generator[Finding, None, None]:
    yield finding("load", str(len(text)), str(sum(numbers)), text[-3:])


def test_arguments_of_many_megabytes_arrive_whole() -> None:
    (found,) = run(measures, "x" * 3_000_000 + "end", list(range(1000))).findings
    assert (found.subject, found.expected, found.found) == ("3000003", "499500", "end")


def ends(how: str, code: int) -> Iterator[Finding]:
    yield one("before")
    if how == "exit":
        os._exit(code)
    os.kill(os.getpid(), code)
    time.sleep(60)


@pytest.mark.parametrize(
    ("how", "code", "words"),
    [
        ("exit", 0, "the end of the process (exit code 0) in its start"),
        ("exit", 3, "the end of the process (exit code 3) in its start"),
        ("signal", signal.SIGKILL, "a crash (SIGKILL) in its start"),
        ("signal", signal.SIGSEGV, "a crash (SIGSEGV) in its start"),
        ("signal", 40, "a crash (signal 40) in its start"),
    ],
)
def test_how_a_process_ends_is_a_finding_behind_those_before(how: str, code: int, words: str) -> None:
    outcome = run(ends, how, code)
    assert told(outcome.findings) == [told([one("before")])[0], ("load", "a case", words)]
    assert not outcome.complete and not outcome.hung
    assert run(finds).complete


def sleeps(seconds: float) -> Iterator[Finding]:
    time.sleep(seconds)
    yield one("awake")


def test_a_case_that_does_not_come_back_is_ended_and_the_next_one_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(finds).complete  # the server has started
    monkeypatch.setattr(process, "TIMEOUT", 1.0)
    outcome = run(sleeps, 60.0)
    assert [found.found for found in outcome.findings] == ["no answer from its start within 1 s"]
    assert outcome.hung and not outcome.complete
    assert run(finds, "next").findings == [one("next")]


def fails() -> Iterator[Finding]:
    yield one("before")
    raise LookupError("no 'such' thing")


def test_a_probe_that_fails_by_its_own_fault_ends_the_check_with_its_place() -> None:
    with pytest.raises(
        CannotCheck, match=r"^the probe of load failed: LookupError: no 'such' thing \(test_processes\.py, line \d+\)$"
    ):
        run(fails)
    assert run(finds).complete


def leaves(file: Path) -> Generator[Finding, None, None]:
    """A process that would run for a minute."""
    if os.fork() == 0:
        time.sleep(60)
        os._exit(0)
    file.write_text(str(os.getpgid(0)))
    yield from ()


def test_what_a_case_leaves_behind_is_ended(tmp_path: Path) -> None:
    assert run(leaves, tmp_path / "group").complete
    group, end = int((tmp_path / "group").read_text()), time.monotonic() + 10
    assert group != os.getpgid(0)

    def left() -> list[int]:
        found = []
        for pid in psutil.pids():
            with contextlib.suppress(OSError, psutil.Error):  # it has ended since
                if os.getpgid(pid) == group and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
                    found.append(pid)
        return found

    while left() and time.monotonic() < end:
        time.sleep(0.01)
    assert left() == []


def prints(text: bytes) -> Generator[Finding, None, dict[str, Any]]:
    os.write(1, text)
    yield from ()
    return {"read": os.read(0, 10).decode()}


def test_what_a_case_prints_or_reads_is_none_of_the_checks(tmp_path: Path) -> None:
    assert run(prints, b"1 e 0\n1 f {}\n", keep=tmp_path / "kept").findings == []
    assert json.loads((tmp_path / "kept").read_text()) == {"read": ""}


def test_a_server_that_is_gone_is_replaced() -> None:
    first = process.prepare()
    assert process.prepare() is first and first.is_alive
    first.end()
    assert not first.is_alive and process.prepare() is not first
    assert run(finds).complete


@pytest.mark.parametrize(
    ("status", "name"),
    [(0, "fmi2OK"), (3, "fmi2Error"), (4, "fmi2Fatal"), (5, "fmi2Pending"), (6, "the status 6"), (-1, "the status -1")],
)
def test_a_status_has_its_name_and_one_that_is_none_its_number(status: int, name: str) -> None:
    assert status_name(status) == name
