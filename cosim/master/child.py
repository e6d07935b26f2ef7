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
from cosim.master.run import Inputs, perform, prepare
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


def _serve(request: Request, answer: Callable[[object], None]) -> Ended:
    shapes: dict[str, tuple[tuple[int, ...], Any]] = {}
    scratch = request.folder / "scratch"
    for folder in (scratch, request.folder / RECORD):
        folder.mkdir()
    os.chdir(scratch)

    def allocate(name: str, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
        shapes[name] = (shape, dtype)
        size = int(np.prod(shape)) * np.dtype(dtype).itemsize
        if size and hasattr(os, "posix_fallocate"):  # a full disk must be an error now, not a signal in the middle
            with (request.folder / RECORD / name).open("wb") as file:
                try:
                    os.posix_fallocate(file.fileno(), 0, size)
                except OSError as error:
                    raise MemoryError from error
            return mapped(request.folder, name, shape, dtype, "r+")
        return mapped(request.folder, name, shape, dtype, "w+")

    try:
        made = prepare(
            request.system,
            request.folder,
            stop=request.stop,
            step=request.step,
            overrides=request.overrides,
            inputs=request.inputs,
            allocate=allocate,
        )
        made.record.messages = _Told(answer)
        answer(Begun(made.record.outline, shapes))
        perform(made, request.folder)
    except RunError as error:
        return Ended("RunError", error.text, error.element, error.time)
    except (SystemFileError, ExperimentError) as error:
        return Ended(type(error).__name__, str(error))
    except Exception:
        return Ended("Exception", traceback.format_exc())
    return Ended()


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
    waiting: queue.Queue[Request] = queue.Queue()

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
        ended = _serve(waiting.get(), answer)
        sys.stdout.flush()
        answer(ended)
