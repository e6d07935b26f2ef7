"""What varies from run to run, without an FMU: each seed its own runs, ranges filled to their ends, limits kept."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cosim.campaign.variation import check, draw, parse
from cosim.errors import ExperimentError


def resolved(**variables: dict[str, object]) -> SimpleNamespace:
    """A system with an element `plant` of these variables."""
    defaults = dict(
        causality="parameter", variability="fixed", initial="exact", start="0", min=None, max=None, declaredType=None
    )
    made = {name: SimpleNamespace(name=name, **(defaults | fields)) for name, fields in variables.items()}
    return SimpleNamespace(variables={"plant": made}, drivers=lambda: {})


SYSTEM = resolved(
    x=dict(type="Real", min="-2", max="2"),
    y=dict(type="Real"),
    seed=dict(type="Integer", min="0", max="1048576"),
    small=dict(type="Integer", min="3", max="7"),
    free=dict(type="Integer"),
)
BOTH = {"plant.x": (-1.0, 1.0), "plant.seed": None}


def test_no_run_of_a_seed_is_a_run_of_another_seed() -> None:
    """Seed 1, run 0 is not seed 0, run 1, nor any other."""
    drawn = {(seed, k): draw(BOTH, SYSTEM, seed, k) for seed in range(12) for k in range(12)}
    assert len({values["plant.x"] for values in drawn.values()}) == 144
    seeds = np.array([[drawn[seed, k]["plant.seed"] for k in range(12)] for seed in range(12)])
    assert len(set(seeds.ravel())) == 144
    x = np.array([[drawn[seed, k]["plant.x"] for k in range(12)] for seed in range(12)])
    assert abs(np.corrcoef(x.ravel(), x.T.ravel())[0, 1]) < 0.3  # (seed, run) and (run, seed)


def test_a_variable_has_values_of_its_own_whatever_else_varies() -> None:
    alone = draw({"plant.x": (-1.0, 1.0)}, SYSTEM, 3, 4)["plant.x"]
    assert draw(BOTH | {"plant.y": (0.0, 1.0)}, SYSTEM, 3, 4)["plant.x"] == alone
    both = draw({"plant.x": (-1.0, 1.0), "plant.y": (-1.0, 1.0)}, SYSTEM, 3, 4)
    assert both["plant.x"] != both["plant.y"]


def test_whole_numbers_are_distinct_until_all_are_used_and_then_begin_again() -> None:
    values = [draw({"plant.small": None}, SYSTEM, 5, k)["plant.small"] for k in range(10)]
    assert sorted(values[:5]) == [3, 4, 5, 6, 7] and values[5:] == values[:5]
    free = {draw({"plant.free": None}, SYSTEM, seed, 0)["plant.free"] for seed in range(20)}
    assert len(free) == 20 and min(free) >= 0 and max(free) < 2**31


def test_a_range_of_whole_numbers_has_both_its_ends() -> None:
    values = [draw({"plant.small": (3.0, 7.0)}, SYSTEM, 0, k)["plant.small"] for k in range(200)]
    assert set(values) == {3, 4, 5, 6, 7}
    reals = np.array([draw({"plant.y": (2.0, 6.0)}, SYSTEM, 0, k)["plant.y"] for k in range(500)])
    assert reals.min() >= 2 and reals.max() < 6 and abs(reals.mean() - 4) < 4 * (4 / np.sqrt(12)) / np.sqrt(500)


def test_what_to_vary_is_read_from_the_command_line() -> None:
    assert parse(["plant.x=-1:2.5", " plant.seed "]) == {"plant.x": (-1.0, 2.5), "plant.seed": None}
    for text, words in (
        ("plant.x=1", "not of the form"),
        ("=1:2", "not of the form"),
        ("plant.x=a:2", "'a' and '2' must be numbers"),
    ):
        with pytest.raises(ExperimentError, match=words):
            parse([text])
    with pytest.raises(ExperimentError, match=r"'plant\.x' is varied twice"):
        parse(["plant.x=1:2", "plant.x=1:3"])


@pytest.mark.parametrize(
    ("variations", "runs", "words"),
    [
        ({"plant.small": None}, 6, "'plant.small' has 5 values: too few for 6 runs"),
        ({"plant.x": None}, 1, "'plant.x' is a Real: it varies in a range"),
        ({"plant.x": (1.0, 1.0)}, 1, "the range 1:1 must be finite and ascend"),
        ({"plant.x": (1.0, float("inf"))}, 1, "the range 1:inf must be finite"),
        ({"plant.y": (0.0, 1.0)}, 1, "'plant.y' is varied and set to 3"),
        ({"plant.z": (0.0, 1.0)}, 1, "z"),
    ],
)
def test_what_cannot_be_varied_so_is_refused(variations, runs: int, words: str) -> None:
    with pytest.raises(ExperimentError, match=words):
        check(variations, SYSTEM, {"plant.y": 3}, runs)  # type: ignore[arg-type]


def test_as_many_runs_as_there_are_values_are_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[dict[str, float]] = []
    monkeypatch.setattr("cosim.campaign.variation.start_values", lambda system, values: tried.append(values))
    check({"plant.small": None, "plant.x": (-1.0, 2.0)}, SYSTEM, {}, 5)  # type: ignore[arg-type]
    assert tried == [{"plant.small": 3}, {"plant.x": -1.0}, {"plant.x": 2.0}]  # both ends of a range must be legal
