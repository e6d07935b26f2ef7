"""Whatever lies in a campaign's folder, it is the record of that run or one sentence that names the file."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cosim.campaign import campaign as module
from cosim.campaign.run import Outcome, load, save
from cosim.campaign.variation import draw
from cosim.errors import ExperimentError, SystemFileError
from cosim.system import Element, System
from cosim.system.resolve import resolve

VALUES = {"plant.start.x1": 0.25, "plant.sensor.seed": 7}
OUTCOME = Outcome(3, VALUES, "", {"rms(x1)": 0.5, "status": 3}, np.arange(5.0), np.ones((5, 2)), np.zeros((5, 2)))
QUESTION = {"system": "0" * 64, "vary": {"plant.start.x1": [0.0, 1.0]}, "seed": 1, "stop": 3.0, "parameters": []}


@st.composite
def mutated(draw: st.DrawFn, sound: bytes) -> bytes:
    """`sound` with some bytes replaced, cut out or put in, or its end cut off."""
    data = bytearray(sound)
    for _ in range(draw(st.integers(0, 6))):
        at, removed = draw(st.integers(0, len(data))), draw(st.integers(0, 4))
        data[at : at + removed] = draw(st.binary(max_size=4))
    return bytes(data[: draw(st.integers(0, len(data)))] if draw(st.booleans()) else data)


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("record") / "000003.npz"
    save(OUTCOME, path)
    return path.read_bytes()


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_mutated_bytes_of_a_record_are_the_record_or_one_sentence(
    data: st.DataObject, record: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "000003.npz"
    path.write_bytes(data.draw(mutated(record)))
    try:
        found = load(path, 3, VALUES, 2)
    except SystemFileError as error:
        assert str(error).startswith(f"{path}: not the record of this run (")
    else:
        assert found.run == 3 and found.values == VALUES and found.truths.shape == found.estimates.shape == (5, 2)


# Contents that are sound files and yet no record.
HEAD: dict[str, Any] = {"run": 3, "values": VALUES, "failure": "", "numbers": {"rms(x1)": 0.5}}
ARRAYS = {"time": np.arange(5.0), "truths": np.ones((5, 2)), "estimates": np.ones((5, 2))}
FORGED: dict[str, tuple[object, dict[str, np.ndarray]]] = {
    "another run": (HEAD | {"run": 4}, ARRAYS),
    "other values": (HEAD | {"values": {**VALUES, "plant.start.x1": 0.5}}, ARRAYS),
    "a list": ([1, 2], ARRAYS),
    "a word too many": (HEAD | {"more": 1}, ARRAYS),
    "numbers that are none": (HEAD | {"numbers": {"rms(x1)": "0.5"}}, ARRAYS),
    "a failure that is none": (HEAD | {"failure": None}, ARRAYS),
    "one pair": (HEAD, ARRAYS | {"truths": np.ones((5, 1))}),
    "fewer rows": (HEAD, ARRAYS | {"estimates": np.ones((4, 2))}),
    "whole numbers": (HEAD, ARRAYS | {"estimates": np.ones((5, 2), dtype=np.int64)}),
    "no time": (HEAD, {"truths": np.ones((5, 2)), "estimates": np.ones((5, 2))}),
    "no rows": (HEAD, {"time": np.empty(0), "truths": np.empty((0, 2)), "estimates": np.empty((0, 2))}),
}


@pytest.mark.parametrize("kind", FORGED)
def test_a_sound_file_that_is_not_the_record_of_this_run_is_refused(kind: str, tmp_path: Path) -> None:
    head, arrays = FORGED[kind]
    path = tmp_path / "000003.npz"
    np.savez_compressed(path, head=np.array(json.dumps(head)), **arrays)  # type: ignore[arg-type]
    with pytest.raises(SystemFileError, match="delete it to run it again"):
        load(path, 3, VALUES, 2)


def test_a_record_that_inflates_beyond_the_limit_is_refused_before_it_does(tmp_path: Path) -> None:
    path = tmp_path / "000003.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("head.npy", "w") as entry:
        for _ in range(257):
            entry.write(bytes(2**20))
    assert path.stat().st_size < 2**20
    with pytest.raises(SystemFileError, match="269484032 bytes, more than 268435456"):
        load(path, 3, VALUES, 2)


def test_an_array_that_promises_more_than_there_is_takes_no_memory(tmp_path: Path) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (2**40,)})
    path = tmp_path / "000003.npz"
    np.savez(path, head=np.array(json.dumps(HEAD)), truths=ARRAYS["truths"], estimates=ARRAYS["estimates"])
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("time.npy", header.getvalue())
    with pytest.raises(SystemFileError, match="the array 'time' is cut off"):
        load(path, 3, VALUES, 2)


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.one_of(mutated(json.dumps(QUESTION, indent=1).encode()), st.sampled_from([b"[]", b"1", b"[" * 10**5])))
def test_mutated_bytes_of_the_head_are_the_head_another_one_or_one_sentence(text: bytes, tmp_path: Path) -> None:
    (tmp_path / module.QUESTION).write_bytes(text)
    try:
        module._open_folder(tmp_path, QUESTION)
    except ExperimentError as error:
        assert "holds another campaign" in str(error)
    except SystemFileError as error:
        assert str(error).startswith(f"{tmp_path / module.QUESTION}: not the head of a campaign (")
    assert (tmp_path / module.QUESTION).read_bytes() == text


def test_seeds_and_runs_do_not_stand_for_each_other(built: Callable[[str], Path]) -> None:
    resolved = resolve(System("alone", {"plant": Element(built("duffing"))}, stop=1.0, step=0.1))
    vary = {"plant.start.x1": (-1.0, 1.0), "plant.sensor.seed": None}
    found = [tuple(draw(vary, resolved, seed, run).values()) for seed in range(20) for run in range(20)]
    for values in zip(*found, strict=True):
        assert len(set(values)) == len(found)
