"""Which observer for a model: what is tried, on what, and how the choice is made. Knows models, components and the compiler."""
