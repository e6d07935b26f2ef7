"""What can go wrong when a component is exported."""


class ExportError(ValueError):
    """The component cannot become an FMU; the message names the component, the variable or function, and why."""
