"""What a process prints while an FMU is loaded in it, taken from it however much it is."""

from __future__ import annotations

import ctypes
import os
import threading

_KEPT = 2000  # bytes: enough to show


class Capture:
    """stdout and stderr of this process from here on: the first bytes, and how many there were."""

    def __init__(self) -> None:
        self.size = 0
        self._begin = b""
        self._source, sink = os.pipe()
        for stream in (1, 2):
            os.dup2(sink, stream)
        os.close(sink)
        self._thread = threading.Thread(target=self._drain, daemon=True)
        self._thread.start()

    def _drain(self) -> None:
        while content := os.read(self._source, 1 << 16):
            self._begin += content[: _KEPT - len(self._begin)]
            self.size += len(content)

    def end(self) -> str:
        """What was printed: its beginning. Then nothing is captured any more."""
        library = ctypes.cdll.msvcrt if os.name == "nt" else ctypes.CDLL(None)
        library.fflush(None)  # the C library writes to a pipe when its buffer is full, not by the line
        nothing = os.open(os.devnull, os.O_WRONLY)
        for stream in (1, 2):
            os.dup2(nothing, stream)
        self._thread.join(timeout=5.0)  # a process that the FMU started may still hold the other end
        return self._begin.decode("utf-8", "replace").strip()
