"""Ctrl-C while the command is being loaded: it ends without a word.

While modules are being imported KeyboardInterrupt is a traceback at the best; libraries, and callbacks of the import system, swallow it.
"""

import os
import signal
import sys
from types import FrameType


def begins() -> None:
    """From here on Ctrl-C ends the process, unless whoever started it says that it is ignored."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)


def is_done() -> None:
    """From here on Ctrl-C is KeyboardInterrupt again, which verbs answer."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(number: int, frame: FrameType | None) -> None:
    sys.stdout.flush()
    os._exit(130)
