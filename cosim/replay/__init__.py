"""An observer over a recorded file."""

from cosim.replay.replay import Replay, replay

__all__ = ["Replay", "replay"]
