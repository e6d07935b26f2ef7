"""The component without FMI, as a micro-controller runs it: the example in `sources/embedded/` of every FMU."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest
from lxml import etree

from fmu_src.native.embedded import embedded
from fmu_src.native.sources import fixed_sources, functions, prefix, tables
from observers.component import Component, Port
from observers.instance import Instance
from reference_models.duffing import DUFFING
from reference_models.plant import plant
from slave import Slave
from test_sources import call, compiler, sources
from tools import few
from toys import double_toy, feedthrough_toy, sampled_toy

Path_of = Callable[[str], Path]
STRICT = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off")
# A filter, a moving window in segments, two linear observers: each with sample instants.
OBSERVERS = ("duffing_missing_ukf", "duffing_segments", "linear_3_riccati", "linear_3_least_squares")
# Reads the first input of each sample from stdin instead of making one up.
READER = """\
#define main example
#include "example.c"
#undef main

int main(void)
{
    double value;
    if (start())
        return 1;
    for (int k = 0; scanf("%lf", &value) == 1; k++) {
        u[0] = (casadi_real)value;
        if (sample(k * MODEL_STEP(p), (k + 1) * MODEL_STEP(p)))
            return 1;
        for (int i = 0; i < MODEL_N_Y; i++)
            printf("%.17g ", (double)y[i]);
        printf("\\n");
    }
    return 0;
}
"""


def example(folder: Path, program: Path, *options: str, source: Path | None = None) -> Path:
    place = folder / "sources" / "embedded"
    files = [source or place / "example.c", folder / "sources" / "functions.c"]
    call([*compiler("gcc"), *STRICT, *options, "-I", place, *files, "-lm", "-o", program], program.parent)
    return program


def doubles(text: str) -> np.ndarray:
    return np.array([line.split() for line in text.splitlines()], float)


@pytest.mark.parametrize("name", few(OBSERVERS))
def test_the_example_gives_the_fmus_outputs_bit_for_bit(name: str, unpacked: Path_of, tmp_path: Path) -> None:
    folder = unpacked(name)
    found = doubles(call([example(folder, tmp_path / "example")], tmp_path))
    slave = Slave(folder)
    variables = fmpy.read_model_description(str(folder)).modelVariables
    first, step = slave.variables[variables[0].name], 0.1
    shown = [v.name for v in variables if v.initial == "calculated"]
    slave.initialize()
    wanted = []
    for k in range(20):
        slave.set(first.name, float(first.start) + 0.125 * (k % 7))
        slave.step(k * step, step)
        wanted.append([slave.get(variable) for variable in shown])
    slave.fmu.freeInstance()
    assert found.tobytes() == np.array(wanted).tobytes()
    assert len(np.unique(found)) > 10


@pytest.mark.parametrize("name", ["duffing", "rlc", "feedthrough_toy"])
def test_every_kind_of_component_has_an_example_that_compiles_and_runs(
    name: str, unpacked: Path_of, tmp_path: Path
) -> None:
    printed = doubles(call([example(unpacked(name), tmp_path / "example")], tmp_path))
    assert printed.shape[0] == 20 and np.isfinite(printed).all()


def test_no_importer_takes_the_example_for_a_source(unpacked: Path_of) -> None:
    folder = unpacked("duffing")
    listed = [element.get("name") for element in etree.parse(folder / "modelDescription.xml").iter("File")]
    assert listed == [path.name for path in sources(folder)]
    assert {path.name for path in (folder / "sources" / "embedded").iterdir()} == {"example.c", "model.h"}


def test_the_header_gives_each_variable_its_place_and_start(unpacked: Path_of) -> None:
    toy = sampled_toy()
    header = embedded(toy)["embedded/model.h"].decode()
    for group, ports in (("u", toy.inputs), ("p", toy.parameters), ("y", toy.outputs)):
        places = re.findall(rf"^    sampled_toy_{group}_(\w+), /\* (\S+?)[ :]", header, re.M)
        assert [name for _, name in places] == [port.name for port in ports]
        assert len({place for place, _ in places}) == len(ports)
    assert "sampled_toy_p_start[] = {1.0, 0.1, 0.33, 0.5, 1.0, 1.0};" in header
    assert "#define sampled_toy_MAX_STEP 0.03\n" in header
    assert "feedthrough_toy_MAX_STEP DBL_MAX" in embedded(feedthrough_toy())["embedded/model.h"].decode()


# What a variable may be called: as the header calls its own, as another becomes in C, a word of C, with every kind of index.
NAMES = (
    "start",
    "start_2",
    "x.start",
    "x_start",
    "x.start_2",
    "x_start[1]",
    "x_start_1",
    "N_P",
    "MAX_STEP",
    "int",
    "p",
)


def with_names(group: str) -> Component:
    """A component with a variable of each of NAMES in this group and one in the others."""
    ports = {"inputs": [Port("i")], "parameters": [Port("k")], "outputs": [Port("o")]}
    ports[group] = [Port(name) for name in NAMES]
    n_u, n_p, n_y = map(len, ports.values())
    z, u, p, t, h = ca.SX(0, 1), ca.SX.sym("u", n_u), ca.SX.sym("p", n_p), ca.SX.sym("t"), ca.SX.sym("h")
    return Component(
        name="named",
        description="Any names",
        start=ca.Function("start", [p, t], [z]),
        flow=ca.Function("flow", [z, u, p, t, h], [z]),
        output=ca.Function("output", [z, u, p, t], [ca.repmat(ca.sum1(u) + ca.sum1(p) + t, n_y)]),
        **{name: tuple(of_group) for name, of_group in ports.items()},
    )


@pytest.mark.parametrize("group", ["inputs", "parameters", "outputs"])
def test_variables_of_any_names_have_places_of_their_own_and_compile(group: str, tmp_path: Path) -> None:
    write(with_names(group), tmp_path)
    header = (tmp_path / "sources" / "embedded" / "model.h").read_text()
    letter = {"inputs": "u", "parameters": "p", "outputs": "y"}[group]
    places = re.findall(rf"^    named_{letter}_(\w+), /\* (\S+) ", header, re.M)
    assert tuple(name for _, name in places) == NAMES
    assert len({place for place, _ in places} | {"start"}) == len(places) + 1
    call([example(tmp_path, tmp_path / "example", "-O0")], tmp_path)


def write(component: Component, folder: Path) -> None:
    """The component's sources, without an FMU around them."""
    parts = fixed_sources() | prefix(component) | functions(component) | tables(component, "{guid}")
    for name, content in (parts | embedded(component)).items():
        path = folder / "sources" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


@pytest.mark.parametrize("name", few(["int", "start", "output", "casadi", "component", "fmi2", "MODEL", "main"], 2))
def test_a_model_of_any_name_compiles(name: str, tmp_path: Path) -> None:
    """Names that stand in the sources for something else. They are there without optimisation, which takes most of the time."""
    write(replace(double_toy(), name=name), tmp_path)
    call([example(tmp_path, tmp_path / "example", "-O0")], tmp_path)
    library = [
        *compiler("gcc"),
        *STRICT,
        "-O0",
        "-fPIC",
        "-shared",
        *sources(tmp_path),
        "-lm",
        "-o",
        tmp_path / "library.so",
    ]
    call(library, tmp_path)


def test_infinite_bounds_in_a_table_are_constants_to_a_compiler_that_folds_no_infinity(tmp_path: Path) -> None:
    """tcc: -INFINITY is no constant to it. The outputs are gcc's."""
    z, u, p, t, h = ca.MX(0, 1), ca.MX.sym("u"), ca.MX.sym("p", 0), ca.MX.sym("t"), ca.MX.sym("h")
    low, high = ca.MX(ca.DM([-np.inf, 0.3, -np.inf])), ca.MX(ca.DM([np.inf, np.inf, 0.4]))
    bounded = Component(
        name="bounded",
        description="Clips its input",
        start=ca.Function("start", [p, t], [z]),
        flow=ca.Function("flow", [z, u, p, t, h], [z]),
        output=ca.Function("output", [z, u, p, t], [ca.fmax(low, ca.fmin(u, high))]),
        inputs=(Port("u"),),
        outputs=(Port("free"), Port("from_below"), Port("from_above")),
    )
    write(bounded, tmp_path)
    place = tmp_path / "sources"
    assert re.search(r"static const.*\{-casadi_inf, .*, -casadi_inf\}", (place / "functions.c").read_text())
    command = [*compiler("tcc"), "-I", place / "embedded", place / "embedded" / "example.c", place / "functions.c"]
    call([*command, "-lm", "-o", tmp_path / "by_tcc"], tmp_path)
    printed = call([tmp_path / "by_tcc"], tmp_path)
    assert printed == call([example(tmp_path, tmp_path / "by_gcc")], tmp_path)
    assert (np.ptp(doubles(printed), axis=0) > 0.3).all()


def measured(component: Component, samples: int) -> list[float]:
    """What a noisy sensor of this plant measures at its sample instants."""
    sensor = {"sensor.noise_bound": 0.01, "sensor.sample_time": 0.1, "sensor.seed": 3}
    face = Instance(component, sensor)
    values = []
    for k in range(samples):
        values.append(face.get("y"))
        face.step(0.1 * k, 0.1)
    return values


def test_single_precision_is_good_enough_for_a_filter(unpacked: Path_of, tmp_path: Path) -> None:
    """-Dcasadi_real=float: estimates within 1e-4 of the largest of each; 4e-5 was measured."""
    folder = unpacked("duffing_missing_ukf")
    source = tmp_path / "reader.c"
    source.write_text(READER.replace("MODEL", "duffing_ukf"))
    given = "\n".join(map(repr, measured(plant(DUFFING), 300)))
    answers = []
    for number, options in (("double", ()), ("float", ("-Dcasadi_real=float",))):
        program = example(folder, tmp_path / number, *options, source=source)
        done = subprocess.run([program], input=given, capture_output=True, text=True, check=True)
        answers.append(doubles(done.stdout)[:, :3])  # the estimates
    assert answers[0].shape == (300, 3)
    error = np.abs(answers[0] - answers[1]).max(axis=0) / np.abs(answers[0]).max(axis=0)
    assert (error < 1e-4).all()


def test_a_state_that_is_not_finite_ends_the_example(unpacked: Path_of, tmp_path: Path) -> None:
    program = example(unpacked("growing_toy"), tmp_path / "example")
    done = subprocess.run([program], capture_output=True, text=True)
    assert done.returncode == 1 and np.isfinite(doubles(done.stdout)).all()
