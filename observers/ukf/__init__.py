"""The unscented Kalman filter."""

from observers.ukf.observer import ukf

__all__ = ["ukf"]
