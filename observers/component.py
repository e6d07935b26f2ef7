"""What a user gets: a hybrid system over flat vectors, everything an FMU needs and nothing about FMI.

Signatures (columns of doubles; z is the whole state, u the inputs, p the parameters in the order of `parameters`):

    start(p, t0) -> z        flow(z, u, p, t, h) -> z    continuous motion over h, inputs held
                             jump(z, u, p, t) -> z       at a sample instant
                             output(z, u, p, t) -> y     in the order of `outputs`
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import casadi as ca

from observers.model import Variable

SHORTEST_SAMPLE_TIME = 1e-6  # [s]; times are counted in nanoseconds, below this their rounding is no longer small


def check_sample_time(owner: str, name: str, value: float) -> None:
    """Raise a ValueError unless `value` [s] is 0 (no sample instants) or finite and at least SHORTEST_SAMPLE_TIME."""
    if not (value == 0 or (value >= SHORTEST_SAMPLE_TIME and math.isfinite(value))):
        raise ValueError(f"{owner}: {name} = {value:.10g} must be 0 or finite and at least {SHORTEST_SAMPLE_TIME:g} s")


@dataclass(frozen=True)
class Enumeration:
    """A named set of items; the values count from 1."""

    name: str
    items: tuple[tuple[str, str], ...]  # (item, description)


@dataclass(frozen=True)
class Port(Variable):
    """A variable of a component: a Variable with the FMI attributes that depend on its use.

    `kind` is "Real", "Integer", "Boolean" (0 or 1) or "Enumeration" (then `enumeration` says which); all travel as doubles.
    `variability` is "continuous" or "discrete" (inputs, outputs), "tunable" or "fixed" (parameters), "constant" (constants). `local`
    marks an output that is shown, not connected; `given` a start value that was asked for and is no default. `unit` is "" where the
    quantity has one that no unit expression can say, such as m/sqrt(s), or may have any: the FMU then declares none.
    """

    kind: str = "Real"
    variability: str = "continuous"
    enumeration: Enumeration | None = None
    local: bool = False
    given: bool = False
    NEEDS_UNIT: ClassVar[bool] = False


def bounds(port: Port) -> tuple[float, float]:
    """Smallest and largest legal value of a parameter."""
    if port.enumeration is None:
        return port.min, port.max
    return max(port.min, 1), min(port.max, len(port.enumeration.items))


def estimated(component: Component) -> list[Port]:
    """The states and unknown parameters that an observer has a guess of, under their own names; none of another component."""
    guesses = [port for port in component.parameters if port.name.startswith("guess.")]
    return [replace(port, name=port.name.removeprefix("guess.")) for port in guesses]


@dataclass(frozen=True)
class Failure:
    """Why a motion cannot go on: `what` happened, and the name of the `measure` that tells."""

    what: str
    measure: str


@dataclass(frozen=True)
class Component:
    """A hybrid system with named ports; see the module's docstring for the functions' signatures.

    Attributes:
        sample_time: Ts [s], or the name of the fixed parameter that holds it; 0 = no sample instants.
        samples_inputs: the inputs are read at the sample instants, so that a step longer than Ts would lose samples.
        breaks: fixed parameters that hold times [s] at which the right-hand side jumps: flow is cut there.
        max_step: the longest h that `flow` is called with [s].
        stop_time, step_size: the default experiment [s].
        counters: outputs that count troubles; a rise is worth a warning.
        failures: why the motion can end, by code from 1. A component that has some keeps (code, time, measure) in the last three
            entries of z, code 0 while all is well; a start or a step that ends with another code is an error that says so.
        documentation: the component's method and limits, as HTML paragraphs for the FMU's documentation page.

    Raises:
        ValueError: functions whose sizes contradict the ports or whose results are sparse; names that are unknown, not unique, or the
            branch of another (`x` beside `x.x1`); a sample time that is neither 0 nor at least SHORTEST_SAMPLE_TIME; a time span that
            is not positive.
    """

    name: str
    description: str
    start: ca.Function
    output: ca.Function
    flow: ca.Function
    jump: ca.Function | None = None
    inputs: tuple[Port, ...] = ()
    parameters: tuple[Port, ...] = ()
    outputs: tuple[Port, ...] = ()
    constants: tuple[Port, ...] = ()
    sample_time: float | str = 0.0
    samples_inputs: bool = False
    breaks: tuple[str, ...] = ()
    max_step: float = math.inf
    stop_time: float = 10.0
    step_size: float = 0.01
    counters: tuple[str, ...] = ()
    failures: tuple[Failure, ...] = ()
    documentation: str = ""
    functions: dict[str, ca.Function] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        functions = {"start": self.start, "flow": self.flow, "output": self.output}
        if self.jump is not None:
            functions["jump"] = self.jump
        object.__setattr__(self, "functions", functions)
        self._check_names()
        self._check_times()
        self._check_sizes()

    @property
    def n_z(self) -> int:
        """Length of the state vector z."""
        return self.start.numel_out(0)

    def _check_names(self) -> None:
        seen: set[str] = set()
        for port in (*self.inputs, *self.parameters, *self.outputs, *self.constants):
            if port.name in seen:
                raise ValueError(f"component '{self.name}': two ports are called '{port.name}'")
            seen.add(port.name)
        for name in seen:
            parts = name.split(".")
            for k in range(1, len(parts)):
                if (branch := ".".join(parts[:k])) in seen:
                    raise ValueError(
                        f"component '{self.name}': the port '{branch}' has the name of the branch that '{name}' stands on"
                    )
        fixed = {p.name for p in self.parameters if p.variability == "fixed"}
        wanted = [*self.breaks, *([self.sample_time] if isinstance(self.sample_time, str) else [])]
        for name in wanted:
            if name not in fixed:
                raise ValueError(f"component '{self.name}': '{name}' is no fixed parameter")
        for name in self.counters:
            if name not in {p.name for p in self.outputs}:
                raise ValueError(f"component '{self.name}': the counter '{name}' is no output")

    def _check_times(self) -> None:
        where = f"component '{self.name}'"
        if not isinstance(self.sample_time, str):
            check_sample_time(where, "the sample time", self.sample_time)
        if not self.max_step > 0:
            raise ValueError(f"{where}: max_step = {self.max_step:g} must be positive")
        for what, value in (("stop_time", self.stop_time), ("step_size", self.step_size)):
            if not (value > 0 and math.isfinite(value)):
                raise ValueError(f"{where}: {what} = {value:g} must be positive and finite")

    def _check_sizes(self) -> None:
        z, u, p, y = self.n_z, len(self.inputs), len(self.parameters), len(self.outputs)
        wanted = {
            "start": ([p, 1], z),
            "flow": ([z, u, p, 1, 1], z),
            "jump": ([z, u, p, 1], z),
            "output": ([z, u, p, 1], y),
        }
        for name, function in self.functions.items():
            arguments, result = wanted[name]
            if function.name() != name:
                raise ValueError(f"component '{self.name}': the function {function.name()!r} must be called '{name}'")
            found = [function.numel_in(i) for i in range(function.n_in())]
            if found != arguments or function.numel_out(0) != result:
                raise ValueError(
                    f"component '{self.name}': {name} maps sizes {found} to {function.numel_out(0)}, "
                    f"the ports ask for {arguments} to {result}"
                )
            if function.nnz_out(0) != result:
                raise ValueError(f"component '{self.name}': the result of {name} is sparse; casadi.densify it")
        if self.failures and z < 3:
            raise ValueError(
                f"component '{self.name}': failures take the last three of the state's entries, it has {z}"
            )

    def __str__(self) -> str:
        def row(label: str, ports: Sequence[Port]) -> str:
            return f"  {len(ports):3d} {label:<11} " + ", ".join(p.name for p in ports)

        sampled = f", sample time {self.sample_time}" if self.sample_time else ""
        return "\n".join(
            [
                f"Component {self.name}: {self.description} ({self.n_z} states{sampled})",
                row("inputs", self.inputs),
                row("parameters", self.parameters),
                row("outputs", self.outputs),
            ]
        )
