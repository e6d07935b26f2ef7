"""The platforms an FMU can hold a binary for."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from dataclasses import dataclass

from fmu_src.errors import ExportError


@dataclass(frozen=True)
class Platform:
    """`target`: zig's name for it; `suffix`: of its shared libraries."""

    target: str
    suffix: str


# By the folder in `binaries/`. glibc 2.17 is what RHEL 7 has, hence everything newer as well; macOS 11 is the first on
# Apple silicon, 10.13 is of 2017. Without a version zig takes the newest it knows, and older systems refuse the library.
PLATFORMS = {
    "linux64": Platform("x86_64-linux-gnu.2.17", ".so"),
    "win64": Platform("x86_64-windows-gnu", ".dll"),
    "darwin64": Platform("x86_64-macos.10.13", ".dylib"),
    "aarch64-linux": Platform("aarch64-linux-gnu.2.17", ".so"),
    "aarch64-darwin": Platform("aarch64-macos.11.0", ".dylib"),
}

_HOSTS = {
    ("Linux", "x86_64"): "linux64",
    ("Windows", "AMD64"): "win64",
    ("Darwin", "x86_64"): "darwin64",
    ("Linux", "aarch64"): "aarch64-linux",
    ("Darwin", "arm64"): "aarch64-darwin",
}


def resolve(names: Iterable[str]) -> list[str]:
    """Platform folders in the order of PLATFORMS, without duplicates, for `names` that may contain "host" and "all".

    Raises:
        ExportError: an unknown name, no name at all, or "host" on a machine that is none of the platforms.
    """
    wanted: set[str] = set()
    for name in names:
        if name == "all":
            wanted.update(PLATFORMS)
        elif name == "host":
            machine = (platform.system(), platform.machine())
            if machine not in _HOSTS:
                raise ExportError(
                    f"this machine ({' '.join(machine)}) is none of the platforms; name one of {', '.join(PLATFORMS)}"
                )
            wanted.add(_HOSTS[machine])
        elif name in PLATFORMS:
            wanted.add(name)
        else:
            raise ExportError(f"platform '{name}' is unknown; known: host, all, {', '.join(PLATFORMS)}")
    if not wanted:
        raise ExportError(f"no platform given; known: host, all, {', '.join(PLATFORMS)}")
    return [name for name in PLATFORMS if name in wanted]
