"""Problem 2 on a window: its discretisation, its condensing and its solution, as functions that CasADi can generate."""
