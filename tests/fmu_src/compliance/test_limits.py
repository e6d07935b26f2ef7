"""The limits of the check are those that docs/compliance.md states."""

from __future__ import annotations

import re

from fmu_src.compliance import check, finding
from fmu_src.compliance.files import package
from fmu_src.compliance.library import derivatives, dynamic, exchange, lifecycle, ls_ref, process
from tools import ROOT

PAGE = (ROOT / "docs" / "compliance.md").read_text()
UNITS = {"GiB": 2**30, "MiB": 2**20, "": 1}
LIMITS = {
    "all files, inflated": package.MOST_BYTES,
    "modelDescription.xml": package.MOST_BYTES_OF_DESCRIPTION,
    "another .xml document, but in resources/": package.MOST_BYTES_OF_XML,
    "a table of reference results": ls_ref.MOST_BYTES,
    "number of files": package.MOST_FILES,
    "folders one in the other": package.MOST_FOLDERS,
    "steps of an experiment": ls_ref.MOST_STEPS,
    "tags and attributes of modelDescription.xml": package.MOST_MARKS,
}


def test_what_is_checked_at_all_is_as_large_as_the_pages_table_says() -> None:
    table = PAGE[PAGE.index("| limit |") : PAGE.index("## How it is done")]
    rows = re.findall(r"^\| ([^|]+) \| ([\d ]+?) ?(GiB|MiB|) \|$", table, flags=re.M)
    assert {what: int(number.replace(" ", "")) * UNITS[unit] for what, number, unit in rows} == LIMITS


def test_how_it_is_done_is_as_the_page_says() -> None:
    words = " ".join(PAGE.split())
    for sentence, found, stated in (
        ("cut to 300 characters", finding.LONGEST, 300),
        ("the variables, files or functions (three of them", finding._SHOWN, 3),
        ("a crash or a hang (30 s without an answer to one call)", process.TIMEOUT, 30),
        ("After three hangs it does not", dynamic._MOST_HANGS, 3),
        ("8 steps of its step size", lifecycle.STEPS, 8),
        ("more than a tenth of its size or nominal value", exchange.CHANGE, 0.1),
        ("looked at for up to 200 steps", derivatives.MOST_STEPS, 200),
        ("at most 20 columns each", derivatives._MOST_KNOWNS, 20),
        ("in up to 1000 variables, outputs first", check._MOST_WATCHED, 1000),
    ):
        assert sentence in words and found == stated
