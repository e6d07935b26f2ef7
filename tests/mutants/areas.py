"""Which files make an area, and which tests see them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

METHODS = ("canonical_dae", "elementary", "least_squares", "pseudospectral", "riccati", "ukf")


@dataclass(frozen=True)
class Area:
    """`files`: patterns of what is mutated, but not `without`; `tests`: folders and files of tests that ask what they promise.

    Of tests that come once for each method, those of `method`.
    """

    files: tuple[str, ...]
    tests: tuple[str, ...]
    without: tuple[str, ...] = ()
    method: str = ""

    @property
    def keywords(self) -> str:
        """pytest's `-k`."""
        return f"{self.method} or not ({' or '.join(METHODS)})" if self.method else ""

    def paths(self, root: Path) -> list[str]:
        """The files, relative to `root`, in the order of their names."""
        left_out = {path for pattern in self.without for path in root.glob(pattern)}
        found = {path for pattern in self.files for path in root.glob(pattern)} - left_out
        return sorted(path.relative_to(root).as_posix() for path in found if path.stat().st_size)


SHARED = tuple(
    f"tests/observers/test_{name}.py"
    for name in ("explicit_time", "diagnostics", "failures", "restarts", "linear_inputs")
)


def _method(name: str) -> Area:
    return Area((f"observers/{name}/*.py",), (f"tests/observers/{name}", *SHARED), method=name)


AREAS = {
    "contract": Area(
        ("observers/*.py",),
        (
            "tests/observers/test_component.py",
            "tests/observers/test_model.py",
            "tests/observers/test_mistakes.py",
            "tests/observers/test_contract.py",
            "tests/observers/test_ports.py",
            "tests/observers/test_compose.py",
            "tests/observers/test_linearisation.py",
            "tests/fmu_src/description/test_units.py",
            "tests/observers/test_tuning.py",
            "tests/observers/test_judgement.py",
            "tests/observers/test_clock.py",
            "tests/observers/test_bounds.py",
            "tests/observers/test_watch.py",
            "tests/observers/test_tables.py",
            "tests/observers/test_undo.py",
            "tests/observers/test_free_motion.py",
            "tests/observers/test_failures.py",
        ),
    ),
    "numerics": Area(
        ("observers/numerics/*.py",),
        ("tests/observers/numerics", "tests/observers/test_model.py", "tests/observers/test_linearisation.py"),
    ),
    "window": Area(
        ("observers/pseudospectral/window/*.py",),
        (
            "tests/observers/pseudospectral/window",
            "tests/observers/pseudospectral/test_segments.py",
            "tests/observers/pseudospectral/test_pseudospectral.py",
            "tests/observers/pseudospectral/test_process_noise.py",
            "tests/observers/pseudospectral/test_wandering_parameter.py",
            "tests/observers/pseudospectral/test_window_diagnostics.py",
        ),
    ),
    "pseudospectral": Area(
        ("observers/pseudospectral/*.py",),
        (
            *SHARED,
            "tests/observers/pseudospectral/test_pseudospectral.py",
            "tests/observers/pseudospectral/test_arrival_cost.py",
            "tests/observers/pseudospectral/test_forgotten_past.py",
            "tests/observers/pseudospectral/test_bounded_noise.py",
            "tests/observers/pseudospectral/test_constraints.py",
            "tests/observers/pseudospectral/test_wandering_parameter.py",
            "tests/observers/pseudospectral/test_window_diagnostics.py",
        ),
        method="pseudospectral",
    ),
    "riccati": _method("riccati"),
    "ukf": _method("ukf"),
    "least_squares": _method("least_squares"),
    "canonical_dae": _method("canonical_dae"),
    "elementary": _method("elementary"),
    "plants": Area(
        (
            "reference_models/plant.py",
            "reference_models/motion.py",
            "reference_models/sine.py",
            "reference_models/ramp.py",
        ),
        (
            "tests/reference_models/test_plant.py",
            "tests/reference_models/test_signal_sources.py",
            "tests/reference_models/test_dae_plant.py",
            "tests/observers/test_component.py",
            "tests/observers/test_model.py",
        ),
    ),
    "shell": Area(
        ("fmu_src/native/shell/*.c", "fmu_src/native/shell/clock.h"),  # arithmetic.c: tests that take minutes
        (
            "tests/fmu_src/native/test_shell.py",
            "tests/fmu_src/native/test_lifecycle.py",
            "tests/fmu_src/native/test_states.py",
            "tests/fmu_src/native/test_unevaluated.py",
        ),
    ),
    "description": Area(
        ("fmu_src/description/*.py", "fmu_src/native/*.py", "fmu_src/*.py"),
        (
            "tests/fmu_src/description",
            "tests/fmu_src/native/test_native.py",
            "tests/fmu_src/native/test_lifecycle.py",
            "tests/fmu_src/native/test_unevaluated.py",
        ),
    ),
    "plant_inside": Area(
        ("fmu_src/plant/*.py", "fmu_src/native/plant/*.c"), ("tests/fmu_src/plant", "tests/commands/test_wrap.py")
    ),
    "python_target": Area(("fmu_src/python/*.py",), ("tests/fmu_src/python/test_python_target.py",)),
    "compliance": Area(("fmu_src/compliance/**/*.py",), ("tests/fmu_src/compliance",)),
    "cosim": Area(
        ("cosim/*.py", "cosim/system/*.py", "cosim/master/*.py", "cosim/masters/*.py"),
        ("tests/cosim/system", "tests/cosim/master", "tests/cosim/masters/test_comparison.py"),
        without=("cosim/masters/ecos.py", "cosim/masters/libcosim.py"),  # of tools that may be missing here
    ),
    "runs": Area(
        ("cosim/campaign/*.py", "cosim/replay/*.py", "cosim/report/*.py"),
        ("tests/cosim/campaign", "tests/cosim/replay", "tests/cosim/report"),
    ),
}
