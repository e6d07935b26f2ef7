"""The C driver of these tests, compiled, and what ctypes needs to call it."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

from fmu_src.native.compiler import compile_library
from slave import Slave

WAYS = (
    "added",
    "multiplied",
    "nanoseconds",
    "microseconds",
    "differences",
    "differences of nanoseconds",
    "9e-7 too fast",
    "9e-7 too slow",
)
HOSTS = ("plain", "traps", "upward", "downward", "toward zero", "flush to zero", "x87 of 53 bits")


@cache
def driver() -> ctypes.CDLL:
    folder = Path(mkdtemp())
    (folder / "driver.c").write_bytes((Path(__file__).parent / "driver.c").read_bytes())
    library = folder / "driver.so"
    library.write_bytes(compile_library("driver", folder, "linux64"))
    loaded = ctypes.CDLL(str(library))
    loaded.drive.restype = loaded.visit.restype = ctypes.c_long
    return loaded


def pointer(fmu: Slave, function: str) -> ctypes.c_void_p:
    return ctypes.cast(getattr(fmu.fmu.dll, function), ctypes.c_void_p)


def drive(fmu: Slave, variable: str, t0: float, h: float, first: int, last: int, way: str, total: float) -> float:
    """Steps number `first` to `last` in this way; returns the time of an importer that adds up, which was `total`."""
    sum_ = ctypes.c_double(total)
    failed = driver().drive(
        pointer(fmu, "fmi2DoStep"),
        pointer(fmu, "fmi2SetReal"),
        ctypes.c_void_p(fmu.fmu.component),
        fmu.variables[variable].valueReference,
        ctypes.c_double(t0),
        ctypes.c_double(h),
        ctypes.c_long(first),
        ctypes.c_long(last),
        WAYS.index(way),
        ctypes.byref(sum_),
    )
    assert failed == 0, fmu.messages[:1]
    return sum_.value
