"""The fmpy-driven master: runs a system once."""

from cosim.master.run import MOST_STEPS, count_steps, run, start_values

__all__ = ["MOST_STEPS", "count_steps", "run", "start_values"]
