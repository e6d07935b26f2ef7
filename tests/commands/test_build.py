"""observer-fmus build, as `python build_fmus.py`: a model of their own, and one line, never a traceback, for a mistake."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tools import ROOT

MODEL = """
import casadi as ca
from observers.model import Model, Variable

model = Model(
    name="pendulum",
    states=[Variable("angle", unit="rad", start=1.0), Variable("rate", unit="rad/s")],
    outputs=[Variable("y", unit="rad")],
    ode=lambda x, u, p, t: [x.rate, -ca.sin(x.angle)],
    output=lambda x, u, p, t: [x.angle],
)
"""
COMPONENTS = """
from observers.pseudospectral import pseudospectral
from pendulum import model
from reference_models.plant import plant

observer = pseudospectral(model, sample_time=0.1, N=15)
truth = plant(model)
"""


def build(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(ROOT / "build_fmus.py"), *arguments], cwd=folder, capture_output=True, text=True
    )


def refused(result: subprocess.CompletedProcess[str]) -> str:
    """The one line of an error."""
    assert result.returncode == 2, result.stderr
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ")
    return line


def test_a_users_own_model_becomes_plant_and_observer(tmp_path: Path) -> None:
    (tmp_path / "pendulum.py").write_text(MODEL)
    (tmp_path / "mine.py").write_text(COMPONENTS)  # imports the module beside it
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    result = build(elsewhere, "--file", "../mine.py", "--out", "made")
    assert result.returncode == 0, result.stderr
    assert sorted(path.name for path in (elsewhere / "made").iterdir()) == [
        "pendulum.fmu",
        "pendulum_pseudospectral.fmu",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1\ny = x / 0\n", "mine.py, line 2: ZeroDivisionError: division by zero"),
        ("x = (\n", "mine.py: SyntaxError"),
        ("import sys\nsys.exit(3)\n", "mine.py, line 2: SystemExit: 3"),
        (MODEL, "mine.py defines no Component at module level, such as"),
        (MODEL.replace("x.angle]", "x.angel]"), "there is no state 'angel'; known: angle, rate"),
        (
            MODEL + COMPONENTS.replace("from pendulum import model", "again = pseudospectral(model, sample_time=0.2)"),
            "two Components are called 'pendulum_pseudospectral'",
        ),
    ],
    ids=["fails", "syntax", "exits", "no component", "unknown state", "name clash"],
)
def test_a_file_that_cannot_be_built_is_named_with_the_reason(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "mine.py").write_text(text)
    assert message in refused(build(tmp_path, "--file", "mine.py"))
    assert [path.name for path in tmp_path.iterdir() if path.suffix != ".pyc"] == ["mine.py"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--only", "duffin"], "'duffin' is neither an FMU nor a system of the catalogue; did you mean 'duffing'"),
        (["--only", "sine", "--platforms", "linux64, beos"], "platform 'beos' is unknown; known: host, all, linux64"),
        (["--only", "sine", "--target", "cobol"], "target 'cobol' is unknown; known: native, python"),
        (["--only", "sine", "--out", "taken"], "cannot write to taken: Not a directory"),
        (["--file", "nowhere.py"], "nowhere.py: there is no such file"),
        (["--file", "."], ".: is a folder"),
        (["--file", "nowhere.py", "--only", "sine"], "--file and --only exclude each other"),
    ],
)
def test_a_users_mistake_is_one_line_and_status_2(tmp_path: Path, arguments: list[str], message: str) -> None:
    (tmp_path / "taken").write_text("a file")
    assert message in refused(build(tmp_path, *arguments))
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_an_argument_of_no_such_name_is_told_what_it_may_have_meant(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("from observers.model import Variable\nheight = Variable('h', units='m')\n")
    line = refused(build(tmp_path, "--file", "mine.py"))
    assert "mine.py, line 2: " in line and line.endswith("did you mean unit?")
