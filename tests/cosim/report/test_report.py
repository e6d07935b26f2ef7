"""What is shown of a run: estimates beside their truths, figures, a page that needs nothing else."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from cosim.master import run
from cosim.report.estimates import paired, pairs
from cosim.report.figures import POINTS, figures
from cosim.report.page import Table, write_report
from cosim.system import Element, System

Build = Callable[[str], Path]


def test_estimates_are_paired_with_truths_by_name(duffing_system: Path) -> None:
    result = run(duffing_system)
    assert [(p.variable, p.estimate, p.truth) for p in pairs(result)] == [
        (v, f"observer.estimate.{v}", f"plant.x.{v}") for v in ("x1", "x2", "theta")
    ]
    np.testing.assert_array_equal(
        pairs(result)[0].error(result), np.abs(result["observer.estimate.x1"] - result["plant.x.x1"])
    )


def test_an_estimate_is_paired_with_the_plant_that_it_observes_only_and_algebraic_variables_too() -> None:
    names = [
        "a.x.v",
        "a.z.w",
        "b.x.v",
        "b.z.w",
        "one.estimate.v",
        "one.estimate.w",
        "two.estimate.v",
        "alone.estimate.v",
    ]
    upstream = {"a": {"one"}, "b": set(), "one": {"a", "one"}, "two": {"filter", "b"}, "alone": set()}
    found = paired(names, {element: frozenset(sources) for element, sources in upstream.items()})
    assert [(pair.estimate, pair.truth) for pair in found] == [
        ("one.estimate.v", "a.x.v"),
        ("one.estimate.w", "a.z.w"),
        ("two.estimate.v", "b.x.v"),
    ]


def test_the_figures_show_states_errors_status_and_times(duffing_system: Path) -> None:
    titles = [figure.layout.title.text for figure in figures(run(duffing_system))]
    assert titles == [
        "True and estimated values",
        "Errors of the estimates",
        "Status (observer.diagnostics.status)",
        "Cost of the estimate",
        "Iterations of the solver",
        "Computing time per communication step",
    ]


def test_a_system_without_an_observer_has_figures_too(built: Build) -> None:
    result = run(System("alone", {"plant": Element(built("duffing"))}, stop=1.0, step=0.1))
    titles = [figure.layout.title.text for figure in figures(result)]
    assert titles == ["Outputs of plant", "Computing time per communication step"]


def test_long_curves_are_thinned_without_losing_a_peak(built: Build) -> None:
    result = run(System("long", {"plant": Element(built("duffing"))}, stop=100.0, step=0.01))
    curve = figures(result)[0].data[1]
    assert curve.name == "x.x1 [m]" and len(curve.y) <= POINTS
    assert max(curve.y) == np.float32(result["plant.x.x1"].max())
    assert min(curve.y) == np.float32(result["plant.x.x1"].min())


def test_the_report_is_one_file_that_needs_nothing_else(duffing_system: Path, tmp_path: Path) -> None:
    result = run(duffing_system)
    table = Table(("claim", "measured"), [("error < 1e-8", "2e-9")])
    sections = [("First <run>", "As in the paper.", result), ("Second run", "", result)]
    write_report(tmp_path / "report.html", "A & B", "<p>Two runs.</p>", table, sections)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<title>A &amp; B</title>" in page and "First &lt;run&gt;" in page and "<td>error &lt; 1e-8</td>" in page
    assert not re.search(r"<(script|link|img)[^>]*(src|href)=", page)
    assert page.count("plotly.js v") == 1 and len(page) < 8e6
    identifiers = re.findall(r'id="(run-\d+-figure-\d+)"', page)
    assert len(identifiers) == len(set(identifiers)) == 12
