"""The process behind `process.py`: it forks a child for each case, and watches that none outlives the check.

Forked from here, a child has everything imported and the FMU's description in memory: a case costs milliseconds.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import json
import os
import pickle
import select
import signal
import struct
import sys
import traceback
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from fmu_src.compliance.library.calls import Broken, Subject
from fmu_src.compliance.library.capture import Capture
from fmu_src.compliance.library.fmu import Fmu
from fmu_src.compliance.library.process import Case
from fmu_src.compliance.rules import finding

import_module("fmu_src.compliance.check")  # all that a child would import; by name, for an import would close a circle

_PR_SET_PDEATHSIG = 1  # from <sys/prctl.h>


def serve(forks: bool) -> None:
    """Serve the process at the other end of stdin and stdout until it is gone; without forks, one case."""
    commands, results = os.dup(0), os.dup(1)
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1):
        os.dup2(nothing, stream)
    woken, waker = os.pipe()
    os.set_blocking(waker, False)
    if forks:
        signal.set_wakeup_fd(waker)
        signal.signal(signal.SIGCHLD, lambda *_: None)
    os.write(results, b"0 r ready\n")
    subject: Subject | None = None
    while True:
        match _receive(commands):
            case ("subject", subject):
                gc.freeze()  # it is the children's too: a collection there would copy it
            case ("case", number, case, timeout):
                if not forks:
                    _run(number, case, subject, timeout, results)
                child = os.fork()
                if child == 0:
                    signal.set_wakeup_fd(-1)
                    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                    os.setsid()
                    _end_with_the_server()
                    _run(number, case, subject, timeout, results)
                code = _wait(child, commands, woken)
                os.write(results, f"\n{number} e {code}\n".encode())
            case None:
                return


def _end_with_the_server() -> None:
    """The FMU may end the process that watches it. Linux alone can be told."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _wait(child: int, commands: int, woken: int) -> int:
    """The child's exit code; it is killed on demand, and when nobody is there any more to ask for it."""
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            _kill(child)  # what it left behind
            return os.waitstatus_to_exitcode(status)
        ready, _, _ = select.select([commands, woken], [], [])
        if woken in ready:
            os.read(woken, 4096)
        elif _receive(commands) is None:
            _kill(child)
            os._exit(0)
        else:
            _kill(child)


def _kill(child: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):  # it is gone, or has not come to its setsid
        os.killpg(child, signal.SIGKILL)


def _receive(commands: int) -> Any:
    """The next message; None when the other end is gone."""
    header = _read(commands, 8)
    content = _read(commands, struct.unpack("=Q", header)[0]) if len(header) == 8 else b""
    return pickle.loads(content) if content else None


def _read(source: int, size: int) -> bytes:
    content = bytearray()
    while len(content) < size:
        more = os.read(source, min(size - len(content), 1 << 20))
        if not more:
            break
        content += more
    return bytes(content)


def _run(number: int, case: Case, subject: Subject | None, timeout: float, results: int) -> NoReturn:
    """The child: runs the case, and ends at once, for what the library does at the end of a process is no probe's subject."""

    def tell(kind: str, content: str = "") -> None:
        os.write(results, f"{number} {kind} {content}\n".encode())

    try:
        _probe(case, subject, timeout, tell)
        tell("v", "complete")
    except Broken as broken:
        tell("f", _record(broken.finding))
        tell("v", "broken")
    except Exception as error:  # a fault of the probe itself, or of the machine
        place = traceback.extract_tb(error.__traceback__)[-1]
        tell("b", json.dumps(f"{type(error).__name__}: {error} ({Path(place.filename).name}, line {place.lineno})"))
    finally:  # the pipe may be gone
        os._exit(0)


def _probe(case: Case, subject: Subject | None, timeout: float, tell: Any) -> None:
    if case.drives:
        assert subject is not None
        os.chdir(subject.scratch)  # what the FMU writes into its working directory goes there
        printed = Capture() if case.captures else None
        try:
            fmu = Fmu(subject, lambda call: tell("c", call), printed, timeout)
        except OSError as error:
            expected = "a library that loads"
            raise Broken(finding("load", os.path.basename(subject.library), expected, str(error))) from None
        probe = case.probe(fmu, *case.arguments)
    else:
        probe = case.probe(*case.arguments)
    value = None
    while True:
        try:
            tell("f", _record(next(probe)))
        except StopIteration as end:
            value = end.value
            break
    if case.keep is not None:
        case.keep.write_text(json.dumps(value))


def _record(found: Any) -> str:
    return json.dumps([found.rule, found.section, found.subject, found.expected, found.found])
