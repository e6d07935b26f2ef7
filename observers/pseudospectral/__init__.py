"""The pseudospectral moving-horizon observer of Gong, Ross & Kang 2007."""

from observers.pseudospectral.observer import pseudospectral

__all__ = ["pseudospectral"]
