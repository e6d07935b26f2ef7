"""The window's samples and inputs, moved on by one sample: straight-line functions of scalars."""

from __future__ import annotations

import casadi as ca


def insert_sample(ny: int, count: int) -> ca.Function:
    """insert(column, new, k): a window of `count` samples with the k-th one put in place, or moved up by one and the new one at its end."""
    column, new, k = ca.SX.sym("column", ny * count), ca.SX.sym("new", ny), ca.SX.sym("k")
    moving = k > count - 1
    rows = []
    for i in range(count):
        here = column[i * ny : (i + 1) * ny]
        following = column[(i + 1) * ny : (i + 2) * ny] if i + 1 < count else new
        rows.append(ca.if_else(moving, following, ca.if_else(k == i, new, here)))
    return ca.Function("insert", [column, new, k], [ca.vertcat(*rows)])


def insert_input(nu: int, L: int, held: bool) -> ca.Function:
    """inputs(window, last, now, k): the known inputs of the new window; what lies ahead is held at its present value.

    `last` is the mean over the last interval (held) or the present value (linear).
    """
    count = L if held else L + 1
    column, last, now, k = ca.SX.sym("window", nu * count), ca.SX.sym("last", nu), ca.SX.sym("now", nu), ca.SX.sym("k")
    newest = k - 1 if held else k
    rows = []
    for i in range(count):
        here = column[i * nu : (i + 1) * nu]
        following = column[(i + 1) * nu : (i + 2) * nu] if i + 1 < count else last
        filling = ca.if_else(newest == i, last, ca.if_else(newest < i, now, here))
        rows.append(ca.if_else(k > L, following, filling))
    return ca.Function("inputs", [column, last, now, k], [ca.vertcat(*rows)])
