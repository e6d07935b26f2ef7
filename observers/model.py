"""What a user gives: the equations of a system, written with names.

duffing = Model(
    name="duffing",
    states=[Variable("x1", start=2.0), Variable("x2", start=1.0)],
    unknown_parameters=[Variable("theta", start=0.4)],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [x.x2, x.x1 - x.x1**3 + p.theta * ca.cos(t)],
    output=lambda x, u, p, t: [x.x1 + 0.5 * x.x2],
)
"""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Any

import casadi as ca
import numpy as np

from observers.expressions import ModelError, described, evaluated
from observers.numerics.equations import Equations
from observers.variable import Names, Variable

__all__ = ["BRANCHES", "Model", "ModelError", "Names", "Variable", "column_of"]

# CasADi 3.8.2 takes a vector argument of a call that mixes two inputs at consecutive places for a piece of one of them, and writes C that
# reads the wrong numbers: every call of a parameter beside an estimated one. Vectors that are always copied are right.
ca.GlobalOptions.setCopyElisionMinSize(-1)

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
# The first parts of the structured names in our FMUs: a tool that builds a tree of them cannot have a variable of that name beside.
BRANCHES = frozenset(
    {"actuator", "certificate", "diagnostics", "estimate", "feedback", "filtered", "guess", "measurement_valid"}
) | frozenset({"parameter", "sensor", "start", "structure", "tuning", "x", "z"})
_GROUPS = (
    "states",
    "outputs",
    "inputs",
    "parameters",
    "unknown_parameters",
    "algebraic",
    "unknown_disturbances",
    "constraints",
)


@dataclass(frozen=True)
class Model:
    """A nonlinear system x' = f(x, u, p, t), 0 = g, y = h(x, u, p, t), with named, typed, documented variables.

    Attributes:
        name: an identifier; it names the FMU files made of the model.
        states: the differential variables x.
        outputs: what a sensor measures, y.
        ode: `(x, u, p, t) -> [x'_1, ...]`, one entry for each state. With algebraic variables the signature of all
            three callables is `(x, z, u, p, t)`.
        output: the same signature, `-> [y_1, ...]`, one entry for each output.
        inputs: known inputs u.
        parameters: known parameters, settable in the FMU; `p.<name>`.
        unknown_parameters: constants that an observer estimates; `p.<name>` too.
        algebraic: algebraic variables z, determined by `algebraic_equations`, as many as those.
        algebraic_equations: `(x, z, u, p, t) -> [g_1, ...]`, each zero.
        unknown_disturbances: time-varying inputs that nobody measures; `u.<name>`.
        constraints: what the motion is known to obey besides, r(x, z, u, p, t) <= 0, by name; `nominal` is the magnitude in which a
            violation is measured. An observer that imposes none says so.
        constraint: the same signature, `-> [r_1, ...]`, one entry for each constraint.
        input_between_samples: what a known input does between two samples, "held" or "linear". Until the next sample is known an
            observer holds it, or follows the derivatives that its host sets; then it takes the line.
        output_starts: what a sensor shows before anything has moved: each output's own start value where it has one, else the output at the
            start values of everything, at t = 0.

    Raises:
        ModelError: names that are no identifiers, not unique, or (inputs, outputs) one of BRANCHES; unknown names in an
            equation, an equation count that does not match, an equation that is not finite at the start values, an output or a
            constraint that depends on nothing that is estimated, a constraint with bounds or a start value.
    """

    name: str
    states: Sequence[Variable]
    outputs: Sequence[Variable]
    ode: Callable[..., Iterable[Any]]
    output: Callable[..., Iterable[Any]]
    inputs: Sequence[Variable] = ()
    parameters: Sequence[Variable] = ()
    unknown_parameters: Sequence[Variable] = ()
    algebraic: Sequence[Variable] = ()
    algebraic_equations: Callable[..., Iterable[Any]] | None = None
    unknown_disturbances: Sequence[Variable] = ()
    constraints: Sequence[Variable] = ()
    constraint: Callable[..., Iterable[Any]] | None = None
    input_between_samples: str = "held"
    description: str = ""
    equations: Equations = field(init=False, repr=False, compare=False)
    output_starts: tuple[float, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self._check_names()
        if self.input_between_samples not in ("held", "linear"):
            raise ModelError(
                f"model '{self.name}': input_between_samples = {self.input_between_samples!r} must be 'held' or 'linear'"
            )
        if bool(self.algebraic) != (self.algebraic_equations is not None):
            raise ModelError(f"model '{self.name}': algebraic variables and algebraic_equations go together")
        if bool(self.constraints) != (self.constraint is not None):
            raise ModelError(f"model '{self.name}': constraints and constraint, their function, go together")
        equations = self._build()
        object.__setattr__(self, "equations", equations)
        at_start = self._finite_at_start(equations)
        # Fewer digits than machines agree in: they become start values of FMUs, whose bytes must not depend on the machine.
        shown = tuple(v.start or float(f"{value:.12g}") for v, value in zip(self.outputs, at_start, strict=True))
        object.__setattr__(self, "output_starts", shown)

    def _groups(self) -> dict[str, Sequence[Variable]]:
        return {
            "state": self.states,
            "algebraic variable": self.algebraic,
            "input": self.inputs,
            "output": self.outputs,
            "parameter": self.parameters,
            "unknown parameter": self.unknown_parameters,
            "unknown disturbance": self.unknown_disturbances,
            "constraint": self.constraints,
        }

    def _check_names(self) -> None:
        if not isinstance(self.name, str) or not _NAME.match(self.name) or keyword.iskeyword(self.name):
            raise ModelError(f"model name {self.name!r} {_no_name(self.name)}")
        self._check_groups()
        seen: dict[str, str] = {}
        for group, variables in self._groups().items():
            for variable in variables:
                if not _NAME.match(variable.name) or keyword.iskeyword(variable.name):
                    raise ModelError(f"model '{self.name}': {group} name {variable.name!r} {_no_name(variable.name)}")
                # A sensor may have the name of the state that it shows: nothing of the two is ever looked up in one place.
                if variable.name in seen and not (group == "output" and seen[variable.name] == "state"):
                    raise ModelError(
                        f"model '{self.name}': the name '{variable.name}' stands for a {seen[variable.name]} and a {group}"
                    )
                seen[variable.name] = group
        for group in ("input", "output", "unknown disturbance"):
            for variable in self._groups()[group]:
                if variable.name in BRANCHES:
                    raise ModelError(
                        f"model '{self.name}': the {group} '{variable.name}' would be a variable of the FMU beside its branch "
                        f"'{variable.name}.*'; taken are {', '.join(sorted(BRANCHES))}"
                    )
        if not self.states:
            raise ModelError(f"model '{self.name}' has no states")
        if not self.outputs:
            raise ModelError(f"model '{self.name}' has no outputs")
        for v in self.constraints:
            if v.start or math.isfinite(v.min) or math.isfinite(v.max):
                raise ModelError(
                    f"model '{self.name}': the constraint '{v.name}' has start = {v.start:g}, min = {v.min:g}, max = {v.max:g}; "
                    "a constraint says that its expression is at most 0: write its limit into the expression"
                )

    def _check_groups(self) -> None:
        for attribute in _GROUPS:
            given = getattr(self, attribute)
            example = f"{attribute}=[Variable(...), ...]"
            if isinstance(given, (str, dict, Variable)) or not isinstance(given, Sequence):
                raise ModelError(
                    f"model '{self.name}': {attribute} is {described(given)}, where a list is wanted: {example}"
                )
            for i, variable in enumerate(given):
                if not isinstance(variable, Variable):
                    raise ModelError(
                        f"model '{self.name}': entry {i + 1} of {attribute} is {described(variable)}, where a Variable is wanted: {example}"
                    )

    def _build(self) -> Equations:
        def symbols(variables: Sequence[Variable]) -> dict[str, ca.SX]:
            return {v.name: ca.SX.sym(v.name) for v in variables}

        x, z, u, w = map(symbols, (self.states, self.algebraic, self.inputs, self.unknown_disturbances))
        p, theta = map(symbols, (self.parameters, self.unknown_parameters))
        t = ca.SX.sym("t")
        arguments: list[Any] = [Names("state", x)]
        if self.algebraic:
            arguments.append(Names("algebraic variable", z))
        arguments += [Names("input", u | w), Names("parameter", p | theta), t]

        def evaluate(what: str, equations: Callable[..., Iterable[Any]], variables: Sequence[Variable]) -> ca.SX:
            where = f"model '{self.name}', {what}"
            values = evaluated(where, equations, arguments, "(x, z, u, p, t)" if self.algebraic else "(x, u, p, t)")
            return column_of(where, values, variables)

        def column(group: dict[str, ca.SX]) -> ca.SX:
            return ca.vertcat(*group.values()) if group else ca.SX(0, 1)

        made = Equations(
            x=column(x),
            z=column(z),
            u=column(u),
            w=column(w),
            p=column(p),
            theta=column(theta),
            t=t,
            ode=evaluate("ode", self.ode, self.states),
            algebraic=evaluate("algebraic_equations", self.algebraic_equations, self.algebraic)
            if self.algebraic_equations
            else ca.SX(0, 1),
            output=evaluate("output", self.output, self.outputs),
            constraint=evaluate("constraint", self.constraint, self.constraints) if self.constraint else ca.SX(0, 1),
        )
        for variable, expression in zip(self.outputs, ca.vertsplit(made.output), strict=True):
            if not ca.depends_on(expression, ca.vertcat(made.x, made.z)):
                raise ModelError(f"model '{self.name}': output '{variable.name}' depends on no state")
        for variable, expression in zip(self.constraints, ca.vertsplit(made.constraint), strict=True):
            if not ca.depends_on(expression, ca.vertcat(made.x, made.z, made.theta, made.w)):
                raise ModelError(
                    f"model '{self.name}': constraint '{variable.name}' depends on nothing that is estimated"
                )
        return made

    def _finite_at_start(self, made: Equations) -> list[float]:
        """The outputs at the start values, at t = 0; a ModelError that names the first equation which is not finite there."""
        groups = (
            self.states,
            self.algebraic,
            self.inputs,
            self.unknown_disturbances,
            self.parameters,
            self.unknown_parameters,
        )
        starts = [ca.DM([v.start for v in group]) for group in groups]
        symbols = [made.x, made.z, made.u, made.w, made.p, made.theta, made.t]
        for what, expressions, variables in (
            ("ode", made.ode, self.states),
            ("algebraic_equations", made.algebraic, self.algebraic),
            ("constraint", made.constraint, self.constraints),
            ("output", made.output, self.outputs),
        ):
            values = ca.Function("at_start", symbols, [ca.densify(expressions)])(*starts, 0).full().ravel().tolist()
            for variable, value in zip(variables, values, strict=True):
                if not math.isfinite(value):
                    raise ModelError(
                        f"model '{self.name}', {what}: the equation for '{variable.name}' is {value:g} at the start values"
                    )
        return values

    def __str__(self) -> str:
        lines = [f"Model {self.name}" + (f": {self.description}" if self.description else "")]
        for group, variables in self._groups().items():
            if variables:
                named = ", ".join(v.name + (f" [{v.unit}]" if v.unit not in ("", "1") else "") for v in variables)
                label = f"{group}s:" if len(variables) > 1 else f"{group}:"
                lines.append(f"  {len(variables)} {label:<22} {named}")
        return "\n".join(lines)


def column_of(where: str, values: Sequence[Any], variables: Sequence[Variable]) -> ca.SX:
    """The expressions `values`, one for each of `variables`, as a column.

    Raises:
        ModelError: there are more or fewer, or one is no scalar; the message begins with `where`.
    """
    if len(values) != len(variables):
        names = ", ".join(v.name for v in variables)
        raise ModelError(f"{where}: {len(values)} expressions for {len(variables)} variables ({names})")
    column = []
    for variable, value in zip(variables, values, strict=True):
        if isinstance(value, np.ndarray) and value.size == 1:
            value = value.item()
        if not isinstance(value, (Real, ca.DM, ca.SX)):
            raise ModelError(f"{where}: the expression for '{variable.name}' is {described(value)}, not a scalar")
        value = ca.SX(float(value) if isinstance(value, Real) else value)
        if value.shape != (1, 1):
            raise ModelError(
                f"{where}: the expression for '{variable.name}' is not a scalar, its shape is {value.shape}"
            )
        column.append(value)
    return ca.vertcat(*column) if column else ca.SX(0, 1)


def _no_name(given: object) -> str:
    if isinstance(given, str) and keyword.iskeyword(given):
        return "is a word of Python's own: take another, such as " + repr(f"{given}_")
    return "is not an identifier: letters, digits and _, a letter first"
