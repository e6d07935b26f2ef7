"""The convergence certificates of James & Baras 1987, section 3 and (2.3), (2.6): how far off a guess may be, and the guaranteed rate.

The suprema of |A|, |H|, ... are bounded by interval arithmetic over the model's bounds (states, unknown parameters, inputs, all times;
known parameters at their start values), cell by cell; eigenvalues of the cells' matrices in doubles, rounded to nine digits: that is the
margin.

What deviates from the paper, and why:
- (3.8), the bound p of |P|, is wrong as printed (it gives p < |P0|). Comparing P with a scalar Riccati equation gives
  p = max(|P0|, (a + sqrt(a^2 + r0 |H|^2)) / r0), a = sup lmax(-(A + A') / 2).
- (3.7), the bound q of |Q|, is valid; comparison gives the tighter max(|Q0|, (|N|^2 + |Lambda|^2) / (2 alpha0)). Both are here.
- The paper leaves Lambda of (3.3) to the designer. Lambda = -s H' is tried, s >= 0 chosen for the smallest q; s = 0 where A is negative.
- Where H has full column rank, q comes from (3.4) by comparison, as p does, instead of from Corollary 3.1.
- They hold for the continuous-time observer: for the sampled one in the limit Ts -> 0.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from observers.component import Enumeration, Port
from observers.linearisation import Linearisation
from observers.model import Model, Variable
from observers.numerics.interval import IntervalError, Range, interval, ranges
from observers.tuning import UNKNOWN

CELLS = 256  # into which the bounded region is cut, at most
DIGITS = 9  # to which the suprema are rounded: LAPACK's last bits depend on the machine
GAINS = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 121)])  # s of Lambda = -s H', times |A| / |H|^2

CERTIFICATE = Enumeration(
    "RiccatiCertificate",
    (
        (
            "none",
            "there are no finite bounds, or a changed parameter, a rejected sample or an excursion made them void",
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
        "is convergence guaranteed from the guess?",
        kind="Enumeration",
        start=1,
        enumeration=CERTIFICATE,
        variability="discrete",
    ),
    Port(
        "diagnostics.guaranteed_rate",
        "guaranteed exponential decay of the error; 0: none",
        "1/s",
        variability="discrete",
    ),
)


@dataclass(frozen=True)
class Certificate:
    """The paper's constants; infinite (or for alpha0 negative, for rho zero) where there is none.

    A, H, Dh, D2f, D2h: suprema of spectral norms. alpha0, s: of (3.3) with Lambda = -s H'. p, q: bounds of |P|, |Q| by comparison, q_paper
    by (3.7). C: the bracket of (2.3). rho, delta: (2.3), (2.6) with q; rho_paper, delta_paper with q_paper. low, high: bounds of (m, u).
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
    low: np.ndarray
    high: np.ndarray
    n: int

    @property
    def exists(self) -> bool:
        return math.isfinite(self.q) and math.isfinite(self.p)

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
            ("alpha0", "alpha0 of (3.3); not positive: not uniformly detectable by Lambda = -s H'", self.alpha0),
            ("p", "bound of |P|, by comparison", self.p),
            ("q", "bound of |Q|, by comparison", self.q),
            ("q_paper", "bound of |Q| by (3.7)", self.q_paper),
            ("rho", "radius of convergence (2.3)", self.rho),
            ("rho_paper", "radius of convergence (2.3) with q of (3.7)", self.rho_paper),
            ("delta", "delta of (2.6); positive: convergence from any guess", self.delta),
            ("delta_paper", "delta of (2.6) with q of (3.7)", self.delta_paper),
        ]

    def html(self) -> str:
        lines = "".join(
            f"<tr><td>{name}</td><td>{what}</td><td>{value:.6g}</td></tr>" for name, what, value in self.rows()
        )
        return (
            "<p>Certificates, by interval arithmetic over the model's bounds at the start values of its parameters and of the tuning, "
            f"for the limit of fast sampling; infinite where there is no bound:</p><table>{lines}</table>"
        )


def certificate(model: Model, line: Linearisation, N: np.ndarray, R: np.ndarray, Q0: np.ndarray) -> Certificate:
    """The certificates of `model` (linearised: `line`) with the design matrices N, R, Q0."""
    cells = _cells(model, line)
    R_inverse = np.linalg.inv(R)
    gradients = [Range(R_inverse @ c[1].middle, abs(R_inverse) @ c[1].radius) for c in cells]
    A, Dh, H = (_sup(_norm(x) for x in xs) for xs in ([c[0] for c in cells], [c[1] for c in cells], gradients))
    D2f, D2h = (_sup(_bilinear(c[i]) for c in cells) for i in (2, 3))
    NN, r0 = _rounded(float(np.linalg.norm(N, 2)) ** 2), _rounded(np.linalg.eigvalsh(N @ N.T).min())
    first = np.linalg.eigvalsh(Q0)
    Q0_norm, P0 = _rounded(first.max()), _rounded(1 / first.min())
    a = _sup(_largest(Range(-c[0].middle, c[0].radius)) for c in cells)
    p = max(P0, (a + math.sqrt(a**2 + r0 * H**2)) / r0) if np.isfinite(a) else math.inf

    pairs = [(c[0], g) for c, g in zip(cells, gradients, strict=True)]
    s, alpha0, forcing = _detectability(pairs, A, H, NN)
    q = max(Q0_norm, forcing)
    rank = -_sup(-_smallest_gain(g) for g in gradients) if len(R) >= line.m.numel() else 0.0
    if rank > 0:
        growth = _sup(_largest(c[0]) for c in cells)
        q = min(q, max(Q0_norm, (growth + math.sqrt(growth**2 + rank**2 * NN)) / rank**2))
    q_paper = Q0_norm + forcing

    R1 = _rounded(float(np.linalg.norm(R_inverse, 2)) ** 2)

    def bracket(q: float) -> float:
        return _times(math.sqrt(p), D2f) + _times(math.sqrt(q) * R1, _times(Dh, D2h))

    def rho(q: float) -> float:
        if not (math.isfinite(p) and math.isfinite(q)):
            return 0.0
        return r0 / (q**2 * math.sqrt(P0)) / bracket(q) if bracket(q) else math.inf

    def delta(q: float) -> float:
        return r0 / q**2 - (4 * p * A if D2f else 0.0) - (4 * R1 * Dh**2 if D2h else 0.0)

    regions = [(v.min, v.max) for v in (*line.variables, *model.inputs)]
    return Certificate(
        A=A, H=H, Dh=Dh, D2f=D2f, D2h=D2h, alpha0=alpha0, s=s, r0=r0, P0=P0, p=p, q=q, q_paper=q_paper, C=bracket(q),
        rho=rho(q), rho_paper=rho(q_paper), delta=delta(q), delta_paper=delta(q_paper),
        low=np.array([r[0] for r in regions]), high=np.array([r[1] for r in regions]), n=line.m.numel(),
    )  # fmt: skip


def certify(known: Certificate, distance: Any, holds: Any) -> tuple[Any, Any]:
    """(diagnostics.certified, diagnostics.guaranteed_rate) for a guess at most `distance` off; `holds` = 0 makes both void.

    The rate: Theorem 2.1's proof, (r0 / q^2 - |P0^1/2| |e0| C) / (2 p), or Corollary 2.1's, delta / (2 p).
    """
    if not known.exists:
        return ca.MX(NONE), ca.MX(0)
    slack = known.r0 / known.q**2 - math.sqrt(known.P0) * known.C * distance
    rate = ca.fmax(slack, max(known.delta, 0.0)) / (2 * known.p)
    code = ca.if_else(slack > 0, INSIDE, OUTSIDE)
    if known.delta > 0 or known.C == 0:
        code = ca.MX(ANYWHERE)
    return ca.if_else(holds, code, NONE), ca.if_else(holds, rate, 0)


def certificate_ports(known: Certificate) -> tuple[Port, ...]:
    """The constants as `certificate.*`; what is infinite as 1e30."""
    return tuple(
        Port(f"certificate.{name}", what, start=max(min(value, UNKNOWN), -UNKNOWN), variability="constant", local=True)
        for name, what, value in known.rows()
    )


def _cells(model: Model, line: Linearisation) -> list[list[Any]]:
    """Ranges of [A, Dh, [Hessians of f], [Hessians of h]] over the cells of the region; of everything where a bound is unknown."""
    hessians = [[ca.hessian(e, line.m)[0] for e in ca.vertsplit(column)] for column in (line.f, line.h)]
    expressions = [line.A, line.C, *hessians[0], *hessians[1]]
    function = ca.Function("bounded", [line.m, line.u, line.p, line.t], expressions)
    parameters = [interval(v.start, v.start) for v in model.parameters]
    variables = (*line.variables, *model.inputs)
    symbols = ca.vertcat(line.m, line.u)
    flat = ca.vertcat(*[ca.vec(ca.densify(e)) for e in expressions])
    used = ca.which_depends(flat, symbols, 1, False)
    cut = [
        i
        for i, v in enumerate(variables)
        if used[i] and math.isfinite(v.min) and math.isfinite(v.max) and v.min < v.max
    ]
    pieces = max(1, math.floor(CELLS ** (1 / len(cut)))) if cut else 1
    found = []
    for index in itertools.product(range(pieces), repeat=len(cut)):
        box = [
            _piece(v, index[cut.index(i)] if i in cut else 0, pieces if i in cut else 1)
            for i, v in enumerate(variables)
        ]
        n = len(line.variables)
        try:
            A, C, *rest = ranges(function, [box[:n], box[n:], parameters, [interval(-math.inf, math.inf)]])
        except IntervalError:
            A, C, *rest = (Range(np.zeros(e.shape), np.full(e.shape, np.inf)) for e in expressions)
        found.append([A, C, rest[:n], rest[n:]])
    return found


def _piece(v: Variable, index: int, pieces: int) -> Any:
    if not (math.isfinite(v.min) and math.isfinite(v.max)):
        return interval(v.min, v.max)
    width = (v.max - v.min) / pieces
    return interval(v.min + index * width, v.max if index + 1 == pieces else v.min + (index + 1) * width)


def _detectability(pairs: list[tuple[Range, Range]], A: float, H: float, NN: float) -> tuple[float, float, float]:
    """(s, alpha0, (|N|^2 + |Lambda|^2) / (2 alpha0)) of (3.3) with the Lambda = -s H' for which the last is smallest."""
    best = (0.0, -math.inf, math.inf)
    if not (math.isfinite(A) and math.isfinite(H)):
        return best
    for gain in GAINS:
        s = float(gain) * (A / H**2 if H > 0 else 0.0)
        alpha0 = -_sup(_closed(a, g, s) for a, g in pairs)
        forcing = _rounded((NN + s**2 * H**2) / (2 * alpha0)) if alpha0 > 0 else math.inf
        if forcing < best[2] or (best[2] == math.inf and alpha0 > best[1]):
            best = (s, alpha0, forcing)
    return best


def _closed(A: Range, H: Range, s: float) -> float:
    """Bound of lmax of the symmetric part of A - s H'H."""
    square = H.middle.T @ H.middle
    slack = 2 * np.linalg.norm(H.middle, 2) * np.linalg.norm(H.radius, 2) + np.linalg.norm(H.radius, 2) ** 2
    return _largest(Range(A.middle - s * square, A.radius)) + float(s * slack)


def _norm(x: Range) -> float:
    return (
        math.inf
        if not np.all(np.isfinite(x.radius))
        else float(np.linalg.norm(x.middle, 2) + np.linalg.norm(x.radius, 2))
    )


def _largest(x: Range) -> float:
    """Bound of the largest eigenvalue of the symmetric part."""
    if not np.all(np.isfinite(x.radius)):
        return math.inf
    half, spread = (x.middle + x.middle.T) / 2, (x.radius + x.radius.T) / 2
    return float(np.linalg.eigvalsh(half).max() + np.linalg.norm(spread, 2))


def _smallest_gain(x: Range) -> float:
    """Bound from below of the smallest singular value."""
    if not np.all(np.isfinite(x.radius)):
        return 0.0
    return float(np.linalg.svd(x.middle, compute_uv=False).min() - np.linalg.norm(x.radius, 2))


def _bilinear(hessians: list[Range]) -> float:
    """Bound of |D2f(e, e)| / |e|^2."""
    return math.sqrt(sum(_norm(x) ** 2 for x in hessians))


def _sup(values: Iterable[float]) -> float:
    return _rounded(max(values))


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}") + 0.0


def _times(a: float, b: float) -> float:
    """a b, and 0 where one of them is 0 and the other infinite: the term is not there."""
    return 0.0 if a == 0 or b == 0 else a * b
