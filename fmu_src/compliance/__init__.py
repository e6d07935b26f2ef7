"""Is an FMU what FMI 2.0 says it is? Checks of the file, and of what its library does when it is driven.

`observer-fmus check FILE.fmu ...`; the rules are in `rules.py` and in docs/compliance.md.
"""
