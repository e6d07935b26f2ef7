"""A user's Python file, run: what it defines, or one sentence with the line and, where it is known, the cure."""

from __future__ import annotations

import difflib
import inspect
import re
import runpy
import sys
import traceback
from pathlib import Path
from typing import Any

from observers.expressions import of_a_table

_UNEXPECTED = re.compile(r"(\w+)(?:\.__init__)?\(\) got an unexpected keyword argument '(\w+)'")


def namespace_of(path: Path) -> dict[str, Any]:
    """What a Python file defines at module level, by name. Modules beside the file can be imported in it, as when Python runs it.

    Raises:
        ValueError: the file is missing, or fails.
    """
    if not path.is_file():
        raise ValueError(f"{path}: {'is a folder' if path.is_dir() else 'there is no such file'}")
    beside = str(path.resolve().parent)
    sys.path.insert(0, beside)
    try:
        return runpy.run_path(str(path))
    except (Exception, SystemExit) as error:  # a user's file can fail in any way; one line names it
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        where = f"{path}, line {lines[-1]}" if lines else str(path)
        raise ValueError(f"{where}: {of_a_table(error) or _told(error, str(path))}") from error
    finally:
        sys.path.remove(beside)


def _told(error: BaseException, path: str) -> str:
    """The error, and of an unknown argument what it may have been meant to be."""
    told = f"{type(error).__name__}: {error}"
    unknown = _UNEXPECTED.search(str(error))
    if unknown is None:
        return told
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__) if frame.f_code.co_filename == path]
    called = frames[-1].f_globals.get(unknown[1]) if frames else None
    if not callable(called):
        return told
    known = [name for name in inspect.signature(called).parameters]
    near = difflib.get_close_matches(unknown[2], known, n=2, cutoff=0.5)
    return f"{told}; " + (f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(known)}")
