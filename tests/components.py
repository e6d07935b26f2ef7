"""The components that several rooms' tests drive as FMUs, by the names under which the fixtures `built` and `slave` know them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import linear_models
import moving_window
from build_fmus import FMUS
from observers.component import Component
from observers.least_squares import least_squares
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.ukf import ukf
from reference_models.duffing import DUFFING
from reference_models.gong_2007 import rlc
from reference_models.plant import plant
from toys import double_toy, draining_toy, feedthrough_toy, growing_toy, guarded_toy, sampled_toy

MOVED = Model(
    name="moved",
    states=[Variable("s", "position", "m"), Variable("v", "speed", "m/s")],
    outputs=[Variable("y", "measured position", "m")],
    ode=lambda x, u, p, t: [x.v, -x.s],
    output=lambda x, u, p, t: [x.s],
)
COMPONENTS: dict[str, Callable[[], Component]] = {
    "sampled_toy": sampled_toy,
    "feedthrough_toy": feedthrough_toy,
    "growing_toy": growing_toy,
    "double_toy": double_toy,
    "draining_toy": draining_toy,
    "guarded_toy": guarded_toy,
    "rlc": rlc,
    "duffing": lambda: plant(DUFFING, jumps={"theta": 2}),
    "duffing_segments": lambda: pseudospectral(DUFFING, sample_time=0.1, N=7, L=8, segments=4, name="duffing_segments"),
    "linear_arrival": lambda: pseudospectral(
        moving_window.linear(),
        sample_time=0.1,
        N=10,
        L=4,
        segments=2,
        arrival_cost=True,
        measurement_noise={"y1": 0.3, "y2": 0.5},
        name="linear_arrival",
    ),
    "linear_noise": lambda: pseudospectral(
        moving_window.linear(disturbed=True),
        sample_time=0.1,
        N=5,
        L=4,
        segments=4,
        arrival_cost=True,
        measurement_noise={"y1": 0.3, "y2": 0.5},
        process_noise={"x2": 0.5, "d": 0.8},
        name="linear_noise",
    ),
    "rotation_bounded": lambda: pseudospectral(
        moving_window.rotation(), sample_time=0.2, N=12, L=10, name="rotation_bounded"
    ),
    "rotation_with_sign": lambda: pseudospectral(
        moving_window.rotation_with_sign(), sample_time=0.2, N=12, L=10, name="rotation_with_sign"
    ),
    "duffing_missing_ukf": lambda: ukf(DUFFING, sample_time=0.1, measurement_noise={"y": 1e-3}, name="duffing_ukf"),
    **{name: FMUS[name][0] for name in ("motor_canonical_dae", "van_der_pol_known_elementary")},
    "moved_riccati": lambda: riccati(
        MOVED, sample_time=0.1, process_noise={"v": 0.3}, measurement_noise={"y": 0.2}, initial_std={"s": 2.0}
    ),
    "moved_least_squares": lambda: least_squares(MOVED, sample_time=0.1, T=0.5, measurement_noise={}, initial_std={}),
    "linear_3_least_squares": lambda: linear_models.least_squares(3),
    **{f"linear_{n}_riccati": partial(linear_models.riccati, n) for n in range(1, linear_models.LARGEST + 1)},
}
# Of these tests ask what they estimate, to some digits: optimisation, which takes long for them, changes the last bits at most.
STRAIGHT = {
    "linear_arrival",
    "linear_noise",
    "rotation_bounded",
    "rotation_with_sign",
    "motor_canonical_dae",
    "van_der_pol_known_elementary",
    "moved_riccati",
    "moved_least_squares",
    *(f"linear_{n}_riccati" for n in range(4, linear_models.LARGEST + 1)),
}
