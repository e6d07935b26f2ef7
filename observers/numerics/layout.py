"""Names for the parts of a flat state vector."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import casadi as ca


class Layout:
    """A state vector made of named columns: `Layout(x=2, window=9)`; sizes are numbers of doubles, zero allowed."""

    def __init__(self, **sizes: int):
        self.sizes = sizes
        self.total = sum(sizes.values())

    def unpack(self, z: Any) -> SimpleNamespace:
        """The parts of z (total x 1), by attribute."""
        parts, start = {}, 0
        for name, size in self.sizes.items():
            parts[name] = z[start : start + size] if size else type(z)(0, 1)  # an empty slice would be 1 x 0
            start += size
        return SimpleNamespace(**parts)

    def pack(self, parts: Mapping[str, Any]) -> Any:
        """One column from all parts; raises ValueError for a part that is missing, unknown or of the wrong size."""
        if parts.keys() != self.sizes.keys():
            raise ValueError(f"parts {sorted(parts.keys() ^ self.sizes.keys())} are missing or unknown")
        columns = []
        for name, size in self.sizes.items():
            column = ca.vertcat(parts[name]) if isinstance(parts[name], (int, float)) else parts[name]
            if column.numel() != size:
                raise ValueError(f"part '{name}' has {column.numel()} entries, expected {size}")
            columns.append(column)
        return ca.vertcat(*columns)

    def replace(self, z: Any, /, **changed: Any) -> Any:
        """z with some parts changed."""
        return self.pack({**vars(self.unpack(z)), **changed})
