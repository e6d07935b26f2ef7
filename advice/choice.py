"""Which of the observers that were tried to take: of those that settle and are not wrong in silence, one that is near the best.

That is looked at on clean streams first, then, among those that are near there, a while after an unknown parameter has jumped: an observer
that hardly lets a parameter wander is the best of all until it does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from advice.trial import Outcome

SILENT = 0.05  # of the wrong estimates: more is too many
NEAR = 1.25  # times the least error on clean streams: who has less is asked about jumps
TIE = 1.03  # times the smallest regret: the cheapest of these is taken


def choose(outcomes: Sequence[Outcome]) -> Outcome | None:
    """The first choice, None where no observer is one."""
    _, _, equals = _finalists(outcomes)
    return min(equals, key=lambda o: o.per_sample) if equals else None


def why(chosen: Outcome, outcomes: Sequence[Outcome]) -> str:
    """One sentence on what `choose` went by, of its choice."""
    able, near, equals = _finalists(outcomes)
    if len(able) == 1:
        return "The only one that settles and is not wrong in silence."
    best = min(able, key=lambda o: o.total)
    clean = f"{chosen.total / best.total:.2f} times that of {best.candidate.method}"
    told = ["the least error on clean streams" if chosen is best else f"an error on clean streams of {clean}"]
    if chosen.after_jump is not None and len(near) > 1:
        least = min(o.after_jump for o in near if o.after_jump is not None)
        factor = chosen.after_jump / least
        told.append(
            f"after a jump {factor:.2f} times the least" if chosen.after_jump > least else "the least after a jump"
        )
    if len(equals) > 1:
        told.append(f"the quickest of the {len(equals)} that are equal to {TIE - 1:.0%}")
    return f"It has {', '.join(told)}."


def _finalists(outcomes: Sequence[Outcome]) -> tuple[list[Outcome], list[Outcome], list[Outcome]]:
    """Those that can be chosen, of these those near the best on clean streams, of these those that are nowhere far from the best."""
    able = [o for o in outcomes if not unfit(o, outcomes)]
    near = [o for o in able if o.total <= NEAR * min(other.total for other in able)]
    regrets = [_regret(o, near) for o in near]
    return able, near, [o for o, regret in zip(near, regrets, strict=True) if regret <= TIE * min(regrets)]


def _regret(outcome: Outcome, among: Sequence[Outcome]) -> float:
    """By which factor an error is larger than the least one: on clean streams or after a jump, whichever is more."""
    factors = [outcome.total / min(o.total for o in among)]
    after = [o.after_jump for o in among if o.after_jump is not None]
    if outcome.after_jump is not None:
        factors.append(outcome.after_jump / min(after))
    return max(factors)


def unfit(outcome: Outcome, among: Sequence[Outcome]) -> str:
    """Why an observer cannot be chosen; empty if it can."""
    if outcome.ended:
        return f"a run ended: {outcome.ended}"
    if not np.isfinite([outcome.total, outcome.after_jump or 0.0]).all():
        return "its estimates are not finite"
    if outcome.settled == 0 or outcome.settled < max(o.settled for o in among):
        return "it does not settle on every motion"
    if outcome.silent > SILENT:
        return f"{outcome.silent:.0%} of its wrong estimates are trusted"
    return ""
