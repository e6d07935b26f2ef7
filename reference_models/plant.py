"""A model becomes a plant: flow and output, jumps of its unknown parameters, sensor noise made inside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca

from observers import units
from observers.arguments import checked
from observers.component import Component, Failure, Port
from observers.linearisation import prediction_step
from observers.model import Model, Variable
from observers.numerics import noise
from reference_models.motion import consistent, move

NEVER = 1e30  # a jump time beyond any run
ACCURATE = 1e-6  # error of a step, in units of a state's largest value or of its nominal value
_ALGEBRAIC = (
    "The algebraic equations are solved by Newton's method at every stage, from the last solution; the first one is that near "
    "start.*. Where that branch of solutions ends, within a step or two of the method, the step is an error that names the "
    "variable, the time and the smallest pivot of dg/dz. Shorter steps come nearer to the end. "
)


@checked
def plant(
    model: Model,
    *,
    jumps: Mapping[str, int] | None = None,
    input_noise: bool = False,
    max_step: float = 0.05,
    stop_time: float = 50.0,
    step_size: float = 0.1,
) -> Component:
    """The component that behaves as `model` does.

    Unknown disturbances are inputs, behind the known ones. States are outputs `x.<state>`, algebraic variables `z.<name>`, unknown
    parameters `x.<name>` (their true value now). Parameters: `start.<state>`, `start.<algebraic variable>` (a guess: the solution
    near it is taken, and its branch followed until it ends), `parameter.<parameter>`; for each jump i of an unknown parameter (count
    in `jumps`) `parameter.<name>_jump_time[i]` and `parameter.<name>_jump_value[i]`, in ascending order: the value holds for t > time.
    Sensor: `sensor.noise_bound` (uniform), `sensor.noise_std` (Gaussian), of several outputs `sensor.noise_bound.<output>` and
    `sensor.noise_std.<output>`; `sensor.seed`, `sensor.sample_time` (0 = clean); y(t_k) carries the k-th draw. With `input_noise` the
    plant is driven by its known inputs plus noise of `actuator.noise_std` (of several inputs `actuator.noise_std.<input>`), Gaussian,
    drawn at the sensor's sample instants and held between them.

    Args:
        jumps: how many jumps of which unknown parameters.
        input_noise: the plant has the parameters `actuator.*`.
        max_step: the longest step of the eighth-order Runge-Kutta method [s]; shortened as
            `observers.linearisation.prediction_step` says.
        stop_time, step_size: the default experiment [s].

    Raises:
        ValueError: a jump of a parameter that is not unknown; noise of inputs where there are none.
    """
    jumps = dict(jumps or {})
    for name in jumps:
        if name not in {v.name for v in model.unknown_parameters}:
            raise ValueError(f"plant '{model.name}': jumps of '{name}', which is no unknown parameter")

    if input_noise and not model.inputs:
        raise ValueError(f"plant '{model.name}': input_noise of a model without known inputs")

    ports = _parameters(model, jumps, input_noise)
    p = {port.name: ca.SX.sym(port.name) for port in ports.all}
    p_all = ca.vertcat(*p.values())
    nx, ny, nz = len(model.states), len(model.outputs), len(model.algebraic)
    driven = (*model.inputs, *model.unknown_disturbances)
    x, u, t, h = ca.SX.sym("x", nx), ca.SX.sym("u", len(driven)), ca.SX.sym("t"), ca.SX.sym("h")
    # Noise of the outputs, of the inputs, and the states of their generators.
    nw = len(model.inputs) if input_noise else 0
    noise_now, stream = ca.SX.sym("noise", ny), ca.SX.sym("stream", 2)
    pushed, push = ca.SX.sym("pushed", nw), ca.SX.sym("push", 1 if nw else 0)
    algebraic, failure = ca.SX.sym("z", nz), ca.SX.sym("failure", 3 if nz else 0)
    z = ca.vertcat(x, algebraic, noise_now, stream, pushed, push, failure)
    eq = model.equations
    inputs = ca.vertcat(eq.u, eq.w)
    known = ca.vertcat(*[p[f"parameter.{q.name}"] for q in model.parameters])
    longest = prediction_step(model, max_step, tolerance=ACCURATE)
    measure = ca.Function("measure", [eq.x, eq.z, inputs, eq.p, eq.theta, eq.t], [eq.output])

    def unknown(time: ca.SX) -> ca.SX:
        return _unknown_parameters(model, jumps, p, time)

    sampled = p["sensor.sample_time"] > 0

    def scaled(group: Sequence[Port]) -> list[ca.SX]:
        return [sampled * p[port.name] for port in group]

    def drawn(state: ca.SX) -> tuple[ca.SX, ca.SX]:
        return noise.draw(state, scaled(ports.bounds), scaled(ports.deviations))

    def drawn_inputs(state: ca.SX) -> tuple[ca.SX, ca.SX]:
        return noise.draw_gaussian(state, scaled(ports.actuator)) if nw else (state, pushed)

    first_stream, first_noise = drawn(noise.start(p["sensor.seed"]))
    next_stream, next_noise = drawn(stream)
    first_push, first_pushed = drawn_inputs(noise.start_inputs(p["sensor.seed"]) if nw else push)
    next_push, next_pushed = drawn_inputs(push)

    def driving(noise_of_inputs: ca.SX, given: ca.SX) -> ca.SX:
        return ca.vertcat(given[:nw] + noise_of_inputs, given[nw:]) if nw else given

    theta = unknown(t + h / 2)  # constant over the substep, which the shell cuts at the jumps
    moved = move(model, x, algebraic, failure, [driving(pushed, u), known, theta], t, h)
    x_start = ca.vertcat(*[p[port.name] for port in ports.starts])
    z_guess = ca.vertcat(*[p[port.name] for port in ports.guesses])
    u_start = ca.SX(ca.DM([v.start for v in model.inputs]))
    z_start, first_failure = consistent(model, x_start, z_guess, [driving(first_pushed, u_start), known, unknown(t)], t)
    z_now, _ = consistent(
        model, x, algebraic, [driving(pushed, u), known, unknown(t)], t
    )  # an input set since the last step acts on it
    return Component(
        name=model.name,
        description=model.description or f"plant {model.name}",
        start=ca.Function(
            "start",
            [p_all, t],
            [ca.vertcat(x_start, z_start, first_noise, first_stream, first_pushed, first_push, first_failure)],
        ),
        flow=ca.Function(
            "flow", [z, u, p_all, t, h], [ca.vertcat(*moved[:2], noise_now, stream, pushed, push, moved[2])]
        ),
        jump=ca.Function(
            "jump",
            [z, u, p_all, t],
            [ca.vertcat(x, algebraic, next_noise, next_stream, next_pushed, next_push, failure)],
        ),
        output=ca.Function(
            "output",
            [z, u, p_all, t],
            [ca.vertcat(measure(x, z_now, driving(pushed, u), known, unknown(t), t) + noise_now, x, z_now, unknown(t))],
        ),
        inputs=tuple(_port(w.name, w, "continuous") for w in driven),
        parameters=ports.all,
        outputs=_outputs(model),
        sample_time="sensor.sample_time",
        breaks=tuple(port.name for port in ports.jumps if port.name.split("[")[0].endswith("_jump_time")),
        max_step=longest,
        failures=tuple(
            Failure(
                f"the algebraic equations do not determine '{v.name}' (singular, or no solution nearby)",
                "the smallest pivot of dg/dz",
            )
            for v in model.algebraic
        ),
        stop_time=stop_time,
        step_size=step_size,
        documentation=(
            f"<p>The model {model.name} as a plant, integrated with Dormand and Prince's eighth-order method in steps of at most "
            f"{longest:g} s. {_ALGEBRAIC if nz else ''}Measurement noise is made inside the plant by a Lehmer generator that "
            "gives the same sequence in every tool: y at the k-th sample instant carries the k-th draw.</p>"
        ),
    )


@dataclass(frozen=True)
class _Parameters:
    """A plant's parameters, by group."""

    starts: tuple[Port, ...]
    guesses: tuple[Port, ...]
    constants: tuple[Port, ...]
    jumps: tuple[Port, ...]
    bounds: tuple[Port, ...]
    deviations: tuple[Port, ...]
    sensor: tuple[Port, ...]
    actuator: tuple[Port, ...]

    @property
    def all(self) -> tuple[Port, ...]:
        first = (*self.starts, *self.guesses, *self.constants, *self.jumps)
        return (*first, *self.bounds, *self.deviations, *self.sensor, *self.actuator)


def _parameters(model: Model, jumps: Mapping[str, int], input_noise: bool) -> _Parameters:
    made: list[Port] = []
    for v in model.unknown_parameters:
        for i in range(1, jumps.get(v.name, 0) + 1):
            name, what = f"parameter.{v.name}_jump", v.description or v.name
            when = f"time of jump {i} of {v.name}"
            made.append(Port(f"{name}_time[{i}]", when, "s", NEVER, min=0.0, variability="fixed"))
            made.append(_port(f"{name}_value[{i}]", v, "tunable", f"{what} after jump {i}"))
    return _Parameters(
        starts=tuple(
            _port(f"start.{v.name}", v, "fixed", f"start value of the {v.description or v.name}") for v in model.states
        ),
        guesses=tuple(
            _port(f"start.{v.name}", v, "fixed", f"guess of the start value of the {v.description or v.name}")
            for v in model.algebraic
        ),
        constants=tuple(
            _port(f"parameter.{v.name}", v, "tunable") for v in (*model.parameters, *model.unknown_parameters)
        ),
        jumps=tuple(made),
        bounds=_noise("sensor.noise_bound", "half-width of the uniform measurement noise", model.outputs),
        deviations=_noise("sensor.noise_std", "standard deviation of the Gaussian measurement noise", model.outputs),
        sensor=_SENSOR,
        actuator=_noise(
            "actuator.noise_std", "standard deviation of the Gaussian noise added to the input", model.inputs
        )
        if input_noise
        else (),
    )


_SENSOR = (
    Port("sensor.seed", "seed of the noise", min=0, max=noise.LARGEST_SEED, kind="Integer", variability="fixed"),
    Port("sensor.sample_time", "sample time of the noise; 0: clean measurement", "s", min=0.0, variability="fixed"),
)


def _noise(name: str, what: str, of: Sequence[Variable]) -> tuple[Port, ...]:
    """A parameter for each of the variables: by its name, or `name` alone for a single one."""
    single = len(of) == 1
    return tuple(
        Port(
            name if single else f"{name}.{v.name}",
            what if single else f"{what} {v.name}",
            units.difference(v.unit),
            min=0.0,
            variability="tunable",
        )
        for v in of
    )


def _outputs(model: Model) -> tuple[Port, ...]:
    def true(branch: str, variables: Sequence[Variable]) -> list[Port]:
        return [_port(f"{branch}.{v.name}", v, "continuous", f"true {v.description or v.name}") for v in variables]

    measured = [_port(v.name, v, "continuous") for v in model.outputs]
    return (
        *measured,
        *true("x", model.states),
        *true("z", model.algebraic),
        *true("x", model.unknown_parameters),
    )


def _unknown_parameters(model: Model, jumps: Mapping[str, int], p: Mapping[str, ca.SX], time: ca.SX) -> ca.SX:
    """The unknown parameters at `time`: piecewise constant, the new value for time > jump time."""
    values = []
    for v in model.unknown_parameters:
        name = f"parameter.{v.name}"
        value = p[name]
        for i in range(1, jumps.get(v.name, 0) + 1):
            value = ca.if_else(time > p[f"{name}_jump_time[{i}]"], p[f"{name}_jump_value[{i}]"], value)
        values.append(value)
    return ca.vertcat(*values)


def _port(name: str, like: Variable, variability: str, description: str = "") -> Port:
    """A port called `name` with the unit, start and nominal of `like`; a parameter has its bounds too."""
    port = Port(name, description or like.description, like.unit, like.start, like.nominal, variability=variability)
    return port if variability == "continuous" else replace(port, min=like.min, max=like.max)
