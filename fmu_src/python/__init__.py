"""The PythonFMU target: one slave for every component, and the relay in front of PythonFMU's library."""
