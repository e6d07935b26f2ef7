"""Streams of measurements with their truth, what corrupts them, and what an observer is worth on them."""
