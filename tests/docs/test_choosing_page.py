"""Each number on the page of the choice is what the project computes: instructions, sizes, sample times."""

from __future__ import annotations

import importlib
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from elftools.elf.elffile import ELFFile

from benchmarks import callgrind
from benchmarks.native import build_driver
from benchmarks.streams.catalogue import CATALOGUE
from benchmarks.worst_case import costs
from build_fmus import FMUS
from fmu_src import export
from said import check, rows_of
from test_sources import call
from tools import ROOT, need

ROWS = rows_of(ROOT / "docs" / "choosing.md")
TARGETS = rows_of(ROOT / "docs" / "targets.md")
COSTS, SAMPLING = "What they cost", "How often to sample"
ENTRIES = {
    "unscented Kalman filter": "duffing_ukf",
    "Riccati": "duffing_riccati",
    "least squares": "duffing_least_squares",
    "pseudospectral": "duffing_pseudospectral",
    "pseudospectral with an arrival cost": "duffing_pseudospectral_arrival",
}
SIZED = (
    "motor_canonical_dae",
    "chen_yen_least_squares",
    "james_baras_5_1_riccati",
    "duffing_ukf",
    "duffing_pseudospectral",
)
MODELS = {
    "stirred tank": "stirred_tank",
    "lithium-ion cell": "lithium_cell",
    "single-track car": "single_track_car",
    "attitude": "gyro_attitude",
    "quadruple tank": "quadruple_tank",
}


def test_the_page_repeats_the_tables_of_the_targets() -> None:
    assert {claim for heading, claim in ROWS if heading == COSTS} == {"observer", *ENTRIES}
    for observer, name in ENTRIES.items():
        median, worst, *sizes = ROWS[COSTS, observer]
        (cells,) = (row for (_, first), row in TARGETS.items() if first == f"`{name}`" and len(row) == 9)
        assert (median, float(worst)) == (cells[0], max(float(cell) for cell in cells[1:6:2]))
        if sizes != ["", ""]:
            assert sizes == TARGETS["Without FMI", f"`{name}`"][:2]


@pytest.mark.long
@pytest.mark.parametrize("observer", ENTRIES)
def test_a_sample_takes_the_instructions_that_are_said(observer: str, tmp_path: Path) -> None:
    need(callgrind.is_installed(), "valgrind counts the instructions")
    entry = CATALOGUE[ENTRIES[observer]]
    noise, *faulty = costs(build_driver(tmp_path), entry, entry.make(), tmp_path)
    found = [noise.median / 1e3, max(c.worst for c in (noise, *faulty)) / 1e3]
    # A few percent depend on the processor, for which glibc picks its cosine.
    check(" ".join(ROWS[COSTS, observer][:2]), "{} {}", found, rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize("name", SIZED)
def test_without_fmi_it_has_the_size_that_is_said(name: str, tmp_path: Path) -> None:
    with zipfile.ZipFile(export(FMUS[name][0](), tmp_path)) as fmu:
        fmu.extractall(tmp_path)
    found = []
    for options in ((), ("-Dcasadi_real=float",)):
        flash = sizes(tmp_path / "sources" / "functions.c", tmp_path, *options)[0]
        ram = sizes(tmp_path / "sources" / "embedded" / "example.c", tmp_path, *options)[1]
        found += [flash / 1000, ram / 1000]
    check(" ".join(TARGETS["Without FMI", f"`{name}`"]), "{} {} {} {}", found, rel=0.01)


def sizes(source: Path, folder: Path, *options: str) -> tuple[int, int]:
    """Bytes that a Cortex-M7 only reads, and that it writes."""
    target = ["-target", "thumb-linux-musleabihf", "-mcpu=cortex_m7", "-Os"]
    call([sys.executable, "-m", "ziglang", "cc", *target, *options, "-c", source, "-o", folder / "object.o"], folder)
    with (folder / "object.o").open("rb") as file:
        kept = [section for section in ELFFile(file).iter_sections() if section["sh_flags"] & 2]  # SHF_ALLOC, SHF_WRITE
        written = sum(section["sh_size"] for section in kept if section["sh_flags"] & 1)
        return sum(section["sh_size"] for section in kept) - written, written


def test_the_gallerys_sample_times_are_those_of_its_models() -> None:
    assert {claim for heading, claim in ROWS if heading == SAMPLING} == {"model", *MODELS}
    for name, model in MODELS.items():
        check(ROWS[SAMPLING, name][1], "{} s", [importlib.import_module(f"gallery.{model}").SAMPLE_TIME], rel=0)


def test_the_gallerys_fastest_motions_are_those_of_its_models() -> None:
    tank, cell, car, body, tanks = (importlib.import_module(f"gallery.{model}") for model in MODELS.values())

    def jacket(t: float) -> float:
        return float(tank.jacket.output([], [], [], t))

    known = {v.name: v.start for v in cell.MODEL.parameters}
    found = {
        "stirred tank": ("ignites within seconds, every {} s", 1 / fastest(jacket, 1500)),
        "lithium-ion cell": ("RC branch of {} s", known["R1"] * known["C1"]),
        "single-track car": (
            "steering with {} Hz",
            fastest(lambda t: car.ride(None, SimpleNamespace(slalom=1.0), t)[0], 500),
        ),
        "attitude": ("sways in {} s, gyroscope's noise", 1 / fastest(lambda t: body.turn(None, None, t)[0], 500)),
    }
    for name, (words, value) in found.items():
        check(ROWS[SAMPLING, name][0], words, [value], rel=0)
    assert ROWS[SAMPLING, "quadruple tank"][0].startswith("levels in a minute")
    level, outlet = tanks.MODEL.states[0].start, tanks.MODEL.parameters[0].start
    # A dh/dt = -a sqrt(2 g h) with A = 28 cm2, about its start.
    assert 28 / outlet * np.sqrt(2 * level / tanks.GRAVITY) == pytest.approx(60, rel=0.1)


def fastest(signal: Callable[[float], float], span: float) -> float:
    """The highest frequency [Hz] of which a signal, seen for `span` [s], has a tenth of the amplitude of its largest."""
    values = np.array([signal(t) for t in np.linspace(0, span, 5000, endpoint=False)])
    amplitude = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values))))
    inner = (amplitude[1:-1] > amplitude[:-2]) & (amplitude[1:-1] >= amplitude[2:])
    peaks = 1 + np.flatnonzero(inner & (amplitude[1:-1] > 0.1 * amplitude.max()))
    return float(peaks[-1] / span)
