"""--input FILE.csv: each cell is what its input takes, or one sentence says what it is not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cosim.errors import ExperimentError
from cosim.master import run
from cosim.master.signals import checked, sampled
from cosim.system import Connector, Element, System
from cosim.system.resolve import resolve
from cosim.system.resolved import ResolvedSystem

Strict = Callable[..., Path]
TIMES = 0.1 * np.arange(11)
SOUND = "time,drive,a.n,a.b,a.e,note\n0,0,1,0,1,first\n0.45,9,3,1,2,second\n1,9,3,1,2,third\n"


@pytest.fixture
def system(strict: Strict) -> System:
    connectors = {"drive": Connector("input")}
    return System("x", {"a": Element(strict())}, [("drive", "a.u")], stop=1.0, step=0.1, connectors=connectors)


@pytest.fixture
def resolved(system: System) -> ResolvedSystem:
    return resolve(system)


def read(text: str | bytes, resolved: ResolvedSystem, folder: Path) -> dict[str, np.ndarray]:
    path = folder / "drive.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    signals = checked(sampled(path, resolved, TIMES), resolved, (), len(TIMES) - 1)
    return {s.variable.name: s.values for s in signals}


@pytest.mark.parametrize(
    "text", [SOUND, "\ufeff" + SOUND, SOUND.replace("\n", "\r\n")], ids=["plain", "with a mark", "of Windows"]
)
def test_reals_are_linear_and_other_types_hold_the_last_row(
    text: str, resolved: ResolvedSystem, tmp_path: Path
) -> None:
    found = read(text, resolved, tmp_path)
    np.testing.assert_allclose(found["u"], np.minimum(20 * TIMES, 9), rtol=1e-15)
    later = TIMES > 0.45
    for name, (before, after) in {"n": (1, 3), "b": (0, 1), "e": (1, 2)}.items():
        np.testing.assert_array_equal(found[name], np.where(later, after, before), err_msg=name)


@pytest.mark.parametrize("time", ["0.3", "0.30000000000000004"])
def test_a_row_at_a_communication_point_counts_from_there_on(
    time: str, resolved: ResolvedSystem, tmp_path: Path
) -> None:
    """Whether the file's number is the master's, 3 * 0.1, or the one that people write."""
    found = read(f"time,drive,a.n,a.b,a.e\n0,0,1,0,1\n{time},9,3,1,2\n1,9,3,1,2\n", resolved, tmp_path)
    for name, (before, after) in {"n": (1, 3), "b": (0, 1), "e": (1, 2)}.items():
        np.testing.assert_array_equal(found[name].ravel(), np.where(np.arange(11) >= 3, after, before))


def test_a_step_holds_the_value_of_its_beginning(system: System, tmp_path: Path) -> None:
    (tmp_path / "drive.csv").write_text(SOUND)
    result = run(system, inputs=tmp_path / "drive.csv")
    np.testing.assert_array_equal(result["a.m"], [1, 1, 1, 1, 1, 1, 3, 3, 3, 3, 3])


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("0,0,1", "0,1_0,1", "line 2: '1_0' in the column 'drive' is not a number"),
        ("0,0,1", "0,,1", "line 2: '' in the column 'drive' is not a number"),
        ("0,0,1", "0,٣,1", "line 2: '٣' in the column 'drive' is not a number"),
        ("9,3,1,2,second", "9,3,1", "line 3: 4 cells under 6 names of columns"),
        ("a.b", "a.n", "two columns have one name"),
        ("time,", "when,", "the first line does not start with 'time'"),
        ("0.45", "0", "the times must be finite and ascend"),
        ("\n1,", "\n0.9,", "holds times from 0 to 0.9 s, the run goes from 0 to 1 s"),
        ("9,3,", "9,3.5,", "'a.n' cannot take 3.5: it is no whole number of 32 bits"),
        ("9,3,", "9,nan,", "'a.n' cannot take nan: it is no whole number of 32 bits"),
        ("9,3,", "9,1e10,", "'a.n' cannot take 1e+10: it is no whole number of 32 bits"),
        ("3,1,2", "3,2,2", "'a.b' cannot take 2: it is neither 0 nor 1"),
        ("3,1,2", "3,1,7", "'a.e' cannot take 7: it is none of 1, 2"),
    ],
)
def test_what_an_input_cannot_take_is_refused(
    old: str, new: str, reason: str, resolved: ResolvedSystem, tmp_path: Path
) -> None:
    with pytest.raises(ExperimentError) as caught:
        read(SOUND.replace(old, new, 1), resolved, tmp_path)
    assert reason in str(caught.value) and len(str(caught.value).splitlines()) == 1


@settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    places=st.lists(
        st.tuples(
            st.integers(0, len(SOUND)),
            st.integers(0, 6),
            st.one_of(
                st.binary(max_size=3), st.sampled_from([b"\0", b'"', b",", b"\n", b"nan", b"1e999", b"-1", b"\xff"])
            ),
        ),
        min_size=1,
        max_size=4,
    )
)
def test_mutated_bytes_are_values_or_one_sentence(
    places: list[tuple[int, int, bytes]], resolved: ResolvedSystem, tmp_path: Path
) -> None:
    text = SOUND.encode()
    for at, gone, new in places:
        text = text[:at] + new + text[at + gone :]
    try:
        found = read(text, resolved, tmp_path)
    except ExperimentError as error:
        assert len(str(error).splitlines()) == 1 and str(error).isprintable()
    else:
        assert all(values.shape == TIMES.shape for values in found.values())
