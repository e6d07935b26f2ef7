"""What can go wrong when a component is exported, or made for a plant that is an FMU."""

from observers.expressions import ModelError


class ExperimentFailed(ValueError):
    """A component's default experiment ends with an error; the message names the component and why."""


class ExportWarning(UserWarning):
    """The FMU is written, but something of what should travel with it is not; the message says what and why."""


class ExportError(ValueError):
    """The component cannot become an FMU; the message names the component, the variable or function, and why."""


class PlantError(ModelError):
    """A foreign FMU cannot be the plant of an observer; the message names the file, and why."""
