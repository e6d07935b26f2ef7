"""A zip file whose bytes depend on its contents only."""

from __future__ import annotations

import errno
import os
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

_EPOCH = (1980, 1, 1, 0, 0, 0)
_UNIX = 3


def check_writable(folder: Path) -> None:
    """See that a file could be written into `folder`, or the folder be made; what is tried is gone afterwards.

    Raises:
        OSError: it could not.
    """
    there = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
    if not there.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(there))
    with tempfile.TemporaryFile(dir=there):  # the rights alone do not tell: of root, of what is mounted to be read only
        pass


def write_zip(path: Path, contents: Mapping[str, bytes]) -> None:
    """Write `contents` (by path in the archive, sorted here) to `path`: first under another name, never half a file.

    Entries are stored, not compressed: what zlib makes of the same bytes differs between its versions and forks.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
            for name in sorted(contents):
                entry = zipfile.ZipInfo(name, _EPOCH)
                entry.create_system = _UNIX
                entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
                archive.writestr(entry, contents[name])
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
