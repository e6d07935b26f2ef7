"""Suprema of a linearised model's derivatives over its bounded region: interval arithmetic cell by cell, every result rounded outward.

Eigenvalues and norms of a cell's matrices are computed in doubles by LAPACK, whose error is a few ulps of the matrix' norm, and whose last
bits depend on the machine. Each is therefore moved outward by MARGIN of that norm, which covers the error, and then rounded outward to
DIGITS digits, which makes it the same everywhere.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import ROUND_CEILING, Context, Decimal

import casadi as ca
import numpy as np

from observers.linearisation import Linearisation
from observers.model import Model, Variable
from observers.numerics.operations import is_opaque
from observers.riccati.interval import IntervalError, Range, interval, ranges

CELLS = 256  # into which the bounded region is cut, at most
DIGITS = 9
MARGIN = 1e-12  # of a matrix' norm; LAPACK's errors are below n 1e-15 of it

_UPWARD = Context(prec=DIGITS, rounding=ROUND_CEILING)


@dataclass(frozen=True)
class Cell:
    """Ranges over one cell of A (n x n), Dh (ny x n) and the Hessians of f (n of n x n) and h (ny of n x n)."""

    A: Range
    Dh: Range
    D2f: list[Range]
    D2h: list[Range]


@dataclass(frozen=True)
class Suprema:
    """What is known of a model's derivatives over its bounded region, whatever the design.

    A, Dh, D2f, D2h: suprema of spectral norms; a: sup lmax(-(A + A') / 2). obstacle: why they are infinite, or "". low, high: bounds of
    (m, u), m of n entries.
    """

    cells: list[Cell]
    A: float
    Dh: float
    D2f: float
    D2h: float
    a: float
    obstacle: str
    low: np.ndarray
    high: np.ndarray
    n: int


def suprema_of(model: Model, line: Linearisation) -> Suprema:
    """The suprema over the region of `cells`."""
    found, obstacle = cells(model, line)
    A, Dh = supremum(norm(c.A) for c in found), supremum(norm(c.Dh) for c in found)
    D2f, D2h = supremum(second(c.D2f) for c in found), supremum(second(c.D2h) for c in found)
    a = supremum(largest(Range(-c.A.middle, c.A.radius)) for c in found)
    regions = np.array([(v.min, v.max) for v in (*line.variables, *model.inputs)])
    return Suprema(found, A, Dh, D2f, D2h, a, obstacle, regions[:, 0], regions[:, 1], line.m.numel())


def cells(model: Model, line: Linearisation) -> tuple[list[Cell], str]:
    """The cells of the model's bounded region, and why their ranges are infinite where they are ("" where all are finite).

    The region: states, unknown parameters and inputs within their bounds, all times, known parameters at their start values. A variable
    that no derivative depends on, or without both bounds, is not cut. Where A is affine and Dh constant, as in a bilinear model, the
    region's corners stand for it: all that is bounded here is convex in A, hence largest at one of them.
    """
    n = len(line.variables)
    if is_opaque(ca.vertcat(line.f, line.h)):
        return [_unbounded(n, line)], "the plant is an FMU, of which there are no formulas"
    hessians = [[ca.hessian(e, line.m)[0] for e in ca.vertsplit(column)] for column in (line.f, line.h)]
    expressions = [line.A, line.C, *hessians[0], *hessians[1]]
    function = ca.Function("bounded", [line.m, line.u, line.p, line.t], expressions)
    parameters = [interval(v.start, v.start) for v in model.parameters]
    variables = (*line.variables, *model.inputs)
    flat = ca.vertcat(*[ca.vec(ca.densify(e)) for e in expressions])
    symbols = ca.vertcat(line.m, line.u)
    used = ca.which_depends(flat, symbols, 1, False)
    cut = [i for i, v in enumerate(variables) if used[i] and _is_bounded(v) and v.min < v.max]
    is_affine = not any(ca.which_depends(ca.vec(ca.densify(line.A)), symbols, 2, False))
    is_affine &= not any(ca.which_depends(ca.vec(ca.densify(line.C)), symbols, 1, False))
    corners = is_affine and 2 ** len(cut) <= CELLS
    pieces = 2 if corners else max(1, math.floor(CELLS ** (1 / len(cut)))) if cut else 1
    whole = [interval(v.min, v.max) for v in variables]
    found, reason = [], ""
    for index in itertools.product(range(pieces), repeat=len(cut)):
        box = whole.copy()
        for i, k in zip(cut, index, strict=True):
            v = variables[i]
            edges = np.linspace(v.min, v.max, 2 if corners else pieces + 1)
            box[i] = interval(edges[k], edges[k] if corners else edges[k + 1])
        try:
            A, C, *rest = ranges(function, [box[:n], box[n:], parameters, [interval(-math.inf, math.inf)]])
        except IntervalError as error:
            return [_unbounded(n, line)], str(error)
        found.append(Cell(A, C, rest[:n], rest[n:]))
        if not (np.all(np.isfinite(A.radius)) and np.all(np.isfinite(C.radius))):
            open_ = [v.name for v, depends in zip(variables, used, strict=True) if depends and not _is_bounded(v)]
            reason = f"A or Dh has no bound over {', '.join(open_) or 'the bounded region'}"
            reason += ", which the model does not bound" if open_ else ""
    return found, reason


def _unbounded(n: int, line: Linearisation) -> Cell:
    """A cell of which nothing is known."""

    def anything(rows: int) -> Range:
        return Range(np.zeros((rows, n)), np.full((rows, n), np.inf))

    ny = line.h.numel()
    return Cell(anything(n), anything(ny), [anything(n)] * n, [anything(n)] * ny)


def upward(value: float) -> float:
    """The next number of DIGITS digits not below `value`."""
    return float(_UPWARD.create_decimal(Decimal(value))) + 0.0 if math.isfinite(value) else value


def downward(value: float) -> float:
    """The next number of DIGITS digits not above `value`."""
    return -upward(-value) + 0.0


def supremum(values: Iterable[float]) -> float:
    """The largest of upper bounds, rounded up."""
    return upward(max(values))


def norm(x: Range) -> float:
    """Upper bound of |X|."""
    if not np.all(np.isfinite(x.radius)):
        return math.inf
    return float(np.linalg.norm(x.middle, 2) + np.linalg.norm(x.radius, 2)) * (1 + MARGIN)


def largest(x: Range) -> float:
    """Upper bound of the largest eigenvalue of the symmetric part."""
    if not np.all(np.isfinite(x.radius)):
        return math.inf
    half, spread = (x.middle + x.middle.T) / 2, (x.radius + x.radius.T) / 2
    return float(np.linalg.eigvalsh(half).max() + np.linalg.norm(spread, 2)) + MARGIN * norm(x)


def smallest_gain(x: Range) -> float:
    """Lower bound of the smallest singular value."""
    if not np.all(np.isfinite(x.radius)):
        return 0.0
    return float(np.linalg.svd(x.middle, compute_uv=False).min() - np.linalg.norm(x.radius, 2)) - MARGIN * norm(x)


def second(hessians: list[Range]) -> float:
    """Upper bound of |D2f(e, e)| / |e|^2."""
    return math.sqrt(sum(norm(x) ** 2 for x in hessians)) * (1 + MARGIN)


def point(X: np.ndarray) -> Range:
    """A matrix known exactly."""
    return Range(X, np.zeros(X.shape))


def _is_bounded(v: Variable) -> bool:
    return math.isfinite(v.min) and math.isfinite(v.max)
