"""What `make bench` runs: how fast the observer's FMU is, beside what one would use instead and beside its floor."""
