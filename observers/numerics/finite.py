"""What still counts as a number: the one limit by which every observer tells a lost computation from a large value."""

HUGE = 1e150  # beyond: not finite; its square still is a number
