"""Every observer, as one would write it for a model: those that apply as components, and why the others do not."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from observers.canonical_dae import canonical_dae
from observers.component import Component
from observers.elementary import elementary
from observers.least_squares import least_squares
from observers.model import Model
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.ukf import ukf

METHODS: dict[str, Callable[..., Component]] = {
    method.__name__: method for method in (riccati, ukf, pseudospectral, least_squares, elementary, canonical_dae)
}
STEPS = 10  # of the prediction, in a long sample
SHORTEST = 10  # samples of a window
POLES = 5  # samples in the time constants of the errors


@dataclass(frozen=True)
class Task:
    """What an observer is made for: `noise` by output, `window` in samples."""

    model: Model
    sample_time: float
    noise: Mapping[str, float]
    window: int


@dataclass(frozen=True)
class Candidate:
    """An observer that applies, with the arguments that made it."""

    method: str
    arguments: Mapping[str, Any]
    component: Component

    def line(self, variable: str) -> str:
        """The Python that makes it of the Model called `variable`."""
        return f"{self.method}({', '.join([variable, *(f'{n}={_text(v)}' for n, v in self.arguments.items())])})"


@dataclass(frozen=True)
class Refused:
    """An observer that does not apply, and what its builder says."""

    method: str
    reason: str


def candidate(method: str, task: Task) -> Candidate | Refused:
    """One of METHODS for the task, with everything at its default that the task does not say."""
    if method == "elementary" and task.model.unknown_parameters:
        names = ", ".join(v.name for v in task.model.unknown_parameters)
        return Refused(
            method,
            f"elementary: model '{task.model.name}' has unknown parameters ({names}), whose weights want choosing by hand",
        )
    arguments = _arguments(method, task)
    try:
        return Candidate(method, arguments, METHODS[method](task.model, **arguments))
    except (ValueError, ArithmeticError, RuntimeError) as error:  # CasADi's are RuntimeErrors
        return Refused(method, str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__)


def _arguments(method: str, task: Task) -> dict[str, Any]:
    """As little as possible: the sample time, the noise, and what has no default or one that does not suit the sample time."""
    Ts, window = task.sample_time, max(task.window, SHORTEST)
    made: dict[str, Any] = {"sample_time": Ts}
    if method == "least_squares":
        made |= {"T": float(f"{window * Ts:.6g}"), "linearise": True}
    if method == "elementary":
        made |= {"N": window + 1}
    if method == "canonical_dae":
        unknown = len(task.model.states) + len(task.model.unknown_parameters) - len(task.model.unknown_disturbances)
        made |= {"poles": [float(f"{-1 / (POLES * Ts):.4g}")] * unknown}
    made["measurement_noise"] = dict(task.noise)
    longest = inspect.signature(METHODS[method]).parameters["max_step"].default
    if longest is not None and Ts > STEPS * longest:
        made["max_step"] = float(f"{Ts / STEPS:.6g}")
    return made


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f'"{name}": {number:.6g}' for name, number in value.items()) + "}"
    return repr(value)
