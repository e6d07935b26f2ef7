"""The noises of an observer FMU, from recorded files: maximum likelihood of its innovations."""

from cosim.tuning.tune import Tuned, tune

__all__ = ["Tuned", "tune"]
