"""Fuzzes the C of the FMUs (`make fuzz`): libFuzzer drives them through harness.c, under the address and undefined-behaviour sanitizers.

Seven kinds of component in the native shell, one with a plant inside, and the relay of the PythonFMU target with a native component in
PythonFMU's place.
What makes one fail is kept in `build/fuzz/<kind>/`; run `build/fuzz/<kind>/binaries/host/fuzz FILE` to see it again.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS), str(TESTS.parent)]  # run as a script

import linear_models  # noqa: E402
import plant_fmu  # noqa: E402
from fmu_src import PlantFMU  # noqa: E402
from fmu_src.description.model_description import entries  # noqa: E402
from fmu_src.native.sources import fixed_sources, functions, prefix, tables  # noqa: E402
from fmu_src.plant.guest import guest_of  # noqa: E402
from fmu_src.plant.sources import plant_sources  # noqa: E402
from fmu_src.platforms import resolve  # noqa: E402
from fmu_src.python.target import relay  # noqa: E402
from observers.component import Component  # noqa: E402
from observers.pseudospectral import pseudospectral  # noqa: E402
from observers.ukf import ukf  # noqa: E402
from reference_models.closed_loop import FMUS  # noqa: E402
from reference_models.duffing import DUFFING  # noqa: E402
from reference_models.plant import plant  # noqa: E402
from toys import sampled_toy  # noqa: E402

HARNESS = Path(__file__).parent / "harness.c"
WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Werror")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", "-fno-omit-frame-pointer")
# Not optimised: that takes a minute for all kinds, mostly of CasADi's functions, and more than it brings in calls.
COMPILE = ("clang", "-std=c99", "-O0", "-gline-tables-only", "-fPIC", *WARNINGS, *SANITIZERS)
SECONDS_A_RUN = 30  # more is a hang
LONGEST_INPUT = 1024  # [bytes]
GUID = "{fuzz}"
RELAY = "relay"


def plant_inside() -> Component:
    """A filter whose plant is an FMU, which refuses points that are far off with an error."""
    with tempfile.TemporaryDirectory() as scratch:
        path = plant_fmu.write(Path(scratch) / "error.fmu", plant_fmu.compiled(Path(scratch)), "error")
        model = PlantFMU(path, outputs=["y"], inputs=["force"], unknown_parameters=["mu"])
    return ukf(model, sample_time=0.1, measurement_noise={"y": 1e-3})


KINDS: dict[str, Callable[[], Component]] = {
    "plant": lambda: plant(DUFFING, jumps={"theta": 2}),
    "pseudospectral": lambda: pseudospectral(DUFFING, sample_time=0.1, N=5, L=6),
    "ukf": lambda: ukf(DUFFING, sample_time=0.1, measurement_noise={"y": 1e-3}),
    "riccati": lambda: linear_models.riccati(2),
    "least_squares": lambda: linear_models.least_squares(2),
    "plant inside": plant_inside,
    "controller": FMUS["duffing_ukf_controller"][0],
    RELAY: sampled_toy,
}


@dataclass(frozen=True)
class Outcome:
    """Of one kind: how many FMI calls were made, and what the fuzzer said where it found something."""

    calls: int
    finding: str


def fmu_h(component: Component, resources: Path) -> bytes:
    """What the harness knows of the FMU, whose resources are in this folder."""
    names = [entry.port.name for entry in entries(component)]
    lines = [
        f"#define GUID {json.dumps(GUID)}",
        f"#define RESOURCES {json.dumps(resources.as_uri())}",
        f"#define STEP {component.step_size!r}",
        f"#define N_VARIABLES {len(names)}u",
        f"static const char *const NAMES[] = {{{', '.join(map(json.dumps, names))}}};",
    ]
    return ("\n".join(lines) + "\n").encode()


def build(kind: str, folder: Path) -> Path:
    """The fuzzer of this kind, compiled in `folder`, which it makes."""
    component = KINDS[kind]()
    host = folder / "binaries" / "host"  # where the relay expects to be
    host.mkdir(parents=True, exist_ok=True)
    guest = guest_of(component)
    native = fixed_sources() | prefix(component) | functions(component, guest.name if guest else "")
    native |= tables(component, GUID, plant=guest is not None)
    extra: list[str] = []
    if guest:
        native |= plant_sources() | {"plant_tables.c": guest.tables}
        for name, content in guest.resources(resolve(["host"])).items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        extra = ["-ldl"]
    sources = _written(native | {"fmu.h": fmu_h(component, folder / "resources")}, folder / "native")
    if kind == RELAY:
        subprocess.run([*COMPILE, "-shared", *sources, "-lm", "-o", host / "libpythonfmu-export.so"], check=True)
        # The relay asks the process for a Python.
        python = b"int Py_IsInitialized(void);\nint Py_IsInitialized(void) { return 1; }\n"
        relayed = relay(component, GUID) | {"fmu.h": fmu_h(component, folder / "resources"), "python.c": python}
        sources = _written(relayed, folder / "relay")
        extra = ["-rdynamic", "-ldl"]
    program = host / "fuzz"
    include = ["-I", sources[0].parent]
    subprocess.run(
        [*COMPILE, "-fsanitize=fuzzer", *include, HARNESS, *sources, *extra, "-lm", "-o", program], check=True
    )
    return program


def _written(contents: dict[str, bytes], folder: Path) -> list[Path]:
    """Writes the files; returns those to compile."""
    folder.mkdir(exist_ok=True)
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    return sorted(folder / name for name in contents if name.endswith(".c"))


def ordinary_runs() -> dict[str, bytes]:
    """Inputs to begin with: harness.c says what the bytes mean. Begin, then steps, values read and set, states put back."""
    begin, step, again, read, put = (
        bytes([1, 0, 0]),
        bytes([0, 0, 0]),
        bytes([10, 0, 0]),
        bytes([7, 4, 0, 9, 13, 16]),
        bytes([14, 0]),
    )
    set_input = bytes([6, 1, 0, 40])
    return {
        "steps": begin + 40 * (set_input + step + read),
        "rollback": begin + 20 * (set_input + again + read + put),
        "two": begin + bytes([225, 1, 0, 0]) + 10 * (step + read + bytes([11, 12])),
    }


def fuzz(kind: str, folder: Path, seconds: int) -> Outcome:
    """Fuzz for so many seconds, always from the same seed."""
    program = build(kind, folder)
    corpus = folder / "corpus"
    corpus.mkdir(exist_ok=True)
    for name, run in ordinary_runs().items():
        (corpus / name).write_bytes(run)
    limits = [f"-max_total_time={seconds}", f"-max_len={LONGEST_INPUT}", f"-timeout={SECONDS_A_RUN}", "-seed=1"]
    command = [program, *limits, "-print_final_stats=1", f"-artifact_prefix={folder}/", corpus]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace")
    counted = re.search(r"^calls: (\d+)$", done.stderr, re.M)
    lines = done.stderr.splitlines()
    first = next((i for i, line in enumerate(lines) if re.search("FINDING|ERROR: |runtime error", line)), 0)
    finding = "\n".join(lines[first : first + 30]) if done.returncode != 0 else ""
    return Outcome(int(counted[1]) if counted else 0, finding)


def main(seconds: int, folder: Path) -> int:
    """Fuzz every kind, `seconds` in all; the number of those with a finding."""
    outcomes: dict[str, Outcome] = {}
    for kind in KINDS:
        outcomes[kind] = fuzz(kind, folder / kind, max(seconds // len(KINDS), 1))
        print(f"{kind:15} {outcomes[kind].calls:10,} calls", outcomes[kind].finding, flush=True)
    print(f"{sum(outcome.calls for outcome in outcomes.values()):,} calls in all")
    return sum(bool(outcome.finding) for outcome in outcomes.values())


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), Path(sys.argv[2]).resolve()))
