"""Runs in a process of their own, master and FMUs together: whatever an FMU does to that process is one error of this one.

The parent looks now and then at a few numbers that the run leaves in a file; no step costs more for it.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import tempfile
import threading
import time as clock
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from cosim.errors import ExperimentError, SystemFileError
from cosim.fmu import Value
from cosim.master.child import RECORD, Again, Begun, Ended, Keep, Request, mapped, receive, send
from cosim.master.run import NOTHING, Inputs
from cosim.master.slave import CALLS, GET, RunError
from cosim.python import command, end, environment
from cosim.results import Message, Messages, Result
from cosim.system import System

LIMIT = 60.0  # [s] that a call of an FMU may take
LOOK = 0.1  # [s] between two looks at what the run is doing
WORDS = 4096  # characters of what the FMUs print that are kept


def run(
    system: System | Path | str,
    *,
    stop: float | None = None,
    step: float | None = None,
    overrides: Mapping[str, Value] | None = None,
    inputs: Inputs | None = None,
    progress: Callable[[int, int], None] | None = None,
    limit: float = LIMIT,
) -> Result:
    """As `cosim.master.run`, in a process of its own, which works in a scratch folder.

    Args:
        limit: how long a call of an FMU may take [s].

    Raises:
        SystemFileError, ExperimentError: as there.
        RunError: an FMU failed, ended the process, or a call did not return within `limit`; `partial` has the rows up to there.
    """
    with Child() as child:
        return child.run(
            system, stop=stop, step=step, overrides=overrides, inputs=inputs, progress=progress, limit=limit
        )


class Child:
    """A process for runs, one after the other; started when it is needed, and again after it went down."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._answers: queue.Queue[Any] = queue.Queue()
        self._said = bytearray()

    def __enter__(self) -> Child:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()

    def run(
        self,
        system: System | Path | str,
        *,
        stop: float | None = None,
        step: float | None = None,
        overrides: Mapping[str, Value] | None = None,
        inputs: Inputs | None = None,
        progress: Callable[[int, int], None] | None = None,
        limit: float = LIMIT,
    ) -> Result:
        """As the function `run`."""
        # Where Windows still holds files of a process that was killed, what is left there is left.
        with tempfile.TemporaryDirectory(prefix="cosim-", ignore_cleanup_errors=True) as directory:
            folder = Path(directory).resolve()
            whole = absolute(system)
            given = inputs.resolve() if isinstance(inputs, Path) else inputs
            self._said.clear()
            try:
                self.send(Request(whole, folder, stop, step, dict(overrides or {}), given))
                return self.watch(folder, progress, limit)[0]
            except BaseException as error:
                if not isinstance(error, (SystemFileError, ExperimentError, RunError)):
                    self.kill()  # Ctrl-C: nothing goes on behind our back
                if isinstance(error, (SystemFileError, ExperimentError)) and isinstance(whole, Path):
                    # Files in it are the caller's by its name, and it is called as the caller does.
                    text = str(error).replace(f"{folder}/", f"{whole}: ").replace(str(whole), str(system))
                    raise type(error)(text) from None
                raise

    @property
    def alive(self) -> bool:
        """Is there a process, with all that it keeps?"""
        return self._process is not None and self._process.poll() is None

    def send(self, request: Request | Keep | Again) -> None:
        """Ask the process for something, of which `watch` tells what came of it."""
        if not self.alive:
            self._start()
        assert self._process is not None and self._process.stdin is not None
        try:
            send(self._process.stdin, request)  # type: ignore[arg-type]
        except OSError:  # what an earlier FMU left behind has just ended it
            self.kill()
            self._start()
            send(self._process.stdin, request)  # type: ignore[arg-type]

    def _start(self) -> None:
        self._process = subprocess.Popen(
            command("cosim.master"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment(),
            start_new_session=True,  # so that what FMUs start ends with it
        )
        answers: queue.Queue[Any] = queue.Queue()
        self._answers, self._said = answers, bytearray()
        said, process = self._said, self._process

        def listen() -> None:
            while (answer := receive(process.stdout)) is not None:  # type: ignore[arg-type]
                answers.put(answer)
            answers.put(None)

        def hear() -> None:
            while heard := os.read(process.stderr.fileno(), 65536):  # type: ignore[union-attr]
                said.extend(heard)
                del said[:-WORDS]

        for task in (listen, hear):
            threading.Thread(target=task, daemon=True).start()

    def watch(
        self, folder: Path, progress: Callable[[int, int], None] | None, limit: float, begun: Begun | None = None
    ) -> tuple[Result, Begun]:
        """What came of the request that was sent last, and how it began (`begun` where that was before). Errors as of `run`."""
        messages = Messages()
        seen, since = (0, NOTHING), clock.monotonic()
        while True:
            try:
                answer = self._answers.get(timeout=LOOK)
            except queue.Empty:
                answer = ()
            now = _at(folder, begun) or seen
            if now != seen or now[1] == NOTHING:
                seen, since = now, clock.monotonic()
                if progress is not None and begun is not None and now[1] > 0:
                    progress(now[1], begun.outline.steps)
            match answer:
                case ():
                    pass
                case Message():
                    messages.append(answer)
                case Begun():
                    begun = answer
                case Ended(kind=""):
                    assert begun is not None
                    return self._result(begun, folder, seen[1], messages), begun
                case Ended(kind="RunError"):
                    raise self._failure(answer.element, answer.time, answer.text, begun, folder, seen[1], messages)
                case Ended(kind="SystemFileError"):
                    raise SystemFileError(answer.text)
                case Ended(kind="ExperimentError"):
                    raise ExperimentError(answer.text)
                case Ended():
                    raise RuntimeError(answer.text)
                case _:
                    how = self._how()
                    raise self._down(how, begun, folder, _at(folder, begun), messages)
            if clock.monotonic() - since > limit:
                self.kill()
                raise self._down(f"has not returned for {limit:g} s", begun, folder, seen, messages)

    def _down(
        self, how: str, begun: Begun | None, folder: Path, at: tuple[int, int] | None, messages: Messages
    ) -> RunError:
        """The error of a run whose process is no more."""
        words = [line.strip() for line in self._said.decode("utf-8", "replace").splitlines() if line.strip()]
        last = f": {words[-1]}" if words else ""
        if begun is None or at is None:
            return RunError("", 0.0, f"the process of the run {how}{' before it began' if begun is None else ''}{last}")
        place, row = at
        outline = begun.outline
        row = min(max(row + (place % len(CALLS) == GET and row >= 0), 0), outline.steps)
        element, time = list(outline.sources)[place // len(CALLS)], outline.start + row * outline.step
        return self._failure(element, time, f"{CALLS[place % len(CALLS)]} {how}{last}", begun, folder, at[1], messages)

    def _failure(
        self,
        element: str,
        time: float,
        text: str,
        begun: Begun | None,
        folder: Path,
        row: int,
        messages: Messages,
    ) -> RunError:
        """The error with what there is of the record."""
        error = RunError(element, time, text)
        if begun is not None:
            with contextlib.suppress(RunError):  # this error is the one to tell of
                error.partial = self._result(begun, folder, row, messages)
        return error

    def _result(self, begun: Begun, folder: Path, row: int, messages: Messages) -> Result:
        try:
            arrays = {name: mapped(folder, name, shape, dtype, "r") for name, (shape, dtype) in begun.shapes.items()}
        except (OSError, ValueError):  # it is gone, or shorter than it was
            raise RunError("", 0.0, "the record of the run is damaged, which an FMU must have done") from None
        printed = self._said.count(b"\n")
        outline = begun.outline
        if printed:
            first = self._said.decode("utf-8", "replace").splitlines()[0].strip()
            outline = replace(outline, notes=[*outline.notes, f"the FMUs printed {printed} lines or more: {first}"])
        return outline.result(arrays, max(row + 1, 0), messages)

    def _how(self) -> str:
        """How the process ended, which it did or is about to."""
        assert self._process is not None
        try:
            code = self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:  # an FMU closed or filled the pipe
            self.kill()
            return "broke the connection to the process that it runs in"
        self.kill()
        if code < 0:
            return f"ended the process by {signal.Signals(-code).name}"
        return f"ended the process with exit({code})"

    def kill(self) -> None:
        """End the process, and what it started."""
        process, self._process = self._process, None
        if process is None:
            return
        end(process)
        with contextlib.suppress(OSError):  # what was not yet sent
            process.stdin.close()  # type: ignore[union-attr]


def _at(folder: Path, begun: Begun | None) -> tuple[int, int] | None:
    """The call and the row that the run is at; None where what it left says nothing. Read, not mapped: the file may be cut."""
    try:
        place, row = np.fromfile(folder / RECORD / "here", np.int64).tolist()
    except (OSError, ValueError):
        return None
    if begun is None or not (0 <= place < len(begun.outline.sources) * len(CALLS) and row <= begun.outline.steps):
        return None
    return place, row


def absolute(system: System | Path | str) -> System | Path:
    if not isinstance(system, System):
        return Path(system).resolve()
    elements = {name: replace(element, fmu=element.fmu.resolve()) for name, element in system.elements.items()}
    return replace(system, elements=elements)
