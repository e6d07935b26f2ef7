"""An observer and a static feedback as one component, hence one FMU: measurements in, the estimate and u = k(estimate) out.

The feedback acts at the observer's sample instants and is held between them. At t_k the output u_k = k(estimate of t_k), from samples up to
t_{k-1}, can be read before the step; the jump at t_k takes the same u_k in, and the observer flows with it to t_{k+1}, as the plant
does. So nothing depends directly on an input, every master runs the loop alike, and since the estimate read at t_k is *of* t_k there is
no delay beyond the hold.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import casadi as ca

from observers import units
from observers.component import Component, Port
from observers.numerics.layout import Layout

# How close to a sample instant a time is that instant: of the sample time, and of the time itself, of which doubles resolve 2e-16.
NEAR, RESOLUTION = 1e-6, 1e-15


def compose(
    observer: Component, feedback: Component, *, source: str = "estimate", name: str | None = None
) -> Component:
    """The component that closes the loop through `feedback` on what `observer` puts out.

    Each input `x` of the feedback is the observer's output `<source>.x`. Each of its outputs is an output, and where the observer has an
    input of that name (a known input of its model), it drives this too. Its parameters are called `feedback.<name>`. All else is the
    observer's.

    Args:
        observer: a component with a sample time, such as `pseudospectral` makes; or a plant with `source="x"`: its own true state then
            closes the loop.
        feedback: a component that has outputs only, such as `controller` makes.
        name: the component's name; `<observer>_<feedback>` if absent.

    Raises:
        ValueError: the observer has no output that an input of the feedback asks for; types or units differ; the feedback has states; the
            observer has no sample time, or one that can be 0; an output of the observer depends directly on an input.
    """
    where = f"compose '{observer.name}' with '{feedback.name}'"
    if feedback.n_z or feedback.jump is not None:
        raise ValueError(f"{where}: the feedback has {feedback.n_z} states; only a static one can be composed")
    read = [_source(where, observer, source, port) for port in feedback.inputs]
    driven = {port.name: k for k, port in enumerate(feedback.outputs)}
    _check_feedthrough(where, observer, driven)
    for goal in observer.inputs:
        if goal.name in driven:
            _check_fit(where, feedback.outputs[driven[goal.name]], goal, f"the observer takes '{goal.name}'")
    free = tuple(port for port in observer.inputs if port.name not in driven)
    n_p = len(observer.parameters)
    parameters = (*observer.parameters, *(replace(port, name=f"feedback.{port.name}") for port in feedback.parameters))

    # The observer comes last: its state may end with why its motion failed. next: the sample instant to come [s].
    state = Layout(held=len(feedback.outputs), next=1, observer=observer.n_z)
    z, u, p = ca.MX.sym("z", state.total), ca.MX.sym("u", len(free)), ca.MX.sym("p", len(parameters))
    t, h = ca.MX.sym("t"), ca.MX.sym("h")
    s, own, settings = state.unpack(z), p[:n_p], p[n_p:]
    period = _sample_time(where, observer, own)

    def inputs(control: ca.MX) -> ca.MX:
        """All inputs of the observer, in its order."""
        given = iter(range(len(free)))
        parts = [control[driven[v.name]] if v.name in driven else u[next(given)] for v in observer.inputs]
        return ca.vertcat(*parts) if parts else ca.MX(0, 1)

    y = observer.output(s.observer, inputs(s.held), own, t)
    fresh = feedback.output(ca.MX(0, 1), y[read] if read else ca.MX(0, 1), settings, t)
    due = t > s.next - ca.fmax(NEAR * period, RESOLUTION * ca.fabs(t))
    control = ca.if_else(due, fresh, s.held)
    flown = observer.flow(s.observer, inputs(s.held), own, t, h)
    jumped = observer.jump(s.observer, inputs(fresh), own, t) if observer.jump is not None else s.observer
    return replace(
        observer,
        name=name or f"{observer.name}_{feedback.name}",
        description=f"{observer.description}, with the feedback {feedback.name} ({feedback.description})",
        start=ca.Function("start", [p, t], [ca.vertcat(ca.DM.zeros(len(driven)), t, observer.start(own, t))]),
        flow=ca.Function("flow", [z, u, p, t, h], [ca.vertcat(s.held, s.next, flown)]),
        jump=ca.Function("jump", [z, u, p, t], [ca.densify(ca.vertcat(fresh, t + period, jumped))]),
        output=ca.Function("output", [z, u, p, t], [ca.vertcat(y, control)]),
        inputs=free,
        parameters=parameters,
        outputs=(*observer.outputs, *feedback.outputs),
        documentation=observer.documentation
        + f"<p>The loop is closed inside by the static feedback {feedback.name}: its outputs are held between the sample instants, and "
        "none depends directly on an input of this component.</p>",
    )


def _source(where: str, observer: Component, source: str, port: Port) -> int:
    """The position of the output that the feedback's input `port` reads."""
    places = {output.name: k for k, output in enumerate(observer.outputs)}
    wanted = f"{source}.{port.name}"
    if wanted not in places:
        known = ", ".join(name for name in places if name.startswith(f"{source}.")) or "none"
        raise ValueError(f"{where}: the feedback reads '{wanted}', which the observer does not put out; known: {known}")
    _check_fit(where, observer.outputs[places[wanted]], port, f"the feedback reads '{port.name}'")
    return places[wanted]


def _check_fit(where: str, source: Port, goal: Port, taking: str) -> None:
    """As between FMUs: types agree, nothing converts units, and an end without a unit, or a dimensionless one, fits any."""
    if source.kind != goal.kind:
        raise ValueError(f"{where}: '{source.name}' is of type {source.kind}, but {taking} as {goal.kind}")
    if not {"1", units.NONE} & {source.unit, goal.unit} and source.unit != goal.unit:
        raise ValueError(f"{where}: '{source.name}' is in {source.unit}, but {taking} in {goal.unit}")


def _check_feedthrough(where: str, observer: Component, driven: Collection[str]) -> None:
    """Outputs that depend on no input at once: then neither does u, and the loop is no algebraic one."""
    rows, columns = observer.output.jac_sparsity(0, 1).get_triplet() if observer.inputs else ([], [])
    for row, column in zip(rows, columns, strict=True):
        name = observer.inputs[column].name
        loop = "algebraic loop: " if name in driven else ""
        raise ValueError(
            f"{where}: {loop}the output '{observer.outputs[row].name}' depends directly on the input '{name}'"
        )


def _sample_time(where: str, observer: Component, p: ca.MX) -> ca.MX:
    if not isinstance(observer.sample_time, str):
        if observer.sample_time == 0:
            raise ValueError(f"{where}: '{observer.name}' has no sample time, at whose instants the feedback would act")
        return ca.MX(observer.sample_time)
    place = [port.name for port in observer.parameters].index(observer.sample_time)
    if not observer.parameters[place].min > 0:
        raise ValueError(
            f"{where}: the sample time '{observer.sample_time}' of '{observer.name}' can be 0 (its min is "
            f"{observer.parameters[place].min:g}), but the feedback acts at sample instants"
        )
    return p[place]
