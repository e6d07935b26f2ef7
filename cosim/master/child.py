"""The process that a run happens in: python -m cosim.master, started and watched by `cosim.master.watched`.

Requests come on stdin, answers go to what was stdout: each a pickle after its length. What the FMUs print goes to stderr. The
record is in files, which the parent reads whatever becomes of this process.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from cosim.errors import ExperimentError, SystemFileError
from cosim.fmu import Value
from cosim.master.record import Outline
from cosim.master.repetition import Detour, Repetition
from cosim.master.run import Inputs, Prepared, perform, prepare
from cosim.master.slave import RunError
from cosim.results import MOST_MESSAGES, Message, Messages
from cosim.system import System

LENGTH = 8  # bytes that say how long a pickle is
LONGEST = 2**31  # bytes of a pickle: the inputs of a run fill a quarter
RECORD = "record"  # the folder of the record's files, in the folder of a run


@dataclass(frozen=True)
class Request:
    """What to run, as of `cosim.master.run`; all paths are absolute. `folder` is empty and the run's own."""

    system: System | Path
    folder: Path
    stop: float | None
    step: float | None
    overrides: dict[str, Value]
    inputs: Inputs | None


@dataclass(frozen=True)
class Keep:
    """Load what `request` says, and keep it to be run by `Again`, with detours if there is one."""

    request: Request
    detour: Detour | None


@dataclass(frozen=True)
class Again:
    """The first `steps` steps of the kept run with this `number`, counted from 0, with other start values."""

    number: int
    overrides: dict[str, Value]
    steps: int


@dataclass(frozen=True)
class Begun:
    """Everything is checked; from now on FMUs are called. `shapes` and types of the record's files by name."""

    outline: Outline
    shapes: dict[str, tuple[tuple[int, ...], Any]]


@dataclass(frozen=True)
class Ended:
    """How it ended: without an error, or with one of this `kind`, what it says, and of a RunError element and time."""

    kind: str = ""
    text: str = ""
    element: str = ""
    time: float = 0.0


def send(stream: BinaryIO, thing: object) -> None:
    content = pickle.dumps(thing)
    stream.write(len(content).to_bytes(LENGTH, "little") + content)
    stream.flush()


def receive(stream: BinaryIO) -> Any:
    """The next thing; None at the end, or where what comes is no pickle of ours."""
    head = stream.read(LENGTH)
    length = int.from_bytes(head, "little")
    if len(head) < LENGTH or length > LONGEST:
        return None
    try:
        return pickle.loads(stream.read(length))
    except Exception:  # an FMU wrote into our pipe
        return None


def mapped(folder: Path, name: str, shape: tuple[int, ...], dtype: Any, mode: Any) -> np.ndarray:
    """The array in the file `name`; one without entries needs no file."""
    if 0 in shape:
        return np.zeros(shape, dtype)
    return np.memmap(folder / RECORD / name, dtype, mode, shape=shape)


def _serve(request: Request | Keep | Again, answer: Callable[[object], None], kept: list[Repetition]) -> Ended:
    try:
        match request:
            case Request():
                record = _Record(request.folder)
                made = _prepared(request, record, answer)
                answer(Begun(made.record.outline, record.shapes))
                perform(made, request.folder)
            case Keep(request=wanted, detour=detour):
                record = _Record(wanted.folder)
                made = _prepared(wanted, record, answer)
                assert not isinstance(wanted.inputs, Path)
                repeated = Repetition(
                    made, wanted.folder, wanted.inputs or {}, wanted.overrides, detour, record.allocate
                )
                answer(Begun(made.record.outline, record.shapes))
                repeated.load()
                kept.append(repeated)
            case Again():
                kept[request.number].again(request.overrides, request.steps)
    except RunError as error:
        return Ended("RunError", error.text, error.element, error.time)
    except (SystemFileError, ExperimentError) as error:
        return Ended(type(error).__name__, str(error))
    except Exception:
        return Ended("Exception", traceback.format_exc())
    return Ended()


def _prepared(request: Request, record: _Record, answer: Callable[[object], None]) -> Prepared:
    scratch = request.folder / "scratch"
    for folder in (scratch, request.folder / RECORD):
        folder.mkdir()
    os.chdir(scratch)
    made = prepare(
        request.system,
        request.folder,
        stop=request.stop,
        step=request.step,
        overrides=request.overrides,
        inputs=request.inputs,
        allocate=record.allocate,
    )
    made.record.messages = _Told(answer)
    return made


class _Record:
    """The files of a record in the folder of a run; `shapes` and types by name."""

    def __init__(self, folder: Path):
        self._folder = folder
        self.shapes: dict[str, tuple[tuple[int, ...], Any]] = {}

    def allocate(self, name: str, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
        self.shapes[name] = (shape, dtype)
        size = int(np.prod(shape)) * np.dtype(dtype).itemsize
        if size and hasattr(os, "posix_fallocate"):  # a full disk must be an error now, not a signal in the middle
            with (self._folder / RECORD / name).open("wb") as file:
                try:
                    os.posix_fallocate(file.fileno(), 0, size)
                except OSError as error:
                    raise MemoryError from error
            return mapped(self._folder, name, shape, dtype, "r+")
        return mapped(self._folder, name, shape, dtype, "w+")


class _Told(Messages):
    """The FMUs' messages; the parent is told each that it keeps at once."""

    def __init__(self, answer: Callable[[object], None]):
        super().__init__()
        self._answer = answer

    def append(self, message: Message) -> None:
        more = len(self) < MOST_MESSAGES
        super().append(message)
        if more:
            self._answer(self[-1])


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what Ctrl-C means
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    waiting: queue.Queue[Request | Keep | Again] = queue.Queue()
    kept: list[Repetition] = []

    def listen() -> None:
        while (request := receive(requests)) is not None:
            waiting.put(request)
        os._exit(0)  # the parent is gone, whatever an FMU is doing

    threading.Thread(target=listen, daemon=True).start()
    lock = threading.Lock()  # an FMU may log from a thread of its own

    def answer(thing: object) -> None:
        with lock:
            send(answers, thing)

    while True:
        ended = _serve(waiting.get(), answer, kept)
        sys.stdout.flush()
        answer(ended)
