"""The gallery's models, as their files stand: from the wrong guess to the truth under the sensors' noise, and trusted there."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import gallery
from observers.component import Component
from observers.instance import Instance
from tools import few

NAMES = sorted(path.stem for path in Path(gallery.__file__).parent.glob("[a-z]*.py"))
# The sensors' noise, for how long, and how far each estimate may be from the truth over the last quarter: a few times what is measured.
NOISE = {
    "gyro_attitude": {
        **{f"sensor.noise_std.a{axis}": 0.1 for axis in "xyz"},
        **{f"actuator.noise_std.gyro_{axis}": 0.01 for axis in "xyz"},
        "sensor.noise_std.compass": 0.05,
    },
    "lithium_cell": {"sensor.noise_std": 0.002},
    "quadruple_tank": {"sensor.noise_std.y1": 0.1, "sensor.noise_std.y2": 0.1},
    "single_track_car": {"sensor.noise_std.yaw_rate": 0.003, "sensor.noise_std.ay": 0.1},
    "stirred_tank": {"sensor.noise_std": 0.2},
}
LASTS = {
    "gyro_attitude": 20.0,
    "lithium_cell": 1200.0,
    "quadruple_tank": 400.0,
    "single_track_car": 20.0,
    "stirred_tank": 1000.0,
}
NEAR = {
    "gyro_attitude": {"roll": 0.02, "pitch": 0.02, "yaw": 0.02, "bias_x": 2e-3, "bias_y": 2e-3, "bias_z": 2e-3},
    "lithium_cell": {"soc": 1e-3, "v1": 2e-3, "R0": 6e-4},
    "quadruple_tank": {"h1": 0.3, "h2": 0.2, "h3": 0.01, "h4": 0.2, "valve1": 0.025},
    "single_track_car": {"vy": 0.03, "rate": 0.008, "grip": 0.03},
    "stirred_tank": {"c": 0.025, "T": 5.0, "cooling": 5e-4},
}


def source_of(module: object) -> Component:
    (source,) = [value for value in vars(module).values() if isinstance(value, Component) and not value.inputs]
    return source


@pytest.mark.parametrize("name", few(NAMES, 2))
def test_a_model_of_the_gallery_finds_the_truth_and_is_trusted(name: str) -> None:
    module = import_module(f"gallery.{name}")
    model, step = module.MODEL, module.SAMPLE_TIME
    truth = Instance(module.true_system, {"sensor.sample_time": step, "sensor.seed": 1, **NOISE[name]})
    observer, source = Instance(module.observer), Instance(source_of(module))
    read = [port.name for port in module.observer.outputs]
    errors, trusted = [], []
    for k in range(round(LASTS[name] / step)):
        for known in model.inputs:
            truth.set(known.name, source.get(known.name))
            observer.set(known.name, source.get(known.name))
        for measured in model.outputs:
            observer.set(measured.name, truth.get(measured.name))
        for instance in (source, truth, observer):
            instance.step(k * step, step)
        shown = dict(zip(read, observer.outputs(), strict=True))
        errors.append([shown[f"estimate.{v}"] - truth.get(f"x.{v}") for v in NEAR[name]])
        trusted.append(shown["diagnostics.trusted"] == 1)
    last = 3 * len(errors) // 4
    largest = dict(zip(NEAR[name], np.abs(errors[last:]).max(axis=0), strict=True))
    assert not {v: found for v, found in largest.items() if found > NEAR[name][v]}
    assert all(trusted[last:])
