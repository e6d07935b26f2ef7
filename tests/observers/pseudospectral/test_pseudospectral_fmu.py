"""The observer's FMU as a binary: time, state, threads, failures."""

import math
import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from build_fmus import FMUS, Build, build_all
from observers.status import CODE
from tools import ROOT, TESTS

NAME = "duffing_pseudospectral"
TRUE = [0.4 * math.sin(0.3 * k) + 2.0 * math.cos(0.17 * k) for k in range(400)]  # any signal will do


def advance(slave, first: int, count: int, h: float = 0.1) -> None:
    for k in range(first, first + count):
        slave.set("y", TRUE[k])
        slave.step(0.1 * k, h)


@pytest.mark.parametrize("sample", [3, 60])
def test_a_saved_state_resumes_bit_for_bit(catalogue_slave: Callable, sample: int) -> None:
    slave = catalogue_slave(NAME).initialize()
    advance(slave, 0, sample)
    saved = slave.fmu.getFMUState()
    advance(slave, sample, 40)
    once = slave.outputs()
    slave.fmu.setFMUState(saved)
    slave.fmu.freeFMUState(saved)
    advance(slave, sample, 40)
    assert slave.outputs() == once


def test_a_serialised_state_resumes_bit_for_bit_in_a_new_process(
    catalogue_slave: Callable, catalogue_fmu: Callable[[str], Path], tmp_path: Path
) -> None:
    slave = catalogue_slave(NAME).initialize()
    advance(slave, 0, 60)
    (tmp_path / "state").write_bytes(slave.state())
    advance(slave, 60, 40)
    code = f"""
import sys
sys.path[:0] = {[str(Path(__file__).parent), str(TESTS), str(ROOT)]!r}
import fmpy
from slave import Slave
from test_pseudospectral_fmu import advance
slave = Slave(fmpy.extract({str(catalogue_fmu(NAME))!r}, {str(tmp_path / "unpacked")!r})).initialize()
handle = slave.fmu.deSerializeFMUstate(open({str(tmp_path / "state")!r}, "rb").read())
slave.fmu.setFMUState(handle)
advance(slave, 60, 40)
print(repr(slave.outputs()))
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == repr(slave.outputs())


def test_eight_instances_in_eight_threads_give_the_sequential_results_bit_for_bit(catalogue_slave: Callable) -> None:
    def whole_run(slave, seed: int) -> dict[str, float]:
        rng = np.random.default_rng(seed)
        for k in range(300):
            slave.set("y", TRUE[k] + 0.1 * rng.normal())
            slave.step(0.1 * k, 0.1)
        return slave.outputs()

    alone = [whole_run(catalogue_slave(NAME).initialize(), seed) for seed in range(8)]
    slaves = [catalogue_slave(NAME).initialize() for _ in range(8)]
    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(whole_run, slaves, range(8)))
    assert together == alone


def test_masters_that_multiply_accumulate_or_round_times_get_identical_bits(catalogue_slave: Callable) -> None:
    ends = []
    for scheme in ("multiplied", "accumulated", "rounded"):
        slave, t = catalogue_slave(NAME).initialize(), 0.0
        for k in range(600):
            begin = {"multiplied": k * 0.05, "accumulated": t, "rounded": round(k * 0.05 * 1e9) / 1e9}[scheme]
            slave.set("y", TRUE[k // 2])
            slave.step(begin, 0.05)
            t += 0.05
        ends.append(slave.outputs())
    assert ends[0] == ends[1] == ends[2]


def test_a_nan_measurement_is_logged_as_a_warning_and_nothing_is_lost(catalogue_slave: Callable) -> None:
    slave, clean = catalogue_slave(NAME).initialize(), catalogue_slave(NAME).initialize()
    advance(slave, 0, 30)
    advance(clean, 0, 30)
    prediction = clean.get("estimate.x1")
    slave.set("y", math.nan)
    slave.step(3.0, 0.1)
    assert slave.get("diagnostics.status") == CODE.sample_rejected
    assert slave.get("diagnostics.rejected_samples") == 1
    assert slave.get("filtered.x1") == prediction
    assert [
        text
        for status, category, text in slave.messages
        if category == "logStatusWarning" and "rejected_samples" in text
    ]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s: s.step(3.0, 0.11), ("0.11", "0.1")),
        (lambda s: s.step(2.0, 0.1), ("2", "3")),
        (lambda s: s.step(3.0, -0.1), ("-0.1",)),
        (lambda s: s.set("guess.x1", 1.0), ("guess.x1",)),
        (lambda s: s.set("tuning.tolerance", -1.0), ("tuning.tolerance", "-1", "1e-14")),
        (lambda s: s.set("tuning.iteration_limit", 41), ("tuning.iteration_limit", "41", "40")),
        (lambda s: s.set("tuning.tolerance", math.nan), ("tuning.tolerance", "nan")),
        (lambda s: s.fmu.getReal([987654]), ("987654",)),
        (lambda s: s.set("estimate.x1", 1.0), ("estimate.x1",)),
    ],
    ids=[
        "h > Ts",
        "backward",
        "h < 0",
        "fixed",
        "range",
        "integer range",
        "nan parameter",
        "unknown reference",
        "output",
    ],
)
def test_a_refused_call_names_the_culprit_and_loses_nothing(
    catalogue_slave: Callable, call: Callable, words: tuple[str, ...]
) -> None:
    slave, clean = catalogue_slave(NAME).initialize(), catalogue_slave(NAME).initialize()
    for one in (slave, clean):
        advance(one, 0, 30)
    before = slave.state()
    message = slave.refuses(lambda: call(slave))
    for word in words:
        assert word in message, message
    assert slave.state() == before
    advance(slave, 30, 20)
    advance(clean, 30, 20)
    assert slave.outputs() == clean.outputs()


@pytest.mark.long  # its short form, with a small component: tests/fmu_src/native/test_native.py
def test_built_again_from_another_folder_the_observer_has_the_same_bytes(tmp_path: Path) -> None:
    build_all(Build(fmus={NAME: FMUS[NAME]}), tmp_path / "first", ["host"])
    command = [sys.executable, str(ROOT / "build_fmus.py"), "--only", NAME, "--out", "again"]
    subprocess.run(command, cwd=tmp_path, env=os.environ | {"PYTHONHASHSEED": "7"}, capture_output=True, check=True)
    again = tmp_path / "again" / f"{NAME}.fmu"
    assert again.read_bytes() == (tmp_path / "first" / f"{NAME}.fmu").read_bytes()
