"""A model's equations as CasADi expressions: what the numerics work on."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class Equations:
    """A model's equations as CasADi SX columns.

    Symbols `x` (nx), `z` (nz), `u` (nu), `w` (nw), `p` (np), `theta` (nt), `t`; expressions `ode` (nx), `algebraic` (nz), `output` (ny),
    `constraint` (nr), each entry at most 0.
    """

    x: ca.SX
    z: ca.SX
    u: ca.SX
    w: ca.SX
    p: ca.SX
    theta: ca.SX
    t: ca.SX
    ode: ca.SX
    algebraic: ca.SX
    output: ca.SX
    constraint: ca.SX
