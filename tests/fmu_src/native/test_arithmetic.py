"""A host that traps, rounds otherwise or flushes to zero gets the numbers of any other, and its environment back."""

from __future__ import annotations

import ctypes
import math
import multiprocessing
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from host import HOSTS, driver, pointer
from slave import Slave

STEP = 1 / 16  # a power of two: the host's own sums of it are exact in every rounding
STEPS = 200
# By component: the input that gets noise, a sample that is missing and one that is far off; start values.
RUNS: dict[str, tuple[str | None, dict[str, float]]] = {
    "duffing": ("u", {"sensor.sample_time": STEP, "sensor.noise_std": 0.01, "sensor.noise_bound": 0.02}),
    "duffing_segments": ("y", {}),
    "duffing_missing_ukf": ("y", {"sample_time": STEP}),
    "linear_1_riccati": ("y", {}),
    "linear_3_least_squares": ("y", {}),
    "draining_toy": (None, {}),
}


def signal(name: str) -> list[float]:
    values = [math.sin(0.3 * k) + 0.1 * math.sin(17.0 * k) for k in range(STEPS)]
    if name != "duffing":  # a plant has no use for an input that is not there
        values[50] = math.nan
        values[120] = 1e4
    return values


def visit(folder: Path, name: str, host: str) -> tuple[int, bytes]:
    """Calls that left the host's environment changed or were refused, and all Real outputs of all steps."""
    measured, start = RUNS[name]
    fmu = Slave(folder)
    known = {key: value for key, value in start.items() if key in fmu.variables}
    fmu.initialize(known)
    reals = [v.valueReference for v in fmu.variables.values() if v.initial == "calculated" and v.type == "Real"]
    inputs = [v.name for v in fmu.variables.values() if v.causality == "input" and v.type == "Real"]
    used = measured if measured in inputs else inputs[0] if measured else None
    values = (ctypes.c_double * (STEPS * len(reals)))()
    bad = driver().visit(
        pointer(fmu, "fmi2DoStep"),
        pointer(fmu, "fmi2SetReal"),
        pointer(fmu, "fmi2GetReal"),
        ctypes.c_void_p(fmu.fmu.component),
        HOSTS.index(host),
        ctypes.c_double(STEP),
        ctypes.c_long(STEPS if name != "draining_toy" else 20),
        fmu.variables[used].valueReference if used else 0,
        ctypes.c_size_t(used is not None),
        (ctypes.c_double * STEPS)(*signal(name)),
        (ctypes.c_uint * len(reals))(*reals),
        ctypes.c_size_t(len(reals)),
        values,
    )
    fmu.fmu.freeInstance()
    return bad, bytes(values)


def in_child(folder: Path, name: str, host: str) -> tuple[int, bytes]:
    """As visit, in a process of its own, forked from this one: a trap would end it."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as pool:
        return pool.submit(visit, folder, name, host).result()


@pytest.mark.skipif(sys.platform != "linux", reason="the driver is one for x86-64 Linux")
@pytest.mark.parametrize("name", RUNS)
def test_every_host_gets_the_same_bits_and_its_environment_back(unpacked: Callable[[str], Path], name: str) -> None:
    folder = unpacked(name)
    bad, plain = visit(folder, name, "plain")
    assert bad == 0
    assert len(set(plain[k : k + 8] for k in range(0, len(plain), 8))) > 30
    for host in HOSTS[1:]:
        assert in_child(folder, name, host) == (0, plain), host
