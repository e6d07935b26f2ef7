"""What every observer says of its estimate: one enumeration, whose order is the order of severity, and whether it can be trusted.

The status of a sample is the gravest that applies. The trusted ones come first: `diagnostics.trusted` says that the estimate is claimed
to be within its stated uncertainty.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca

from observers.component import Enumeration

STATUS = Enumeration(
    "ObserverStatus",
    (
        ("estimating", "the estimate rests on the samples, and fits them"),
        ("prediction_kept", "the prediction fits within tuning.cost_threshold: no solve was needed"),
        ("outlier", "a measurement was too far from its prediction: it had less weight, or none"),
        (
            "sample_rejected",
            "a measurement was missing or not finite: the estimate rests on the others, or is the prediction",
        ),
        ("settling", "after a start or a restart, the estimate rests on few samples yet"),
        (
            "iterating",
            "the iterations of this sample did not get below tuning.epsilon and the noise; the next ones go on from here",
        ),
        ("coarse_collocation", "the residual at node 0 exceeds its bound: N is too small for the window"),
        ("parameter_changed", "a model parameter was changed: older samples in the window obey the old value"),
        ("uncertain", "a standard deviation exceeds tuning.deviation_limit"),
        (
            "inconsistent",
            "the samples do not fit the model and the noise: the estimate, the model or a sensor is wrong",
        ),
        ("undetermined", "the samples do not determine the estimate"),
        ("singular", "the equations hardly determine what the method has to solve for"),
        ("solver_failed", "a solve or a step failed: the estimate is the prediction, or starts again"),
        ("propagated_guess", "too few samples yet: the estimate is the propagated guess"),
    ),
)
CODE = SimpleNamespace(**{item: i for i, (item, _) in enumerate(STATUS.items, start=1)})


def trusted(status: Any) -> Any:
    """Whether an estimate of this status is claimed to be within its stated uncertainty."""
    return status <= CODE.sample_rejected


def shown(status: Any) -> Any:
    """What `ports.VERDICT` shows of it."""
    return ca.vertcat(status, trusted(status))


def worst(*cases: tuple[Any, int]) -> Any:
    """The gravest code whose condition is true, `estimating` if none is; `cases`: (condition, code)."""
    status: Any = CODE.estimating
    for condition, code in sorted(cases, key=lambda case: case[1]):
        status = ca.if_else(condition, code, status)
    return status
