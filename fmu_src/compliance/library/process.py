"""Cases run in child processes: a crash or a hang of the FMU is an outcome, not the end of the check.

One process serves all FMUs (`server.py`): it forks a child for each case, and tells how that ended. Child and server write
lines to one pipe: the case's number, a letter, and what belongs to it.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import queue
import signal
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fmu_src.compliance.finding import CannotCheck, Finding
from fmu_src.compliance.library.calls import Subject
from fmu_src.compliance.rules import finding

TIMEOUT = 30.0  # [s] for a single call: one that takes longer hangs
FORKS = hasattr(os, "fork")  # else a server is for one case
_START = 120.0  # [s] for the server, on a machine however busy
_END = 5.0  # [s] for the server to end its child and itself
_LONGEST_LINE = 1 << 16
_GARBAGE = "the FMU wrote into the pipe of the process that drives it"

Probe = Callable[..., Iterator[Finding]]


@dataclass(frozen=True)
class Case:
    """One probe of one rule: `probe(fmu, *arguments)` yields findings, and may return a value for the next case.

    `drives`: the probe wants the FMU loaded; without, it is `probe(*arguments)`. `captures`: it wants to know what the process
    prints. `keep`: the file that takes the value, as JSON.
    """

    rule: str
    subject: str
    probe: Probe
    arguments: tuple[Any, ...] = ()
    expected: str = "an answer"
    drives: bool = True
    captures: bool = False
    keep: Path | None = None


@dataclass
class Outcome:
    """`complete`: the probe came to its end, and what it returned is kept; else there is a finding."""

    findings: list[Finding] = field(default_factory=list)
    complete: bool = False
    hung: bool = False


class Server:
    """The process that forks the cases' children; `subject` is the FMU that they drive.

    Raises:
        CannotCheck: the process does not start.
    """

    def __init__(self) -> None:
        self._number = 0
        self._subject: Subject | None = None
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        path = f"import sys; sys.path[:] = {sys.path!r}"
        code = f"{path}; from fmu_src.compliance.library.server import serve; serve(forks={FORKS})"
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", code],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # an interrupt at the terminal is the parent's affair
            )
        except OSError as error:
            raise CannotCheck(f"no process for the probes: {error.strerror or error}") from None
        threading.Thread(target=self._read, daemon=True).start()

    def wait(self) -> None:
        """Until it has started."""
        try:
            if self._number == 0:
                self._next(_START)
        except queue.Empty:
            raise CannotCheck(f"the process that runs the probes did not start within {_START:g} s") from None

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def end(self) -> None:
        """The server, and by it the child that it watches."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):  # what it was to read may be in the pipe still
            self._process.stdin.close()
        try:
            self._process.wait(_END)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _read(self) -> None:
        pipe = self._process.stdout
        assert pipe is not None
        while line := pipe.readline(_LONGEST_LINE):
            self._lines.put(line)
        self._lines.put(b"")

    def _send(self, *message: Any) -> None:
        content = pickle.dumps(message)
        pipe = self._process.stdin
        assert pipe is not None
        try:
            pipe.write(struct.pack("=Q", len(content)) + content)
            pipe.flush()
        except OSError:
            raise CannotCheck("the process that runs the probes is gone") from None

    def run(self, case: Case, subject: Subject | None) -> Outcome:
        """Run the case in a process of its own."""
        self.wait()
        self._number += 1
        if subject is not self._subject:
            self._send("subject", subject)
            self._subject = subject
        self._send("case", self._number, case, TIMEOUT)
        outcome, call, ended = Outcome(), "its start", False
        while True:
            try:
                kind, content = self._next(TIMEOUT)
            except queue.Empty:
                if outcome.hung:
                    raise CannotCheck(f"a process that hung in {call} could not be ended") from None
                outcome.hung = True
                outcome.findings.append(_ended(case, f"no answer from {call} within {TIMEOUT:g} s"))
                if FORKS:
                    self._send("kill")
                else:
                    self._process.kill()
                continue
            try:
                match kind:
                    case "c":
                        call = content
                    case "f":
                        outcome.findings.append(Finding(*json.loads(content)))
                    case "v":
                        ended, outcome.complete = True, content == "complete"
                    case "b":
                        raise CannotCheck(f"the probe of {case.rule} failed: {json.loads(content)}")
                    case "e":
                        if not ended and not outcome.hung:
                            outcome.findings.append(_ended(case, f"{_cause(int(content))} in {call}"))
                        return outcome
            except (ValueError, TypeError):
                raise CannotCheck(_GARBAGE) from None

    def _next(self, timeout: float) -> tuple[str, str]:
        """Kind and content of the next message of the present case.

        Raises:
            queue.Empty: none came in time.
            CannotCheck: what came is no message, or the process is gone.
        """
        while True:
            line = self._lines.get(timeout=timeout)
            if not line:
                if not FORKS:
                    return "e", str(self._process.wait())
                raise CannotCheck("the process that runs the probes was ended by the FMU")
            if line == b"\n":
                continue
            try:
                number, kind, content = line.decode().rstrip("\n").split(" ", 2)
                if int(number) == self._number:
                    return kind, content
            except ValueError:
                raise CannotCheck(_GARBAGE) from None


_server: Server | None = None


def prepare() -> Server:
    """Start the server, if there is none: it takes a moment, in which the caller may do something else."""
    global _server
    if _server is None or not _server.is_alive:
        _server = Server()
    return _server


def run(case: Case, subject: Subject | None = None) -> Outcome:
    """Run the case in a process of its own, which drives `subject` where the case drives one.

    Raises:
        CannotCheck: the processes themselves failed; the next call begins with new ones.
    """
    global _server
    server = prepare()
    try:
        return server.run(case, subject)
    except BaseException:
        server.end()
        _server = None
        raise


def _ended(case: Case, how: str) -> Finding:
    return finding(case.rule, case.subject, case.expected, how)


def _cause(code: int) -> str:
    if code < 0:
        known = {member.value: member.name for member in signal.Signals}
        return f"a crash ({known.get(-code, f'signal {-code}')})"
    return f"the end of the process (exit code {code})"
