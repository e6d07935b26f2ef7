"""What a system leaves open is said when it is built, and whether its estimates were to be trusted when it has run."""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner

from build_fmus import coupled
from commands.app import app
from cosim.master import run
from cosim.results import Result
from observers.component import Component
from observers.controller import controller
from observers.model import Model, Variable
from observers.ukf import ukf
from reference_models.plant import plant

DRIVEN = Model(
    name="driven",
    states=[Variable("x")],
    inputs=[Variable("pump_1")],
    outputs=[Variable("y")],
    ode=lambda x, u, p, t: [u.pump_1 - x.x],
    output=lambda x, u, p, t: [x.x],
)


def notes(*others: Component) -> list[str]:
    truth, observer = plant(DRIVEN), ukf(DRIVEN, sample_time=0.1)
    made = {
        one.name: (lambda one=one: one, (lambda: truth) if one is observer else None)
        for one in (truth, observer, *others)
    }
    return coupled(made).notes  # type: ignore[arg-type]


def source(output: str, name: str = "pumps") -> Component:
    return controller(name, inputs=[], outputs=[Variable(output)], law=lambda x, p, t: [1.0])


def test_an_input_that_no_source_drives_is_named_with_the_output_that_may_be_meant() -> None:
    open_ends = (
        "system driven_ukf: no source puts out 'pump_1'; plant.pump_1 and observer.pump_1 keep their start values"
    )
    assert notes() == [open_ends]
    assert notes(source("pump1")) == [f"{open_ends}: is it 'pump1' of pumps?"]
    assert notes(source("pump_1")) == []


def test_an_input_that_two_sources_drive_is_open_for_that_reason() -> None:
    (note,) = notes(source("pump_1"), source("pump_1", "others"))
    assert note == (
        "system driven_ukf: pumps and others have an output 'pump_1'; plant.pump_1 and observer.pump_1 keep their start values"
    )


def test_a_run_says_how_much_of_it_was_trusted_and_why_the_rest_was_not(duffing_system: Path, tmp_path: Path) -> None:
    result: Result = run(duffing_system)
    trusted = result["observer.diagnostics.trusted"]
    said = CliRunner().invoke(app, ["run", str(duffing_system), "--out", str(tmp_path)], env={"COLUMNS": "200"}).stdout
    (line,) = [line for line in said.splitlines() if "of the rows" in line]
    assert line.startswith(f"observer: trusted in {trusted.mean():.1%} of the rows; ")
    words = result.items["observer.diagnostics.status"]
    status = result["observer.diagnostics.status"][trusted < 0.5]
    for code in set(status.astype(int)):
        assert f"{words[code]} {(status == code).sum() / len(trusted):.1%}" in line
