"""Other tools run our systems: the same numbers, or what docs/masters.md says of them."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest

from build_fmus import FMUS, SYSTEMS
from cosim.fmu import Value
from cosim.master import run
from cosim.masters import process
from cosim.masters.comparison import LIMIT, MASTERS, differences, largest, record_all
from cosim.masters.experiment import MasterError
from cosim.system import Element, System
from fmu_src import export
from observers.component import Component, Port
from observers.instance import Instance
from reference_models.duffing import DUFFING
from reference_models.plant import plant
from systems import coupled, edited, written
from tools import ROOT

Build = Callable[[str], Path]
OTHERS = ("ecos", "libcosim")
UNREAD = {"ecos": {"Enumeration"}, "libcosim": {"Enumeration", "Boolean"}}  # kinds of outputs that a tool does not give
# The systems with a static controller as an FMU of its own: direct feedthrough, which the others delay by a step.
DELAYED = ("closed_loop_duffing_controller", "closed_loop_motor_controller")


@pytest.mark.usefixtures("other_masters")
@pytest.mark.parametrize("name", [name for name in SYSTEMS if name not in DELAYED])
def test_every_system_without_direct_feedthrough_gives_the_same_numbers_in_every_tool(
    name: str, catalogue_system: Build
) -> None:
    recordings = record_all(catalogue_system(name), MASTERS)
    reference = recordings["fmpy"]
    kinds = run(catalogue_system(name), stop=SYSTEMS[name].step).kinds
    for tool in OTHERS:
        found = differences(reference, recordings[tool])
        assert largest(found) <= LIMIT, found
        missing = {column for column, value in found.items() if value is None}
        assert missing == {column for column, kind in kinds.items() if kind in UNREAD[tool]}


@pytest.mark.usefixtures("other_masters")
@pytest.mark.parametrize("tool", OTHERS)
@pytest.mark.parametrize(
    ("element", "values"),
    [
        ("plant", {"start.x1": 1.25}),
        ("plant", {"parameter.damping": 0.5}),
        ("plant", {"parameter.theta_jump_time[1]": 2.03, "parameter.theta_jump_value[1]": 0.1}),
        ("plant", {"sensor.seed": 7}),
        ("plant", {"u": 0.5}),
        ("toy", {"start.level": -2.0}),
        ("toy", {"tuning.scale": 3}),
        ("toy", {"tuning.gain": 0.125}),
        ("toy", {"sample_time": 0.2}),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else value,
)
def test_a_parameter_binding_that_differs_from_the_default_is_applied(
    tool: str, element: str, values: dict[str, Value], built: Build, tmp_path: Path
) -> None:
    with_binding = record_all(written(coupled(built, **{element: values}), tmp_path), ["fmpy", tool])
    without = process.record(tool, written(coupled(built), tmp_path))
    assert largest(differences(with_binding["fmpy"], with_binding[tool])) <= LIMIT
    assert largest(differences(without, with_binding[tool])) > 1e-3


@pytest.mark.usefixtures("other_masters")
def test_libcosim_runs_from_a_start_time_and_ecos_says_that_it_cannot(built: Build, tmp_path: Path) -> None:
    system = System("late", {"plant": Element(built("duffing"))}, start=10.0, stop=15.0, step=0.1)
    path = written(system, tmp_path)
    recordings = record_all(path, ["fmpy", "libcosim"])
    assert largest(differences(recordings["fmpy"], recordings["libcosim"])) <= LIMIT
    assert recordings["libcosim"]["time"][0] == 10.0
    with pytest.raises(MasterError, match="ecos: starts at t = 0, not at 10 as asked"):
        process.record("ecos", path)


@pytest.mark.usefixtures("other_masters")
def test_a_tool_that_ends_its_process_is_a_message(built: Build, tmp_path: Path) -> None:
    path = written(coupled(built, toy={"tuning.mode": 2}), tmp_path)
    with pytest.raises(MasterError, match=r"libcosim: the process ended by SIGABRT: .*Enumeration type"):
        process.record("libcosim", path)
    with pytest.raises(MasterError, match="ecos: Unknown XML node in ssv:Parameter"):
        process.record("ecos", path)


@pytest.mark.usefixtures("other_masters")
def test_libcosim_stops_where_an_fmu_fails_and_ecos_goes_on_with_the_last_values(built: Build, tmp_path: Path) -> None:
    path = written(System("doomed", {"growing": Element(built("growing_toy"))}, stop=3.0, step=0.1), tmp_path)
    with pytest.raises(MasterError, match=r"libcosim: .*the state is not finite after the step from t = 1\.3 to 1\.4"):
        process.record("libcosim", path)
    z = process.record("ecos", path)["growing.z"]
    assert len(z) == 31 and z[12] < z[13] and np.all(z[13:] == z[13])


@pytest.mark.usefixtures("other_masters")
def test_ecos_applies_only_the_parameter_set_that_it_is_told_by_name(built: Build, tmp_path: Path) -> None:
    path = written(coupled(built, {"start.x1": 1.25}), tmp_path)
    other = edited(path, lambda text: text.replace('"initialValues"', '"other"'), "other")
    recordings = record_all(other, MASTERS)
    assert recordings["libcosim"]["plant.x.x1"][0] == recordings["fmpy"]["plant.x.x1"][0] == 1.25
    assert recordings["ecos"]["plant.x.x1"][0] == DUFFING.states[0].start != 1.25


@pytest.mark.usefixtures("other_masters")
def test_ecos_and_libcosim_ignore_parameters_bound_at_the_system(built: Build, tmp_path: Path) -> None:
    system = System("alone", {"plant": Element(built("duffing"), {"start.x1": 1.25})}, stop=1.0, step=0.1)

    def lift(text: str) -> str:
        bindings = re.search(r"<ssd:ParameterBindings>.*?</ssd:ParameterBindings>", text, re.DOTALL)
        assert bindings is not None
        lifted = bindings[0].replace('ssv:Parameter name="', 'ssv:Parameter name="plant.')
        return text.replace(bindings[0], "").replace("<ssd:Elements>", lifted + "<ssd:Elements>")

    recordings = record_all(edited(written(system, tmp_path), lift, "lifted"), MASTERS)
    starts = {tool: recording["plant.x.x1"][0] for tool, recording in recordings.items()}
    default = DUFFING.states[0].start
    assert starts == {"fmpy": 1.25, "ecos": default, "libcosim": default}


def gain() -> Component:
    """A static controller, u = -0.5 y."""
    z, u, p, t, h = ca.SX(0, 1), ca.SX.sym("u", 1), ca.SX.sym("p", 0), ca.SX.sym("t"), ca.SX.sym("h")
    return Component(
        name="gain",
        description="Static gain",
        start=ca.Function("start", [p, t], [z]),
        flow=ca.Function("flow", [z, u, p, t, h], [z]),
        output=ca.Function("output", [z, u, p, t], [-0.5 * u]),
        inputs=(Port("y", "measured"),),
        outputs=(Port("u", "force"),),
    )


@pytest.mark.usefixtures("other_masters")
def test_direct_feedthrough_comes_one_step_late_in_ecos_and_libcosim(built: Build, tmp_path: Path) -> None:
    elements = {"plant": Element(built("duffing")), "gain": Element(export(gain(), tmp_path))}
    system = System("loop", elements, [("plant.y", "gain.y"), ("gain.u", "plant.u")], stop=5.0, step=0.1)
    recordings = record_all(written(system, tmp_path), MASTERS)
    at_once, late = (delayed_loop(delay) for delay in (0, 1))
    assert np.abs(at_once - late).max() > 0.01
    np.testing.assert_allclose(recordings["fmpy"]["plant.y"], at_once, rtol=1e-12)
    for tool in OTHERS:
        np.testing.assert_allclose(recordings[tool]["plant.y"], late, rtol=1e-12)


def delayed_loop(delay: int) -> np.ndarray:
    """The plant's y under u = -0.5 y, by the Python face; u is of `delay` steps ago, at first of the start."""
    run = Instance(plant(DUFFING, jumps={"theta": 2}))
    y = [run.get("y")]
    for k in range(50):
        run.set("u", -0.5 * y[max(k - delay, 0)])
        run.step(0.1 * k, 0.1)
        y.append(run.get("y"))
    return np.array(y)


@pytest.mark.usefixtures("other_masters")
@pytest.mark.parametrize("name", DELAYED)
def test_a_loop_through_a_controller_fmu_is_one_step_late_in_ecos_and_libcosim_and_nothing_else(
    name: str, catalogue_system: Build
) -> None:
    recordings = record_all(catalogue_system(name), MASTERS)
    late = read_then_set(name)
    in_time = recordings["fmpy"]["plant.x.x1"]
    assert np.abs(in_time - late["plant.x.x1"]).max() > 1e-4 * np.abs(in_time).max()
    for tool in OTHERS:
        for column, values in late.items():
            # Ecos shows what the controller makes of the inputs that it has just been given: what acts a step later.
            if column in recordings[tool] and not (tool == "ecos" and column == "controller.u"):
                limit = 1e-12 * np.abs(values).max()
                np.testing.assert_allclose(
                    recordings[tool][column], values, rtol=0, atol=limit, err_msg=f"{tool} {column}"
                )


def read_then_set(name: str) -> dict[str, np.ndarray]:
    """The outputs of a system of the catalogue by the Python face where all outputs are read and then all inputs set, once a step.

    They are exchanged once before, in initialisation.
    """
    recipe = SYSTEMS[name]
    runs = {e: Instance(FMUS[fmu][0](), recipe.parameters.get(e, {})) for e, fmu in recipe.fmus.items()}
    columns: dict[str, list[float]] = {
        f"{e}.{port.name}": [] for e, run in runs.items() for port in run.component.outputs
    }
    for k in range(-1, round(recipe.stop / recipe.step) + 1):
        if k > 0:
            for run in runs.values():
                run.step((k - 1) * recipe.step, recipe.step)
        outputs = [value for run in runs.values() for value in run.outputs()]
        if k >= 0:
            for values, value in zip(columns.values(), outputs, strict=True):
                values.append(value)
        now = dict(zip(columns, outputs, strict=True))
        for start, end in recipe.connections:
            element, _, variable = end.partition(".")
            runs[element].set(variable, now[start])
    return {column: np.array(values) for column, values in columns.items()}


@pytest.mark.parametrize("name", ["gong_example_2", "gong_example_2_ukf", "james_baras_5_1", "nikoukhah_motor"])
def test_an_observer_driven_by_fmpy_alone_gives_the_masters_numbers(
    name: str, example: Callable, catalogue_fmu: Build
) -> None:
    result, recipe = example(name), SYSTEMS[name]
    ends = [(end.partition(".")[2], start) for start, end in recipe.connections if end.startswith("observer.")]
    signals = np.rec.fromarrays([result.time, *(result[s] for _, s in ends)], names=["time", *(e for e, _ in ends)])
    outputs = [column for column in result.names if column.startswith("observer.")]
    found = fmpy.simulate_fmu(
        str(catalogue_fmu(recipe.fmus["observer"])),
        stop_time=result.time[-1],
        step_size=recipe.step,
        output_interval=recipe.step,
        start_values=dict(recipe.parameters.get("observer", {})),
        input=signals,
        output=[column.removeprefix("observer.") for column in outputs],
    )
    np.testing.assert_allclose(found["time"], result.time, rtol=1e-12)
    for column in outputs:
        scale = np.abs(result[column]).max()
        np.testing.assert_allclose(
            found[column.removeprefix("observer.")], result[column], rtol=0, atol=1e-12 * scale, err_msg=column
        )


@pytest.mark.usefixtures("other_masters")
@pytest.mark.parametrize("package", ["ecospy", "libcosimpy", "fmpy"])
def test_the_documented_commands_find_theta(package: str, catalogue_system: Build, tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "masters.md").read_text(encoding="utf-8"), flags=re.S)
    (code,) = (block for block in blocks if f"from {package}" in block or f"import {package}" in block)
    for made in catalogue_system("gong_example_2").parent.parent.iterdir():
        (tmp_path / made.name).symlink_to(made)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (theta,) = re.findall(r"^\[?(0\.\d+)\]?$", done.stdout, flags=re.M)  # among what libcosim says
    assert float(theta) == pytest.approx(0.3, abs=1e-6)
