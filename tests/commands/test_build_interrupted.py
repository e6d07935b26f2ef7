"""What keeps a build from being made is one line, said before minutes of work; and Ctrl-C ends the compiler too."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
import time
from importlib.machinery import ModuleSpec
from pathlib import Path

import psutil
import pytest
from typer.testing import CliRunner

from commands.app import app
from fmu_src import ExportError, export
from fmu_src.archive import check_writable
from fmu_src.native import compiler
from toys import sampled_toy

MODEL = """
import casadi as ca
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral

PENDULUM = Model(
    name="pendulum",
    states=[Variable("angle", start=1.0), Variable("rate")],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [x.rate, -{constant} * ca.sin(x.angle)],
    output=lambda x, u, p, t: [x.angle],
)
observer = pseudospectral(PENDULUM, sample_time=0.05, N=12, L=20)
"""


def is_compiler(process: psutil.Process) -> bool:
    try:
        return "ziglang/zig" in " ".join(process.cmdline())
    except psutil.NoSuchProcess:  # it has ended since it was found
        return False


def compilers(of: psutil.Process) -> list[psutil.Process]:
    return [child for child in of.children(recursive=True) if is_compiler(child)]


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
@pytest.mark.parametrize("which", ["my model", "the catalogue"])
def test_ctrl_c_ends_the_compiler_too(which: str, tmp_path: Path) -> None:
    # A number that no build has seen: the compiler would find its work in its cache.
    (tmp_path / "mine.py").write_text(MODEL.format(constant=repr(1 + time.time_ns() % 10**9 / 1e9)))
    what = ["--file", str(tmp_path / "mine.py")]
    if which == "the catalogue":
        what = []  # all of it: where the compiler finds its work in its cache, one run of it is easily missed
    script = "import sys\nfrom commands.app import main\nmain(sys.argv[1:])\n"
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-c", script, "build", *what, "--platforms", "all", "--out", str(tmp_path / "fmus")]
    build = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    parent, running = psutil.Process(build.pid), []
    deadline = time.monotonic() + 120
    while not running and build.poll() is None and time.monotonic() < deadline:
        running = compilers(parent)
        time.sleep(0.02)
    assert running, f"the compiler never ran: {build.communicate()}"
    children = parent.children(recursive=True)
    os.killpg(build.pid, signal.SIGINT)  # as a terminal does
    said = build.communicate(timeout=60)[1]
    assert build.returncode == 130 and said.strip().splitlines()[-1].startswith(
        "error: stopped; what was finished is in"
    )
    _, alive = psutil.wait_procs(children, timeout=20)
    assert not alive, alive
    assert "Traceback" not in said


def test_a_folder_that_cannot_be_written_is_said_before_anything_is_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler, "_run", lambda *_: pytest.fail("compiled"))
    (tmp_path / "taken").write_text("a file")
    (tmp_path / "mine.py").write_text(MODEL.format(constant=9.81))
    for out in (tmp_path / "taken", tmp_path / "taken" / "below", Path("/proc/nowhere")):
        done = CliRunner().invoke(app, ["build", "--file", str(tmp_path / "mine.py"), "--out", str(out)])
        (line,) = done.stderr.strip().splitlines()
        assert done.exit_code == 2 and line.startswith(f"error: cannot write to {out}: "), done.output


def test_a_folder_without_the_right_to_write_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)  # root may write anywhere
    with pytest.raises(PermissionError):
        check_writable(tmp_path / "deep" / "deeper")
    assert not (tmp_path / "deep").exists()


def broken(tmp_path: Path, text: str, mode: int = 0o755) -> Path:
    (tmp_path / "zig").write_text(text)
    (tmp_path / "zig").chmod(mode)
    return tmp_path


@pytest.mark.skipif(os.name != "posix", reason="writes a shell script")
@pytest.mark.parametrize(
    ("program", "mode", "message"),
    [
        (None, 0, "the C compiler is missing: install it by 'pip install ziglang'"),
        ("#!/bin/sh\nexit 0\n", stat.S_IRUSR, "does not start: Permission denied"),
        ("\x7fELF nonsense", 0o755, "does not start: Exec format error"),
        ("#!/bin/sh\nkill -9 $$\n", 0o755, "the C compiler was ended by SIGKILL for"),
        (
            "#!/bin/sh\necho 'a note' >&2\necho 'x.c:1: error: no' >&2\nexit 1\n",
            0o755,
            "refused its sources for linux64: x.c:1: error: no",
        ),
        ("#!/bin/sh\nexit 3\n", 0o755, "refused its sources for linux64: it says nothing"),
    ],
)
def test_a_missing_or_broken_compiler_is_one_line(
    program: str | None, mode: int, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = None
    if program is not None:
        spec = ModuleSpec("ziglang", None, origin=str(broken(tmp_path, program, mode) / "__init__.py"))
    monkeypatch.setattr(compiler, "find_spec", lambda name: spec)
    with pytest.raises(ExportError) as caught:
        export(sampled_toy(), tmp_path / "out", ("linux64",))
    assert message in str(caught.value) and len(str(caught.value).splitlines()) == 1
    assert not (tmp_path / "out").exists()
