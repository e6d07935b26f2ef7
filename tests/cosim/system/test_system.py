"""The .ssp file: what is written is the standard's, deterministic, and read back the same; what is wrong is named."""

from __future__ import annotations

import errno
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import fmpy
import pytest
from fmpy.ssp.ssd import read_ssd
from lxml import etree

from cosim.errors import ExperimentError, SystemFileError
from cosim.system import Element, System, read_ssp, write_ssp
from cosim.system.resolve import resolve
from cosim.system.ssp_files import SSV, STRUCTURE

Build = Callable[[str], Path]


@pytest.fixture
def system(built: Build) -> System:
    """Two plants of one FMU and a sampled component with parameters of every kind."""
    duffing, toy = built("duffing"), built("sampled_toy")
    return System(
        name="two_plants",
        elements={
            "plant": Element(duffing, {"start.x1": 0.1, "sensor.seed": 7}),
            "twin": Element(duffing),
            "observer": Element(toy, {"tuning.mode": "Replace", "tuning.scale": 2}),
        },
        connections=[("plant.y", "observer.y")],
        stop=2.0,
        step=0.05,
        description="Two plants, one observed",
    )


@pytest.fixture
def file(system: System, tmp_path: Path) -> Path:
    write_ssp(system, tmp_path / "two_plants.ssp")
    return tmp_path / "two_plants.ssp"


def edited(file: Path, old: str, new: str, more: dict[str, str] | None = None) -> Path:
    """A copy of `file` whose structure has `new` for `old`, and further members."""
    copy = file.with_name("edited.ssp")
    with zipfile.ZipFile(file) as source, zipfile.ZipFile(copy, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == STRUCTURE:
                assert old in content.decode()
                content = content.decode().replace(old, new, 1).encode()
            target.writestr(name, content)
        for name, text in (more or {}).items():
            target.writestr(name, text)
    return copy


def test_what_is_written_is_read_back(system: System, file: Path, tmp_path: Path) -> None:
    read = read_ssp(file, tmp_path)
    assert (read.name, read.description, read.connections) == (system.name, system.description, system.connections)
    assert (read.start, read.stop, read.step) == (0.0, 2.0, 0.05)
    assert list(read.elements) == list(system.elements)
    for name, element in system.elements.items():
        assert read.elements[name].parameters == element.parameters
        assert read.elements[name].fmu.read_bytes() == element.fmu.read_bytes()


def test_the_same_system_gives_the_same_bytes_without_timestamps(system: System, file: Path) -> None:
    again = file.with_name("again.ssp")
    write_ssp(system, again)
    assert again.read_bytes() == file.read_bytes()
    with zipfile.ZipFile(file) as archive:
        entries = archive.infolist()
        assert [e.filename for e in entries] == [STRUCTURE, "resources/duffing.fmu", "resources/sampled_toy.fmu"]
        assert {(e.date_time, e.compress_type) for e in entries} == {((1980, 1, 1, 0, 0, 0), zipfile.ZIP_STORED)}
        assert "generationDateAndTime" not in archive.read(STRUCTURE).decode()


def test_the_file_is_valid_and_fmpy_understands_it(file: Path) -> None:
    ssd = read_ssd(str(file))
    components = {c.name: c for c in ssd.system.elements}
    assert [c.source for c in components.values()] == [
        "resources/duffing.fmu",
        "resources/duffing.fmu",
        "resources/sampled_toy.fmu",
    ]
    kinds = {c.name: c.kind for c in components["plant"].connectors}
    assert kinds["u"] == "input" and kinds["y"] == "output" and kinds["sensor.seed"] == "parameter"
    assert "start.x2" not in kinds  # a parameter without a value of its own
    assert not ssd.system.connectors
    schema = etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "ssp/schema/SystemStructureDescription.xsd"))
    with zipfile.ZipFile(file) as archive:
        schema.assertValid(etree.fromstring(archive.read(STRUCTURE)))


def test_connectors_carry_types_units_and_enumerations(file: Path) -> None:
    with zipfile.ZipFile(file) as archive:
        root = etree.fromstring(archive.read(STRUCTURE))
    connector = "//ssd:Component[@name='observer']//ssd:Connector[@name='{}']/*"

    def declared(name: str) -> tuple[str, dict[str, str]]:
        found = root.xpath(connector.format(name), namespaces=root.nsmap)[0]
        return etree.QName(found).localname, dict(found.attrib)

    assert declared("y") == ("Real", {"unit": "m"})
    assert declared("diagnostics.rejected_samples") == ("Integer", {})
    assert declared("tuning.mode") == ("Enumeration", {"name": "ToyMode"})
    items = root.xpath("//ssc:Enumeration[@name='ToyMode']/ssc:Item/@name", namespaces=root.nsmap)
    assert items == ["Average", "Replace"]
    unit = root.xpath("//ssc:Unit[@name='m/s2']/ssc:BaseUnit", namespaces=root.nsmap)[0]
    assert (unit.get("m"), unit.get("s")) == ("1", "-2")


def test_an_enumeration_that_nothing_uses_is_not_declared_since_libcosim_aborts_at_it(file: Path) -> None:
    with zipfile.ZipFile(file) as archive:
        assert "diagnostics.status" not in archive.read(STRUCTURE).decode()


def test_without_a_step_in_the_file_the_smallest_of_the_fmus_counts(file: Path, system: System, tmp_path: Path) -> None:
    read = read_ssp(edited(file, '<osp:FixedStepAlgorithm baseStepSize="0.05"/>', ""), tmp_path)
    assert read.step is None
    steps = [float(d.defaultExperiment.stepSize) for d in resolve(system).descriptions.values()]
    assert resolve(read).experiment() == (2.0, min(steps))
    assert resolve(read).experiment(stop=7.0, step=0.2) == (7.0, 0.2)


def test_parameters_may_come_from_ssv_files_and_the_systems_win(file: Path, tmp_path: Path) -> None:
    ssv = (
        f'<ssv:ParameterSet xmlns:ssv="{SSV}" version="1.0" name="p">'
        "<ssv:Parameters>{}</ssv:Parameters></ssv:ParameterSet>"
    )
    own = '<ssv:Parameter name="x1"><ssv:Real value="0.5"/></ssv:Parameter>'
    whole = (
        '<ssv:Parameter name="twin.start.x1"><ssv:Real value="0.75"/></ssv:Parameter>'
        '<ssv:Parameter name="plant.sensor.seed"><ssv:Integer value="3"/></ssv:Parameter>'
        '<ssv:Parameter name="observer.tuning.mode"><ssv:Integer value="1"/></ssv:Parameter>'
    )
    binding = '<ssd:ParameterBindings><ssd:ParameterBinding source="resources/{}.ssv"{}/></ssd:ParameterBindings>'
    marked = edited(file, "<ssd:Elements>", binding.format("whole", "") + "<ssd:Elements>")
    twin = 'name="twin" type="application/x-fmu-sharedlibrary" source="resources/duffing.fmu">'
    with zipfile.ZipFile(marked) as archive:
        structure = archive.read(STRUCTURE).decode()
    end = structure.index("</ssd:Component>", structure.index(twin))
    part = structure[structure.index(twin) : end]
    more = {"resources/own.ssv": ssv.format(own), "resources/whole.ssv": ssv.format(whole)}
    copy = edited(marked.rename(file), part, part + binding.format("own", ' prefix="start."'), more)
    read = read_ssp(copy, tmp_path)
    assert read.elements["twin"].parameters == {"start.x1": 0.75}
    assert read.elements["plant"].parameters == {"start.x1": 0.1, "sensor.seed": 3}
    assert resolve(read).parameters["observer"]["tuning.mode"] == 1


def test_a_file_is_written_into_a_folder_that_is_made(system: System, file: Path, tmp_path: Path) -> None:
    deep = tmp_path / "new" / "deeper" / "two_plants.ssp"
    write_ssp(system, deep)
    assert deep.read_bytes() == file.read_bytes()
    assert deep.stat().st_mode & 0o777 == 0o644


def test_a_file_that_cannot_be_finished_leaves_what_was_there(
    system: System, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = file.read_bytes()
    write = zipfile.ZipFile.writestr

    def full(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, content: bytes) -> None:
        if entry.filename.endswith(".fmu"):
            raise OSError(errno.ENOSPC, "No space left on device")
        write(archive, entry, content)

    monkeypatch.setattr(zipfile.ZipFile, "writestr", full)
    with pytest.raises(OSError, match="No space left"):
        write_ssp(replace(system, name="another"), file)
    assert file.read_bytes() == before
    assert [path.name for path in file.parent.iterdir()] == [file.name]


def test_a_missing_file_and_a_file_that_is_no_zip_are_named(tmp_path: Path) -> None:
    with pytest.raises(SystemFileError, match=r"nowhere\.ssp: there is no such file"):
        read_ssp(tmp_path / "nowhere.ssp", tmp_path)
    (tmp_path / "text.ssp").write_text("hello")
    with pytest.raises(SystemFileError, match=r"text\.ssp: not an SSP file"):
        read_ssp(tmp_path / "text.ssp", tmp_path)
    with zipfile.ZipFile(tmp_path / "empty.ssp", "w"):
        pass
    with pytest.raises(SystemFileError, match=r"there is no SystemStructure\.ssd in it"):
        read_ssp(tmp_path / "empty.ssp", tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<ssd:Elements>", "<ssd:Elements", r"SystemStructure\.ssd, line \d+: "),
        ('kind="output"', 'kind="exit"', r"SystemStructure\.ssd, line \d+: .*'exit'"),
        ('<ssv:Real value="0.1"/>', '<ssv:Real value="much"/>', r"line \d+: .*'much'"),
        ("resources/duffing.fmu", "resources/dufing.fmu", r"'resources/dufing\.fmu' is not in it; did you mean"),
        ("resources/duffing.fmu", "../../duffing.fmu", r"'\.\./\.\./duffing\.fmu' is not in it"),
        ('type="application/x-fmu-sharedlibrary"', 'type="application/x-modelica"', "'plant' is no FMU and no system"),
        ('source="resources', 'implementation="ModelExchange" source="resources', "'plant' asks for model exchange"),
        ('name="twin"', 'name="plant"', "two elements are called 'plant'"),
        ('baseStepSize="0.05"', 'baseStepSize="often"', "baseStepSize 'often' is not a number"),
        ('startElement="plant" ', "", "the system has no connector 'y'; known: none"),
        (
            "</ssd:ParameterValues>",
            "</ssd:ParameterValues><ssd:ParameterMapping/>",
            "a parameter binding without a ParameterMapping",
        ),
    ],
)
def test_a_file_that_cannot_be_honoured_is_refused(
    file: Path, tmp_path: Path, old: str, new: str, message: str
) -> None:
    with pytest.raises(SystemFileError, match=message):
        read_ssp(edited(file, old, new), tmp_path)


@pytest.mark.parametrize(
    ("connection", "message"),
    [
        (("plnt.y", "observer.y"), r"there is no element 'plnt' \(plnt\.y\); did you mean 'plant'"),
        (("plant.yy", "observer.y"), "element 'plant' has no variable 'yy'; did you mean 'y'"),
        (("plant.y", "observer.rated"), "element 'observer' has no variable 'rated'; did you mean 'rate'"),
        (("y", "observer.y"), "'y' is not of the form <element>.<variable>"),
        (("twin.y", "observer.y"), r"input 'observer\.y' is driven by 'plant\.y' and by 'twin\.y'"),
        (("plant.u", "observer.rate"), r"'plant\.u' is no output \(its causality is input\)"),
        (("plant.y", "observer.filtered.level"), r"'observer\.filtered\.level' is no input"),
        (("observer.diagnostics.status", "plant.u"), "the types Enumeration and Real differ"),
        (("plant.y", "plant.u"), "the units 'm' and 'm/s2' differ"),
    ],
)
def test_a_connection_that_does_not_fit_is_refused(system: System, connection: tuple[str, str], message: str) -> None:
    with pytest.raises(SystemFileError, match=message):
        resolve(replace(system, connections=[*system.connections, connection]))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("sensor.sed", 7, r"element 'plant' has no variable 'sensor\.sed'; did you mean 'sensor\.seed'"),
        ("sensor.seed", 1.5, r"'sensor\.seed' is an Integer: 1\.5 is not a whole number"),
        ("sensor.seed", float("nan"), "is not a whole number"),
        ("sensor.seed", 2**21, r"'sensor\.seed' = 2097152 lies outside \[0, 1048576\]"),
        ("parameter.damping", "strong", r"'parameter\.damping' is a Real: 'strong' is not a number"),
        ("y", 1.0, "'y' is an output that is calculated"),
    ],
)
def test_a_parameter_value_that_does_not_fit_is_refused(
    system: System, name: str, value: float | str, message: str
) -> None:
    plant = Element(system.elements["plant"].fmu, {name: value})
    with pytest.raises(SystemFileError, match=f"system 'two_plants', parameters of 'plant': .*{message}"):
        resolve(replace(system, elements={**system.elements, "plant": plant}))


def test_an_unknown_enumeration_item_is_refused_with_the_known_ones(system: System) -> None:
    observer = Element(system.elements["observer"].fmu, {"tuning.mode": "Guess"})
    with pytest.raises(SystemFileError, match=r"'Guess' is none of Average \(1\), Replace \(2\)"):
        resolve(replace(system, elements={**system.elements, "observer": observer}))


def test_files_that_are_no_co_simulation_fmus_are_refused(built: Build, tmp_path: Path) -> None:
    def refused(content: dict[str, str] | str, message: str) -> None:
        fmu = tmp_path / "odd.fmu"
        if isinstance(content, str):
            fmu.write_text(content)
        else:
            with zipfile.ZipFile(fmu, "w") as archive:
                for name, text in content.items():
                    archive.writestr(name, text)
        with pytest.raises(SystemFileError, match=rf"odd\.fmu: {message}"):
            resolve(System("odd", {"odd": Element(fmu)}))

    with zipfile.ZipFile(built("duffing")) as archive:
        description = archive.read("modelDescription.xml").decode()
    start, end = description.index("<CoSimulation"), description.index("<LogCategories")
    refused("no zip", r"not an FMU \(not a sound zip file\)")
    refused({"a.txt": ""}, r"there is no modelDescription\.xml in it")
    refused({"modelDescription.xml": "<fmi"}, r"modelDescription\.xml, line 1")
    refused({"modelDescription.xml": '<fmiModelDescription fmiVersion="3.0"/>'}, r"is an FMU of FMI version 3\.0")
    exchange = description[:start] + '<ModelExchange modelIdentifier="duffing"/>' + description[end:]
    refused({"modelDescription.xml": exchange}, "is no co-simulation FMU")
    misspelt = description.replace("causality=", "causlity=", 1)
    refused({"modelDescription.xml": misspelt}, r"modelDescription\.xml, line \d+: .*causlity")


def test_a_system_needs_elements_with_plain_names(built: Build) -> None:
    with pytest.raises(SystemFileError, match="system 'empty' has no elements"):
        resolve(System("empty", {}))
    for name in ("", "a..b", ".a", "a."):
        with pytest.raises(SystemFileError, match=r"element name '.*' must not be empty, nor a part of it"):
            resolve(System("dotted", {name: Element(built("duffing"))}))
    two = {"a": Element(built("duffing")), "a.b": Element(built("duffing"))}
    with pytest.raises(SystemFileError, match=r"the names of the elements 'a' and 'a\.b' are ambiguous"):
        resolve(System("two", two))


def test_two_fmus_of_one_file_name_are_refused(system: System, tmp_path: Path) -> None:
    other = tmp_path / "duffing.fmu"
    other.write_bytes(system.elements["plant"].fmu.read_bytes())
    with pytest.raises(SystemFileError, match=r"would both be resources/duffing\.fmu"):
        write_ssp(replace(system, elements={**system.elements, "twin": Element(other)}), tmp_path / "x.ssp")


def test_an_experiment_that_nobody_describes_is_asked_for(built: Build, tmp_path: Path) -> None:
    bare = tmp_path / "bare.fmu"
    with zipfile.ZipFile(built("duffing")) as source, zipfile.ZipFile(bare, "w") as target:
        description = source.read("modelDescription.xml").decode()
        start = description.index("<DefaultExperiment")
        end = description.index("/>", start) + 2
        target.writestr("modelDescription.xml", description[:start] + description[end:])
    with pytest.raises(ExperimentError, match="system 'bare' and its FMUs name no stop time"):
        resolve(System("bare", {"plant": Element(bare)})).experiment()
