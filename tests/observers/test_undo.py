"""Where an estimate goes back to, by the module's words: the prediction before the last sample, then the guess, and what is counted."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import casadi as ca
import pytest

from observers import undo
from observers.status import CODE

GUESS, BEFORE = 0.4, 1.25
WORTH, NOT_WORTH, UNDONE = 1, 0, -1


def state(undoable: int) -> SimpleNamespace:
    fields = {"undoable": undoable, "before": BEFORE, "status": CODE.estimating, "failures": 3, "restarts": 2}
    return SimpleNamespace(**{name: ca.DM(value) for name, value in fields.items()})


@pytest.mark.parametrize(
    ("undoable", "back", "then", "restarts"),
    [(WORTH, BEFORE, UNDONE, 2), (NOT_WORTH, GUESS, NOT_WORTH, 3), (UNDONE, GUESS, NOT_WORTH, 3)],
)
def test_what_escapes_goes_back_to_the_prediction_before_the_sample_once_and_then_to_the_guess(
    undoable: int, back: float, then: int, restarts: int
) -> None:
    """A failure in any case, a restart where it is the guess; what is whole changes nothing."""
    place, told = undo.escaped(state(undoable), ca.DM(GUESS), ca.DM(0))
    assert float(place) == back
    expected = {"undoable": then, "status": CODE.solver_failed, "failures": 4, "restarts": restarts}
    assert {name: float(value) for name, value in told.items()} == expected
    _, told = undo.escaped(state(undoable), ca.DM(GUESS), ca.DM(1))
    expected = {"undoable": undoable, "status": CODE.estimating, "failures": 3, "restarts": 2}
    assert {name: float(value) for name, value in told.items()} == expected


def test_a_prediction_outside_the_domain_undoes_the_sample_before_it_where_that_is_worth_a_try() -> None:
    for undoable, outside in itertools.product((WORTH, NOT_WORTH, UNDONE), (0, 1)):
        undone, stuck = undo.at_sample(state(undoable), ca.DM(outside))
        assert (bool(undone), bool(stuck)) == (outside and undoable == WORTH, outside and undoable != WORTH)


def test_a_sample_is_worth_to_be_undone_unless_it_follows_one_that_was_or_starts_again() -> None:
    for undoable, undone, again in itertools.product((WORTH, NOT_WORTH, UNDONE), (0, 1), (0, 1)):
        worth = undo.undoable(state(undoable), ca.DM(undone), ca.DM(again))
        assert bool(worth) == (undoable != UNDONE and not undone and not again)
