"""The convergence certificates of James & Baras 1987, section 3 and (2.3), (2.6): how far off a guess may be, and the guaranteed rate.

Upper bounds are rounded up, lower bounds down (`suprema`): the constants are theorems about the continuous-time observer, hence
about the sampled one in the limit Ts -> 0, for known parameters at their start values.

What deviates from the paper, and why:
- (3.8), the bound p of |P|, is wrong as printed (it gives p < |P0|). Comparing P with a scalar Riccati equation gives
  p = max(|P0|, (a + sqrt(a^2 + r0 |H|^2)) / r0), a = sup lmax(-(A + A') / 2).
- (3.7), the bound q of |Q|, is valid; comparison gives the tighter max(|Q0|, (|N|^2 + |Lambda|^2) / (2 alpha0)). Both are here. Where A is
  not negative across what no output sees at an instant, (3.3) is shown in other coordinates (`detectability`).
- Where H has full column rank, q comes from (3.4) by comparison, as p does, instead of from Corollary 3.1, which is wrong as (3.8) is.
- The proofs of section 4 bound V = e' P e by V' <= -d |e|^2, d = r0 / q^2 - sqrt(V) C or delta, and use |e|^2 >= V / p: the rate d / (2 p).
  But e' P N N' P e >= (r0 / q) V, and the other terms are at most (r0 / q^2 - d) q V: hence V' <= -q d V, the rate q d / 2, faster by
  the factor p q.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from typing import Any

import casadi as ca
import numpy as np

from observers.component import Enumeration, Port
from observers.numerics.exact import in_high_precision, matrix, rounded, table
from observers.riccati.design import UNKNOWN
from observers.riccati.detectability import by_comparison, by_full_rank, by_injection
from observers.riccati.interval import Range
from observers.riccati.suprema import Suprema, downward, largest, norm, point, supremum, upward

LIFT = 1 + 1e-14  # covers the rounding of a few operations on scalars

CERTIFICATE = Enumeration(
    "RiccatiCertificate",
    (
        (
            "none",
            "there are no finite bounds, or a changed parameter, a sample that is missing or rejected, or an excursion made them void",
        ),
        ("outside", "the guess may lie outside rho: no promise"),
        ("inside", "the guess lies inside rho: the error decays at least with guaranteed_rate"),
        ("anywhere", "delta > 0: the error decays at least with guaranteed_rate from any guess"),
    ),
)
NONE, OUTSIDE, INSIDE, ANYWHERE = 1, 2, 3, 4
CERTIFIED = (
    Port(
        "diagnostics.certified",
        "is convergence guaranteed from the guess? (of the continuous-time observer, the limit of fast sampling)",
        kind="Enumeration",
        start=1,
        enumeration=CERTIFICATE,
        variability="discrete",
    ),
    Port(
        "diagnostics.guaranteed_rate",
        "guaranteed exponential decay of the error (of the continuous-time observer); 0: none",
        "1/s",
        variability="discrete",
    ),
)


@dataclass(frozen=True)
class Certificate:
    """The paper's constants; infinite (or for alpha0 negative, for rho zero) where there is none.

    A, H, Dh, D2f, D2h: suprema of spectral norms. alpha0, s: of (3.3) with Lambda = -s H'. p, q: bounds of |P|, |Q| by comparison,
    q_paper by (3.7). C: the bracket of (2.3). rho, delta: (2.3), (2.6) with q; rho_paper, delta_paper with q_paper. obstacle: why there is
    no q, or "". low, high: bounds of (m, u).
    """

    A: float
    H: float
    Dh: float
    D2f: float
    D2h: float
    alpha0: float
    s: float
    r0: float
    P0: float
    p: float
    q: float
    q_paper: float
    C: float
    rho: float
    rho_paper: float
    delta: float
    delta_paper: float
    obstacle: str
    low: np.ndarray
    high: np.ndarray
    n: int

    @property
    def exists(self) -> bool:
        return math.isfinite(self.q) and math.isfinite(self.p)

    def slack(self, distance: Any) -> Any:
        """r0 / q^2 - |P0^1/2| |e0| C of Theorem 2.1 for a guess `distance` off, a number or a CasADi expression."""
        return self.r0 / self.q**2 - math.sqrt(self.P0) * self.C * distance

    def rate(self, distance: Any) -> Any:
        """The guaranteed rate [1/s], 0: none, where the certificate exists: q / 2 times the slack, or times delta (Corollary 2.1)."""
        return ca.fmax(self.slack(distance), max(self.delta, 0.0)) * self.q / 2

    def distance(self, guess: Any, initial_error: Any) -> Any:
        """The largest |x0 - m0| that bounds and `initial_error` leave, for a CasADi column `guess`."""
        low, high = self.low[: self.n], self.high[: self.n]
        if not np.all(np.isfinite([low, high])):
            return initial_error
        return ca.fmin(initial_error, ca.norm_2(ca.fmax(guess - ca.DM(low), ca.DM(high) - guess)))

    def inside(self, m: Any, u: Any) -> Any:
        """1 where (m, u) lies in the region that the bounds were computed for."""
        value = ca.vertcat(m, u)
        result = ca.MX(1)
        for i in range(len(self.low)):
            if np.isfinite(self.low[i]):
                result = ca.logic_and(result, value[i] >= self.low[i])
            if np.isfinite(self.high[i]):
                result = ca.logic_and(result, value[i] <= self.high[i])
        return result

    def rows(self) -> list[tuple[str, str, float]]:
        """(name, meaning, value) of everything worth printing."""
        return [
            ("A", "sup |A|, A = Df", self.A),
            ("H", "sup |H|, H = R^-1 Dh", self.H),
            ("D2f", "sup |D2f|", self.D2f),
            ("D2h", "sup |D2h|", self.D2h),
            (
                "alpha0",
                "alpha0 of (3.3) with Lambda = -s H'; where it is not positive q comes from other coordinates",
                self.alpha0,
            ),
            ("s", "s of that Lambda", self.s),
            ("p", "bound of |P|, by comparison", self.p),
            ("q", "bound of |Q|, by comparison", self.q),
            ("q_paper", "bound of |Q| by (3.7)", self.q_paper),
            ("rho", "radius of convergence (2.3)", self.rho),
            ("rho_paper", "radius of convergence (2.3) with q of (3.7)", self.rho_paper),
            ("delta", "delta of (2.6); positive: convergence from any guess", self.delta),
            ("delta_paper", "delta of (2.6) with q of (3.7)", self.delta_paper),
        ]

    def html(self) -> str:
        """The constants as a paragraph and a table, and what stands in the way where there is no q."""
        lines = "".join(
            f"<tr><td>{name}</td><td>{what}</td><td>{value:.6g}</td></tr>" for name, what, value in self.rows()
        )
        return (
            "<p>Certificates, by interval arithmetic over the model's bounds at the start values of its parameters and of the tuning, "
            f"for the limit of fast sampling; infinite where there is no bound:</p><table>{lines}</table>"
            + (f"<p>There is no certificate: {escape(self.obstacle)}.</p>" if self.obstacle else "")
        )


def certificate_of(over: Suprema, N: np.ndarray, R: np.ndarray) -> Callable[[np.ndarray], Certificate]:
    """certificate(Q0) of a model with the design matrices N, R, Q0; what Q0 has no part in is computed once."""
    R_inverse = _inverse(R)
    pairs = [(c.A, Range(R_inverse @ c.Dh.middle, abs(R_inverse) @ c.Dh.radius)) for c in over.cells]
    A, Dh, D2f, D2h, a = over.A, over.Dh, over.D2f, over.D2h, over.a
    H = supremum(norm(h) for _, h in pairs)
    NN = point(N @ N.T)
    r0 = max(downward(-largest(Range(-NN.middle, NN.radius))), 0.0)
    growth = (a + math.sqrt(a**2 + r0 * H**2)) / r0 * LIFT if math.isfinite(a) and r0 > 0 else math.inf
    s, alpha0, forcing = by_injection(pairs, A, H, upward(norm(NN)))
    compared = by_comparison(pairs, A, N)
    full_rank = by_full_rank(pairs, norm(NN)) if len(R) >= len(N) else math.inf
    R1 = norm(point(R_inverse)) ** 2

    def certificate(Q0: np.ndarray) -> Certificate:
        Q0_norm, least = upward(largest(point(Q0))), -largest(point(-Q0))
        P0 = upward(1 / least) if least > 0 else math.inf
        p = upward(max(P0, growth))
        q = min(max(Q0_norm, min(forcing, full_rank)), compared(Q0))
        q_paper = upward(Q0_norm + forcing)
        obstacle = over.obstacle
        if not (obstacle or math.isfinite(q)):
            obstacle = "uniform detectability was not found, neither (3.3) with Lambda = -s H' nor in other constant coordinates"
        if not (obstacle or math.isfinite(p)):
            obstacle = "N N' or Q0 is singular to working precision"

        def bracket(q: float) -> float:
            return upward((_times(math.sqrt(p), D2f) + _times(math.sqrt(q) * R1, _times(Dh, D2h))) * LIFT)

        def rho(q: float) -> float:
            if not (math.isfinite(p) and math.isfinite(q)):
                return 0.0
            return downward(r0 / (q**2 * math.sqrt(P0)) / bracket(q) / LIFT) if bracket(q) else math.inf

        def delta(q: float) -> float:
            against = (4 * p * A if D2f else 0.0) + (4 * R1 * Dh**2 if D2h else 0.0)
            return downward(r0 / q**2 / LIFT - against * LIFT)

        return Certificate(
            A=A, H=H, Dh=Dh, D2f=D2f, D2h=D2h, alpha0=alpha0, s=s, r0=r0, P0=P0, p=p, q=q, q_paper=q_paper, C=bracket(q),
            rho=rho(q), rho_paper=rho(q_paper), delta=delta(q), delta_paper=delta(q_paper), obstacle=obstacle,
            low=over.low, high=over.high, n=over.n,
        )  # fmt: skip

    return certificate


def certify(known: Certificate, distance: Any, holds: Any) -> tuple[Any, Any]:
    """(diagnostics.certified, diagnostics.guaranteed_rate) for a guess at most `distance` off; `holds` = 0 makes both void."""
    if not known.exists:
        return ca.MX(NONE), ca.MX(0)
    code = ca.if_else(known.slack(distance) > 0, INSIDE, OUTSIDE)
    if known.delta > 0 or known.C == 0:
        code = ca.MX(ANYWHERE)
    return ca.if_else(holds, code, NONE), ca.if_else(holds, known.rate(distance), 0)


def certificate_ports(known: Certificate) -> tuple[Port, ...]:
    """The constants as `certificate.*`; what is infinite as 1e30."""
    return tuple(
        Port(f"certificate.{name}", what, start=max(min(value, UNKNOWN), -UNKNOWN), variability="constant", local=True)
        for name, what, value in known.rows()
    )


def _times(a: float, b: float) -> float:
    """a b, and 0 where one of them is 0 and the other infinite: the term is not there."""
    return 0.0 if a == 0 or b == 0 else a * b


@in_high_precision
def _inverse(M: np.ndarray) -> np.ndarray:
    return rounded(table(matrix(M).inv()))
