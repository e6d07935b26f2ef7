"""Worked models from the literature, each a file to start from: `observer-fmus gallery NAME` copies one."""
