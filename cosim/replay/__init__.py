"""An observer over a recorded file."""
