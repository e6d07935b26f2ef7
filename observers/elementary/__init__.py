"""The observer by elementary Hamilton-Jacobi problems of Calvillo-Corona & Alamir."""

from observers.elementary.observer import elementary

__all__ = ["elementary"]
