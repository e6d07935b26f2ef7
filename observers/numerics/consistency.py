"""Do the innovations look like what the filter believes of them? Chi-square tests, of each sample and of the last few.

With innovation nu (ny) of covariance S, two things are compared with their quantiles at a probability of false alarm a test:

    the normalised innovation squared nu' S^-1 nu, chi-square with ny degrees of freedom, of the sample alone and summed with weights
        lam^i over the past, which finds too much noise, wrong signs, jumps;
    the normalised innovations nu_i / sqrt(S_ii) themselves, summed in the same way, which finds a bias: offset, drift, a slow model error.

A geometric weight lam = (n - 1) / (n + 1) is as good as the last n samples: the weighted sum has the mean and the variance of
(D2 / D1) chi-square with D1^2 / D2 degrees of freedom, D1 = sum lam^i d_i, D2 = sum lam^(2 i) d_i (Satterthwaite), so that missing
samples and several outputs need no table. A single absurd sample is clipped before it enters the sums, so that they find runs of them and
forget one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from observers.numerics.finite import finite

WINDOWS = (5, 20, 60)  # samples
# Samples in a row whose mean of nu' S^-1 nu is below a quarter of what was learned: of Gaussian ones one in five million.
HUSHED, HUSH = 16, 0.25


def hushed(count: Any, value: Any, usual: Any, there: Any) -> Any:
    """How many samples in a row were far quieter than usual: `count` until now, then one of `value`, if it is `there` at all.

    Where the usual is no louder than the design took the noise to be, 1, nothing loud was learned: exact samples grow quieter for long.
    """
    return ca.if_else(there, ca.if_else(ca.logic_and(usual > 1, value < HUSH * usual), count + 1, 0), count)


def chi_square_quantile(dof: Any, false_alarm: Any) -> Any:
    """What a chi-square variable with `dof` degrees of freedom (any number above 0) exceeds with probability `false_alarm`.

    Wilson & Hilferty, PNAS 17, 1931. At 1e-4 it is 7 % too large for one degree of freedom, 2 % for 5, 0.2 % for 60.
    """
    return dof * ca.fmax(1 - 2 / (9 * dof) + normal_quantile(false_alarm) * ca.sqrt(2 / (9 * dof)), 0) ** 3


def normal_quantile(false_alarm: Any) -> Any:
    """What a standard normal variable exceeds with probability `false_alarm` <= 0.5, to 4.5e-4 (Abramowitz & Stegun 26.2.23)."""
    t = ca.sqrt(-2 * ca.log(false_alarm))
    above, below = 2.515517 + t * (0.802853 + t * 0.010328), 1 + t * (1.432788 + t * (0.189269 + t * 0.001308))
    return t - above / below


@dataclass(frozen=True)
class Tested:
    """`memory` after the sample; `alone` whether it is too far by itself, `lately` whether the last ones are, together."""

    memory: Any
    alone: Any
    lately: Any


def memory_size(ny: int) -> int:
    """Length of what is kept from sample to sample; it starts at 0, and a restart sets it to 0 again."""
    return len(WINDOWS) * (3 + 2 * ny)


def tested(memory: Any, squared: Any, normalised: Any, valid: Any, false_alarm: Any) -> Tested:
    """The tests of one sample.

    Args:
        memory: `memory_size(ny)`, of the last sample.
        squared: nu' S^-1 nu over the valid outputs; not finite counts as far too large.
        normalised: nu_i / sqrt(S_ii) (ny); only the valid ones count.
        valid: (ny), which outputs were measured.
        false_alarm: probability of a false alarm, of each test.
    """
    ny = normalised.numel()
    dof = ca.sum1(valid)
    some = dof > 0
    limit = chi_square_quantile(ca.fmax(dof, 1), false_alarm)
    readable = finite(squared)
    alone = ca.logic_and(some, ca.logic_not(ca.logic_and(readable, squared <= limit)))
    clipped = ca.if_else(some, ca.if_else(alone, limit, squared), 0)
    bound = ca.sqrt(chi_square_quantile(1, false_alarm))
    signed = ca.if_else(finite(normalised), ca.fmax(ca.fmin(normalised, bound), -bound), 0)
    signed = ca.if_else(valid, signed, 0)
    after, lately = [], 0
    for i, n in enumerate(WINDOWS):
        lam = (n - 1) / (n + 1)
        old = memory[i * (3 + 2 * ny) : (i + 1) * (3 + 2 * ny)]
        total = lam * old[0] + clipped
        D1, D2 = lam * old[1] + dof, lam**2 * old[2] + dof
        sums, weights = lam * old[3 : 3 + ny] + signed, lam**2 * old[3 + ny :] + valid
        # With one sample the sums say what the sample alone does; without any they say nothing.
        enough = D1 > 1
        effective = ca.if_else(enough, D1**2 / ca.fmax(D2, 1e-30), 1)
        heavy = total * D1 > D2 * chi_square_quantile(effective, false_alarm)
        biased = ca.sum1(sums**2 > weights * bound**2) > 0
        lately = ca.logic_or(lately, ca.logic_and(enough, ca.logic_or(heavy, biased)))
        after += [total, D1, D2, sums, weights]
    return Tested(ca.vertcat(*after), alone, lately)
