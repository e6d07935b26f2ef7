"""The package as pip installs it, away from this folder: everything that it needs at run time is inside."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from cosim.results import read_csv
from cosim.system import Element, System, write_ssp
from tools import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
# Not Python, or read as text: what setuptools leaves out unless it is told.
NEEDED = (
    *(f"fmu_src/native/shell/{path.name}" for path in (ROOT / "fmu_src/native/shell").iterdir()),
    *(f"fmu_src/python/relay/{path.name}" for path in (ROOT / "fmu_src/python/relay").iterdir()),
    *(f"fmu_src/documentation/licenses/{path.name}" for path in (ROOT / "fmu_src/documentation/licenses").iterdir()),
    *(f"reference_models/data/{path.name}" for path in (ROOT / "reference_models/data").iterdir()),
    *(f"{package}/py.typed" for package in ("commands", "cosim", "fmu_src", "observers", "reference_models")),
    "build_fmus.py",
)


@pytest.fixture(scope="module")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The source distribution, and the wheel that is built from it and from nothing else."""
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, "-m", "build", "--outdir", folder, ROOT], check=True, capture_output=True)
    (source,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
    return source, wheel


@pytest.fixture(scope="module")
def installed(distributions: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Callable[..., str]:
    """Runs a program of an environment that has the wheel; what it depends on is seen there as it is here."""
    folder = tmp_path_factory.mktemp("installed")
    subprocess.run([sys.executable, "-m", "venv", folder / "env"], check=True)
    binaries = folder / "env" / "bin"
    subprocess.run([binaries / "pip", "install", "--no-deps", "--no-index", distributions[1]], check=True)
    (packages,) = (folder / "env" / "lib").glob("python*/site-packages")
    # A path in a .pth file comes after the wheel's folder, and brings no .pth of its own: not this checkout's editable install.
    here = [path for path in sys.path if path.endswith("site-packages")]
    (packages / "dependencies.pth").write_text("\n".join(here))
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(program: str, *arguments: object, cwd: Path) -> str:
        done = subprocess.run(
            [binaries / program, *map(str, arguments)], cwd=cwd, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return run


@pytest.mark.long
def test_source_distribution_and_wheel_hold_what_is_not_python(distributions: tuple[Path, Path]) -> None:
    source, wheel = distributions
    with tarfile.open(source) as archive:
        in_source = {name.partition("/")[2] for name in archive.getnames()}
    with zipfile.ZipFile(wheel) as archive:
        in_wheel = set(archive.namelist())
    assert not set(NEEDED) - in_source and not set(NEEDED) - in_wheel
    assert any(name.endswith("LICENSE") for name in in_wheel) and "LICENSE" in in_source
    assert not [name for name in in_wheel if name.startswith(("tests", "docs", "benchmarks", "build/"))]


@pytest.mark.long
def test_the_installed_package_builds_checks_and_runs_a_users_model_in_another_folder(
    installed: Callable[..., str], tmp_path: Path
) -> None:
    where = installed("python", "-c", "import observers, fmu_src, build_fmus; print(fmu_src.__file__)", cwd=tmp_path)
    assert str(ROOT) not in where
    example = README.split('```python title="pendulum.py"\n')[1].split("```")[0]
    installed("observer-fmus", "gallery", "quadruple_tank", cwd=tmp_path)
    assert (tmp_path / "quadruple_tank.py").read_bytes() == (ROOT / "gallery" / "quadruple_tank.py").read_bytes()
    (tmp_path / "pendulum.py").write_text(example, encoding="utf-8")
    installed("observer-fmus", "build", "--file", "pendulum.py", cwd=tmp_path)
    plant, observer = tmp_path / "fmus" / "pendulum.fmu", tmp_path / "fmus" / "pendulum_pseudospectral.fmu"
    assert installed("observer-fmus", "check", plant, observer, cwd=tmp_path).count("no finding") == 2
    elements = {"plant": Element(plant), "observer": Element(observer, {"guess.friction": 0.0})}
    system = System("pendulum", elements, [("plant.y", "observer.y")], stop=3.0, step=0.05)
    write_ssp(system, tmp_path / "systems" / "pendulum.ssp")
    installed("observer-fmus", "run", "systems/pendulum.ssp", "--out", "results/x", cwd=tmp_path)
    found = read_csv(tmp_path / "results" / "x" / "results.csv")
    assert found["observer.estimate.friction"][-1] == pytest.approx(0.2, abs=1e-4)
    assert (tmp_path / "results" / "x" / "report.html").is_file()
