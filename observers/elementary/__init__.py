"""The observer by elementary Hamilton-Jacobi problems of Calvillo-Corona & Alamir."""

from observers.elementary.observer import calvillo_alamir

__all__ = ["calvillo_alamir"]
