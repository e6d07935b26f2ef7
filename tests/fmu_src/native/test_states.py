"""A serialised state from outside: a right checksum is no proof, what it holds must be what an instance can hold."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

import pytest

from components import COMPONENTS
from slave import Slave

Make = Callable[..., Slave]

# Of the header, by byte offset: see Header and Run in shell/state.c and shell/instance.h.
LIFECYCLE, IS_SET_UP, STOP_DEFINED, EXTRAPOLATES, STOP, CLOCK = 32, 40, 48, 56, 64, 72
WHOLE, STEPS, START, SAMPLE_TIME, LABEL, PHASE, CARRY, LAST, ELAPSED = range(CLOCK, CLOCK + 72, 8)
HEADER = CLOCK + 72
NAN, INF = math.nan, math.inf
# Component, offset, how it is packed, value.
UNSOUND = {
    "lifecycle that is none": ("sampled_toy", LIFECYCLE, "q", 64),
    "two lifecycles": ("sampled_toy", LIFECYCLE, "q", 5),
    "negative lifecycle": ("sampled_toy", LIFECYCLE, "q", -4),
    "started without a set-up": ("sampled_toy", IS_SET_UP, "q", 0),
    "flag": ("sampled_toy", STOP_DEFINED, "q", 2),
    "derivatives flag": ("sampled_toy", EXTRAPOLATES, "q", -1),
    "negative ticks": ("sampled_toy", WHOLE, "q", -5),
    "endless ticks": ("sampled_toy", WHOLE, "q", 2**62),
    "negative steps": ("sampled_toy", STEPS, "q", -1),
    "no steps, but a last one": ("sampled_toy", STEPS, "q", 0),
    "start time": ("sampled_toy", START, "d", NAN),
    "sample time of another run": ("sampled_toy", SAMPLE_TIME, "d", 1e-30),
    "time": ("sampled_toy", LABEL, "d", NAN),
    "infinite time": ("sampled_toy", LABEL, "d", INF),
    "phase": ("sampled_toy", PHASE, "d", 1.0),
    "negative phase": ("sampled_toy", PHASE, "d", -0.5),
    "phase that is no number": ("sampled_toy", PHASE, "d", NAN),
    "carry": ("sampled_toy", CARRY, "d", 3.0),
    "elapsed time": ("sampled_toy", ELAPSED, "d", 0.51),
    "last step": ("sampled_toy", LAST, "d", NAN),
    "state": ("sampled_toy", HEADER, "d", NAN),
    "infinite state": ("sampled_toy", HEADER + 8, "d", INF),
    "parameter out of range": ("sampled_toy", HEADER + (4 + 2 + 3) * 8, "d", 7.0),
    "integer that is not whole": ("sampled_toy", HEADER + (4 + 2 + 4) * 8, "d", 1.5),
    "enumeration's item": ("sampled_toy", HEADER + (4 + 2 + 5) * 8, "d", 3.0),
    "break that no parameter holds": ("sampled_toy", HEADER + (4 + 2 + 6 + 2) * 8, "d", NAN),
    "count": ("sampled_toy", -8, "d", NAN),
    "failure code": ("draining_toy", -3, "z", 1e6),
}


def forged(state: bytes, offset: int, kind: str, value: float, n_z: int) -> bytes:
    """The state with one value changed, and the checksum made right (FNV-1a, 64 bits)."""
    changed = bytearray(state)
    if kind == "z":  # counted from the end of z
        kind, offset = "d", HEADER + 8 * (n_z + offset)
    if offset < 0:
        offset += len(changed)
    struct.pack_into(f"<{kind}", changed, offset, int(value) if kind == "q" else value)
    total = 14695981039346656037
    for byte in changed[32:]:
        total = ((total ^ byte) * 1099511628211) % 2**64
    struct.pack_into("<Q", changed, 24, total)
    return bytes(changed)


def run(slave: Make, name: str) -> Slave:
    fmu = slave(name).initialize()
    for k in range(5):
        fmu.step(k * 0.1, 0.1)
    return fmu


@pytest.mark.parametrize("what", UNSOUND)
def test_a_state_that_no_instance_can_have_is_refused(slave: Make, what: str) -> None:
    name, offset, kind, value = UNSOUND[what]
    fmu = run(slave, name)

    before, outputs = fmu.state(), fmu.outputs()
    bad = forged(before, offset, kind, value, COMPONENTS[name]().n_z)
    assert bad != before
    message = fmu.refuses(lambda: fmu.fmu.deSerializeFMUstate(bad))
    assert message == f"fmi2DeSerializeFMUstate: the state holds what no instance of {name} can hold."
    assert fmu.state() == before and fmu.outputs() == outputs
    fmu.step(0.5, 0.1)


def test_a_state_forged_into_itself_is_taken(slave: Make) -> None:
    fmu = run(slave, "sampled_toy")
    state = fmu.state()
    same = forged(state, WHOLE, "q", 5, 4)
    assert same == state
    handle = fmu.fmu.deSerializeFMUstate(same)
    fmu.fmu.setFMUState(handle)
    fmu.fmu.freeFMUState(handle)
    assert fmu.state() == state
