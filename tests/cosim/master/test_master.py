"""The master: what it records is what the components do under Jacobi's order; what goes wrong is named."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest

import cosim.master.slave
from cosim.errors import ExperimentError, SystemFileError
from cosim.master import run
from cosim.master.slave import RunError
from cosim.results import read_csv, write_csv
from cosim.system import Element, System, write_ssp
from fmu_src import export
from observers.component import Component, Port
from observers.instance import Instance
from reference_models.duffing import DUFFING
from reference_models.plant import plant
from reference_models.sine import sine
from toys import sampled_toy

Build = Callable[[str], Path]

NOISE: dict[str, float] = {"sensor.sample_time": 0.1, "sensor.noise_bound": 0.2, "sensor.seed": 3}


def gain(name: str) -> Component:
    """A static gain: out = k * in, and an output that no input reaches."""
    z, u, p, t, h = ca.SX(0, 1), ca.SX.sym("u", 1), ca.SX.sym("p", 1), ca.SX.sym("t"), ca.SX.sym("h")
    return Component(
        name=name,
        description="Static gain",
        start=ca.Function("start", [p, t], [z]),
        flow=ca.Function("flow", [z, u, p, t, h], [z]),
        output=ca.Function("output", [z, u, p, t], [ca.vertcat(t, p[0] * u[0])]),
        inputs=(Port("in", "input"),),
        parameters=(Port("k", "gain", start=-2.0, variability="tunable"),),
        outputs=(Port("clock", "time", "s"), Port("out", "output")),
    )


@pytest.fixture(scope="module")
def more(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The paths of further FMUs."""
    folder = tmp_path_factory.mktemp("more")
    return {"gain": export(gain("gain"), folder), "sine": export(sine(), folder)}


@pytest.fixture
def observed(built: Build) -> System:
    """A plant and a component that samples its output."""
    return System(
        name="observed",
        elements={
            "plant": Element(built("duffing"), NOISE),
            "observer": Element(built("sampled_toy"), {"start.level": 2.0}),
        },
        connections=[("plant.y", "observer.y")],
        stop=3.0,
        step=0.05,
    )


def test_the_record_is_what_the_components_do_under_jacobis_order(observed: System) -> None:
    result = run(observed)
    truth = Instance(plant(DUFFING, jumps={"theta": 2}), NOISE)
    observer = Instance(sampled_toy(), {"start.level": 2.0})
    rows = []
    for i in range(61):
        observer.set("y", truth.get("y"))
        rows.append([*truth.outputs(), *observer.outputs()[:4]])
        truth.step(i * 0.05, 0.05)
        observer.step(i * 0.05, 0.05)
    assert result.names[:5] == ("plant.y", "plant.x.x1", "plant.x.x2", "plant.x.theta", "observer.estimate.level")
    np.testing.assert_array_equal(result.time, np.arange(61) * 0.05)
    np.testing.assert_allclose(result.values, np.array(rows), rtol=0, atol=1e-14)


def test_a_file_gives_the_bits_that_the_system_gives(observed: System, tmp_path: Path) -> None:
    write_ssp(observed, tmp_path / "observed.ssp")
    np.testing.assert_array_equal(run(tmp_path / "observed.ssp").values, run(observed).values)


def test_every_output_is_recorded_with_its_kind_unit_and_items(observed: System) -> None:
    result = run(observed)
    status = "observer.diagnostics.status"
    assert result.kinds[status] == "Enumeration" and result.items[status] == {1: "Good", 2: "Rejected"}
    assert result.kinds["observer.diagnostics.rejected_samples"] == "Integer"
    assert result.units["plant.x.x2"] == "m/s" and result.descriptions["plant.x.x2"] == "true velocity"
    assert set(result.step_ns) == {"plant", "observer"}
    assert all(len(ns) == 60 and (ns > 0).all() for ns in result.step_ns.values())
    with pytest.raises(KeyError, match=r"no column 'plant\.x\.x3'; did you mean 'plant\.x\.x"):
        result["plant.x.x3"]


def test_the_time_is_a_column_as_in_the_file(built: Build, tmp_path: Path) -> None:
    result = run(System("alone", {"plant": Element(built("duffing"))}, stop=1.0, step=0.1))
    write_csv(result, tmp_path / "results.csv")
    np.testing.assert_array_equal(result["time"], result.time)
    np.testing.assert_array_equal(result["time"], read_csv(tmp_path / "results.csv")["time"])
    with pytest.raises(KeyError, match="no column 'tim'; did you mean 'time'"):
        result["tim"]


def test_a_direct_output_follows_its_input_within_the_instant(built: Build, more: dict[str, Path]) -> None:
    elements = {
        "second": Element(more["gain"]),
        "first": Element(more["gain"], {"k": 3.0}),
        "plant": Element(built("duffing")),
    }
    connections = [("plant.x.x1", "first.in"), ("first.out", "second.in"), ("second.out", "plant.u")]
    result = run(System("loop", elements, connections, stop=2.0, step=0.1))
    np.testing.assert_array_equal(result["first.out"], 3.0 * result["plant.x.x1"])
    np.testing.assert_array_equal(result["second.out"], -2.0 * result["first.out"])
    assert np.ptp(result["second.out"]) > 1.0
    turned = run(System("loop", dict(reversed(elements.items())), connections[::-1], stop=2.0, step=0.1))
    for name in result.names:
        np.testing.assert_array_equal(turned[name], result[name])


def test_one_output_drives_many_inputs(built: Build, more: dict[str, Path]) -> None:
    elements = {"source": Element(more["sine"]), "a": Element(built("duffing")), "b": Element(built("duffing"))}
    result = run(System("fan", elements, [("source.y", "a.u"), ("source.y", "b.u")], stop=5.0, step=0.1))
    np.testing.assert_array_equal(result["a.x.x1"], result["b.x.x1"])
    free = run(System("free", {"a": Element(built("duffing"))}, stop=5.0, step=0.1))
    assert np.max(np.abs(free["a.x.x1"] - result["a.x.x1"])) > 0.1


def test_elements_that_share_an_fmu_are_independent(built: Build) -> None:
    elements = {"one": Element(built("duffing"), {"start.x1": 0.5}), "two": Element(built("duffing"))}
    together = run(System("pair", elements, stop=2.0, step=0.1))
    alone = run(System("alone", {"two": elements["two"]}, stop=2.0, step=0.1))
    np.testing.assert_array_equal(together["two.x.x1"], alone["two.x.x1"])
    assert together["one.x.x1"][0] == 0.5


def test_an_algebraic_loop_is_refused_by_name(more: dict[str, Path]) -> None:
    elements = {"a": Element(more["gain"]), "b": Element(more["gain"])}
    with pytest.raises(SystemFileError, match="algebraic loop: ") as caught:
        run(System("loop", elements, [("a.out", "b.in"), ("b.out", "a.in")], stop=1.0, step=0.1))
    for variable in ("a.in", "a.out", "b.in", "b.out"):
        assert variable in str(caught.value)


def test_an_override_acts_as_a_parameter_of_the_system_does(observed: System) -> None:
    overridden = run(observed, overrides={"plant.sensor.seed": "7", "observer.tuning.mode": "Replace"})
    plant_element, observer = observed.elements["plant"], observed.elements["observer"]
    elements = {
        "plant": replace(plant_element, parameters={**plant_element.parameters, "sensor.seed": 7}),
        "observer": replace(observer, parameters={**observer.parameters, "tuning.mode": 2}),
    }
    np.testing.assert_array_equal(overridden.values, run(replace(observed, elements=elements)).values)
    assert not np.array_equal(overridden["plant.y"], run(observed)["plant.y"])


def test_an_unconnected_input_can_be_set(observed: System) -> None:
    assert run(observed, overrides={"plant.u": 1.0})["plant.x.x2"][-1] != run(observed)["plant.x.x2"][-1]


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("plant.sensor.sede", 7, r"element 'plant' has no variable 'sensor\.sede'; did you mean 'sensor\.seed'"),
        ("plannt.sensor.seed", 7, r"there is no element 'plannt' \(plannt\.sensor\.seed\); did you mean 'plant'"),
        ("seed", 7, "'seed' is not of the form <element>.<variable>"),
        ("plant.sensor.seed", "1.5", r"'sensor\.seed' is an Integer: 1\.5 is not a whole number"),
        ("plant.sensor.seed", "many", "'many' is not a number"),
        ("plant.parameter.damping", -1.0, r"'parameter\.damping' = -1\.0 lies outside \[0, 100\]"),
        ("plant.x.x1", 1.0, r"'x\.x1' is an output that is calculated or constant: it cannot be set"),
        ("observer.y", 1.0, r"'observer\.y' cannot be set: it is connected to 'plant\.y'"),
    ],
)
def test_an_override_that_does_not_fit_is_refused(
    observed: System, name: str, value: float | str, message: str
) -> None:
    with pytest.raises(ExperimentError, match=message):
        run(observed, overrides={name: value})


@pytest.mark.parametrize(
    ("stop", "step", "message"),
    [
        (1.0, 0.3, r"stop time 1\.0 is not a multiple of the step size 0\.3"),
        (0.01, 0.1, r"stop time 0\.01 is not a multiple of the step size 0\.1"),
        (1.0, 0.0, "step size 0 must be positive"),
        (1.0, float("nan"), "step size nan must be positive"),
        (-1.0, 0.1, "stop time -1 must be finite and lie after the start time 0"),
        (float("inf"), 0.1, "stop time inf must be finite"),
        (1e300, 0.1, r"1e\+301 steps of 0\.1 s up to 1e\+300 s are more than 100000000"),
    ],
)
def test_an_experiment_that_is_no_whole_number_of_steps_is_refused(
    observed: System, stop: float, step: float, message: str
) -> None:
    with pytest.raises(ExperimentError, match=message):
        run(observed, stop=stop, step=step)


def test_a_record_that_memory_has_no_room_for_is_refused(observed: System, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(np, "zeros", full)
    with pytest.raises(ExperimentError, match=r"record of 10 steps of 0\.1 s does not fit into memory"):
        run(observed, stop=1.0, step=0.1)


def test_a_stop_time_that_only_rounding_keeps_from_a_multiple_is_accepted(observed: System) -> None:
    result = run(observed, stop=0.1 + 0.2, step=0.1)
    assert result.time.tolist() == [0.0, 0.1, 0.2, 3 * 0.1]


def test_a_run_may_start_at_any_time(built: Build) -> None:
    result = run(System("late", {"plant": Element(built("duffing"))}, start=2.0, stop=3.0, step=0.25))
    assert result.time.tolist() == [2.0, 2.25, 2.5, 2.75, 3.0]
    late = Instance(plant(DUFFING, jumps={"theta": 2}), t0=2.0)
    for t in result.time[:-1]:
        late.step(float(t), 0.25)
    assert result["plant.x.x1"][-1] == pytest.approx(late.get("x.x1"), rel=0, abs=1e-14)


def test_warnings_of_the_fmus_are_collected(built: Build) -> None:
    system = System("blind", {"observer": Element(built("sampled_toy"), {"y": float("nan")})}, stop=1.0, step=0.1)
    result = run(system)
    assert result["observer.diagnostics.rejected_samples"][-1] == 10
    assert result.messages and {(m.element, m.status) for m in result.messages} == {("observer", "warning")}
    assert "rejected_samples" in result.messages[0].text


def test_a_failure_in_the_middle_names_element_time_and_reason_and_keeps_the_rows(built: Build) -> None:
    elements = {"plant": Element(built("duffing")), "growing": Element(built("growing_toy"))}
    system = System("doomed", elements, stop=5.0, step=0.1)
    with pytest.raises(
        RunError, match=r"element 'growing' at t = [\d.]+: fmi2DoStep failed \(error\): .*finite"
    ) as caught:
        run(system)
    error = caught.value
    assert error.element == "growing" and error.partial is not None
    assert 2 < len(error.partial.time) < 51 and error.partial.time[-1] == error.time
    before = run(system, stop=float(error.partial.time[-1]))
    np.testing.assert_array_equal(error.partial.values, before.values)
    assert [m.status for m in error.partial.messages] == ["error"]


def test_a_value_that_an_fmu_refuses_is_a_failed_run(observed: System) -> None:
    with pytest.raises(RunError, match=r"element 'observer' at t = 0: .* h = 0\.2 .*") as caught:
        run(observed, step=0.2, stop=2.0)
    assert caught.value.partial is not None and len(caught.value.partial.time) == 1


def test_an_fmu_without_a_binary_for_this_platform_is_named(built: Build, tmp_path: Path) -> None:
    bare = tmp_path / "duffing.fmu"
    with zipfile.ZipFile(built("duffing")) as source, zipfile.ZipFile(bare, "w") as target:
        target.writestr("modelDescription.xml", source.read("modelDescription.xml"))
        target.writestr("binaries/riscv/duffing.so", b"")
    with pytest.raises(RunError, match=r"element 'plant' at t = 0: the FMU has no binary for .*; it has: riscv"):
        run(System("bare", {"plant": Element(bare)}))


@pytest.mark.skipif(fmpy.platform != "linux64", reason="moves this machine's binary about")
@pytest.mark.parametrize("folder", ["aarch64-linux", "linux64"])
def test_on_aarch64_the_folder_that_the_standard_names_comes_first_and_the_usual_one_then(
    folder: str, built: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = "import platform; platform.machine = lambda: 'aarch64'; from cosim.master.slave import PLATFORMS; print(*PLATFORMS)"
    shown = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True).stdout.split()
    assert shown == [f"aarch64-{fmpy.system}", fmpy.platform]
    monkeypatch.setattr(cosim.master.slave, "PLATFORMS", ("aarch64-linux", "linux64"))
    fmu = tmp_path / "duffing.fmu"
    with zipfile.ZipFile(built("duffing")) as source, zipfile.ZipFile(fmu, "w") as target:
        target.writestr("modelDescription.xml", source.read("modelDescription.xml"))
        works = source.read("binaries/linux64/duffing.so")
        for name, content in {"linux64": b"not for this processor", folder: works}.items():
            target.writestr(f"binaries/{name}/duffing.so", content)
    assert len(run(System("arm", {"plant": Element(fmu)}, stop=1.0, step=0.1)).time) == 11


def test_a_binary_that_is_none_and_a_foreign_guid_are_failures_of_the_element(built: Build, tmp_path: Path) -> None:
    def altered(old: str, member: str, content: bytes) -> Path:
        fmu = tmp_path / f"{old}.fmu"
        with zipfile.ZipFile(built("duffing")) as source, zipfile.ZipFile(fmu, "w") as target:
            for name in source.namelist():
                target.writestr(name, content if member in name else source.read(name))
        return fmu

    with zipfile.ZipFile(built("duffing")) as archive:
        description = archive.read("modelDescription.xml").decode()
    start = description.index('guid="') + len('guid="')
    foreign = description[:start] + "{foreign}" + description[description.index('"', start) :]
    here = Path.cwd()
    with pytest.raises(RunError, match="element 'plant' at t = 0: Failed to load shared library"):
        run(System("broken", {"plant": Element(altered("broken", "binaries/", b"no library"))}))
    with pytest.raises(RunError, match=r"element 'plant' at t = 0: fmi2Instantiate failed: .*foreign"):
        run(System("foreign", {"plant": Element(altered("foreign", "modelDescription", foreign.encode()))}))
    assert Path.cwd() == here


def test_a_damaged_fmu_is_named(built: Build, tmp_path: Path) -> None:
    damaged = tmp_path / "duffing.fmu"
    content = bytearray(built("duffing").read_bytes())
    with zipfile.ZipFile(built("duffing")) as archive:
        member = next(i for i in archive.infolist() if i.filename.startswith("binaries/"))
    middle = member.header_offset + 30 + len(member.filename) + member.compress_size // 2
    content[middle : middle + 8] = bytes(b ^ 0xFF for b in content[middle : middle + 8])
    damaged.write_bytes(content)
    with pytest.raises(SystemFileError, match=r"duffing\.fmu: the file is damaged"):
        run(System("damaged", {"plant": Element(damaged)}))


def test_nothing_stays_loaded_after_a_run_or_a_failure(observed: System, built: Build) -> None:
    maps = Path("/proc/self/maps")
    if not maps.exists():
        pytest.skip("needs Linux's /proc")
    run(observed)
    with pytest.raises(RunError):
        run(System("doomed", {"growing": Element(built("growing_toy"))}, stop=5.0, step=0.1))
    assert "cosim-" not in maps.read_text()


def test_progress_reports_steps_done(observed: System) -> None:
    calls: list[tuple[int, int]] = []
    run(observed, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(i, 60) for i in range(1, 61)]


def test_the_csv_file_reads_back_bit_for_bit(observed: System, tmp_path: Path) -> None:
    result = run(observed)
    write_csv(result, tmp_path / "results.csv")
    read = read_csv(tmp_path / "results.csv")
    assert list(read) == ["time", *result.names]
    np.testing.assert_array_equal(read["time"], result.time)
    for name in result.names:
        np.testing.assert_array_equal(read[name], result[name])
    assert (tmp_path / "results.csv").read_text().splitlines()[1].split(",")[-2:] == ["1", "0"]  # whole numbers as such


def test_a_file_that_is_no_record_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match=r"x\.csv: the first line does not start with 'time'"):
        read_csv(tmp_path / "x.csv")
    (tmp_path / "x.csv").write_text("time,b\n1,two\n")
    with pytest.raises(ValueError, match=r"x\.csv, line 2: 'two'"):
        read_csv(tmp_path / "x.csv")


@pytest.mark.parametrize(
    ("inputs", "overrides", "reason"),
    [
        ({"observer.z": 11}, {}, "has no variable 'z'"),
        ({"plant.y": 11}, {}, "'plant.y' is no numeric input"),
        ({"observer.y": 11}, {}, "it is connected to 'plant.y'"),
        ({"observer.rate": 11}, {"observer.rate": 1.0}, "'observer.rate' has recorded values and is set too"),
        ({"observer.rate": 10}, {}, "'observer.rate' has 10 values; 10 steps take 11"),
    ],
)
def test_inputs_given_beforehand_that_do_not_fit_are_refused(
    observed: System, inputs: dict[str, int], overrides: dict[str, float], reason: str
) -> None:
    with pytest.raises(ExperimentError) as caught:
        run(observed, stop=1.0, step=0.1, overrides=overrides, inputs={k: np.zeros(n) for k, n in inputs.items()})
    assert reason in str(caught.value)
