"""The command line: one file a verb, nothing but words and calls."""
