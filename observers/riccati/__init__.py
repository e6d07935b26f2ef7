"""The Riccati observer of James & Baras 1987."""

from observers.riccati.observer import riccati

__all__ = ["riccati"]
