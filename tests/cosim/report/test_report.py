"""What is shown of a run: estimates beside their truths, figures, a page that needs nothing else."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import browser
from cosim.master import run
from cosim.report.axes import POINTS
from cosim.report.estimates import paired, pairs
from cosim.report.figures import figures
from cosim.report.observed import measurements
from cosim.report.page import Table, on_run, statuses, write_report
from cosim.results import Result
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


def titles(result: Result) -> list[str]:
    return [figure.title.text.removesuffix(" (cut: zoom out)") for figure in figures(result)]


def curve(figure: Any, label: str) -> tuple[np.ndarray, np.ndarray]:
    """What is drawn under `label`."""
    (items,) = [legend.items for legend in figure.legend]
    (item,) = [item for item in items if item.label.value == label]
    data = item.renderers[0].data_source.data
    return data["x"], data["y"]


def test_the_figures_show_estimates_errors_innovations_status_and_times(duffing_system: Path) -> None:
    assert titles(run(duffing_system)) == [
        "x1",
        "x2",
        "theta",
        "Errors of the estimates",
        "observer.y",
        "Innovation of observer.y",
        "Status (observer.diagnostics.status)",
        "Cost of the estimate",
        "Iterations of the solver",
        "Computing time per communication step",
    ]


def test_a_system_without_an_observer_has_figures_too(built: Build) -> None:
    result = run(System("alone", {"plant": Element(built("duffing"))}, stop=1.0, step=0.1))
    assert titles(result) == ["Outputs of plant", "Computing time per communication step"]


def test_a_prediction_is_the_measurement_of_its_sample_without_its_innovation(duffing_system: Path) -> None:
    """At communication steps of the sample time and of a half of it: what the observer expected is what it then put out for that time."""
    for step in (0.1, 0.05):
        result = run(duffing_system, step=step, stop=3.0)
        (one,) = measurements(result)
        assert one.name == "observer.y" and one.unit == "m"
        np.testing.assert_array_equal(one.measured, result["plant.y"])
        assert (one.sampled % round(0.1 / step) == 0).all() and len(one.sampled) > 25
        # Of y = x1 + x2 / 2 the prediction is that of the estimate that was there before the sample.
        expected = (result["observer.estimate.x1"] + 0.5 * result["observer.estimate.x2"])[one.sampled]
        np.testing.assert_allclose(one.predicted, expected, rtol=0, atol=1e-12)


def test_long_curves_are_thinned_without_losing_a_peak(built: Build) -> None:
    result = run(System("long", {"plant": Element(built("duffing"))}, stop=100.0, step=0.01))
    time, shown = curve(figures(result)[0], "x.x1 [m]")
    assert len(shown) == len(time) <= POINTS
    assert max(shown) == np.float32(result["plant.x.x1"].max())
    assert min(shown) == np.float32(result["plant.x.x1"].min())


def test_a_spike_of_an_estimate_does_not_ruin_its_axis_and_one_of_the_truth_is_shown(duffing_system: Path) -> None:
    result = run(duffing_system)
    for column, shown in (("observer.estimate.x1", False), ("plant.x.x1", True)):
        values = result.values.copy()
        values[30, result.names.index(column)] = 1e3
        top = figures(dataclasses.replace(result, values=values))[0]
        assert (top.y_range.end > 1e3) == shown
        assert top.title.text.endswith("(cut: zoom out)") != shown
        assert top.y_range.end > result["plant.x.x1"].max() and top.y_range.start < result["plant.x.x1"].min()


def test_a_constant_that_was_found_exactly_is_a_line_on_an_axis_of_some_width(duffing_system: Path) -> None:
    result = run(duffing_system)
    values = result.values.copy()
    values[:, result.names.index("plant.x.theta")] = 0.4
    values[:, result.names.index("observer.estimate.theta")] = 0.4 + 1e-12 * np.arange(len(values))
    values[0, result.names.index("observer.estimate.theta")] = 50.0
    shown = figures(dataclasses.replace(result, values=values))[2].y_range
    assert shown.start < 0.4 and 0.41 < shown.end < 1.0


def test_the_band_is_two_standard_deviations_about_the_estimate(duffing_system: Path) -> None:
    result = run(duffing_system)
    (band,) = [r for r in figures(result)[0].renderers if type(r.glyph).__name__ == "VArea"]
    x1, std = result["observer.estimate.x1"], result["observer.diagnostics.std.x1"]
    np.testing.assert_array_equal(band.data_source.data["y1"], (x1 - 2 * std).astype(np.float32))
    np.testing.assert_array_equal(band.data_source.data["y2"], (x1 + 2 * std).astype(np.float32))


def test_times_at_which_an_estimate_is_not_trusted_are_shaded(duffing_system: Path) -> None:
    result = run(duffing_system)
    values, column = result.values.copy(), result.names.index("observer.diagnostics.trusted")

    def shaded(trusted: np.ndarray) -> list[tuple[float, float]]:
        values[:, column] = trusted
        found = figures(dataclasses.replace(result, values=values))[0].renderers
        data = [r.data_source.data for r in found if type(r.glyph).__name__ == "VStrip"]
        return [
            (float(low), float(high)) for strips in data for low, high in zip(strips["x0"], strips["x1"], strict=True)
        ]

    trusted = np.ones(len(result.time))
    assert shaded(trusted) == []
    trusted[:3] = trusted[10:12] = trusted[-1] = 0
    t = np.float32(result.time).astype(float)
    assert shaded(trusted) == [(t[0], t[3]), (t[10], t[12]), (t[-1], t[-1])]


def test_statuses_are_counted_in_words(duffing_system: Path) -> None:
    result = run(duffing_system)
    (table,) = statuses(result)
    codes = result["observer.diagnostics.status"]
    word = {"estimating": 1, "propagated_guess": 14}
    assert {row[0]: int(row[1]) for row in table.rows if row[0] in word} == word
    assert {int(code): share for _, code, share in table.rows}[1] == f"{np.mean(codes == 1):.1%}"


def test_the_report_is_one_file_that_needs_nothing_else(duffing_system: Path, tmp_path: Path) -> None:
    result = run(duffing_system)
    table = Table(("claim", "measured"), [("error < 1e-8", "2e-9")])
    sections = [on_run("First <run>", "As in the paper.", result), on_run("Second run", "", result)]
    write_report(tmp_path / "report.html", "A & B", "<p>Two runs.</p>", [table], sections)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<title>A &amp; B</title>" in page and "First &lt;run&gt;" in page and "<td>error &lt; 1e-8</td>" in page
    assert not re.search(r"<(script|link|img)[^>]*(src|href)=", page)
    assert len(page) < 1.5e6
    assert re.findall(r'<div id="(part-\d+-figures)"', page) == ["part-0-figures", "part-1-figures"]


@pytest.mark.long
def test_a_browser_draws_the_report_without_an_error(duffing_system: Path, tmp_path: Path) -> None:
    result = run(duffing_system)
    write_report(tmp_path / "report.html", "A run", "<p>A run.</p>", [], [on_run("Figures", "", result)])
    browser.check(tmp_path / "report.html", len(figures(result)))
