"""Who answers Ctrl-C."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Processes that are started herein hear no Ctrl-C, which a terminal sends to all: this one answers, after the block."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # multiprocessing's, whose start unblocks them
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def interrupts_noticed() -> Iterator[Callable[[], None]]:
    """A block in which libraries may swallow Ctrl-C: an error that follows it becomes KeyboardInterrupt, which what is yielded raises too.

    CasADi's wrappers do: an interrupt while they look for the fitting overload makes them take another one.
    """
    noticed: list[int] = []

    def note(number: int, frame: object) -> None:
        noticed.append(number)
        raise KeyboardInterrupt

    def check() -> None:
        if noticed:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # which alone hears signals
        yield check
        return
    before = signal.signal(signal.SIGINT, note)
    try:
        yield check
    except Exception:
        check()
        raise
    finally:
        signal.signal(signal.SIGINT, before)
