"""What pip is told: ranges that the lock satisfies, and a lock that is the same on any machine."""

from __future__ import annotations

import importlib.metadata
import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import observers
from tools import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
DIRECT = [
    Requirement(text) for text in (*PROJECT["dependencies"], *(text for extra in EXTRAS.values() for text in extra))
]
LOCK = [
    Requirement(line)
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    if not line.startswith("#")
]
LOCKED = {canonicalize_name(exact.name): next(iter(exact.specifier)).version for exact in LOCK}


@pytest.mark.parametrize("wanted", DIRECT, ids=str)
def test_what_is_asked_for_is_a_range_and_the_lock_lies_in_it(wanted: Requirement) -> None:
    assert {bound.operator for bound in wanted.specifier} <= {">=", "<"}
    assert LOCKED[canonicalize_name(wanted.name)] in wanted.specifier


@pytest.mark.parametrize("exact", LOCK, ids=str)
def test_the_lock_names_exact_versions_and_no_place(exact: Requirement) -> None:
    assert [bound.operator for bound in exact.specifier] == ["=="]
    assert exact.url is None and canonicalize_name(exact.name) != "observer-fmus"


def test_the_lock_holds_what_the_locked_packages_ask_for() -> None:
    missing = []
    for name in LOCKED:
        try:
            asked = importlib.metadata.requires(name) or []
        except importlib.metadata.PackageNotFoundError:  # of the extra that `make setup` leaves out
            continue
        for wanted in map(Requirement, asked):
            if wanted.marker is None or wanted.marker.evaluate({"extra": ""}):
                version = LOCKED.get(canonicalize_name(wanted.name))
                if version is None or version not in wanted.specifier:
                    missing.append(f"{name}: {wanted}")
    assert not missing


def test_the_version_has_one_source() -> None:
    assert "version" in PROJECT["dynamic"]
    assert importlib.metadata.version("observer-fmus") == observers.__version__
