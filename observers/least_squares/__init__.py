"""The least-squares observer with covariance reset of Chen & Yen 1999."""

from observers.least_squares.observer import least_squares

__all__ = ["least_squares"]
