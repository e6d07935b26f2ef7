"""The least-squares observer with covariance reset of Chen & Yen 1999."""

from observers.least_squares.observer import chen_yen

__all__ = ["chen_yen"]
