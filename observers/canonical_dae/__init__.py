"""The canonical DAE observer of Nikoukhah 1995."""

from observers.canonical_dae.observer import nikoukhah

__all__ = ["nikoukhah"]
