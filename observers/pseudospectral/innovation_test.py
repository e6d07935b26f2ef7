"""Does the new sample fit the prediction? What it weighs if not, and what follows from a run of samples that do not.

The innovation's covariance is S = H P H' + R with the estimate's own P (`covariance`). Where the user has not said what the measurement
noise is, all of it has a common factor that is learned from the innovations themselves, slowly, and only while they are consistent.

A measurement farther than `tuning.gate` from its prediction is an outlier: it enters the window with a weight that falls with the square
of its distance, and its pull with the distance (Huber's weights, but redescending; within the gate the weight is 1, and nothing changes).
A run of them means that the estimate is wrong, not the sensor: then all samples of the window count again, the arrival cost is forgotten,
and where that does not help within three windows the observer starts again from the guess, then after twice as long, and so on. Where no
sample is as far off as an outlier, the arrival cost is forgotten only after a window of contradictions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from observers.numerics import algebraic, consistency, linear
from observers.numerics.finite import HUGE
from observers.pseudospectral import ports
from observers.pseudospectral.method import Method

LEARNT = 20  # samples after which the learned noise is used
MEMORY = 100  # samples that it is learned from
EARLY = 60  # samples, the first that the noise is learned from: what they learned may have been wrong
SLOWLY = 500  # the same while the samples are inconsistent: noise that has changed for good is believed in the end
SMALLEST = 1e-5  # noise that is learned, relative to the nominal value: below, it is the collocation's error
RUN = 2  # samples for which the tests of the last ones must fail: one outlier alone may let them
MOST_RESTARTS = 20  # doublings of the time until the next


@dataclass(frozen=True)
class Tested:
    """`weight` (ny) of the sample in the window; `outlier`, whether one has less than 1.

    `inconsistent`: whether the last samples contradict the estimate; `forgets`, `begins`: whether the past does not count therefore, and
    since this one, `restart`, whether it is time to start again from the guess. `settling`: consistent again, but not for long enough.
    `state`: what is kept.
    """

    weight: Any
    outlier: Any
    inconsistent: Any
    forgets: Any
    begins: Any
    restart: Any
    settling: Any
    state: dict[str, Any]


def state(method: Method) -> dict[str, int]:
    """Sizes of what is kept from sample to sample."""
    return {
        "tests": consistency.memory_size(method.problem.ny),
        "noise_factor": 1,
        "fit_factor": 1,
        "learnt": 1,
        "hush": 1,
        "doubt": 1,
        "trouble": 1,
        "heavy": 1,
        "quiet": 1,
        "forgetting": 1,
    }


def start() -> dict[str, Any]:
    """What of it does not start at 0."""
    return {"noise_factor": ca.DM(1), "fit_factor": ca.DM(1)}


def patience(method: Method) -> int:
    """Samples for which the tests must be quiet before the estimate is trusted again.

    The window's at least; with a longer memory all that the tests sum over, else what all but the longest of them do.
    """
    return max(method.samples + 1, consistency.WINDOWS[-1 if method.arrival else -2])


def tested(method: Method, now: Any, known: Any, gap: Any, valid: Any) -> Tested:
    """The test of a sample with the innovation `gap` (ny), of which `valid` (ny) count; `now` an `Instant`."""
    s, q, L = now.s, now.q, method.samples
    due = _due(method, s)
    spread = _doubtful(method, s)
    R = q.measurement_noise**2 if method.weighted else ca.DM(method.problem.output_scale**2)
    P = s.covariance
    if not method.weighted:
        # That of the fit, in units of the last window's own noise.
        P = P * (method.problem.segment.sample_time / ca.fmax(s.fit_noise, 1e-300))
    squared, normalised = _normalised(method)(gap, valid, P, R, s.x, known, q.model, s.theta, now.t, s.z)
    alone = squared / ca.fmax(ca.sum1(valid), 1)
    squared, normalised = squared / (s.noise_factor * spread), normalised / ca.sqrt(s.noise_factor * spread)
    found = consistency.tested(s.tests, squared, normalised, ca.logic_and(valid, due), q.false_alarm)
    lately = ca.logic_and(due, ca.logic_or(found.lately, s.heavy))
    doubt = ca.if_else(due, ca.if_else(lately, s.doubt + 1, 0), s.doubt)
    inconsistent = doubt >= RUN
    times = [3 * (L + 1) * 2**i for i in range(MOST_RESTARTS)]
    # Samples that contradict the estimate since it was last trusted.
    trouble = ca.if_else(ca.logic_or(s.quiet > 0, inconsistent), s.trouble + lately, 0)
    recovers = q.gate < ports.NO_GATE
    restart = ca.logic_and(recovers, ca.logic_and(lately, ca.sum1(trouble == ca.DM(times))))
    quiet = ca.fmax(s.quiet - 1, ca.if_else(inconsistent, patience(method), 0))
    quiet = ca.if_else(restart, L + 1 + consistency.WINDOWS[-1], quiet)
    # Where the estimate is not trusted, no sample is judged by it.
    limit = q.gate**2
    far = ca.logic_and(valid, ca.logic_not(normalised**2 <= limit))
    lighter = ca.logic_and(ca.logic_and(due, quiet == 0), far)
    weight = ca.if_else(lighter, ca.fmin(limit / normalised**2, 1), 1)
    weight = ca.if_else(ca.fabs(weight) <= 1, weight, 0)
    # A model that is a little wrong contradicts some samples slightly now and then: what was learned from the others is worth more.
    forgets = ca.logic_and(ca.logic_and(recovers, inconsistent), ca.logic_or(ca.sum1(far) > 0, doubt > L))
    begins = ca.logic_and(forgets, ca.logic_not(s.forgetting))
    kept = {
        # After a window all samples are newer than the contradiction: what lasts shows itself again.
        "tests": ca.if_else(ca.logic_and(due, doubt <= L), found.memory, 0),
        "doubt": doubt,
        "trouble": trouble,
        "quiet": quiet,
        "forgetting": forgets,
        **_learned(method, s, alone, valid, inconsistent),
    }
    outlier = ca.sum1(weight < 1) > 0
    return Tested(weight, outlier, inconsistent, forgets, begins, restart, quiet > 0, kept)


def unit(method: Method, s: Any) -> Any:
    """What a covariance is in units of, by the state `s`: 1, or where nobody has said what the noise is, the factor learned so far."""
    if not method.weighted or method.noise_given:
        return 1
    return ca.if_else(s.learnt >= LEARNT, s.noise_factor, 1)


def unknown_noise(method: Method, s: Any) -> Any:
    """Whether no deviation means anything yet."""
    return s.learnt < LEARNT if method.weighted and not method.noise_given else 0


def fit_tested(method: Method, now: Any, W: Any, cost: Any, accepted: Any, inconsistent: Any) -> tuple[Any, Any]:
    """Whether the residual of a fit that was `accepted` is larger than the measurement noise lets it be, and what `fit_factor` becomes.

    `cost` is the square of the residual of the samples weighted by `W`. Where nobody has said what the measurement noise is, it is compared
    with what it usually is: of the factor of the innovations a part is the process noise's.
    """
    s, problem = now.s, method.problem
    dof = ca.fmax(ca.sum1(W > 0) - (0 if method.arrival else len(problem.scale)), 1)
    mean = cost / (dof * problem.segment.sample_time)
    limit = consistency.chi_square_quantile(dof, now.q.false_alarm) / dof * s.fit_factor * _doubtful(method, s)
    heavy = ca.logic_and(accepted, ca.logic_and(_due(method, s), mean > limit))
    counts = ca.logic_and(accepted, ca.logic_and(s.k > method.samples, mean < HUGE))
    return heavy, _followed(method, s, s.fit_factor, mean, counts, ca.logic_or(inconsistent, heavy))


def _due(method: Method, s: Any) -> Any:
    """Whether there is something to judge by: a full window, and a noise."""
    return ca.logic_and(s.k > method.samples, ca.logic_or(method.noise_given, s.learnt >= LEARNT))


def _doubtful(method: Method, s: Any) -> Any:
    """By how much the noise that is learned may be too small."""
    return 1.0 if method.noise_given else 1 + 2 * ca.sqrt(2 / ca.fmax(s.learnt * method.problem.ny, 1))


def _learned(method: Method, s: Any, alone: Any, valid: Any, inconsistent: Any) -> dict[str, Any]:
    """The factor of all noise, from the innovations' mean square `alone` in units of their covariance.

    What was learned from a start that went wrong, and finds all samples since far quieter, is learned again.
    """
    counts = ca.logic_and(s.k > method.samples, ca.logic_and(ca.sum1(valid) > 0, alone < HUGE))
    factor = _followed(method, s, s.noise_factor, alone, counts, inconsistent)
    if method.noise_given or not method.weighted:
        return {"noise_factor": factor, "learnt": s.learnt + (0 if method.noise_given else counts), "hush": s.hush}
    hush = consistency.hushed(s.hush, alone, s.noise_factor, counts)
    again = ca.logic_and(hush >= consistency.HUSHED, s.learnt < EARLY)
    return {
        "noise_factor": factor,
        "learnt": ca.if_else(again, 0, s.learnt + counts),
        "hush": ca.if_else(again, 0, hush),
    }


def _followed(method: Method, s: Any, factor: Any, value: Any, counts: Any, inconsistent: Any) -> Any:
    """A factor of the noise that follows the `value` of a sample that `counts`, slowly while the samples are inconsistent."""
    if method.noise_given:
        return factor
    gain = ca.if_else(inconsistent, 1 / SLOWLY, ca.fmax(1 / (s.learnt + 1), 1 / MEMORY))
    clipped = ca.if_else(s.learnt < LEARNT, value, ca.fmin(value, 10 * factor))
    return ca.if_else(counts, ca.fmax(factor + gain * (clipped - factor), SMALLEST**2), factor)


def _normalised(method: Method) -> ca.Function:
    """(nu, valid, P, R's diagonal, x, u, p, theta, t, z) -> (nu' S^-1 nu, nu_i / sqrt(S_ii)) over the valid outputs."""
    problem = method.problem
    nx, ns, ny = problem.nx, len(problem.scale), problem.ny
    measure = algebraic.measurement(method.equations)
    gap, valid, P, R = ca.SX.sym("gap", ny), ca.SX.sym("valid", ny), ca.SX.sym("P", ns * ns), ca.SX.sym("R", ny)
    m = ca.SX.sym("m", ns)
    rest = [ca.SX.sym(measure.name_in(i), measure.numel_in(i)) for i in (1, 2, 4, 5)]
    theta = m[nx:] if ns > nx else ca.SX(0, 1)
    expected, _ = measure(m[:nx], rest[0], rest[1], theta, rest[2], rest[3])
    H = ca.densify(ca.jacobian(expected, m))
    S = ca.mtimes([H, ca.reshape(P, ns, ns), H.T]) + ca.diag(R)
    # Outputs that do not count are independent of the others, and without an innovation.
    mask = ca.mtimes(valid, valid.T)
    S = ca.if_else(mask, S, ca.diag(R))
    nu = ca.if_else(valid, gap, 0)
    whitened = linear.qr_solve(S, nu) if ny > 1 else nu / S
    x, theta_in = ca.SX.sym("x", nx), ca.SX.sym("theta", ns - nx)
    values = ca.substitute([ca.dot(nu, whitened), nu / ca.sqrt(ca.diag(S))], [m], [ca.vertcat(x, theta_in)])
    arguments = [gap, valid, P, R, x, rest[0], rest[1], theta_in, rest[2], rest[3]]
    return ca.Function("normalised_innovation", arguments, values, {"cse": True})
