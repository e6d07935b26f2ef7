"""Whatever a log holds, it is read or refused in one sentence, and within bounds of memory."""

from __future__ import annotations

import gzip
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cosim.errors import ExperimentError
from cosim.replay import cells
from cosim.replay.log import read_log
from cosim.replay.reading import Reading

GIGABYTE = 2**30
SOUND = "\n".join(["# logger", "time [s];y [mV];u", *(f"{k},5;{k * k},25;{k % 3}" for k in range(20))]).encode()
# Bytes that mean something in CSV, in numbers, in units and in encodings are more likely to get far.
BYTES = st.one_of(st.sampled_from(list(b',;\t|"\n\r#[]()^*/.-+eE0_nai \x00\xff\xfe\xef\xbb\xbf')), st.integers(0, 255))


@st.composite
def mutated(draw: st.DrawFn, sound: bytes) -> bytes:
    """`sound` with some bytes replaced, cut out or put in."""
    data = bytearray(sound)
    for _ in range(draw(st.integers(0, 8))):
        at = draw(st.integers(0, len(data)))
        removed = draw(st.integers(0, 6))
        data[at : at + removed] = bytes(draw(st.lists(BYTES, max_size=6)))
    return bytes(data)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.one_of(mutated(SOUND), st.binary(max_size=200)), skip=st.booleans(), packed=st.booleans())
def test_mutated_bytes_are_numbers_or_one_sentence(data: bytes, skip: bool, packed: bool, tmp_path: Path) -> None:
    path = tmp_path / ("log.csv.gz" if packed else "log.csv")
    path.write_bytes(gzip.compress(data, mtime=0) if packed else data)
    try:
        log = read_log(path, Reading(skip_bad_rows=skip, missing=("n/a",)))
        first, *others = log.heads
        found = log.read({first: cells.time(log.decimal)} | {head: log.number() for head in others})
    except ExperimentError as error:
        assert str(error).startswith(str(path)) and "{where}" not in str(error)
    else:
        assert all(column.shape == found.lines.shape for column in found.values.values())
        assert (np.diff(found.values[first]) > 0).all()


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=mutated(gzip.compress(SOUND, mtime=0)))
def test_mutated_compressed_bytes_are_text_or_one_sentence(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "log.csv.gz"
    path.write_bytes(data)
    try:
        read_log(path)
    except ExperimentError as error:
        assert str(error).startswith(str(path))


BOMBS = {
    "one line": (b"time,y\n", b"0" * 2**20),
    "blank lines": (b"time,y\n", b"\n" * 2**20),
    "comments": (b"time,y\n", b"#\n" * 2**19),
    "cells": (b"time,y\n", b"1," * 2**19),
    "an open quote": (b'time,y\n0,"', b"1\n" * 2**19),
}


@pytest.mark.long
@pytest.mark.parametrize("kind", BOMBS)
def test_a_small_file_of_gigabytes_takes_less_than_one(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv.gz"
    with gzip.open(path, "wb", compresslevel=1) as file:
        head, block = BOMBS[kind]
        file.write(head)
        for _ in range(1100):
            file.write(block)
    script = (
        "import re, sys\nfrom pathlib import Path\nfrom cosim.errors import ExperimentError\n"
        "from cosim.replay.log import read_log\ntry:\n    log = read_log(Path(sys.argv[1]))\n"
        "    log.read({head: log.number() for head in log.heads})\nexcept ExperimentError as error:\n    print(error)\n"
        # Not ru_maxrss, in which the process that started this one is counted.
        "print(1024 * int(re.search(r'VmHWM:\\s+(\\d+)', Path('/proc/self/status').read_text())[1]))"
    )
    done = subprocess.run([sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=True)
    message, peak = done.stdout.splitlines()
    assert message.startswith(f"{path}") and int(peak) < GIGABYTE


def test_more_numbers_than_fit_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosim.replay.log.MOST_NUMBERS", 10)
    (tmp_path / "log.csv").write_text("time,y\n" + "".join(f"{k},1\n" for k in range(6)))
    log = read_log(tmp_path / "log.csv")
    assert len(log.numbers("y")) == 6
    with pytest.raises(ExperimentError, match="more than 10 numbers in the columns that are read"):
        log.read({head: log.number() for head in log.heads})
