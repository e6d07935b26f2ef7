"""A copy of the project in which faults are tried, each in a process of its own that has what the tests import from others ready."""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from areas import Area
from mutant import Mutant

# Imported once, before the processes fork: they take most of the time in which a short test runs.
HEAVY = ("casadi", "numpy", "scipy.linalg", "scipy.integrate", "scipy.optimize", "scipy.interpolate", "fmpy.fmi2")
HEAVY += (
    "lxml.etree",
    "matplotlib.figure",
    "matplotlib.backends.backend_svg",
    "bokeh.plotting",
    "distributed",
    "typer",
    "flint",
)
MEMORY = 12 * 2**30  # [bytes] of addresses, so that a fault that takes without end ends
CLOCK_START = (
    1_000_000_000  # [s] modification times count up from here: Python's caches know a text by its time and size
)

SLOW = 2.0  # [s] of processor time: a test that takes longer is left out from the second run on, and what it alone sees survives

KILLED, SURVIVED, TIMED_OUT, BROKEN = "killed", "survived", "timed out", "broken"


class Sandbox:
    """`folder/tree`: the files of the project that git knows or would; a fault is put into it, the tests run, it is taken back."""

    def __init__(self, root: Path, folder: Path):
        self.folder, self.tree = folder, folder / "tree"
        self._writes = 0
        self._update(root)
        os.environ |= {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(self.tree), "NO_COLOR": "1"}
        os.environ.pop("CI", None)
        sys.path.insert(0, str(self.tree))
        for name in HEAVY:
            importlib.import_module(name)

    def _update(self, root: Path) -> None:
        listed = subprocess.run(
            ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
            cwd=root,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for path in [p for p in self.tree.rglob("*") if p.is_file()] if self.tree.exists() else []:
            name = path.relative_to(self.tree).as_posix()
            if not name.startswith(".cache") and "__pycache__" not in name and name not in listed:
                path.unlink()
        for name in listed:
            source, target = root / name, self.tree / name
            if source.is_file() and not (target.is_file() and target.read_bytes() == source.read_bytes()):
                target.parent.mkdir(parents=True, exist_ok=True)
                self._write(name, source.read_bytes())

    def _write(self, name: str, content: bytes) -> None:
        path = self.tree / name
        path.write_bytes(content)
        self._writes += 1
        stamp = CLOCK_START + int(time.time()) % 10**8 * 10 + self._writes
        os.utime(path, (stamp, stamp))

    def compiles(self, mutant: Mutant) -> bool:
        """Whether C with this fault in it passes the compiler as the project calls it; Python always does."""
        if not mutant.file.endswith((".c", ".h")):
            return True
        with self._faulty(mutant):
            compile_it = _compile_plant if mutant.file.startswith("fmu_src/native/plant/") else _compile_shell
            return self._fork(compile_it, 120.0, self.folder / "compiler.txt") == 0

    def run(self, mutant: Mutant | None, area: Area, seconds: float, times: Path) -> tuple[str, str]:
        """(outcome, the first test that failed): the area's tests on the tree with this fault in it, or with none."""
        log = self.folder / "pytest.txt"
        with self._faulty(mutant):
            code = self._fork(lambda: _pytest(self.tree, self.folder, area, times, mutant is None), seconds, log)
        shutil.rmtree(self.folder / "temporary", ignore_errors=True)
        text = log.read_text(errors="replace")
        failed = [line.split(" - ")[0] for line in text.splitlines() if line.startswith(("FAILED ", "ERROR "))]
        if code is None:
            return TIMED_OUT, ""
        if code == 0:
            return SURVIVED, ""
        # 1: a test failed; 2, 4: a test or its fixtures could not be imported; a signal: the fault crashed the process.
        return (KILLED if code in (1, 2, 3, 4) or code < 0 else BROKEN), failed[0] if failed else f"exit code {code}"

    @contextlib.contextmanager
    def _faulty(self, mutant: Mutant | None):
        if mutant is None:
            yield
            return
        sound = (self.tree / mutant.file).read_bytes()
        self._write(mutant.file, mutant.applied(sound.decode()).encode())
        try:
            yield
        finally:
            self._write(mutant.file, sound)

    def _fork(self, work, seconds: float, log: Path) -> int | None:
        """The exit code of `work` in a process of its own, minus the signal that ended it; None: it took too long and was ended."""
        child = os.fork()
        if child == 0:
            os.setsid()
            # A run in the background ignores an interrupt, and so would what its tests start and interrupt.
            signal.signal(signal.SIGINT, signal.default_int_handler)
            os.chdir(self.tree)
            with log.open("w") as out:
                os.dup2(out.fileno(), 1)
                os.dup2(out.fileno(), 2)
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            code = 70
            try:
                code = int(work())
            finally:
                os._exit(code)
        deadline = time.monotonic() + seconds
        status = 0
        done = 0
        while not done and time.monotonic() < deadline:
            done, status = os.waitpid(child, os.WNOHANG)
            if not done:
                time.sleep(0.05)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)  # the child's own group: itself, and what its tests left behind
        if not done:
            os.waitpid(child, 0)
            return None
        return os.waitstatus_to_exitcode(status)


def _compile_shell() -> int:
    """0 if the shell's C compiles, for the smallest component."""
    import tempfile

    sys.path.insert(1, "tests")
    from fmu_src.component_fmu import _native
    from fmu_src.errors import ExportError
    from toys import sampled_toy

    with tempfile.TemporaryDirectory():
        try:
            _native(sampled_toy(), ["host"])
        except ExportError:
            return 1
    return 0


def _compile_plant() -> int:
    """0 if the C around a plant compiles, for a plant without variables."""
    import tempfile

    from fmu_src.errors import ExportError
    from fmu_src.native.compiler import compile_library
    from fmu_src.native.sources import fixed_sources
    from fmu_src.plant.guest import PREFIX_H, libraries
    from fmu_src.plant.sources import plant_sources
    from fmu_src.platforms import resolve

    sources = plant_sources() | {n: content for n, content in fixed_sources().items() if n.startswith("fmi2")}
    sources |= {"prefix.h": PREFIX_H.encode()}
    sources["tables.c"] = b'#include "plant.h"\nconst PlantTables plant_tables = {0};\n'
    (host,) = resolve(["host"])
    with tempfile.TemporaryDirectory() as folder:
        for name, content in sources.items():
            (Path(folder) / name).write_bytes(content)
        try:
            compile_library("plant", Path(folder), host, libraries(host))
        except ExportError:
            return 1
    return 0


def _pytest(tree: Path, folder: Path, area: Area, times: Path, measure: bool) -> int:
    known = [test for test in area.tests if (tree / test).exists()]
    arguments = [
        "--maxfail=20" if measure else "-x",
        "-q",
        "-m",
        "not long",
        "-k",
        area.keywords,
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        "--tb=line",
        "-rfE",
    ]
    arguments += [f"--basetemp={folder / 'temporary'}", f"--rootdir={tree}", "-c", str(tree / "pyproject.toml")]
    return pytest.main([*arguments, *known], plugins=[Quickest(times, measure)])


class Quickest:
    """Runs the tests that take least first, as a run without a fault measured them, and leaves those out that take more than SLOW or fail.

    Those that need an FMU come after those that don't: building it takes longer than they do.
    """

    FMU = (
        "built",
        "unpacked",
        "slave",
        "catalogue_fmu",
        "catalogue_system",
        "example",
        "catalogue_slave",
        "duffing_system",
    )

    def __init__(self, times: Path, measure: bool):
        self.path, self.measure = times, measure
        self.times: dict[str, float] = json.loads(times.read_text()) if times.is_file() and not measure else {}

    def pytest_collection_modifyitems(self, items: list) -> None:
        def order(item) -> tuple[bool, float]:
            return bool(set(self.FMU) & set(item.fixturenames)), self.times.get(item.nodeid, 0.0)

        chosen = [item for item in dict.fromkeys(items) if self.times.get(item.nodeid, 0.0) <= SLOW]
        items[:] = sorted(chosen, key=order)

    def pytest_runtest_logreport(self, report) -> None:
        if self.measure and report.failed:
            self.times[report.nodeid] = 1e6  # it finds faults where there are none

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item):
        return (yield from self._limited(item, 3 * SLOW))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item):
        return (yield from self._limited(item, SLOW))

    def _limited(self, item, seconds: float):
        """Without a fault: what takes too long is noted, ended and skipped."""
        if not self.measure:
            return (yield)

        def too_slow(*_: object) -> None:
            self.times[item.nodeid] = 1e6
            pytest.skip("too slow")

        signal.signal(signal.SIGPROF, too_slow)
        signal.setitimer(signal.ITIMER_PROF, seconds)
        began = _processor_time()
        try:
            return (yield)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            taken = _processor_time() - began
            if (
                seconds == SLOW or self.times.get(item.nodeid) == 1e6
            ):  # building an FMU in the set-up is shared with others
                self.times[item.nodeid] = max(self.times.get(item.nodeid, 0.0), round(taken, 3))

    def pytest_sessionfinish(self) -> None:
        if self.measure:
            self.path.write_text(json.dumps(self.times, indent=0))


def _processor_time() -> float:
    """[s], of this process and of those that it waited for: the wall clock says more of the machine than of a test."""
    return sum(os.times()[:4])
