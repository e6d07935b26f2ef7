"""The Riccati observer of James & Baras 1987."""

from observers.riccati.observer import james_baras

__all__ = ["james_baras"]
