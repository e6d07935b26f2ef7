"""Small components made by hand, for tests of the shell: every kind of variable, every way in which time enters."""

from __future__ import annotations

import casadi as ca

from observers.component import Component, Enumeration, Failure, Port
from observers.model import Model, Variable
from reference_models.plant import plant

STATUS = Enumeration(
    "ToyStatus", (("Good", "the last sample was used"), ("Rejected", "the last sample was not finite"))
)
MODE = Enumeration("ToyMode", (("Average", "move towards the sample"), ("Replace", "take the sample")))


def sampled_toy() -> Component:
    """A level that integrates `rate`, twice as fast after `kick_time`, and is corrected by the sampled `y`.

    z = (level, level at the last sample, rejected samples, status). Not a finite y: the sample is rejected and counted.
    """
    parameters = (
        Port("start.level", "level at the start time", "m", start=1.0, min=-10.0, max=10.0, variability="fixed"),
        Port("sample_time", "sample time", "s", start=0.1, min=0.01, max=10.0, variability="fixed"),
        Port("kick_time", "from here on the level moves twice as fast", "s", start=0.33, variability="fixed"),
        Port("tuning.gain", "weight of a sample", start=0.5, min=0.0, max=1.0, variability="tunable"),
        Port("tuning.scale", "divides the gain", start=1, min=1, max=5, kind="Integer", variability="tunable"),
        Port("tuning.mode", "what a sample does", start=1, kind="Enumeration", enumeration=MODE, variability="tunable"),
    )
    outputs = (
        Port("estimate.level", "level now", "m"),
        Port("filtered.level", "level at the last sample", "m", variability="discrete"),
        Port(
            "diagnostics.status", "how it goes", start=1, kind="Enumeration", enumeration=STATUS, variability="discrete"
        ),
        Port("diagnostics.rejected_samples", "samples not used", kind="Integer", variability="discrete"),
        Port("diagnostics.doubled", "twice the level", "m", local=True),
    )
    z, u, p, t, h = ca.SX.sym("z", 4), ca.SX.sym("u", 2), ca.SX.sym("p", 6), ca.SX.sym("t"), ca.SX.sym("h")
    level, filtered, rejected, status = ca.vertsplit(z)
    y, rate = ca.vertsplit(u)
    start, _, kick, gain, scale, mode = ca.vertsplit(p)
    finite = ca.fabs(y) < 1e300
    weight = ca.if_else(mode == 2, 1, gain / scale)
    corrected = ca.if_else(finite, level + weight * (y - level), level)
    speed = ca.if_else(t + h / 2 > kick, 2, 1)
    return Component(
        name="sampled_toy",
        description="Sampled & integrated <toy>",
        start=ca.Function("start", [p, t], [ca.vertcat(start, start, 0, 1)]),
        flow=ca.Function("flow", [z, u, p, t, h], [ca.vertcat(level + h * speed * rate, filtered, rejected, status)]),
        jump=ca.Function(
            "jump", [z, u, p, t], [ca.vertcat(corrected, corrected, rejected + (1 - finite), ca.if_else(finite, 1, 2))]
        ),
        output=ca.Function("output", [z, u, p, t], [ca.vertcat(level, filtered, status, rejected, 2 * level)]),
        inputs=(Port("y", "measured level", "m"), Port("rate", "known rate", "m/s", start=0.25)),
        parameters=parameters,
        outputs=outputs,
        constants=(Port("certificate", "a number of the method", "1/(V2.s2)", start=0.125),),
        sample_time="sample_time",
        samples_inputs=True,
        breaks=("kick_time",),
        max_step=0.03,
        stop_time=2.0,
        step_size=0.1,
        counters=("diagnostics.rejected_samples",),
        documentation="<p>For tests.</p>",
    )


def feedthrough_toy() -> Component:
    """A static controller: force = -gain * position, plus a bias that no input reaches."""
    z, u, p, t, h = ca.SX(0, 1), ca.SX.sym("u", 1), ca.SX.sym("p", 2), ca.SX.sym("t"), ca.SX.sym("h")
    return Component(
        name="feedthrough_toy",
        description="Static gain",
        start=ca.Function("start", [p, t], [z]),
        flow=ca.Function("flow", [z, u, p, t, h], [z]),
        output=ca.Function("output", [z, u, p, t], [ca.vertcat(-p[0] * u[0], p[1] + t)]),
        inputs=(Port("position", "position", "m"),),
        parameters=(
            Port("gain", "gain", "N/m", start=2.0, variability="tunable"),
            Port("bias", "bias", "N", start=1.0, variability="tunable"),
        ),
        outputs=(Port("force", "force", "N"), Port("bias_now", "bias plus time", "N")),
    )


def growing_toy() -> Component:
    """z' = z^2 by Euler steps: leaves the doubles soon, which must not pass. Of MX, with a linear solve inside."""
    z, u, p, t, h = ca.MX.sym("z", 2), ca.MX.sym("u", 0), ca.MX.sym("p", 1), ca.MX.sym("t"), ca.MX.sym("h")
    matrix = ca.vertcat(ca.horzcat(2, 1), ca.horzcat(1, 3))
    return Component(
        name="growing_toy",
        description="A state that blows up",
        start=ca.Function("start", [p, t], [ca.vertcat(p, ca.if_else(p < 1e300, p, 1e10 * p))]),  # overflows
        flow=ca.Function("flow", [z, u, p, t, h], [z + h * ca.mtimes(matrix, ca.solve(matrix, z, "qr")) ** 2]),
        output=ca.Function("output", [z, u, p, t], [z[0]]),
        parameters=(Port("start.z", "start value", start=1.0, variability="fixed"),),
        outputs=(Port("z", "the state"),),
        max_step=0.03,
        stop_time=0.5,
        step_size=0.1,
    )


def draining_toy() -> Component:
    """A tank that drains by Torricelli's law, its outflow an algebraic variable: level (sqrt(start) - t / 2)^2, empty at a singularity.

    Twice the outflow of `head` = level + lift; the equations stand so that dg/dz has a zero on its diagonal.
    """
    model = Model(
        name="draining_toy",
        states=[Variable("level", start=1.0)],
        algebraic=[Variable("outflow", start=0.8), Variable("head", start=0.7)],
        inputs=[Variable("lift")],
        outputs=[Variable("y")],
        ode=lambda x, z, u, p, t: [-z.outflow],
        algebraic_equations=lambda x, z, u, p, t: [z.head - x.level - u.lift, z.outflow**2 - z.head],
        output=lambda x, z, u, p, t: [z.outflow],
    )
    return plant(model, max_step=1e-3, stop_time=1.9)


def double_toy() -> Component:
    """Everything at least twice, so that the second of a kind is told from the first; every right-hand side depends on t itself.

    s' = a (1, 2 or 4: before, between, after the kicks), w' = t b, each a failure beyond 8; a sample counts a > 100 and b > 100.
    """
    inputs = (
        Port("a", "first input", "m/s", start=0.5),
        Port("flag", "a truth value", kind="Boolean", start=1, variability="discrete"),
        Port("b", "second input", "m/s2", start=-1.0),
    )
    parameters = (
        Port("start.s", "start of s", "m", start=0.25, min=-10, max=10, variability="fixed"),
        Port("late_kick", "from here on s moves four times as fast", "s", start=0.27, variability="fixed"),
        Port("early_kick", "from here on s moves twice as fast", "s", start=0.13, variability="fixed"),
        Port("sample_time", "sample time", "s", start=0.1, min=0.01, max=1.0, variability="fixed"),
        Port("gain", "gain", start=2.0, min=-3.0, max=4.0, variability="tunable"),
        Port("bias", "bias", "m/s", start=0.5, min=-1.0, max=1.0, variability="tunable"),
        Port("weight", "added at a sample", start=1, min=-2, max=9, kind="Integer", variability="tunable"),
        Port("enabled", "whether samples count", start=1, kind="Boolean", variability="tunable"),
    )
    outputs = (
        Port("s", "first state", "m"),
        Port("w", "second state", "m"),
        Port("sampled_flag", "the flag at the last sample", kind="Boolean", variability="discrete"),
        Port("total", "sum of the weights", kind="Integer", variability="discrete"),
        Port("high_a", "samples with a large a", kind="Integer", variability="discrete"),
        Port("high_b", "samples with a large b", kind="Integer", variability="discrete"),
        Port("force", "gain a + bias + t", "m/s"),
        Port("inverse", "1 / b", "s2/m"),
    )
    z, u, p, t, h = ca.SX.sym("z", 9), ca.SX.sym("u", 3), ca.SX.sym("p", 8), ca.SX.sym("t"), ca.SX.sym("h")
    s, w, flag, total, high_a, high_b, code, when, measure = ca.vertsplit(z)
    a, now, b = ca.vertsplit(u)
    start, late, early, _, gain, bias, weight, enabled = ca.vertsplit(p)
    middle = t + h / 2
    s_new = s + h * a * ca.if_else(middle > late, 4, ca.if_else(middle > early, 2, 1))
    w_new = w + h * middle * b
    broken = ca.if_else(s_new > 8, 1, ca.if_else(w_new > 8, 2, 0))
    kept = code != 0
    failure = [
        ca.if_else(kept, code, broken),
        ca.if_else(kept, when, ca.if_else(broken, t + h, 0)),
        ca.if_else(kept, measure, ca.if_else(broken == 1, s_new, ca.if_else(broken, w_new, 0))),
    ]
    return Component(
        name="double_toy",
        description="Two of everything",
        start=ca.Function("start", [p, t], [ca.vertcat(start, t, 0, 0, 0, 0, start > 9, t, start)]),
        flow=ca.Function("flow", [z, u, p, t, h], [ca.vertcat(s_new, w_new, flag, total, high_a, high_b, *failure)]),
        jump=ca.Function(
            "jump",
            [z, u, p, t],
            [
                ca.vertcat(
                    s, w, now, total + enabled * weight, high_a + (a > 100), high_b + (b > 100), code, when, measure
                )
            ],
        ),
        output=ca.Function(
            "output", [z, u, p, t], [ca.vertcat(s, w, flag, total, high_a, high_b, gain * a + bias + t, 1 / b)]
        ),
        inputs=inputs,
        parameters=parameters,
        outputs=outputs,
        constants=(
            Port("first", "a constant", start=0.125),
            Port("second", "another", start=-3, kind="Integer", variability="constant"),
        ),
        sample_time="sample_time",
        samples_inputs=True,
        breaks=("late_kick", "early_kick"),
        counters=("high_a", "high_b"),
        failures=(Failure("s ran away", "s"), Failure("w ran away", "w")),
        max_step=0.02,
        stop_time=1.0,
        step_size=0.1,
    )


def guarded_toy() -> Component:
    """level' = 1, by functions that refuse to be evaluated where parameters say so: an assertion, which CasADi's C answers with its code.

    The motion refuses the substep around `stuck_at`, the sample the instant `blind_at`, the outputs a level beyond `highest`.
    """
    names = ("start.level", "kick", "stuck_at", "blind_at", "highest")
    z, u, p, t, h = ca.MX.sym("z", 1), ca.MX.sym("u", 0), ca.MX.sym("p", 5), ca.MX.sym("t"), ca.MX.sym("h")
    start, _, stuck, blind, highest = ca.vertsplit(p)
    moves = ca.logic_or(stuck < t, t + h < stuck)
    return Component(
        name="guarded_toy",
        description="Functions that are not defined everywhere",
        start=ca.Function("start", [p, t], [start.attachAssert(start > 0, "no start")]),
        flow=ca.Function("flow", [z, u, p, t, h], [(z + h).attachAssert(moves, "no motion")]),
        jump=ca.Function("jump", [z, u, p, t], [z.attachAssert(ca.fabs(t - blind) > 1e-3, "no sample")]),
        output=ca.Function("output", [z, u, p, t], [z.attachAssert(z <= highest, "no output")]),
        parameters=(
            Port(names[0], "level at the start", start=1.0, variability="fixed"),
            Port(names[1], "the right-hand side jumps", "s", start=0.06, variability="fixed"),
            *(Port(name, "where a function refuses", start=9.0, variability="tunable") for name in names[2:]),
        ),
        outputs=(Port("level", "the level"),),
        sample_time=0.04,
        breaks=("kick",),
        max_step=0.01,
    )
