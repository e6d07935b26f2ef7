"""What at least two observers, or an observer and the plants, use: pure functions."""
