"""Which of the observers that were tried to take: the least error among those that settle, and are not wrong in silence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from advice.trial import Outcome

SILENT = 0.05  # of the wrong estimates: more is too many
TIE = 1.03  # times the least error: the cheaper of these is taken


def choose(outcomes: Sequence[Outcome]) -> Outcome | None:
    """The first choice, None where no observer is one."""
    able = [o for o in outcomes if not unfit(o, outcomes)]
    if not able:
        return None
    least = min(o.total for o in able)
    return min((o for o in able if o.total <= TIE * least), key=lambda o: o.per_sample)


def unfit(outcome: Outcome, among: Sequence[Outcome]) -> str:
    """Why an observer cannot be chosen; empty if it can."""
    if outcome.ended:
        return f"a run ended: {outcome.ended}"
    if not np.isfinite(outcome.total):
        return "its estimates are not finite"
    if outcome.settled == 0 or outcome.settled < max(o.settled for o in among):
        return "it does not settle on every motion"
    if outcome.silent > SILENT:
        return f"{outcome.silent:.0%} of its wrong estimates are trusted"
    return ""
