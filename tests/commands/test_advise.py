"""observer-fmus advise: a file with a model in, a table and the lines to copy out; one line for a mistake."""

from __future__ import annotations

import re
import signal
from pathlib import Path

import numpy as np
import pytest

import browser
from advice.region import AdviceError
from observers.component import Component
from observers.model import Model
from verbs import observer_fmus, refused

TANK = """
from observers.model import Model, Variable

TANK = Model(
    name="tank",
    states=[Variable("level", "level", "m", start=1.0, min=0.0)],
    inputs=[Variable("inflow", "inflow", "m/s", start=0.5, nominal=0.2)],
    unknown_parameters=[Variable("outlet", "outlet", "1/s", start=0.5, nominal=0.2, min=0.05)],
    outputs=[Variable("y", "measured level", "m")],
    ode=lambda x, u, p, t: [u.inflow - p.outlet * x.level],
    output=lambda x, u, p, t: [x.level],
)
"""
BLIND = TANK.replace("[u.inflow - p.outlet * x.level]", "[u.inflow - p.outlet * x.level, 0.1]").replace(
    "min=0.0)]", 'min=0.0), Variable("hidden")]'
)


@pytest.fixture
def tank(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("tank.py").write_text(TANK)
    return Path("tank.py")


@pytest.mark.long
def test_what_is_advised_can_be_copied_and_builds(tank: Path) -> None:
    done = observer_fmus("advise", tank)
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    found = {line.split()[0]: line.split() for line in lines if re.match(r" \w+ .* us ", line)}
    assert {"riccati", "ukf", "pseudospectral", "least_squares"} <= set(found)
    assert any(line.startswith("Not for this model: elementary:") for line in lines)
    (imported,) = (line for line in lines if line.startswith("from observers."))
    (made,) = (line for line in lines if line.startswith("observer = "))
    assert "observer-fmus build --file tank.py" in lines
    namespace: dict = {}
    exec("\n".join((TANK, imported, made)), namespace)
    assert isinstance(namespace["observer"], Component)
    assert [path.name for path in Path().iterdir() if path.is_file()] == ["tank.py"]
    page = Path("results/tank_advice.html")
    assert lines[-1] == str(page)
    text = page.read_text(encoding="utf-8")
    for words in (made.replace('"', "&quot;"), "Not for this model: elementary:", "tank: riccati on a fresh motion"):
        assert words.replace("riccati", made.split("(")[0].split()[-1]) in text
    assert all(f"<td>{method}</td>" in text for method in found)
    browser.check(page, 7)


@pytest.mark.long
def test_a_log_is_predicted_and_gives_the_sample_time(tank: Path) -> None:
    rng, level, rows = np.random.default_rng(0), 1.0, ["time,y [mm],inflow"]
    for k in range(400):
        inflow = 0.5 + 0.2 * np.sign(np.sin(0.11 * k))
        rows.append(f"{0.25 * k},{1000 * (level + 0.01 * rng.standard_normal())},{inflow}")
        rest = inflow / 0.6
        level = rest + (level - rest) * np.exp(-0.6 * 0.25)
    Path("log.csv").write_text("\n".join(rows))
    done = observer_fmus("advise", tank, "--log", "log.csv", "--noise", "y=0.01")
    assert done.exit_code == 0, done.output
    assert "Sample time: 0.25 s" in done.stdout
    row = next(line.split() for line in done.stdout.splitlines() if line.startswith(" ukf"))
    assert float(row[1]) == pytest.approx(0.01, rel=0.2)  # of a good prediction nothing but the noise is left
    assert "over log.csv</h2>" in Path("results/tank_advice.html").read_text(encoding="utf-8")


@pytest.mark.long
def test_where_no_observer_applies_it_says_why_of_each_and_ends_with_1(tank: Path) -> None:
    tank.write_text(BLIND)
    done = observer_fmus("advise", tank)
    assert done.exit_code == 1, done.output
    assert "No observer can be advised for tank." in done.stdout
    assert "no output ever sees hidden" in done.stdout
    assert "Observability: hidden is not determined by the outputs." in done.stdout


@pytest.mark.parametrize(
    ("text", "arguments", "message"),
    [
        (None, [], "tank.py: there is no such file"),
        ("x = 1\n", [], "tank.py defines no Model at module level; observer-fmus new NAME"),
        ("x = 1\ny = x / 0\n", [], "tank.py, line 2: ZeroDivisionError: division by zero"),
        (TANK.replace("x.level]", "x.depth]"), [], "there is no state 'depth'; known: level"),
        (TANK, ["--noise", "z=1"], "noise of 'z': model 'tank' has no such output; known: y"),
        (TANK, ["--noise", "y=0"], "noise of 'y' = 0 must be positive and finite"),
        (TANK, ["--noise", "y"], "--noise y: not of the form OUTPUT=STD"),
        (TANK, ["--noise", "y=much"], "--noise y: could not convert"),
        (TANK, ["--sample-time", "0"], "--sample-time 0 must be between"),
        (TANK, ["--sample-time", "nan"], "--sample-time nan must be between"),
        (TANK, ["--log", "no.csv"], "no.csv: there is no such file"),
        (TANK, ["--log", "short.csv"], "short.csv: 2 rows are too few"),
        (TANK, ["--map", "y=level"], "how a log is read is said, but there is none: give --log"),
        (TANK, ["--log", "other.csv", "--map", "inflow=inflows", "--map", "z=y"], "there is no input 'z' to map"),
        (TANK, ["--log", "other.csv", "--map", "inflow=flow"], "flow"),
        (TANK, ["--log", "other.csv"], "other.csv: there is no column 'inflow'; did you mean 'inflows'?"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(tank: Path, text: str | None, arguments: list[str], message: str) -> None:
    if text is None:
        tank.unlink()
    else:
        tank.write_text(text)
    Path("short.csv").write_text("time,y,inflow\n0,1,1\n1,1,1\n")
    Path("other.csv").write_text("time,y,inflows\n0,1,1\n1,1,1\n")
    assert message in refused(observer_fmus("advise", tank, *arguments))


def test_the_noise_that_an_observer_in_the_file_was_given_is_taken(tank: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = []

    def keep(model: object, **given: object) -> None:
        told.append(given["noise"])
        raise AdviceError("enough")

    monkeypatch.setattr("advice.advise.advise", keep)
    for more, arguments in (
        ("ukf(TANK, sample_time=1.0, measurement_noise={'y': 0.03})", []),
        ("ukf(TANK, sample_time=1.0)", []),
        ("ukf(TANK, sample_time=1.0, measurement_noise={'y': 0.1})", []),  # which is the default too
        ("ukf(TANK, sample_time=1.0, measurement_noise={'y': 0.03})", ["--noise", "y=0.2"]),
    ):
        tank.write_text(f"from observers.ukf import ukf\n{TANK}\nobserver = {more}\n")
        assert "enough" in refused(observer_fmus("advise", tank, *arguments))
    assert told == [{"y": 0.03}, {}, {"y": 0.1}, {"y": 0.2}]


def test_each_model_of_a_file_is_advised_on_with_its_own_noise(tank: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = []

    def keep(model: Model, **given: object) -> None:
        told.append((model.name, given["noise"]))
        raise AdviceError(f"{model.name}: enough")

    monkeypatch.setattr("advice.advise.advise", keep)
    other = TANK.replace("TANK", "POND").replace('"tank"', '"pond"').replace('"y"', '"w"')
    tank.write_text(TANK + other + "AGAIN = TANK\n")
    done = observer_fmus("advise", tank, "--noise", "w=0.5")
    assert done.exit_code == 2
    assert told == [("tank", {}), ("pond", {"w": 0.5})]
    assert done.stderr.split() == ["error:", "tank:", "enough", "error:", "pond:", "enough"]


def test_a_log_is_read_as_replay_reads_it(tank: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = []

    def keep(model: Model, **given: object) -> None:
        told.append(given["record"])
        raise AdviceError("enough")

    monkeypatch.setattr("advice.advise.advise", keep)
    tank.write_text(TANK + TANK.replace("TANK", "POND").replace('"tank"', '"pond"').replace('"y"', '"w"'))
    rows = [f"{k};{k / 8:g};0,5".replace(".", ",") for k in range(101)]
    rows[3] = "3;none;0,5"
    Path("log.csv").write_text("\n".join(["made by a logger", "t;depth;inflow", *rows]))
    options = ("--map", "time=t", "--map", "y=depth", "--map", "w=depth", "--missing", "none", "--skip-lines", "1")
    done = observer_fmus("advise", tank, "--log", "log.csv", *options, "--decimal", ",", "--separator", ";")
    assert done.stderr.split() == ["error:", "enough"] * 2
    for record, name in zip(told, "yw", strict=True):
        assert record.sample_time == 1.0 and np.isnan(record.measured[name][3])
        np.testing.assert_allclose(
            np.delete(record.measured[name], 3), np.delete(np.arange(101) / 8, 3), rtol=0, atol=0
        )
        assert set(record.inputs["inflow"]) == {0.5}


@pytest.mark.parametrize("swallowed", [False, True], ids=["heard", "swallowed by a library"])
def test_ctrl_c_is_one_line(tank: Path, monkeypatch: pytest.MonkeyPatch, swallowed: bool) -> None:
    def interrupted(*_: object, **__: object) -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            if not swallowed:
                raise
            raise ValueError("no overload fits") from None

    monkeypatch.setattr("advice.advise.advise", interrupted)
    assert "stopped; there is no advice yet" in refused(observer_fmus("advise", tank), 130)
