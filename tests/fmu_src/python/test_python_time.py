"""A PythonFMU counts steps as the native FMU does: however an importer makes its times, the outputs are the same."""

from __future__ import annotations

from itertools import product

import pytest

from slave import Slave
from test_time import (  # noqa: F401  what both targets say the same
    KINDS,
    SAMPLE_TIMES,
    T0,
    Make,
    ends,
    test_a_step_past_the_stop_time_by_rounding_is_none,
    test_skipped_repeated_and_backward_steps_are_refused_by_how_far_they_are_off,
    test_times_that_run_away_from_the_steps_are_refused,
)
from tools import few


@pytest.mark.parametrize(("t0", "h", "kind"), few(product(T0, SAMPLE_TIMES, KINDS), len(KINDS)))
def test_however_times_are_made_the_outputs_are_the_same(slave: Make, kind: str, h: float, t0: float) -> None:
    """More than the 50 steps after which 1/60 s in whole nanoseconds is off by a millionth of a step."""
    found = ends(slave, kind, t0, h, 80, Slave.outputs)
    assert {way for way, end in found.items() if end != found["multiplied"]} == set()
