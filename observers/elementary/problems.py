"""Elementary problems (Calvillo-Corona & Alamir, section 4): a model taken apart into scalar optimal control problems, one for each state.

    xi' = F(xi, x^c, nu, tau)                                                            (7)
    min over xi(.), nu(.) of the integral of q (xi - xi_ref)^2 + r |nu - nu_ref|^2       (8)

The problem of the state x_i has F = f_i; the other states and the disturbances on which f_i depends act as its controls nu, known inputs
and time are x^c. Which they are follows from the sparsity of f alone. A state that outputs see follows the measurements, any other one
its last iterate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from observers.elementary.output_problem import output_problems
from observers.elementary.scalar_problem import ScalarProblem
from observers.model import Model, ModelError, Names, Variable
from observers.refusal import refuse, refuse_opaque

LQ, GAUSS_NEWTON, GRID = "lq", "gauss_newton", "grid"
LEVELS = (LQ, GAUSS_NEWTON, GRID)
METHOD = "elementary"
PROXIMAL = 1e-9  # of q, towards the last iterate: where an output's slope vanishes, its state stays determined
_KINKED = {
    getattr(ca, f"OP_{name}")
    for name in (
        "FABS",
        "FMIN",
        "FMAX",
        "FLOOR",
        "CEIL",
        "SIGN",
        "COPYSIGN",
        "FMOD",
        "REMAINDER",
        "LT",
        "LE",
        "EQ",
        "NE",
    )
}


@dataclass(frozen=True)
class Elementary:
    """The elementary problem of one state.

    Attributes:
        index: i, of the state xi = x_i.
        states: indices of the other states that act as controls; `disturbances`: of the disturbances that do.
        outputs: indices of the outputs that see x_i.
        is_affine: its equation is affine in state and controls, the outputs in the state.
        level: how it is solved: LQ, GAUSS_NEWTON or GRID.
        reason: why at this level, as a text for the user.
    """

    index: int
    states: tuple[int, ...]
    disturbances: tuple[int, ...]
    outputs: tuple[int, ...]
    is_affine: bool
    level: str
    reason: str

    @property
    def n_controls(self) -> int:
        """Number of controls nu: states, then disturbances."""
        return len(self.states) + len(self.disturbances)

    def controls(self, model: Model) -> list[Variable]:
        """The variables that act as controls, in their order."""
        return [model.states[j] for j in self.states] + [model.unknown_disturbances[k] for k in self.disturbances]


def with_constants(model: Model) -> Model:
    """`model` with its unknown parameters as states that do not move.

    Such a state's problem has no control: its solution is the mean of the last iterate over the window. In the others' problems it is a
    control, free at every instant; (10) and the mean make it the same everywhere.

    Raises:
        ModelError: algebraic variables, rates or outputs that are no formulas.
    """
    refuse(model, METHOD, "algebraic")
    refuse_opaque(model, METHOD)
    constants = model.unknown_parameters
    if not constants:
        return model

    def of(equations: Callable[..., Any], more: list[Any]) -> Callable[..., Any]:
        def moved(x: Names, u: Names, p: Names, t: ca.SX) -> list[Any]:
            known = {v.name: getattr(p, v.name) for v in model.parameters}
            return [
                *equations(x, u, Names("parameter", known | {v.name: getattr(x, v.name) for v in constants}), t),
                *more,
            ]

        return moved

    return replace(
        model,
        states=[*model.states, *constants],
        unknown_parameters=(),
        ode=of(model.ode, [0] * len(constants)),
        output=of(model.output, []),
        constraint=of(model.constraint, []) if model.constraint is not None else None,
    )


def decompose(model: Model, levels: Mapping[str, str]) -> tuple[Elementary, ...]:
    """The elementary problems of `model` (`with_constants`), one for each state, each at the cheapest level that its structure allows.

    A control with bounds, or an equation that is not smooth, needs the grid. Without, an equation affine in its state and controls (and
    outputs affine in its state) is solved exactly as LQ, any other one by Gauss-Newton steps.

    Args:
        levels: by the state's name, a level to be used instead; one more general than needed is always possible.

    Raises:
        ModelError: a disturbance in no equation; a disturbed output with the name of a state.
        ValueError: an unknown name or level, a level that does not suffice, a grid without finite bounds of its state.
    """
    _refuse_disturbances(model)
    names = [v.name for v in model.states]
    for name, level in levels.items():
        if name not in names:
            raise ValueError(f"{METHOD}: level of '{name}': the model '{model.name}' has no such state")
        if level not in LEVELS:
            raise ValueError(f"{METHOD}: level of '{name}' = {level!r} must be one of {', '.join(LEVELS)}")
    return tuple(_elementary(model, i, levels.get(v.name)) for i, v in enumerate(model.states))


def _refuse_disturbances(model: Model) -> None:
    """Raise a ModelError that names a disturbance in no equation, or a disturbed output whose problem would have a state's name."""
    eq = model.equations
    for k, disturbance in enumerate(model.unknown_disturbances):
        if not ca.depends_on(ca.vertcat(eq.ode, eq.output), eq.w[k]):
            raise ModelError(
                f"{METHOD}: model '{model.name}': the unknown disturbance '{disturbance.name}' acts on no state and no output"
            )
    states = [v.name for v in model.states]
    for problem in output_problems(model):
        name = model.outputs[problem.index].name
        if name in states:
            raise ModelError(
                f"{METHOD}: model '{model.name}': the output '{name}', which an unknown disturbance acts on, has the name of a state: "
                "each has a problem of its own, whose weights go by its name"
            )


def _elementary(model: Model, i: int, wanted: str | None) -> Elementary:
    eq, state = model.equations, model.states[i]
    F = eq.ode[i]
    states = tuple(j for j in range(eq.x.numel()) if j != i and ca.depends_on(F, eq.x[j]))
    disturbances = tuple(k for k in range(eq.w.numel()) if ca.depends_on(F, eq.w[k]))
    outputs = tuple(m for m in range(eq.output.numel()) if ca.depends_on(eq.output[m], eq.x[i]))
    unknowns = ca.vertcat(eq.x[i], *[eq.x[j] for j in states], *[eq.w[k] for k in disturbances])
    bounded = [model.unknown_disturbances[k] for k in disturbances]
    bounded = [v for v in bounded if math.isfinite(v.min) or math.isfinite(v.max)]
    seen = ca.vertcat(*[eq.output[m] for m in outputs]) if outputs else ca.SX(0, 1)
    affine = not any(ca.which_depends(F, unknowns, 2, False))
    affine = affine and not (outputs and any(ca.which_depends(seen, eq.x[i], 2, False)))
    if bounded:
        least, reason = GRID, f"{bounded[0].name} is bounded"
    elif _is_rough(ca.vertcat(F, seen), unknowns):
        least, reason = GRID, "its equation is not smooth"
    elif not affine:
        least, reason = GAUSS_NEWTON, "its equation is smooth"
    else:
        least, reason = LQ, "its equation is affine"
    if wanted is not None and LEVELS.index(wanted) < LEVELS.index(least):
        raise ValueError(
            f"{METHOD}: level of '{state.name}' = '{wanted}' does not suffice: {least} is needed, as {reason}"
        )
    level, reason = (least, reason) if wanted is None else (wanted, "asked for")
    if level == GRID and not (math.isfinite(state.min) and math.isfinite(state.max)):
        raise ValueError(
            f"{METHOD}: the grid for '{state.name}' lacks a bound: min = {state.min:g}, max = {state.max:g} "
            f"must both be finite (needed as {reason})"
        )
    return Elementary(i, states, disturbances, outputs, affine, level, reason)


def _is_rough(expressions: ca.SX, unknowns: ca.SX) -> bool:
    """Whether an operation with a kink or a jump is done on anything that depends on `unknowns`."""
    rest = [symbol for symbol in ca.symvar(expressions) if not ca.depends_on(unknowns, symbol)]
    function = ca.Function("operations", [unknowns, ca.vertcat(*rest)], [expressions])
    depends = [False] * function.sz_w()
    for k in range(function.n_instructions()):
        operation, into, of = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            continue
        depends[into[0]] = of[0] == 0 if operation == ca.OP_INPUT else any(depends[i] for i in of)
        if depends[into[0]] and operation in _KINKED:
            return True
    return False


def describe(model: Model, problems: tuple[Elementary, ...]) -> list[str]:
    """One sentence for each problem, the states' and the outputs': its controls, what it follows, how it is solved and why."""
    lines = []
    for problem in problems:
        state = model.states[problem.index].name
        controls = ", ".join(v.name for v in problem.controls(model)) or "none"
        follows = ", ".join(model.outputs[m].name for m in problem.outputs) or f"the last iterate of {state}"
        lines.append(f"{state}: controls {controls}; follows {follows}; solved by {problem.level}, as {problem.reason}")
    for output in output_problems(model):
        name = model.outputs[output.index].name
        controls = ", ".join(model.unknown_disturbances[k].name for k in output.disturbances)
        lines.append(f"{name}: controls {controls}; follows {name}; solved at each sample, as it is an output's")
    return lines


def bounds(model: Model, problem: Elementary) -> tuple[list[float], list[float]]:
    """Smallest and largest values of the controls; states have none as controls of another state's problem."""
    free = [math.inf] * len(problem.states)
    chosen = [model.unknown_disturbances[k] for k in problem.disturbances]
    return [-v for v in free] + [v.min for v in chosen], free + [v.max for v in chosen]


def disturbed(model: Model, problem: Elementary) -> list[int]:
    """Of the outputs that see the state, those with disturbances."""
    return [output.index for output in output_problems(model) if output.index in problem.outputs]


def scalar_problem(model: Model, problem: Elementary, nodes: int) -> ScalarProblem:
    """The problem's functions (7), (8), for the solvers.

    `known` of an interval: inputs and time; `target` of a node: the measurements that see the state (or, where one was rejected, what the
    last iterate makes of it), the weights of those with disturbances, the last iterates x of the states and (for such outputs) w of the
    disturbances there, inputs and time.
    """
    eq, state = model.equations, model.states[problem.index]
    x, xi, ref, q = eq.x, ca.SX.sym("xi"), ca.SX.sym("ref"), ca.SX.sym("q")
    nu = ca.SX.sym("nu", problem.n_controls)
    controls = ca.vertcat(*[x[j] for j in problem.states], *[eq.w[k] for k in problem.disturbances])
    F = ca.substitute(eq.ode[problem.index], ca.vertcat(x[problem.index], controls), ca.vertcat(xi, nu))
    known = ca.vertcat(eq.u, eq.t)
    dynamics = ca.Function(
        "dynamics", [xi, nu, known, eq.p], [F, ca.densify(ca.jacobian(F, xi)), ca.densify(ca.jacobian(F, nu))]
    )
    y, weights = ca.SX.sym("y", len(problem.outputs)), ca.SX.sym("weights", len(disturbed(model, problem)))
    if problem.outputs:
        h = ca.substitute(ca.vertcat(*[eq.output[m] for m in problem.outputs]), x[problem.index], xi)
        c, each = ca.jacobian(h, xi), ca.SX.ones(len(problem.outputs))
        each[[problem.outputs.index(m) for m in disturbed(model, problem)]] = weights
        value = ca.dot(each * (y - h), y - h) + PROXIMAL * (xi - ref) ** 2
        slope = PROXIMAL * (xi - ref) - ca.dot(each * c, y - h)
        second = ca.dot(each * c, c) + PROXIMAL
    else:
        value, slope, second = (xi - ref) ** 2, xi - ref, ca.SX(1)
    w = eq.w if disturbed(model, problem) else ca.SX(0, 1)
    target = ca.vertcat(y, weights, x, w, eq.u, eq.t)
    lower, upper = bounds(model, problem)
    return ScalarProblem(
        name=state.name,
        dynamics=dynamics,
        penalty=ca.Function("penalty", [xi, ref, target, eq.p, q], [q / 2 * value, q * slope, q * second]),
        affine=problem.is_affine,
        lower=lower,
        upper=upper,
        nodes=(state.min, state.max, nodes),
    )
