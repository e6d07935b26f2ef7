"""A log is read as people and instruments write them: the same numbers, or one line that names what is wrong and what helps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.errors import ExperimentError
from cosim.replay.log import read_log
from cosim.replay.reading import LONGEST_LINE, Reading
from cosim.replay.replay import replay
from fmu_src import export
from observers.component import Component
from observers.model import Model, Variable
from observers.ukf import ukf

TANK = Model(
    name="tank",
    states=[Variable("level", unit="m", start=1.0)],
    inputs=[Variable("inflow", unit="m/s")],
    outputs=[Variable("h", unit="m")],
    ode=lambda x, u, p, t: [u.inflow - 0.1 * x.level],
    output=lambda x, u, p, t: [x.level],
)
TIME = np.arange(30) * 0.5
H, INFLOW = 1 + 0.25 * np.sin(TIME), 0.125 * np.cos(TIME)


def tank_observer() -> Component:
    noise = {"process_noise": {"level": 0.1}, "measurement_noise": {"h": 0.05}, "initial_std": {"level": 0.5}}
    return ukf(TANK, sample_time=0.5, **noise)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(tank_observer(), tmp_path_factory.mktemp("fmu"))


def rows(form: Callable[[float], str] = repr, separator: str = ",") -> list[str]:
    table = zip(TIME.tolist(), H.tolist(), INFLOW.tolist(), strict=True)
    return [separator.join(form(value) for value in row) for row in table]


def comma(value: float) -> str:
    return repr(value).replace(".", ",")


def moments(zone: str = "") -> list[str]:
    halves = [f"2024-05-01T00:00:{k // 2:02d}.{k % 2 * 5}{zone}" for k in range(len(TIME))]
    return [f"{when},{h!r},{u!r}" for when, h, u in zip(halves, H.tolist(), INFLOW.tolist(), strict=True)]


def scaled(time: float, level: float, flow: float) -> list[str]:
    return [
        f"{t * time!r},{h * level!r},{u * flow!r}"
        for t, h, u in zip(TIME.tolist(), H.tolist(), INFLOW.tolist(), strict=True)
    ]


PLAIN = "time,h,inflow"
DIALECTS = {
    "semicolons": ["time;h;inflow", *rows(separator=";")],
    "decimal commas": ["time;h;inflow", *rows(comma, ";")],
    "decimal commas in quotes": [PLAIN, *rows(lambda v: f'"{comma(v)}"')],
    "tabs": ["time\th\tinflow", *rows(separator="\t")],
    "bars": ["time|h|inflow", *rows(separator="|")],
    "blanks": ["  time   h  inflow ", *(f" {row}  " for row in rows(separator="   "))],
    "blanks before quotes": ['"time", "h", "inflow"', *rows(lambda v: f' "{v!r}"')],
    "a byte order mark": ["\ufeff" + PLAIN, *rows()],
    "comments": ["# logger 1.2", "", PLAIN, *rows()[:9], "# paused", *rows()[9:]],
    "numpy.savetxt": ["# " + PLAIN, *rows()],
    "a separator at the end": [PLAIN + ",", *(row + "," for row in rows())],
    "blank lines at the end": [PLAIN, *rows(), "", "", ""],
    "units": ["time [s],h [m],inflow [m/s]", *rows()],
    "units without a blank": ["time[s],h[m],inflow[m/s]", *rows()],
    "units in parentheses": ["time (s),h (m),inflow (m/s)", *rows()],
    "a row of units": [PLAIN, "s,m,m/s", *rows()],
    "a row of units in brackets": [PLAIN, "[s],[m],[m/s]", *rows()],
    "ISO times": [PLAIN, *moments()],
    "ISO times with a zone": [PLAIN, *moments("+02:00")],
    "ISO times of Zulu": [PLAIN, *moments("Z")],
    "exponents": [PLAIN, *rows(lambda v: f"{v:.17E}")],
}


def estimate(fmu: Path, log: Path, **options: object) -> np.ndarray:
    return replay(fmu, log, **options).result["observer.estimate.level"]  # type: ignore[arg-type]


def log_of(folder: Path, lines: list[str], encoding: str = "utf-8") -> Path:
    path = folder / "log.csv"
    path.write_text("\n".join(lines) + "\n", encoding=encoding)
    return path


@pytest.fixture(scope="module")
def reference(fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    return estimate(fmu, log_of(tmp_path_factory.mktemp("plain"), [PLAIN, *rows()]))


@pytest.mark.parametrize("dialect", DIALECTS)
def test_the_dialect_is_found_and_the_numbers_are_the_same(
    dialect: str, fmu: Path, reference: np.ndarray, tmp_path: Path
) -> None:
    np.testing.assert_array_equal(estimate(fmu, log_of(tmp_path, DIALECTS[dialect])), reference)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig"])
def test_the_encoding_is_found_by_its_mark(encoding: str, fmu: Path, reference: np.ndarray, tmp_path: Path) -> None:
    np.testing.assert_array_equal(estimate(fmu, log_of(tmp_path, [PLAIN, *rows()], encoding)), reference)


def test_another_encoding_is_named_by_an_option(fmu: Path, reference: np.ndarray, tmp_path: Path) -> None:
    lines = [PLAIN + ",Bemerkung", *(f"{row},größer" for row in rows())]
    log = log_of(tmp_path, lines, "cp1252")
    with pytest.raises(ExperimentError, match="--encoding says how it is written, such as cp1252"):
        estimate(fmu, log)
    np.testing.assert_array_equal(estimate(fmu, log, reading=Reading(encoding="cp1252")), reference)


# The oracle is a hand's: metres of a millimetre are 1e-3, of a foot 0.3048; a minute has 60 s, an hour 3600 s.
@pytest.mark.parametrize(
    ("head", "factors"),
    [
        ("time [ms],h [mm],inflow [mm/s]", (1e3, 1e3, 1e3)),
        ("time [min],h [km],inflow [km/h]", (1 / 60, 1e-3, 3.6)),
        ("time (sec),h [ft],inflow [m·s^-1]", (1, 1 / 0.3048, 1)),
        ("time [h],h [cm],inflow [ft/min]", (1 / 3600, 100, 60 / 0.3048)),
    ],
)
def test_units_in_the_head_are_converted(
    head: str, factors: tuple[float, float, float], fmu: Path, reference: np.ndarray, tmp_path: Path
) -> None:
    found = estimate(fmu, log_of(tmp_path, [head, *scaled(*factors)]))
    np.testing.assert_allclose(found, reference, rtol=0, atol=2e-15)


def test_units_below_the_names_are_converted(fmu: Path, reference: np.ndarray, tmp_path: Path) -> None:
    log = log_of(tmp_path, [PLAIN, "ms,mm,mm/s", *scaled(1e3, 1e3, 1e3)])
    np.testing.assert_allclose(estimate(fmu, log), reference, rtol=0, atol=2e-15)


def test_temperatures_have_an_offset(tmp_path: Path) -> None:
    room = Model(
        name="room",
        states=[Variable("T", unit="degC", start=20.0)],
        outputs=[Variable("y", unit="degC", start=20.0)],
        ode=lambda x, u, p, t: [0 * x.T],
        output=lambda x, u, p, t: [x.T],
    )
    noise = {"process_noise": {"T": 0.1}, "measurement_noise": {"y": 0.1}, "initial_std": {"T": 1.0}}
    made = export(ukf(room, sample_time=1.0, **noise), tmp_path)  # type: ignore[arg-type]
    ends = []
    # 25 degC is 298.15 K and 77 degF.
    for unit, value in (("degC", 25), ("°C", 25), ("K", 298.15), ("degF", 77)):
        log = log_of(tmp_path, [f"time,y [{unit}]", *(f"{k},{value}" for k in range(50))])
        ends.append(replay(made, log).result["observer.estimate.T"][-1])
    assert ends[0] == pytest.approx(25, rel=1e-13, abs=0)
    np.testing.assert_allclose(ends, ends[0], rtol=0, atol=1e-12)


def test_an_empty_cell_of_a_known_input_holds_the_last_value(fmu: Path, tmp_path: Path) -> None:
    lines = [row.split(",") for row in rows()]
    held = INFLOW.copy()
    for k in (0, 5, 6, 20):
        lines[k][2] = ""
    held[[0, 5, 6, 20]] = held[[1, 4, 4, 19]]  # nothing lies before the first
    found = replay(fmu, log_of(tmp_path, [PLAIN, *(",".join(cells) for cells in lines)]))
    expected = [f"{t!r},{h!r},{u!r}" for t, h, u in zip(TIME.tolist(), H.tolist(), held.tolist(), strict=True)]
    np.testing.assert_array_equal(
        found.result["observer.estimate.level"], estimate(fmu, log_of(tmp_path, [PLAIN, *expected]))
    )
    assert found.held == {"inflow": 4} and found.empty == {"h": 0, "inflow": 0}


@pytest.mark.parametrize("cell", ["n/a", "65535", "65535.0"])
def test_what_stands_for_an_empty_cell_can_be_said(cell: str, fmu: Path, tmp_path: Path) -> None:
    lines = {word: [row.split(",") for row in rows()] for word in ("", cell)}
    for word, table in lines.items():
        table[7][1] = word
    logs = {word: [PLAIN, *(",".join(cells) for cells in table)] for word, table in lines.items()}
    empty = estimate(fmu, log_of(tmp_path, logs[""]))
    said = Reading(missing=("n/a", "65535"))
    np.testing.assert_array_equal(estimate(fmu, log_of(tmp_path, logs[cell]), reading=said), empty)


def test_bad_rows_are_skipped_and_counted_where_that_is_asked_for(
    fmu: Path, reference: np.ndarray, tmp_path: Path
) -> None:
    good = rows()
    bad = [good[9], "4.75,-,1", "4.75,1", "x,1,1", ",1,1", "", "nan,1,1", "1,2,3,4"]
    found = replay(fmu, log_of(tmp_path, [PLAIN, *good[:10], *bad, *good[10:]]), reading=Reading(skip_bad_rows=True))
    np.testing.assert_array_equal(found.result["observer.estimate.level"], reference)
    assert found.rows.skipped == len(bad) and "line 12: time 4.5 does not come after 4.5" in found.rows.reason


def test_the_time_can_have_another_name(fmu: Path, reference: np.ndarray, tmp_path: Path) -> None:
    log = log_of(tmp_path, ["t [ms],level,inflow", *scaled(1e3, 1, 1)])
    with pytest.raises(ExperimentError, match="name it by --map time=COLUMN, or give the time between its rows"):
        estimate(fmu, log, mapping={"h": "level"})
    for name in ("t", "t [ms]"):
        np.testing.assert_array_equal(estimate(fmu, log, mapping={"h": "level", "time": name}), reference)


def test_lines_before_the_names_are_skipped_where_that_is_asked_for(
    fmu: Path, reference: np.ndarray, tmp_path: Path
) -> None:
    log = log_of(tmp_path, ["Recorder 7", "serial 12", PLAIN, *rows()])
    with pytest.raises(ExperimentError, match="--skip-lines leaves out what comes before them"):
        estimate(fmu, log)
    np.testing.assert_array_equal(estimate(fmu, log, reading=Reading(skip_lines=2)), reference)


REFUSED = {
    "an underscore": ([PLAIN, "0,1_0.5,0"], "line 2: '1_0.5' in column 'h' is not a number"),
    "digits of another alphabet": ([PLAIN, "0,١,0"], "line 2: '١' in column 'h' is not a number"),
    "a word": ([PLAIN, "0,1,0", "0.5,n/a,0"], "--missing 'n/a' takes it for an empty cell; --skip-bad-rows"),
    "a decimal comma": (
        ["time;h;inflow", "0;1.5;0", "0.5;1,5;0"],
        "'1,5' in column 'h' is not a number; --decimal ','",
    ),
    "a decimal point": (["time;h;inflow", "0;1,5;0,0", *["0,5;1.5;0"]], "'1,5' in column 'h' is not a number"),
    "thousands": (["time;h;inflow", "0;1,0;0,0", "0,5;1.000,5;0,0"], "'1.000,5' in column 'h' is not a number"),
    "a duplicate": ([PLAIN, "0,1,0", "0,1,0"], "line 3: time 0 does not come after 0, the one before; --skip-bad-rows"),
    "another unit": (
        ["time,h [V],inflow", "0,1,0"],
        "'h [V]' is in V, which cannot become m, the unit of the input 'h'",
    ),
    "no unit": (["time,h [bananas],inflow", "0,1,0"], "the unit 'bananas' of the column 'h [bananas]' is unknown"),
    "no time": (["time [m],h,inflow", "0,1,0"], "the unit 'm' of the column 'time [m]' is none of time"),
    "two units of one name": (["time,h [m],h [mm],inflow", "0,1,1,0"], "two columns are called 'h'"),
    "dates of another form": ([PLAIN, "01.05.2024,1,0"], "is neither a number nor a time like 2024-05-01T00:00:00"),
    "a zone in some": ([PLAIN, "2024-05-01,1,0", "2024-05-02T00:00:00Z,1,0"], "not both with or without a time zone"),
    "no names": (["0,1,0", "0.5,1,0"], "line 1: wants the names of the columns, not numbers"),
    "an empty known input": ([PLAIN, "0,1,", "0.5,1,"], "the column 'inflow' of the known input 'inflow' is empty"),
    "no good row": ([PLAIN, "x,1,1"], "line 2: 'x' in column 'time' is neither a number"),
    "a long line": ([PLAIN, "0" * (LONGEST_LINE + 1)], "has more than 1048576 characters"),
    "one time far away": ([PLAIN, "0,1,0", "0.5,1,0", "1,1,0", "3e7,1,0"], "replay parts of it"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_be_read_is_one_sentence_that_says_what_helps(kind: str, fmu: Path, tmp_path: Path) -> None:
    lines, message = REFUSED[kind]
    with pytest.raises(ExperimentError) as caught:
        estimate(fmu, log_of(tmp_path, lines))
    assert message in str(caught.value) and len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("reading", "message"),
    [
        (Reading(separator=",,"), "--separator ',,' must be one character"),
        (Reading(decimal="'"), "--decimal"),
        (Reading(encoding="latin-99"), "--encoding: unknown encoding: latin-99"),
        (Reading(skip_lines=-1), "--skip-lines -1 must not be negative"),
    ],
)
def test_an_option_that_makes_no_sense_is_refused(reading: Reading, message: str, tmp_path: Path) -> None:
    with pytest.raises(ExperimentError, match=message):
        read_log(log_of(tmp_path, [PLAIN, *rows()]), reading)
