"""What becomes of a value on its way: linear transformations, and tables of whole numbers and of item names (SSP 1.0, 4.4.2)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Linear:
    """factor * value + offset, of a Real: a number or an array."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, value: Any) -> Any:
        return self.factor * value + self.offset


@dataclass(frozen=True)
class Table:
    """Whole numbers for whole numbers, of an Integer, Enumeration or Boolean; what is not in it stays as it is."""

    targets: Mapping[int, int]
    boolean: bool = False

    def __call__(self, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return np.array([self.targets.get(int(one), one) for one in value], dtype=value.dtype)
        return self.targets.get(int(value), value)


@dataclass(frozen=True)
class ItemTable:
    """Item names of one enumeration for those of another; `resolve` makes it a Table by the FMUs' enumerations."""

    targets: Mapping[str, str]

    def __call__(self, value: Any) -> Any:
        return self.targets.get(value, value)

    def numbered(self, source: Mapping[int, str], target: Mapping[int, str]) -> Table:
        """The same by the numbers of the items.

        Raises:
            ValueError: an item that the enumeration does not have.
        """
        before, after = ({name: number for number, name in items.items()} for items in (source, target))
        for names, known in ((self.targets, before), (self.targets.values(), after)):
            for name in names:
                if name not in known:
                    raise ValueError(
                        f"the transformation's item '{name}' is none of {', '.join(known) or 'an enumeration'}"
                    )
        return Table({before[start]: after[end] for start, end in self.targets.items()})


Transformation = Linear | Table | ItemTable


def apply(steps: Iterable[Transformation], value: Any) -> Any:
    """`value` after all `steps`, the first one first."""
    for step in steps:
        value = step(value)
    return value


def merged(steps: Iterable[Transformation]) -> tuple[Transformation, ...]:
    """The same steps, neighbouring linear ones as one, without those that change nothing."""
    kept: list[Transformation] = []
    for step in steps:
        before = kept[-1] if kept else None
        if isinstance(step, Linear) and isinstance(before, Linear):
            kept.pop()
            step = Linear(step.factor * before.factor, step.factor * before.offset + step.offset)
        if step != Linear():
            kept.append(step)
    return tuple(kept)
