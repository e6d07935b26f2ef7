"""Where the command begins: nothing that takes a moment has been imported yet, and Ctrl-C ends it without a word until a verb is loaded.

While modules are being imported KeyboardInterrupt is a traceback at the best; libraries, and callbacks of the import system, swallow it.
"""

import os
import signal
import sys
from types import FrameType


def main() -> None:
    """The console script `observer-fmus`."""
    if (
        signal.getsignal(signal.SIGINT) is signal.default_int_handler
    ):  # not where whoever started it says that it is ignored
        signal.signal(signal.SIGINT, _end)
    from commands.app import main as begin

    begin()


def verb_loaded() -> None:
    """From here on Ctrl-C is KeyboardInterrupt again, which verbs answer."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(number: int, frame: FrameType | None) -> None:
    sys.stdout.flush()
    os._exit(130)
