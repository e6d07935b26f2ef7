"""Models for the moving-horizon tests, plants coupled to their observers, and linear references by the matrix exponential."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg import expm

from observers.instance import Instance
from observers.model import Model, Variable
from reference_models.plant import plant

A = np.array([[0.0, 1.0, 0.0], [-2.0, -0.3, 1.0], [0.0, 0.0, -0.5]])
B = np.array([0.0, 1.0, 0.4])


def linear(damping=None, disturbed=False, **changes):
    """x' = A x + B u, two outputs. With a `damping` parameter one entry of A is no constant, and its term stays in phi; `disturbed` adds
    an unknown constant d to the rate of x2."""
    arguments = dict(
        name="linear",
        states=[Variable(name) for name in ("x1", "x2", "x3")],
        inputs=[Variable("u")],
        parameters=[Variable("damping", start=damping)] if damping else [],
        unknown_parameters=[Variable("d")] if disturbed else [],
        outputs=[Variable("y1"), Variable("y2")],
        ode=lambda x, u, p, t: [
            x.x2,
            -2 * x.x1 - (p.damping if damping else 0.3) * x.x2 + x.x3 + u.u + (p.d if disturbed else 0),
            -0.5 * x.x3 + 0.4 * u.u,
        ],
        output=lambda x, u, p, t: [x.x1, x.x1 + 0.5 * x.x3 + 0.2 * u.u],
    )
    return Model(**{**arguments, **changes})


class Sampled(NamedTuple):
    """s[k+1] = F s[k] + G0 u[k] + G1 u[k+1], y[k] = C s[k] + D u[k]: `linear` over a sample time, s = [x; d] where it is disturbed."""

    F: np.ndarray
    G0: np.ndarray
    G1: np.ndarray
    C: np.ndarray
    D: np.ndarray

    def smoothed(self, y, u, valid=None):
        """The state at the last of the samples y (m, 2) that fits all of them best, by numpy's least squares."""
        n, m = len(self.F), len(y)
        step, offset, rows, right = np.eye(n), np.zeros(n), [], []
        for i in range(m):
            rows.append(self.C @ step)
            right.append(y[i] - self.C @ offset - self.D * u[i])
            if i + 1 < m:
                step, offset = self.F @ step, self.F @ offset + self.G0 * u[i] + self.G1 * u[i + 1]
        chosen = np.ones(2 * m, bool) if valid is None else np.ravel(valid)
        s0 = np.linalg.lstsq(np.vstack(rows)[chosen], np.concatenate(right)[chosen], rcond=None)[0]
        return step @ s0 + offset


def sampled(Ts, held=True, disturbed=False):
    """`linear` with its input held or linear between samples."""
    n = 3 + disturbed
    M = np.zeros((n + 2, n + 2))
    M[:3, :3], M[:3, n] = A, B
    if disturbed:
        M[1, 3] = 1
    M[n, n + 1] = 1
    E = expm(M * Ts)
    by_value, by_slope = E[:n, n], E[:n, n + 1] / Ts
    C = np.zeros((2, n))
    C[:, :3] = [[1, 0, 0], [1, 0, 0.5]]
    G1 = np.zeros(n) if held else by_slope
    return Sampled(E[:n, :n], by_value - G1, G1, C, np.array([0.0, 0.2]))


def rotation(bounded=True):
    """The paper's example (4): y = sin t is explained by x3 = 1 and by x3 = -1."""
    return Model(
        name="rotation",
        states=[
            Variable("x1"),
            Variable("x2"),
            Variable("x3", start=0.5, **({"min": 0.0} if bounded else {})),
        ],
        outputs=[Variable("y")],
        ode=lambda x, u, p, t: [x.x3 * x.x2, -x.x3 * x.x1, 0],
        output=lambda x, u, p, t: [x.x1],
    )


def rotation_with_sign():
    """The same with x3 >= 0 as a path constraint."""
    return replace(rotation(False), constraints=[Variable("forward", "-x3")], constraint=lambda x, u, p, t: [-x.x3])


NONLINEAR = Model(
    name="nonlinear",
    states=[Variable("x1", start=0.8), Variable("x2", start=-0.4), Variable("x3", start=0.5)],
    inputs=[Variable("u")],
    parameters=[Variable("a", start=1.1)],
    unknown_parameters=[Variable("theta", start=0.7), Variable("bias", start=0.2)],
    outputs=[Variable("y1"), Variable("y2")],
    ode=lambda x, u, p, t: [
        x.x2 + 0.1 * ca.sin(x.x3),
        -p.a * ca.sin(x.x1) - p.theta * x.x2 + u.u * x.x3,
        -x.x3 + ca.cos(0.7 * t) * x.x1 + 0.3 * u.u,
    ],
    output=lambda x, u, p, t: [x.x1**2 + x.x1 + 0.2 * ca.sin(t), x.x3 + p.bias + 0.1 * x.x2 * u.u],
)


def coupled(model, observer, samples, Ts, inputs=lambda t: 0.0, truth=None, guess=None):
    """Errors |filtered - true| (samples x estimated) of a plant and an observer in Jacobi order."""
    p, o = Instance(plant(model), truth or {}), Instance(observer, guess or {})
    names = [v.name for v in (*model.states, *model.unknown_parameters)]
    errors = []
    for k in range(samples):
        t = k * Ts
        for v in model.inputs:
            p.set(v.name, inputs(t))
            o.set(v.name, inputs(t))
        for v in model.outputs:
            o.set(v.name, p.get(v.name))
        true = np.array([p.get(f"x.{name}") for name in names])
        p.step(t, Ts)
        o.step(t, Ts)
        errors.append(np.abs([o.get(f"filtered.{name}") for name in names] - true))
    return np.array(errors), o


def noisy_rows(observer):
    """All outputs after each of 20 samples of the nonlinear model with noise on both measurements (20 x n)."""
    run, true, rng, rows = Instance(observer), Instance(plant(NONLINEAR)), np.random.default_rng(2), []
    for k in range(20):
        for one in (run, true):
            one.set("u", np.sin(0.3 * k))
        for name in ("y1", "y2"):
            run.set(name, true.get(name) + 0.01 * rng.normal())
        true.step(0.1 * k, 0.1)
        run.step(0.1 * k, 0.1)
        rows.append(run.outputs())
    return np.array(rows)
