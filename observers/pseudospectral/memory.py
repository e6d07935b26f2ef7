"""What the observer keeps from sample to sample, what it starts with, and what of it is shown."""

from __future__ import annotations

import casadi as ca

from observers.numerics import tiles
from observers.numerics.layout import Layout
from observers.pseudospectral import arrival, bounded_noise, covariance, innovation_test
from observers.pseudospectral.method import Method
from observers.pseudospectral.warm_start import AT_PREDICTION
from observers.status import CODE
from observers.status import shown as verdict


def layout(method: Method) -> Layout:
    """The observer's state z."""
    problem, nu, L = method.problem, method.equations.u.numel(), method.samples
    nx, nz, ny, nt = problem.nx, len(method.model.algebraic), problem.ny, problem.n_theta
    held = problem.segment.input_kind == "held"
    return Layout(
        x=nx,  # the prediction: the estimate of the current time
        z=nz,
        theta=nt,
        x_filtered=nx,  # the estimate of the last sample instant
        z_filtered=nz,
        theta_filtered=nt,
        y=ny * (L + 1),  # the window's samples, oldest first, and their weights: 0 = not taken yet, or rejected
        weight=ny * (L + 1),
        u=nu * (L + (not held)),  # its known inputs: means over the intervals (held), or values at the samples (linear)
        seen=nu * (L + 1) if method.sees_inputs else 0,  # and their values at the samples, where the outputs see them
        input_integral=nu,  # since the last sample
        V=problem.count
        * problem.n_rates,  # the window's trajectory: rates and algebraic variables at the nodes, first state
        Z=problem.count * problem.n_algebraic,
        x0=nx,
        noise=problem.count * problem.n_noise,  # its process noise, and theta at its start where that has some
        theta_first=nt if problem.noisy_parameters else 0,
        **arrival.state(method.model, method.arrival),
        **bounded_noise.state(method.model, method.constraints, L),
        innovation=ny,
        model=len(method.model.parameters),  # model parameters at the last sample
        k=1,  # samples so far
        fresh=1,  # where the next solve starts from: WARM, AT_PREDICTION, AT_GUESS
        changed=1,  # samples until a changed model parameter has left the window
        status=1,
        cost=1,
        iterations=1,
        conditioning=1,
        deviation=1,
        covariance=(nx + nt) ** 2,  # of x, theta: the estimate of the current time
        fit_noise=0 if method.weighted else 1,  # of the last fit, by which its covariance is multiplied
        **innovation_test.state(method),
        node0_residual=1,
        slack=int(method.constraints.any),
        path=len(method.model.constraints),  # the constraints' values at the last sample's estimate
        rejected=1,
        failures=1,
        restarts=1,
    )


def start(method: Method) -> ca.Function:
    """start(p, t0) -> z: the guess, and a window without samples."""
    state = layout(method)
    kind = tiles.kind(len(method.problem.scale))
    p, t = kind.sym("p", method.settings.total), kind.sym("t")
    q = method.settings.unpack(p)
    inputs = ca.DM([v.start for v in method.model.inputs])
    first = {part: ca.DM.zeros(size) for part, size in state.sizes.items()} | {
        "x": q.guess_x,
        "z": q.guess_z,
        "theta": q.guess_theta,
        "x_filtered": q.guess_x,
        "z_filtered": q.guess_z,
        "theta_filtered": q.guess_theta,
        "fresh": ca.DM(AT_PREDICTION),
        "status": ca.DM(CODE.propagated_guess),
        "model": q.model,
        "covariance": covariance.initial(method, q),
        "path": method.path(q.guess_x, inputs, q.model, q.guess_theta, t, q.guess_z),
        **innovation_test.start(),
        **arrival.start(q, method.arrival),
    }
    return ca.Function("start", [p, t], [state.pack(first)])


def output(method: Method) -> ca.Function:
    """output(z, u, p, t) -> y: what of the state is shown, in the order of the component's outputs."""
    state, model = layout(method), method.model
    z, u = ca.SX.sym("z", state.total), ca.SX.sym("u", 2 * len(model.outputs) + len(model.inputs))
    p, t, s = ca.SX.sym("p", method.settings.total), ca.SX.sym("t"), state.unpack(z)
    shown = [s.x, s.z, s.theta, s.x_filtered, s.z_filtered, s.theta_filtered, verdict(s.status), s.cost, s.iterations]
    shown += [
        s.innovation,
        covariance.standard_deviations(innovation_test.unit(method, s) * s.covariance),
        s.conditioning,
        s.deviation,
        s.node0_residual,
        s.slack,
        s.path,
        s.bounds,
        s.rejected,
        s.failures,
        s.restarts,
    ]
    return ca.Function("output", [z, u, p, t], [ca.vertcat(*shown)])
