"""The reference results in an FMU are those that it gives, in another tool too, and are the same bytes wherever it is built."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest
from lxml import etree

from fmu_src.documentation.reference import FOLDER, TOLERANCE, reference_files
from observers.component import Component
from observers.pseudospectral import pseudospectral
from reference_models.duffing import DUFFING
from reference_models.plant import plant
from toys import feedthrough_toy

Path_of = Callable[[str], Path]
NAMESPACE = "{http://fmi-standard.org/fmi-ls-manifest}"


def table(content: bytes) -> np.ndarray:
    """A CSV file as a structured array, with the names as they are."""
    return np.genfromtxt(io.BytesIO(content), delimiter=",", names=True, deletechars="", replace_space=" ")


@pytest.fixture(scope="module")
def observer() -> Component:
    return pseudospectral(DUFFING, sample_time=0.1, N=12, L=20)


@pytest.fixture(scope="module")
def files(observer: Component) -> dict[str, bytes]:
    """Those of an observer that is driven by its plant."""
    return reference_files(observer, plant(DUFFING))


def test_the_manifest_lists_every_file_with_its_checksum(files: dict[str, bytes]) -> None:
    root = etree.fromstring(files[f"{FOLDER}/fmi-ls-manifest.xml"])
    assert root.tag == "fmiReferences"
    assert root.get(f"{NAMESPACE}fmi-ls-name") == "org.fmi-standard.fmi-ls-ref"
    assert root.get(f"{NAMESPACE}fmi-ls-version") == "1.0.0-alpha.1"
    listed = {f"{FOLDER}/{related.get('source')}": related for related in root}
    assert set(listed) | {f"{FOLDER}/fmi-ls-manifest.xml", "documentation/fmi-ls-ref.txt"} == set(files)
    for name, related in listed.items():
        assert related.get("checksum") == hashlib.sha3_256(files[name]).hexdigest(), name
    roles = {related.get("source"): related.get("role") for related in root}
    assert roles["default.exp"] == "experiment/smoke-test" and roles["default_results.csv"] == "result"


def test_the_experiment_names_its_times_and_files(files: dict[str, bytes]) -> None:
    experiment = etree.fromstring(files[f"{FOLDER}/default.exp"]).find("Experiment")
    assert dict(experiment.find("TransientSimulation").attrib) == {
        "startTime": "0",
        "stopTime": "10.0",
        "stepSize": "0.1",
    }
    for element, columns in (
        ("Stimuli", {"time", "y", "u"}),
        ("References", {"time", "estimate.x1", "estimate.theta"}),
    ):
        content = files[f"{FOLDER}/{experiment.find(element).get('source')}"]
        assert columns <= set(table(content).dtype.names)
        assert len(table(content)) == 101


@pytest.mark.parametrize("name", ["duffing", "sampled_toy", "growing_toy"])
def test_fmpy_gets_the_reference_results_from_the_fmu(built: Path_of, name: str) -> None:
    path = built(name)
    with zipfile.ZipFile(path) as archive:
        expected = table(archive.read(f"{FOLDER}/default_results.csv"))
        has_stimuli = f"{FOLDER}/default_stimuli.csv" in archive.namelist()
        stimuli = table(archive.read(f"{FOLDER}/default_stimuli.csv")) if has_stimuli else None
        experiment = etree.fromstring(archive.read(f"{FOLDER}/default.exp")).find("Experiment/TransientSimulation")
    assert has_stimuli == (name != "growing_toy")
    got = fmpy.simulate_fmu(
        str(path),
        stop_time=float(experiment.get("stopTime")),
        output_interval=float(experiment.get("stepSize")),
        input=stimuli,
        output=list(expected.dtype.names[1:]),
    )
    assert len(expected.dtype.names) > 1
    for column in expected.dtype.names[1:]:
        limit = float(TOLERANCE) * max(np.abs(expected[column]).max(), 1.0)
        assert np.abs(got[column] - expected[column]).max() <= limit, column


def test_with_direct_feedthrough_the_outputs_belong_to_the_inputs_of_the_same_time() -> None:
    files = reference_files(feedthrough_toy(), None)
    force, position = table(files[f"{FOLDER}/default_results.csv"]), table(files[f"{FOLDER}/default_stimuli.csv"])
    np.testing.assert_allclose(force["force"], -2.0 * position["position"], rtol=0, atol=1e-15)


def scaled(component: Component, factor: float) -> Component:
    """The component with all its outputs times `factor`."""
    z, u, p, t = (ca.MX.sym(name, component.output.size1_in(i)) for i, name in enumerate("zupt"))
    output = ca.Function("output", [z, u, p, t], [component.output(z, u, p, t) * factor])
    return dataclasses.replace(component, output=output)


def test_last_bits_that_differ_between_machines_do_not_show(observer: Component, files: dict[str, bytes]) -> None:
    assert reference_files(observer, scaled(plant(DUFFING), 1 + 2e-15)) == files


def test_what_is_zero_but_for_rounding_errors_is_written_as_zero() -> None:
    results = reference_files(scaled(feedthrough_toy(), 1e-15), None)[f"{FOLDER}/default_results.csv"]
    assert {row.split(",", 1)[1] for row in results.decode().splitlines()[1:]} == {"0.0,0.0"}


def test_names_with_a_comma_are_one_column() -> None:
    toy = feedthrough_toy()
    outputs = (dataclasses.replace(toy.outputs[0], name="Q[1,2]"), toy.outputs[1])
    results = reference_files(dataclasses.replace(toy, outputs=outputs), None)[f"{FOLDER}/default_results.csv"]
    rows = list(csv.reader(io.StringIO(results.decode())))
    assert rows[0] == ["time", "Q[1,2]", "bias_now"]
    assert {len(row) for row in rows} == {3}
