"""Where the branches of Example 6's circuit can be entered."""

# x1, x2 and a guess of x3: the upper branch twice, the middle one, which moves away from its equilibrium, the lower one twice.
STARTS = [(4.0, 1.5, 2.7), (3.0, 0.5, 2.6), (0.9, 0.2, 1.1), (1.0, 0.1, 1.0), (-2.0, -1.5, -0.7), (-1.0, -1.0, -0.5)]
