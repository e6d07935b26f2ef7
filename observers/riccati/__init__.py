"""The Riccati observer of James & Baras 1987."""

from observers.riccati.front import fastest, trade_off, widest
from observers.riccati.observer import riccati

__all__ = ["fastest", "riccati", "trade_off", "widest"]
