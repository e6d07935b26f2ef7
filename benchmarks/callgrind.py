"""Counts instructions with `valgrind --tool=callgrind`: unlike times, they are the same on every run."""

from __future__ import annotations

import re
import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.compiler import compile_c
from benchmarks.native import Experiment, Unpacked, command, execute

_TOTAL = re.compile(r"^\s*([\d,]+) .*PROGRAM TOTALS", re.MULTILINE)
_COST = re.compile(r"^\s*([\d,]+) \([^)]*\)\s+(?:.*/)?[^:]*:(\S+)", re.MULTILINE)
_CASADI_NAME = re.compile(r"^/\* (\w+):\(.*\*/\n(?:static )?int (casadi_f\d+)\(", re.MULTILINE)


@dataclass(frozen=True)
class Counts:
    """Instructions: in all, and in each function itself (without those that it calls)."""

    total: int
    functions: dict[str, int]


def is_installed() -> bool:
    return shutil.which("valgrind") is not None and shutil.which("callgrind_annotate") is not None


def per_sample(driver: Path, fmu: Unpacked, experiment: Experiment) -> float:
    """Instructions per sample: one run of the FMU's own binary minus one without samples, over the number of samples."""
    none = replace(experiment, samples=np.empty(0))
    whole, idle = (_count(driver, fmu, fmu.library, e).total for e in (experiment, none))
    return (whole - idle) / len(experiment.samples)


def functions_per_sample(driver: Path, fmu: Unpacked, experiment: Experiment) -> dict[str, float]:
    """Instructions per sample of each function itself, most first. The FMU's sources are compiled anew, with their symbols."""
    with tempfile.TemporaryDirectory() as scratch:
        library = Path(scratch) / fmu.library.name
        compile_c(sorted((fmu.directory / "sources").glob("*.c")), library, "-shared", "-lm")
        counts = _count(driver, fmu, library, experiment).functions
        idle = _count(driver, fmu, library, replace(experiment, samples=np.empty(0))).functions
    names = {code: name for name, code in _CASADI_NAME.findall((fmu.directory / "sources" / "functions.c").read_text())}
    each = {names.get(name, name): (count - idle.get(name, 0)) / len(experiment.samples) for name, count in counts.items()}
    return dict(sorted(each.items(), key=lambda item: -item[1]))


def _count(driver: Path, fmu: Unpacked, library: Path, experiment: Experiment) -> Counts:
    with tempfile.TemporaryDirectory() as scratch:
        directory = Path(scratch)
        out = directory / "callgrind.out"
        execute(["valgrind", "--quiet", "--tool=callgrind", f"--callgrind-out-file={out}", *command(driver, fmu, library, experiment, 1, directory)])
        text = execute(["callgrind_annotate", "--threshold=100", str(out)])
    total = _TOTAL.search(text)
    assert total is not None, text
    functions: dict[str, int] = {}
    for count, name in _COST.findall(text):  # a function that several source files have lines of comes in several entries
        functions[name] = functions.get(name, 0) + _number(count)
    return Counts(_number(total[1]), functions)


def _number(text: str) -> int:
    return int(text.replace(",", ""))
