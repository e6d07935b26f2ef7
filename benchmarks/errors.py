"""What can keep a benchmark from being run."""


class BenchmarkError(RuntimeError):
    """A measurement is impossible or would be meaningless; the message says why."""
