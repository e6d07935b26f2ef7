"""What is no function of states, inputs, parameters and time is refused by name, before an observer is made of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import plant_fmu
from fmu_src import PlantFMU
from fmu_src.errors import PlantError
from observers.canonical_dae import canonical_dae
from observers.elementary import elementary
from observers.least_squares import least_squares
from observers.model import ModelError

Plants = Callable[..., Path]


def refused(path: Path, **given: object) -> str:
    wanted: dict[str, object] = {"outputs": ["y"], "inputs": ["force"], "unknown_parameters": ["mu"]}
    with pytest.raises(PlantError) as caught:
        PlantFMU(path, **(wanted | given))  # type: ignore[arg-type]
    message = str(caught.value)
    assert message.startswith(f"plant '{path.name}'")
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (
            "indicators",
            "has 2 event indicators: its modes would stay frozen; export it without events (noEvent, smooth)",
        ),
        ("relay", "remembers: der(x1) at the same point is "),
        ("delay", "keeps a memory between steps (a delay): der(x1) at the same point is "),
        ("chooses", "keeps a memory between steps (a delay, or a choice of states): it wants an event"),
        ("writes", "changes its own states: 'x0' was set to "),
        ("time_event", "has a time event at t = 1: nothing happens at one inside an observer"),
        ("ends", "asks to end the simulation at its initialization"),
        ("endless", "comes to no end with its event iteration"),
        ("fails_to_start", "cannot be initialized: fmi2EnterInitializationMode answers fmi2Error"),
        ("fatal", "ends for good at a point near its start: fmi2GetDerivatives answers fmi2Fatal"),
        ("crash", "ends the process that asks it (SIGABRT) in fmi2GetDerivatives"),
    ],
)
def test_a_plant_that_is_no_function_is_refused_with_what_it_does(plants: Plants, kind: str, said: str) -> None:
    assert said in refused(plants(kind))


def test_names_that_are_not_there_or_of_another_kind_are_refused_with_what_is_there(plants: Plants) -> None:
    path = plants("van_der_pol")
    assert "the output 'yy' is no variable of it; near: y" in refused(path, outputs=["yy"])
    assert "'count' is of type Integer" in refused(path, parameters=["count"])
    assert "'twice' is calculated; take one of mu, m" in refused(path, unknown_parameters=["twice"])
    assert "'switch' is no continuous input but discrete" in refused(path, inputs=["switch"])
    assert "'force' is continuous, input, and no continuous output" in refused(path, outputs=["force"])
    assert "outputs is the text 'y', where a list is wanted: outputs=['y']" in refused(path, outputs="y")
    assert "attributes of 'y': 'units' is none; known: unit, start" in refused(path, attributes={"y": {"units": "m"}})
    assert "attributes of 'z' is no variable of it" in refused(path, attributes={"z": {"unit": "m"}})


def test_names_that_become_one_are_refused(plants: Plants) -> None:
    path = plants("rod3")
    assert "'T[2]' and 'T_2' would both be called 'T_2'" in refused(
        plants("rod3", extra="T_2"), outputs=["T_2"], unknown_parameters=["k"]
    )
    model = PlantFMU(path, outputs=["y"], unknown_parameters=["k"])
    assert [v.name for v in model.states] == ["T_1", "T_2", "T_3"]


def test_a_file_that_is_no_plant_is_refused_in_one_line(
    plants: Plants, built: Callable[[str], Path], tmp_path: Path
) -> None:
    assert "is co-simulation only: FMI 2.0 gives no way to write its states" in refused(built("duffing"))
    text = tmp_path / "text.fmu"
    text.write_text("no archive")
    assert "it cannot be read as an FMU" in refused(text)
    assert "is no file" in refused(tmp_path / "nowhere.fmu")
    assert "is a folder" in refused(tmp_path)
    assert "is FMI 3.0; needed: 2.0 for model exchange" in refused(plants("van_der_pol", version="3.0"))
    assert "has no binary for" in refused(plants("van_der_pol", folder="linux32"))
    assert "has no continuous states" in refused(plants("rod0"))


def test_a_library_that_does_not_load_is_refused_with_the_loaders_words(plants: Plants) -> None:
    assert "does not load" in refused(plants("van_der_pol", library=b"no library"))
    lacking = plant_fmu.library().replace(b"fmi2Reset\0", b"fmi2Resat\0")
    assert "undefined symbol: fmi2Reset" in refused(plants("van_der_pol", library=lacking))


def test_methods_that_need_formulas_say_so_and_which_do_not(modelled: Callable[..., PlantFMU]) -> None:
    known, estimated = modelled("van_der_pol", unknown_parameters=[]), modelled("van_der_pol")
    for make in (
        lambda: least_squares(estimated, sample_time=0.1, T=1.0, linearise=True),
        lambda: elementary(known, sample_time=0.1, N=10),
        lambda: canonical_dae(known, sample_time=0.1),
    ):
        with pytest.raises(
            ModelError, match=r"is an FMU, and this method needs formulas.*ukf, riccati and pseudospectral"
        ):
            make()
