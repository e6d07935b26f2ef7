"""Observers: a Model in, a Component out. Knows nothing of FMI."""

__version__ = "0.1.0"
