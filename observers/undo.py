"""The last sample, undone: an estimate that escapes goes back to the prediction before that sample, and from there on to the guess.

An observer's state has `before`, the prediction at the last sample before it acted, and `undoable`: 1 where to go back to it is worth a
try, 0 where it is not, -1 from an undone sample to the next one. That one does not set it to 1: what escaped without the last sample too is
no place to go back to.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers.status import CODE


def escaped(s: SimpleNamespace, guess: Any, whole: Any) -> tuple[Any, dict[str, Any]]:
    """Between samples: where the estimate goes back to, and the parts of the state that tell of it, unless it is `whole`."""
    undone = s.undoable > 0
    return ca.if_else(undone, s.before, guess), {
        "undoable": ca.if_else(whole, s.undoable, ca.if_else(undone, -1, 0)),
        "status": ca.if_else(whole, s.status, CODE.solver_failed),
        "failures": s.failures + ca.logic_not(whole),
        "restarts": s.restarts + ca.logic_not(ca.logic_or(whole, undone)),
    }


def at_sample(s: SimpleNamespace, outside: Any) -> tuple[Any, Any]:
    """Of a prediction that lies `outside` the domain of h: whether the last sample is undone, and whether only the guess is left."""
    undoable = s.undoable > 0
    return ca.logic_and(outside, undoable), ca.logic_and(outside, ca.logic_not(undoable))


def undoable(s: SimpleNamespace, undone: Any, again: Any) -> Any:
    """After a sample at which the last one was `undone`, or the estimate started `again`."""
    return ca.logic_and(ca.logic_not(ca.logic_or(again, undone)), s.undoable >= 0)
