"""observer-fmus whatever the verb: help and version, and one line, never a traceback, for a wrong word or a file out of reach."""

from __future__ import annotations

import io
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from typer.testing import CliRunner

import cosim.master
from commands.app import VERBS, app
from observers import __version__
from verbs import observer_fmus, refused

TOO_LONG = "x" * 300  # no file system has a name like this: the look alone is an OSError


@pytest.mark.parametrize("verb", VERBS)
def test_each_verb_has_help_with_an_example_that_is_not_broken(verb: str) -> None:
    result = observer_fmus(verb, "--help")
    assert result.exit_code == 0 and "--help" in result.stdout
    lines = [line.strip() for line in result.stdout.splitlines()]
    start = lines.index("Example:") + 1
    example = lines[start : lines.index("", start)]
    assert example[0].startswith(f"observer-fmus {verb} ")
    assert all(line.endswith("\\") for line in example[:-1])  # as a shell takes it
    options = re.findall(r"--[a-z-]+", " ".join(example))
    assert all(option in "\n".join(lines[start + len(example) :]) for option in options)


def test_the_list_of_verbs_loads_none_of_what_they_need() -> None:
    code = (
        "import sys; from commands.app import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: print(sorted({'numpy', 'casadi', 'scipy', 'fmpy', 'bokeh', 'matplotlib'} & set(sys.modules)))"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown.splitlines()[-1] == "[]"


def test_help_lists_every_verb_and_the_module_does_what_the_script_does() -> None:
    command = [sys.executable, "-m", "commands", "--help"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "observer-fmus" in shown and all(verb in shown for verb in VERBS)
    assert observer_fmus().stdout.strip() == observer_fmus("--help").stdout.strip()


def test_the_version_is_the_packages() -> None:
    assert observer_fmus("--version").stdout == f"observer-fmus {__version__}\n"


@pytest.mark.parametrize(
    ("arguments", "message", "help_of"),
    [
        (("buidl",), "No such command 'buidl'", "observer-fmus"),
        (("--nope",), "--nope", "observer-fmus"),
        (("build", "extra"), "(extra)", "observer-fmus build"),
        (("run",), "Missing argument", "observer-fmus run"),
        (("run", "x.ssp", "--stop", "soon"), "Invalid value for '--stop'", "observer-fmus run"),
        (("run", "x.ssp", "--stop", "1_0"), "Invalid value for '--stop': '1_0' is not a number", "observer-fmus run"),
        (("replay", "x.fmu", "x.csv", "--sample-time", "1_0"), "'1_0' is not a number", "observer-fmus replay"),
        (("run", "x.ssp", "--call-limit", "inf"), "inf s is not finite or shorter than 0.1 s", "observer-fmus run"),
        (("run", "x.ssp", "--call-limit", "0.09"), "0.09 s is not finite or shorter than 0.1 s", "observer-fmus run"),
        (("run", "x.ssp", "--sto", "3"), "--sto", "observer-fmus run"),
        (("compare", "x.ssp", "y.ssp"), "(y.ssp)", "observer-fmus compare"),
        (
            ("campaign", "x.ssp", "--runs", "1.5", "--vary", "a.b"),
            "Invalid value for '--runs'",
            "observer-fmus campaign",
        ),
        (("campaign", "x.ssp", "--runs", "1_0", "--vary", "a.b"), "'1_0' is not a whole", "observer-fmus campaign"),
        (("campaign", "x.ssp", "--runs", "2", "--seed", "\u0663"), "is not a whole number", "observer-fmus campaign"),
        (("campaign", "x.ssp", "--runs", "2", "--workers", "1_0"), "is not a whole number", "observer-fmus campaign"),
        (("tune", "x.fmu", "x.csv", "--ahead", "1_0"), "'1_0' is not a whole number", "observer-fmus tune"),
        (("tune", "x.fmu", "x.csv", "--ahead", "0"), "0 samples: 1 is the least", "observer-fmus tune"),
        (("signal", "x.csv", "--skip-lines", "1_0"), "'1_0' is not a whole number", "observer-fmus signal"),
        (("replay", "x.fmu", "x.csv", "--skip-lines", "-1"), "-1 lines cannot be left out", "observer-fmus replay"),
        (("campaign", "x.ssp", "--runs", "2"), "--vary", "observer-fmus campaign"),
        (("replay", "x.fmu"), "Missing argument", "observer-fmus replay"),
        (("check",), "Missing argument", "observer-fmus check"),
    ],
)
def test_a_wrong_word_is_one_line_that_names_it_and_the_help(
    arguments: tuple[str, ...], message: str, help_of: str
) -> None:
    line = refused(observer_fmus(*arguments))
    assert message in line and line.endswith(f"; see {help_of} --help")


READERS = {
    "build": ("build", "--file", "{}"),
    "run": ("run", "{}"),
    "compare": ("compare", "{}"),
    "campaign": ("campaign", "{}", "--runs", "1", "--vary", "a.b", "--out", "out"),
    "replay an FMU": ("replay", "{}", "log.csv"),
    "check": ("check", "{}"),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere", "there is no such file"),
        ("folder", "is a folder"),
        ("file/below", "there is no such file"),
        (TOO_LONG, "File name too long"),
    ],
    ids=["missing", "folder", "below a file", "name too long"],
)
def test_a_file_that_cannot_be_read_is_one_line_with_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reader: str, name: str, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("a file")
    line = refused(observer_fmus(*(argument.format(name) for argument in READERS[reader])))
    assert name in line and message in line
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]


@pytest.mark.parametrize("reader", READERS)
def test_a_file_that_may_not_be_read_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reader: str) -> None:
    """The permission is refused by a stand-in for the system: root, as whom CI runs, may read everything."""
    locked = tmp_path / "locked"
    locked.write_text("a file")
    refuse_to_open(monkeypatch, locked)
    # The stand-in is in this process only: so is the run.
    here = import_module("commands.run")
    monkeypatch.setattr(here, "run_system", lambda *system, limit, **options: cosim.master.run(*system, **options))
    monkeypatch.chdir(tmp_path)
    line = refused(observer_fmus(*(argument.format(locked) for argument in READERS[reader])))
    assert "locked" in line and "Permission denied" in line


def refuse_to_open(monkeypatch: pytest.MonkeyPatch, path: Path) -> None:
    opened = io.open

    def guarded(file: object, *arguments: object, **options: object) -> object:
        if str(file) == str(path):
            raise PermissionError(13, "Permission denied", str(path))
        return opened(file, *arguments, **options)  # type: ignore[call-overload]

    monkeypatch.setattr("io.open", guarded)
    monkeypatch.setattr("builtins.open", guarded)
    monkeypatch.setattr("io.open_code", guarded)


def test_ctrl_c_is_no_traceback_and_status_130(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("commands.replay.perform", interrupted)
    done = CliRunner().invoke(app, ["replay", "x.fmu", "log.csv", "--out", str(tmp_path / "out")])
    assert done.exit_code == 130 and "Traceback" not in done.output + done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("imported", ["typer", "commands.console", "commands.run", "numpy"])
def test_ctrl_c_while_modules_are_imported_is_nothing_and_status_130(imported: str) -> None:
    code = f"""
import signal, sys
class Pressing:
    def find_spec(self, name, path=None, target=None):
        if name == {imported!r}:
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Pressing())
sys.argv = ["observer-fmus", "run", "x.ssp"]
from commands.start import main
main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_a_verb_hears_ctrl_c_again_and_one_that_is_ignored_stays_so() -> None:
    for before, wanted in (("signal.default_int_handler",) * 2, ("signal.SIG_IGN",) * 2):
        code = f"""
import signal, sys
signal.signal(signal.SIGINT, {before})
sys.argv = ["observer-fmus", "run", "no.ssp"]
from commands.start import main
try:
    main()
except SystemExit as end:
    print(end.code, signal.getsignal(signal.SIGINT) == {wanted})
"""
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert done.stdout == "2 True\n"
