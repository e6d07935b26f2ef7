"""Matrices whose columns are samples or intervals of a window."""

from __future__ import annotations

from typing import Any

import casadi as ca


def repeated(column: Any, count: int) -> Any:
    """`column` (n x 1), `count` times side by side; empty for n = 0, where CasADi's repmat would write C that does not compile."""
    return ca.repmat(column, 1, count) if column.numel() else type(column)(0, count)
