"""Counts instructions with `valgrind --tool=callgrind`: unlike times, they are the same on every run."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.compiler import compile_c
from benchmarks.errors import BenchmarkError
from benchmarks.native import Experiment, Unpacked, command, execute

# Lines of callgrind_annotate: "12,345 (100.0%)  PROGRAM TOTALS" and "12,345 (10.00%)  file:function [object]".
_TOTAL = re.compile(r"^ *([\d,]+) .*PROGRAM TOTALS", re.MULTILINE)
_COST = re.compile(r"^ *([\d,]+) \([ \d.]+%\) +[^\n ]*:(\w+)", re.MULTILINE)
# CasADi's C names a function in the comment above it and numbers it in the code.
_CASADI_NAME = re.compile(r"^/\* (\w+):\(.*\*/\nstatic int casadi_(f\d+)\(", re.MULTILINE)


@dataclass(frozen=True)
class Counts:
    """Instructions: in all, and in each function itself (without those that it calls)."""

    total: int
    functions: dict[str, int]


def is_installed() -> bool:
    return shutil.which("valgrind") is not None and shutil.which("callgrind_annotate") is not None


def per_sample(driver: Path, fmu: Unpacked, experiment: Experiment) -> float:
    """Instructions per sample: a run of the FMU's own binary minus one without samples, over the number of samples."""
    whole, idle = (_count(driver, fmu, fmu.library, e).total for e in (experiment, _idle(experiment)))
    return (whole - idle) / len(experiment.samples)


def functions_per_sample(driver: Path, fmu: Unpacked, experiment: Experiment) -> dict[str, float]:
    """Instructions per sample of each function itself, most first.

    The FMU's sources are compiled anew, with their symbols; CasADi's functions appear under their names in Python.
    """
    with tempfile.TemporaryDirectory() as scratch:
        library = Path(scratch) / fmu.library.name
        compile_c(sorted((fmu.directory / "sources").glob("*.c")), library, "-shared", "-lm")
        whole, idle = (_count(driver, fmu, library, e).functions for e in (experiment, _idle(experiment)))
    code = (fmu.directory / "sources" / "functions.c").read_text()
    names = {f"functions_{number}": name for name, number in _CASADI_NAME.findall(code)}
    each: defaultdict[str, float] = defaultdict(float)
    for symbol, count in whole.items():
        each[names.get(symbol, symbol)] += (count - idle.get(symbol, 0)) / len(experiment.samples)
    return dict(sorted(each.items(), key=lambda item: -item[1]))


def _idle(experiment: Experiment) -> Experiment:
    return replace(experiment, samples=np.empty(0))


def instructions(run: Sequence[str]) -> int:
    """Instructions of a command."""
    return _counts(run).total


def _count(driver: Path, fmu: Unpacked, library: Path, experiment: Experiment) -> Counts:
    with tempfile.TemporaryDirectory() as scratch:
        return _counts(command(driver, fmu, library, experiment, 1, Path(scratch)))


def _counts(run: Sequence[str]) -> Counts:
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "callgrind.out"
        execute(["valgrind", "--quiet", "--tool=callgrind", f"--callgrind-out-file={out}", *run])
        text = execute(["callgrind_annotate", "--threshold=100", str(out)])
    total = _TOTAL.search(text)
    if total is None:
        raise BenchmarkError(f"callgrind_annotate printed no total:\n{text[:500]}")
    functions: defaultdict[str, int] = defaultdict(int)
    for count, name in _COST.findall(text):  # one entry for each source file that has lines of the function
        functions[name] += _number(count)
    return Counts(_number(total[1]), functions)


def _number(text: str) -> int:
    return int(text.replace(",", ""))
