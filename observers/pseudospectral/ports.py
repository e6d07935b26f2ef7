"""Status, tuning and diagnostics of the pseudospectral observer, as its FMU shows them."""

from __future__ import annotations

from dataclasses import replace

from observers import ports
from observers.component import Port
from observers.model import Model
from observers.pseudospectral.window.gauss_newton import FEW_UNKNOWNS
from observers.pseudospectral.window.iteration import MOST_ITERATIONS

TUNING = (
    Port(
        "tuning.tolerance",
        "scaled step below which Gauss-Newton stops; 1: mostly one iteration a sample",
        start=1e-5,
        min=1e-14,
        max=1.0,
        variability="tunable",
    ),
    Port(
        "tuning.iteration_limit",
        "iterations a sample after which a solve has failed",
        start=MOST_ITERATIONS,
        min=1,
        max=MOST_ITERATIONS,
        kind="Integer",
        variability="tunable",
    ),
    Port(
        "tuning.regularisation",
        "damping of the step, relative to nominal values; it does not bias the solution",
        start=1e-14,
        min=0.0,
        variability="tunable",
    ),
    Port(
        "tuning.cost_threshold", "cost of the prediction below which no solve is done", min=0.0, variability="tunable"
    ),
    Port(
        "tuning.conditioning_limit",
        "conditioning at or below which the window does not determine the state",
        start=1e-7,
        min=0.0,
        max=1.0,
        variability="tunable",
    ),
    ports.DEVIATION_LIMIT,
    ports.FALSE_ALARM,
    Port(
        "tuning.gate",
        "standard deviations of an innovation beyond which a measurement is an outlier, and has less weight; from 1e15 on none is, and the "
        "estimate never starts again",
        start=6.0,
        min=3.0,
        variability="tunable",
    ),
    Port(
        "tuning.collocation_limit",
        "scaled residual at node 0 above which the status is coarse_collocation",
        start=0.02,
        min=0.0,
        variability="tunable",
    ),
    Port(
        "tuning.residual_limit",
        "rms output residual, in units of tuning.measurement_noise where there is one, else of the outputs' nominal values, above which "
        "the status is inconsistent",
        start=1e30,
        min=0.0,
        variability="tunable",
    ),
)
SMALLEST_LIMIT = 1e-12  # below, rounding takes what is left


def tuning(unknowns: int) -> tuple[Port, ...]:
    """TUNING for a window with so many unknowns: the more there are the wider the pivots spread, a decade for each."""
    return tuple(
        replace(port, start=max(port.start * 0.1 ** max(unknowns - FEW_UNKNOWNS, 0), SMALLEST_LIMIT))
        if port.name == "tuning.conditioning_limit"
        else port
        for port in TUNING
    )


DIAGNOSTICS = (
    *ports.VERDICT,
    Port(
        "diagnostics.cost",
        "integral over the window of the squared output residual, in units of tuning.measurement_noise where there is one, else of the "
        "outputs' nominal values",
        "s",
        variability="discrete",
    ),
    Port(
        "diagnostics.iterations", "Gauss-Newton iterations at the last sample", kind="Integer", variability="discrete"
    ),
)
QUALITY = (
    Port(
        "diagnostics.conditioning",
        "smallest over largest pivot of the normal matrix; near 0: not determined",
        variability="discrete",
    ),
    Port(
        "diagnostics.deviation",
        "standard deviation of the least certain state or unknown parameter at the last sample, in units of nominal values",
        variability="discrete",
    ),
    Port("diagnostics.node0_residual", "collocation residual at the dropped node 0, scaled", variability="discrete"),
)
NO_GATE = 1e15  # of `tuning.gate`
CONSTRAINT_VIOLATION = Port(
    "diagnostics.constraint_violation",
    "by how much bounds and constraints had to give way, in units of nominal values; above 0: they contradict each other or the samples",
    variability="discrete",
)
SMOOTHNESS = 2  # m of Assumption 2
REGULARITY_LIMIT = Port(
    "tuning.regularity_limit",
    "smallest pivot of dg/dz, in units of nominal values, below which the status is singular",
    start=1e-2,
    min=0.0,
    variability="tunable",
)


def window_length(L: int) -> Port:
    """How much of the window counts (Remark 3)."""
    return Port(
        "tuning.window_length",
        "sample intervals of the window that count: of older samples nothing is asked until it is raised again",
        start=L,
        min=1,
        max=L,
        kind="Integer",
        variability="tunable",
    )


def constraints(model: Model) -> tuple[Port, ...]:
    """The values of the model's path constraints (3), at most 0 where they are met."""
    return tuple(
        Port(
            f"diagnostics.constraint.{v.name}",
            f"{v.description or v.name}, at the estimate of the last sample: met up to 0",
            v.unit,
            nominal=v.nominal,
            variability="discrete",
        )
        for v in model.constraints
    )


def constants(N: int, L: int, segments: int, sample_time: float) -> tuple[Port, ...]:
    """The observer's structure, `structure.*`, and the paper's bound, as constants."""

    def structure(name: str, text: str, value: int) -> Port:
        return Port(f"structure.{name}", text, start=value, kind="Integer", variability="constant", local=True)

    return (
        Port("sample_time", "sample time", "s", sample_time, variability="constant", local=True),
        structure("N", "order of the polynomial", N),
        structure("L", "length of the window in sample intervals", L),
        structure("segments", "segments of the window, each with a polynomial of its own", segments),
        Port(
            "diagnostics.node0_bound",
            "(N - 1)^(3/2 - m), m = 2: the bound on node0_residual",
            start=float((N - 1) ** (1.5 - SMOOTHNESS)),  # (17), (20)
            variability="constant",
            local=True,
        ),
    )
