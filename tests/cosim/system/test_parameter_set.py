"""Parameter sets in files: what was written is read, in whatever unit, and what is no parameter set is one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from fmpy.ssp.ssd import read_ssv

from build_fmus import Build, with_parameters
from cosim.errors import ExperimentError, SystemFileError
from cosim.fmu import read_description
from cosim.system.parameter_set import parameters_of, write_parameter_set
from observers.model import Model, Variable
from observers.riccati import riccati
from reference_models.plant import plant

Built = Callable[[str], Path]
HEAD = """<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
 xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" version="1.0" name="x"><ssv:Parameters>"""
TAIL = """</ssv:Parameters><ssv:Units><ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="0.001"/></ssc:Unit>
<ssc:Unit name="kg"><ssc:BaseUnit kg="1"/></ssc:Unit></ssv:Units></ssv:ParameterSet>"""
Y, V = "tuning.measurement_noise.y", "tuning.process_noise.v"
MOVED = Model(
    name="moved",
    states=[Variable("s", unit="m"), Variable("v", unit="m/s")],
    outputs=[Variable("y", unit="m")],
    ode=lambda x, u, p, t: [x.v, -x.s],
    output=lambda x, u, p, t: [x.s],
)


def given(path: Path, *values: str) -> Path:
    path.write_text(HEAD + "".join(values) + TAIL)
    return path


def real(name: str, value: object, unit: str = "") -> str:
    said = f' unit="{unit}"' if unit else ""
    return f'<ssv:Parameter name="{name}"><ssv:Real value="{value}"{said}/></ssv:Parameter>'


def test_what_was_written_is_read_to_the_last_bit_by_us_and_by_fmpy(built: Built, tmp_path: Path) -> None:
    description, values = read_description(built("moved_riccati")), {Y: 0.1 + 0.2, V: 1e-300 / 3}
    write_parameter_set(tmp_path / "new" / "x.ssv", values, description)
    assert parameters_of(tmp_path / "new" / "x.ssv", description) == values
    read = {p.name: (float(p.value), p.unit) for p in read_ssv(tmp_path / "new" / "x.ssv").parameters}
    assert read == {Y: (values[Y], "m"), V: (values[V], None)}


def test_a_value_is_converted_into_the_unit_of_its_variable(built: Built, tmp_path: Path) -> None:
    path = given(tmp_path / "x.ssv", real(Y, 50.0, "mm"), real(V, 0.25))
    assert parameters_of(path, read_description(built("moved_riccati"))) == {Y: 0.05, V: 0.25}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((real(Y, 1.0, "kg"),), "the units 'kg' and 'm' differ"),
        ((real(Y, 1.0, "inch"),), "the unit 'inch' is not defined"),
        ((real("tuning.measurement_noise.z", 1.0),), "has no variable 'tuning.measurement_noise.z'; did you mean"),
        ((real(Y, -1.0),), f"'{Y}' = -1.0 lies outside"),
        ((real(Y, "a lot"),), "x.ssv, line 2: Element"),
        ((), "x.ssv: has no values"),
    ],
)
def test_what_does_not_suit_the_fmu_is_refused(built: Built, tmp_path: Path, values, message: str) -> None:
    path = given(tmp_path / "x.ssv", *values)
    with pytest.raises((SystemFileError, ExperimentError)) as error:
        parameters_of(path, read_description(built("moved_riccati")))
    assert message in str(error.value) and str(path) in str(error.value)


def test_another_file_of_ssp_is_refused_by_what_it_is(built: Built, tmp_path: Path) -> None:
    (tmp_path / "x.ssv").write_text("<ssm:ParameterMapping xmlns:ssm='http://x'/>")
    with pytest.raises(SystemFileError, match="holds a ParameterMapping, where a ParameterSet"):
        parameters_of(tmp_path / "x.ssv", read_description(built("moved_riccati")))


def test_build_gives_the_values_to_the_component_that_has_them_all(tmp_path: Path) -> None:
    observer, system = riccati(MOVED, sample_time=0.1), plant(MOVED)
    work = Build({made.name: (lambda made=made: made, None) for made in (observer, system)})
    made = with_parameters(work, given(tmp_path / "x.ssv", real(Y, 50.0, "mm"), real(V, 0.25)))
    started = {port.name: port.start for port in made.fmus["moved_riccati"][0]().parameters}
    assert (started[Y], started[V]) == (0.05, 0.25)
    before = {port.name: port.start for port in observer.parameters}
    assert {name for name in started if started[name] != before[name]} == {Y, V}
    assert made.fmus["moved"][0]() is system


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            (real(Y, 1.0), real("sensor.seed", 1.0)),
            "nothing has all of its variables; 'moved_riccati' has no 'sensor.seed'",
        ),
        ((real(Y, 1.0, "kg"),), "the units 'kg' and 'm' differ"),
        ((real(Y, -1.0),), "lies outside"),
    ],
)
def test_build_refuses_what_suits_no_component(tmp_path: Path, values, message: str) -> None:
    observer, system = riccati(MOVED, sample_time=0.1), plant(MOVED)
    work = Build({made.name: (lambda made=made: made, None) for made in (observer, system)})
    with pytest.raises(ValueError, match=message):
        with_parameters(work, given(tmp_path / "x.ssv", *values))
