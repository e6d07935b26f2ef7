"""The canonical DAE observer of Nikoukhah, "A new methodology for observer design and implementation", INRIA RR-2677, 1995.

    x' = f(x, u) + h_x(x)' lambda' + Gamma(x, u) lambda     (2.10)
     0 = y - h(x)                                           (2.11)

x is the estimate; lambda, the relaxation, goes to zero with its error and is a residual: it stays away from zero where the measurements
and the model contradict each other. `dae` holds the equations, `dae_gain` the choice of Gamma (section 3), `dae_steps` the integration.

What deviates from the paper, and why:
- The w-form, w = x - h_x' lambda, w' = f + Gamma lambda for a constant h_x, is the same DAE as an ODE of w; x and lambda follow from
  w and (2.11). Classical Runge-Kutta steps it from sample to sample, y between them on a polynomial through the last few. Where h_x
  moves, a half-explicit Runge-Kutta method does, free of y' as well. The paper's BDF is there too (`form="bdf"`).
- (5.5) to (5.7) have a wrong sign in the third entry (one eigenvalue would be +2.19); Gamma is made by automatic differentiation.
  (2.58) and the Gamma block of (4.4) are misprinted as well.
- Divisions of the gain are guarded where the pair (C, A) is not observable; such samples are counted.
- Unknown inputs, the report's outlook: see `dae`. Unknown parameters are states with zero rate.
- Between samples the estimate follows the model: `filtered.*` satisfies (2.11), `estimate.*` is its prediction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import casadi as ca
from numpy.typing import ArrayLike

from observers import judgement, ports
from observers.arguments import checked
from observers.canonical_dae import fault_detector, sample
from observers.canonical_dae.bdf import MOST
from observers.canonical_dae.dae import Dae, relaxed
from observers.canonical_dae.gain import Design, choose, reduced_pair
from observers.canonical_dae.interpolation import HIGHEST
from observers.canonical_dae.ports import SINGULAR, disturbances, documentation, lambdas, structure
from observers.canonical_dae.region import Region, region
from observers.canonical_dae.stability import spectrum
from observers.component import Component
from observers.linearisation import prediction_step
from observers.model import Model
from observers.numerics.runge_kutta import CLASSICAL_4
from observers.refusal import not_imposed, refuse, refuse_opaque

FASTEST = 10.0  # [1/s]: where the poles are by default


@checked
def canonical_dae(
    model: Model,
    *,
    sample_time: float,
    gain: str | Design = "exact",
    poles: Sequence[complex] | None = None,
    alpha: float = 10.0,
    X: ArrayLike | None = None,
    form: str = "w",
    order: int = 2,
    degree: int = 3,
    measurement_noise: Mapping[str, float] | None = None,
    guess: Mapping[str, float] | None = None,
    name: str | None = None,
    max_step: float = 0.01,
    stop_time: float = 10.0,
) -> Component:
    """The observer for `model` as a component: measurements and known inputs in, `estimate.*` and `diagnostics.lambda` out.

    Args:
        sample_time: start value of the fixed parameter `sample_time`, Ts [s].
        gain: "exact" places all eigenvalues of the linearised error dynamics (3.17)-(3.22), "regional" shifts them left of -alpha by the
            Riccati equation (3.25), (3.26); or a function `(x, u, p, t)` that returns the rows of Gamma (n x p), written like the model. As
            `(x, u, p, t, lam)` it gives Gamma that depends on lambda (a column) too, and v = Gamma lambda of (2.4) in general.
        poles: for "exact", the eigenvalues [1/s], one for each state (less the unknown disturbances), real or in conjugate pairs; -10 each
            if absent. Tunable.
        alpha, X: for "regional", the decay rate [1/s] and X, its diagonal or all of it (p - q x p - q); the identity if absent. Tunable.
        form: "w" (Runge-Kutta on the w-form) or "bdf" (the paper's section 4).
        order: of the backward differentiation, 1 to 6.
        degree: of the polynomial through past measurements that the w-form takes between samples, 1 to 9. A higher one follows faster
            signals and amplifies noise near half the sampling frequency.
        measurement_noise: start values of `tuning.measurement_noise.<output>`, the standard deviation of a sample, by which innovations are
            judged; a thousandth of the nominal value if absent.
        guess: start values of `guess.*` that differ from the model's. The first sample projects it onto h(x) = y.
        name: the component's name; `<model>_canonical_dae` if absent.
        max_step: the longest prediction step [s] (classical Runge-Kutta); shortened as `prediction_step` says.
        stop_time: of the default experiment [s].

    Raises:
        ModelError: algebraic variables; outputs that a held input moves other than by a sum; unknown disturbances with which the DAE's
            index is not 1; at a point of the model's region that is named, outputs that are not independent, states that are not
            observable and do not decay as fast as the gain promises, or linearised error dynamics that are not stable.
        ValueError: an option out of range.
    """
    refuse(model, "canonical_dae", "algebraic")
    refuse_opaque(model, "canonical_dae")
    period = ports.sample_time("canonical_dae", sample_time)
    if form not in ("w", "bdf"):
        raise ValueError(f"canonical_dae: form = {form!r} must be 'w' or 'bdf'")
    if not 1 <= order <= MOST:
        raise ValueError(f"canonical_dae: order = {order} must be 1 to {MOST}")
    if not 1 <= degree <= HIGHEST:
        raise ValueError(f"canonical_dae: degree = {degree} must be 1 to {HIGHEST}")
    dae, checked = relaxed(model), region(model)
    # How far left what no gain moves must lie: exact placement leaves nothing, a given gain is asked for stability.
    _check(dae, checked, math.inf if gain == "exact" else alpha if gain == "regional" else 0.0)
    chosen = choose(model, dae, checked, gain, poles, alpha, X)
    stable = spectrum(dae, chosen, checked)

    method = sample.Method(model, dae, chosen, form == "bdf", order, degree)
    # Without a relaxation there is no residual to watch.
    detector = fault_detector.tuning(_rate(gain, poles, alpha), sample_time) if dae.n_lambda else ()
    return Component(
        name=name or f"{model.name}_canonical_dae",
        description=f"Canonical DAE observer for {model.name} (Nikoukhah 1995), {chosen.description}",
        start=sample.start(method),
        flow=sample.flow(method),
        jump=sample.jump(method),
        output=sample.output(method),
        inputs=(*ports.inputs(model), *ports.validity(model)),
        parameters=(
            *ports.guesses(model, guess or {}),
            *ports.known_parameters(model),
            period,
            *chosen.tuning,
            *detector,
            *judgement.tuning("canonical_dae", model, measurement_noise, 1e-3),
        ),
        outputs=(
            *ports.estimates(model),
            *disturbances(model),
            *ports.VERDICT,
            *lambdas(model, dae),
            *([fault_detector.PORT] if dae.n_lambda else []),
            *ports.innovations(model),
            SINGULAR,
            *ports.COUNTERS,
            ports.RESTARTS,
        ),
        constants=structure(form, order, degree),
        sample_time="sample_time",
        samples_inputs=True,
        max_step=prediction_step(model, max_step, CLASSICAL_4),
        stop_time=stop_time,
        step_size=sample_time,
        counters=(SINGULAR.name, *(port.name for port in (*ports.COUNTERS, ports.RESTARTS))),
        documentation=documentation(model, chosen, stable, form, order, degree) + not_imposed(model),
    )


def _rate(gain: str | Design, poles: Sequence[complex] | None, alpha: float) -> float:
    """How fast the slowest error of the design decays [1/s]; a given gain is taken for as fast as the default."""
    if gain == "regional":
        return alpha
    return min((-complex(pole).real for pole in poles), default=FASTEST) if gain == "exact" and poles else FASTEST


def _check(dae: Dae, checked: Region, left_of: float) -> None:
    """The assumptions of Theorem 3.2 at points of the region; (2.11) then has index 1 there (Lemma 2.1).

    The proof of Lemma 3.2 needs less than observability: what (C, A) hides must decay faster than exp(-left_of t) by itself.
    """
    at = dae.arguments
    checked.require_rank("canonical_dae", "h_x", ca.Function("C", at, [ca.densify(dae.C)]), dae.n_outputs)
    hidden = ", ".join(v.name for v in checked.model.unknown_disturbances)
    what = f"what the unknown disturbances ({hidden}) leave of (h_x, f_x)" if hidden else "(h_x, f_x)"
    pair = ca.Function("pair", at, [ca.densify(block) for block in reduced_pair(dae)])
    checked.require_detectable("canonical_dae", what, pair, left_of)
