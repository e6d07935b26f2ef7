"""The canonical DAE observer of Nikoukhah 1995."""

from observers.canonical_dae.observer import canonical_dae

__all__ = ["canonical_dae"]
