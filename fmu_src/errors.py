"""What can go wrong when a component is exported."""


class ExperimentFailed(ValueError):
    """A component's default experiment ends with an error; the message names the component and why."""


class ExportWarning(UserWarning):
    """The FMU is written, but something of what should travel with it is not; the message says what and why."""


class ExportError(ValueError):
    """The component cannot become an FMU; the message names the component, the variable or function, and why."""
