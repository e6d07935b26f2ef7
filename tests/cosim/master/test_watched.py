"""A run in a process of its own: whatever an FMU does, one error that names element, call and time, and the rows up to there."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest

import cosim.master
from cosim.errors import ExperimentError, SystemFileError
from cosim.master import watched
from cosim.master.slave import RunError
from cosim.results import LONGEST_MESSAGE, MOST_MESSAGES, Message, Messages
from cosim.system import Element, System
from strict_fmu import FAILURES

Strict = Callable[..., Path]


def failing(strict: Strict, failure: str, fail_time: float = 0.45) -> System:
    """Two elements, the second of which fails in the step from 0.5 s on."""
    chosen = {"failure": FAILURES.index(failure), "fail_time": fail_time}
    elements = {"good": Element(strict(), {"u": 2.0}), "bad": Element(strict("bad"), chosen)}
    return System("failing", elements, [("good.y", "bad.u")], stop=1.0, step=0.1)


def test_it_gives_the_same_result_to_the_last_bit(built: Callable[[str], Path]) -> None:
    toy = built("sampled_toy")
    elements = {
        "plant": Element(built("duffing")),
        "observer": Element(toy),
        "blind": Element(toy, {"y": float("nan")}),
    }
    system = System("both", elements, [("plant.y", "observer.y")], stop=3.0, step=0.05)
    here, there = cosim.master.run(system), watched.run(system)
    assert here.names == there.names and here.values.tobytes() == there.values.tobytes()
    assert here.time.tobytes() == there.time.tobytes()
    assert (here.units, here.kinds, here.items, here.sources) == (there.units, there.kinds, there.items, there.sources)
    assert here.messages == there.messages and len(there.messages) == 30
    assert all((ns > 0).all() and len(ns) == 60 for ns in there.step_ns.values())


@pytest.mark.parametrize(
    ("failure", "reason"),
    [
        ("exit", r"fmi2DoStep ended the process with exit\(0\)"),
        ("crash", "fmi2DoStep ended the process by SIGSEGV"),
        ("endless", "fmi2DoStep has not returned for 0.5 s"),
        ("pending_for_ever", "fmi2DoStep has not returned for 0.5 s"),
        ("noise", "fmi2DoStep ended the process by SIGABRT: a line that nobody asked for"),
    ],
)
@pytest.mark.skipif(os.name != "posix", reason="Windows has other words for it")
def test_a_step_that_goes_wrong_is_named_and_the_rows_before_are_kept(
    strict: Strict, failure: str, reason: str
) -> None:
    system = failing(strict, failure)
    with pytest.raises(RunError, match=rf"element 'bad' at t = 0\.5: {reason}") as caught:
        watched.run(system, limit=0.5)
    assert "\n" not in str(caught.value)
    partial = caught.value.partial
    assert partial is not None
    np.testing.assert_array_equal(partial.time, 0.1 * np.arange(6))
    np.testing.assert_array_equal(partial.values, watched.run(failing(strict, "none"), stop=0.5).values)


@pytest.mark.skipif(os.name != "posix", reason="the FMU does it by POSIX means")
@pytest.mark.parametrize(
    ("failure", "reason", "rows"),
    [
        ("garble", r"element 'bad' at t = 0\.5: fmi2DoStep ended the process by SIGABRT", 6),
        ("lose", "the record of the run is damaged, which an FMU must have done", None),
        ("log_for_ever", r"element 'bad' at t = 0\.5: fmi2DoStep has not returned for 0\.5 s", 6),
        ("obey_me", r"element 'bad' at t = 0\.5: fmi2DoStep failed \(error\): a line and another \\x1b\[31m", 6),
    ],
)
def test_what_an_fmu_does_to_its_process_is_one_plain_line(
    strict: Strict, failure: str, reason: str, rows: int | None
) -> None:
    with pytest.raises(RunError, match=reason + r"\Z") as caught:
        watched.run(failing(strict, failure), limit=0.5)
    assert str(caught.value).isprintable()
    partial = caught.value.partial
    assert (partial is not None and len(partial.time)) == (rows or False)
    if failure == "log_for_ever":
        assert partial is not None and 0 < len(partial.messages) <= MOST_MESSAGES


def test_of_too_many_messages_the_first_and_the_last_are_kept() -> None:
    kept = Messages()
    for i in range(MOST_MESSAGES + 5):
        kept.append(Message("a", "warning", "", f"{i} " + "x" * 5000))
    assert len(kept) == MOST_MESSAGES and len(kept[0].text) == LONGEST_MESSAGE
    assert [m.text.split()[0] for m in (kept[0], kept[-2], kept[-1])] == [
        "0",
        str(MOST_MESSAGES - 2),
        str(MOST_MESSAGES + 4),
    ]


def test_other_calls_are_named_too(strict: Strict) -> None:
    with pytest.raises(RunError, match=r"element 'bad' at t = 0: fmi2SetXXX has not returned for 0\.5 s") as caught:
        watched.run(failing(strict, "set_for_ever"), limit=0.5)
    assert caught.value.partial is not None and len(caught.value.partial.time) == 1
    with pytest.raises(RunError, match=r"element 'bad' at t = 0\.5: fmi2GetXXX ended the process by SIGABRT"):
        watched.run(failing(strict, "abort_at_get"))


def test_an_fmu_works_in_a_scratch_folder_that_goes_with_the_run(
    strict: Strict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    watched.run(failing(strict, "none"))
    with pytest.raises(RunError):
        watched.run(failing(strict, "exit"))
    assert not list(tmp_path.glob("cosim-*")) and not Path("eventlog.txt").exists()


def test_an_fmu_that_reads_standard_input_finds_nothing_there(strict: Strict) -> None:
    """Not the requests of the master, which come that way."""
    result = watched.run(failing(strict, "read_stdin"), limit=5.0)
    assert len(result.time) == 11


def test_a_mistake_is_the_same_error_as_without_a_process(strict: Strict, tmp_path: Path) -> None:
    system = failing(strict, "none")
    with pytest.raises(ExperimentError, match=r"stop time 0\.25 is not a multiple"):
        watched.run(system, stop=0.25)
    with pytest.raises(SystemFileError, match=r"nowhere\.ssp: there is no such file"):
        watched.run(tmp_path / "nowhere.ssp")


def test_a_child_does_one_run_after_the_other_and_is_started_again_after_a_crash(strict: Strict) -> None:
    with watched.Child() as child:
        first = child.run(failing(strict, "none"))
        with pytest.raises(RunError):
            child.run(failing(strict, "crash"))
        assert child.run(failing(strict, "none")).values.tobytes() == first.values.tobytes()
        (process,) = (p for p in psutil.Process().children() if "cosim.master" in p.cmdline())
    assert not process.is_running()


def test_the_child_ends_when_its_parent_is_killed_in_the_middle_of_a_step(strict: Strict, tmp_path: Path) -> None:
    fmu = failing(strict, "endless").elements["bad"].fmu
    code = (
        "from pathlib import Path; from cosim.system import Element, System; from cosim.master import watched\n"
        f"watched.run(System('x', {{'bad': Element(Path({str(fmu)!r}), {{'failure': 3}})}}, stop=1.0, step=0.1))"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], env=os.environ | {"TMPDIR": str(tmp_path)})
    watch = psutil.Process(parent.pid)
    deadline = time.monotonic() + 60
    while not any((tmp_path).glob("cosim-*/record/here")):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    (child,) = watch.children()
    parent.kill()
    parent.wait()
    psutil.wait_procs([child], timeout=20)
    assert not child.is_running()
