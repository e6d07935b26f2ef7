"""An observer of a plant that is an FMU is the observer of its equations, bit for bit, and a good FMU itself."""

from __future__ import annotations

import math
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import casadi as ca
import fmpy
import numpy as np
import pytest

import plant_fmu
from fmu_src import ExportError, PlantFMU, export
from fmu_src.compliance.check import check
from fmu_src.platforms import PLATFORMS
from observers.component import Component
from observers.instance import Instance
from observers.linearisation import linearisation
from observers.model import Model, Variable
from observers.pseudospectral import pseudospectral
from observers.riccati import riccati
from observers.ukf import ukf
from once import compiled_once
from reference_models.plant import plant
from slave import Slave
from tools import ROOT, TESTS, few, need

H = 0.05
Modelled = Callable[..., PlantFMU]


def measured(k: int) -> tuple[float, float]:
    """A measurement and the force at the sample k: nothing that the plant does, which moves everything."""
    return 1.0 + 0.5 * math.sin(0.7 * k * H) + 0.02 * math.sin(91.0 * k), 0.3 * math.cos(0.2 * k)


@pytest.fixture
def slave(tmp_path: Path) -> Iterator[Callable[..., Slave]]:
    """slave(component, folder) -> an instance of its FMU, initialised; each must give back all of its memory, the plant's too."""
    made: list[Slave] = []

    def make(component: Component, folder: str = "a", **options: Any) -> Slave:
        with compiled_once():
            path = export(component, tmp_path / folder, **options)
        made.append(Slave(Path(fmpy.extract(str(path), str(tmp_path / folder / f"unpacked{len(made)}")))).initialize())
        return made[-1]

    yield make
    for instance in made:
        instance.fmu.freeInstance()
        assert not instance.blocks


def steps(fmu: Slave, first: int = 0, last: int = 60, missing: frozenset[int] = frozenset()) -> list[dict[str, float]]:
    found = []
    for k in range(first, last):
        y, force = measured(k)
        fmu.set("y", y)
        fmu.set("force", force)
        fmu.set("measurement_valid.y", k not in missing)
        fmu.step(k * H, H)
        found.append(fmu.outputs())
    return found


PAIRS: dict[str, tuple[str, Callable[[], Model], dict[str, Any]]] = {
    "van der Pol": ("van_der_pol", plant_fmu.van_der_pol, {}),
    "van der Pol, mu known": (
        "van_der_pol",
        lambda: plant_fmu.van_der_pol(known=True),
        {"parameters": ["mu"], "unknown_parameters": []},
    ),
    "pendulum": ("pendulum", plant_fmu.pendulum, {}),
    "a plant that cannot be reset": ("no_reset", plant_fmu.van_der_pol, {}),
}


@pytest.mark.parametrize("pair", few(PAIRS, 2))
def test_the_ukf_of_an_fmu_is_that_of_its_equations_bit_for_bit_with_missing_samples(
    modelled: Modelled, slave: Callable[..., Slave], pair: str
) -> None:
    kind, twin, choices = PAIRS[pair]
    missing = frozenset({7, 8, 9, 30})
    one = steps(slave(ukf(modelled(kind, **choices), sample_time=H, name="same")), missing=missing)
    other = steps(slave(ukf(twin(), sample_time=H, name="same"), "b"), missing=missing)
    assert one == other
    assert len({row["filtered.x0" if "filtered.x0" in row else "filtered.mass_r"] for row in one}) == len(one)


def test_the_riccati_observer_with_the_plants_own_slopes_is_that_of_its_equations_bit_for_bit(
    modelled: Modelled, slave: Callable[..., Slave]
) -> None:
    kind, twin, choices = PAIRS["van der Pol, mu known"]
    model = modelled(kind, slopes=True, **choices)
    one = steps(slave(riccati(model, sample_time=H, name="same")))
    other = steps(slave(riccati(twin(), sample_time=H, name="same"), "b"))
    shown = [
        name for name in one[0] if not name.startswith(("certificate", "diagnostics.certified", "diagnostics.rate"))
    ]
    assert [[row[name] for name in shown] for row in one] == [[row[name] for name in shown] for row in other]


def test_a_fixed_parameter_is_estimated_by_initialisations_bit_for_bit(
    modelled: Modelled, slave: Callable[..., Slave]
) -> None:
    twin = plant_fmu.pendulum()
    fields = {f: getattr(twin, f) for f in ("name", "states", "outputs", "inputs", "ode", "output")}
    swapped = Model(**fields, parameters=twin.unknown_parameters, unknown_parameters=twin.parameters)
    model = modelled("pendulum", parameters=["spring.c"], unknown_parameters=["mass.m"])
    assert b"fixed[] = {0, 1}" in model.guest.tables
    one = steps(slave(ukf(model, sample_time=H, name="same")))
    assert one == steps(slave(ukf(swapped, sample_time=H, name="same"), "b"))


@pytest.mark.long
def test_a_large_plant_has_the_filter_of_its_equations_bit_for_bit(modelled: Modelled) -> None:
    """Beyond eight estimates the filter works in loops, on a called function as on equations."""
    n = 30

    def ode(x: Any, u: Any, p: Any, t: Any) -> list[Any]:
        T = [getattr(x, f"T_{i + 1}") for i in range(n)]
        return [
            p.k * ((T[i - 1] if i else u.force) - 2 * T[i] + (T[i + 1] if i < n - 1 else T[i])) - 0.1 * T[i] * T[i]
            for i in range(n)
        ]

    twin = Model(
        name="twin",
        states=[Variable(f"T_{i + 1}") for i in range(n)],
        outputs=[Variable("middle")],
        inputs=[Variable("force")],
        parameters=[Variable("k", start=20.0, nominal=20.0, min=0.0)],
        ode=ode,
        output=lambda x, u, p, t: [getattr(x, f"T_{n // 2 + 1}")],
    )
    model = modelled(f"rod{n}", outputs=["middle"], parameters=["k"], unknown_parameters=[])
    pair = [Instance(ukf(m, sample_time=H)) for m in (model, twin)]
    for k in range(20):
        for one in pair:
            one.set("middle", 0.3 * (1 - math.exp(-k * H)))
            one.set("force", 1.0)
            one.step(k * H, H)
    assert np.array_equal(pair[0].outputs(), pair[1].outputs())


@pytest.mark.long
def test_a_plant_that_prints_is_a_plant(modelled: Modelled, slave: Callable[..., Slave]) -> None:
    one = steps(slave(ukf(modelled("prints"), sample_time=H, name="same")), 0, 10)
    assert one == steps(slave(ukf(plant_fmu.van_der_pol(), sample_time=H, name="same"), "b"), 0, 10)


@pytest.mark.long
def test_all_platforms_are_compiled_where_the_plant_has_them_and_gcc_takes_the_sources(
    modelled: Modelled, tmp_path: Path
) -> None:
    others = {}
    for platform in PLATFORMS:
        (tmp_path / platform).mkdir()
        others[platform] = plant_fmu.compiled(tmp_path / platform, platform)
    path = export(ukf(modelled("van_der_pol", others=others), sample_time=H), tmp_path, platforms=["all"])
    folder = Path(fmpy.extract(str(path), str(tmp_path / "all")))
    for root in (folder, folder / "resources" / "plant"):
        assert {p.name for p in (root / "binaries").iterdir()} == set(PLATFORMS)
    need(shutil.which("gcc") is not None, "gcc is not installed here: make ci-tools")
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fPIC", "-shared"]
    sources = sorted((folder / "sources").glob("*.c"))
    subprocess.run(["gcc", *flags, *sources, "-lm", "-ldl", "-o", tmp_path / "made.so"], check=True)


@pytest.mark.parametrize("slopes", [True, False])
def test_an_estimated_parameter_is_differentiated_by_differences_to_eight_digits(
    modelled: Modelled, slopes: bool
) -> None:
    """Directional derivatives are of states and inputs, in this mode: by parameters there are none in FMI 2.0."""
    for kind, twin in (("van_der_pol", plant_fmu.van_der_pol()), ("pendulum", plant_fmu.pendulum())):
        one, other = linearisation(modelled(kind, slopes=slopes)), linearisation(twin)
        m = np.array([v.start for v in other.variables]) + 0.1
        p = [v.start for v in twin.parameters]
        for name in ("jacobian", "gradient", "rate_t"):
            wanted = getattr(other, name)(m, 0.3, p, 1.0).full()
            np.testing.assert_allclose(
                getattr(one, name)(m, 0.3, p, 1.0).full(), wanted, rtol=0, atol=1e-8 * max(1.0, np.abs(wanted).max())
            )


def test_slopes_that_are_wrong_are_not_believed(modelled: Modelled) -> None:
    model = modelled("wrong_slopes", slopes=True)
    assert b".directional_rate = 0" in model.guest.tables and b".directional_measure = 1" in model.guest.tables
    wanted = linearisation(plant_fmu.van_der_pol()).jacobian([1.1, 0.4, 1.6], 0.3, [], 1.0).full()
    found = linearisation(model).jacobian([1.1, 0.4, 1.6], 0.3, [], 1.0).full()
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-8)


def test_a_dependency_that_is_not_declared_is_found_and_declared_ones_keep_the_jacobian_sparse(
    modelled: Modelled,
) -> None:
    rod = modelled("rod8", unknown_parameters=[]).equations
    # What is said of the first place is nothing, so that it may depend on all: the others on their neighbours.
    assert ca.jacobian_sparsity(rod.ode, rod.x).nnz() == 8 + 6 * 3 + 2
    lying = modelled("rod8", lies=True, unknown_parameters=[]).equations
    assert ca.jacobian_sparsity(lying.ode, lying.x).nnz() == 64


def test_time_in_the_plant_is_the_observers(modelled: Modelled, slave: Callable[..., Slave]) -> None:
    twin = plant_fmu.van_der_pol()
    driven = Model(
        **{f: getattr(twin, f) for f in ("name", "states", "outputs", "inputs", "unknown_parameters", "output")},
        ode=lambda x, u, p, t: [x.x1, p.mu * (1 - x.x0 * x.x0) * x.x1 - x.x0 + u.force + ca.sin(3 * t)],
    )
    one = steps(slave(ukf(modelled("explicit_time"), sample_time=H, name="same")))
    assert one == steps(slave(ukf(driven, sample_time=H, name="same"), "b"))
    slopes = linearisation(modelled("explicit_time")).rate_t
    for t in (0.0, 2.0):  # at the beginning to the later side only
        found = slopes([1, 0.5, 1.5], 0, [], t).full().ravel()
        np.testing.assert_allclose(found, [0, 3 * math.cos(3 * t), 0], rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    "options", few([{}, {"N": 6, "L": 5}, {"process_noise": {"x0": 1e-3, "x1": 1e-3, "mu": 1e-2}}])
)
def test_the_moving_horizon_of_an_fmu_is_that_of_its_equations_to_its_tolerance(
    modelled: Modelled, options: dict[str, Any]
) -> None:
    """With an arrival cost and process noise, and without; what is known to be linear in the equations is not in the FMU."""
    truth = Instance(plant(plant_fmu.van_der_pol()))
    pair = [
        Instance(pseudospectral(m, sample_time=H, **options))
        for m in (modelled("van_der_pol"), plant_fmu.van_der_pol())
    ]
    for k in range(60):
        for one in pair:
            one.set("y", truth.get("y"))
            one.step(k * H, H)
        truth.step(k * H, H)
    for name in ("estimate.x0", "estimate.x1", "estimate.mu"):
        assert pair[0].get(name) == pytest.approx(pair[1].get(name), rel=0, abs=1e-5)
        assert pair[0].get(name) == pytest.approx(truth.get(f"x.{name.split('.')[1]}"), rel=0, abs=1e-4)


def test_the_plant_itself_is_a_component_of_a_system(modelled: Modelled, slave: Callable[..., Slave]) -> None:
    one = slave(plant(modelled("pendulum", name="same")))
    twin = plant_fmu.pendulum()
    fields = {
        f: getattr(twin, f)
        for f in ("states", "outputs", "inputs", "parameters", "unknown_parameters", "ode", "output")
    }
    other = slave(plant(Model(name="same", **fields)), "b")
    for fmu in (one, other):
        fmu.set("force", 0.4)
    for k in range(40):
        for fmu in (one, other):
            fmu.step(k * 0.1, 0.1)
        assert one.outputs() == other.outputs()


@pytest.mark.long
def test_four_threads_give_the_sequential_numbers(modelled: Modelled, slave: Callable[..., Slave]) -> None:
    component = ukf(modelled("van_der_pol"), sample_time=H)
    wanted = steps(slave(component))
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(steps, [slave(component) for _ in range(4)])) == [wanted] * 4


RESUME = """
import sys
sys.path[:0] = {paths!r}
from pathlib import Path
from slave import Slave
from test_plant_fmu import steps
fmu = Slave(Path({folder!r}))
fmu.fmu.setFMUState(fmu.fmu.deSerializeFMUstate(Path({state!r}).read_bytes()))
steps(fmu, 20)
print(fmu.state().hex())
"""


def test_a_rollback_a_reset_and_a_new_process_give_the_same_bits(
    modelled: Modelled, slave: Callable[..., Slave], tmp_path: Path
) -> None:
    fmu = slave(ukf(modelled("pendulum"), sample_time=H))
    steps(fmu, 0, 20)
    kept = fmu.fmu.getFMUState()
    (tmp_path / "state").write_bytes(fmu.state())
    steps(fmu, 20)
    end = fmu.state()
    fmu.fmu.setFMUState(kept)
    fmu.fmu.freeFMUState(kept)
    steps(fmu, 20)
    assert fmu.state() == end
    fmu.fmu.reset()
    fmu.initialize()
    steps(fmu)
    assert fmu.state() == end
    script = RESUME.format(
        paths=[str(Path(__file__).parent), str(TESTS), str(ROOT)],
        folder=fmu.fmu.unzipDirectory,
        state=str(tmp_path / "state"),
    )
    output = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert output.strip() == end.hex()


def test_folders_with_umlauts_blanks_and_percent_signs_are_found(modelled: Modelled, tmp_path: Path) -> None:
    with compiled_once():
        path = export(ukf(modelled("van_der_pol"), sample_time=H), tmp_path)
    folder = tmp_path / "Prüf stand 100%25#ä"
    fmpy.extract(str(path), str(folder))
    fmu = Slave(folder).initialize()
    wanted = Slave(Path(fmpy.extract(str(path), str(tmp_path / "plain")))).initialize()
    assert steps(fmu) == steps(wanted)
    for one in (fmu, wanted):
        one.fmu.freeInstance()


def far(fmu: Slave, k: int) -> None:
    """A step whose measurement leads the estimate to where the plant refuses."""
    fmu.set("y", 40.0)
    fmu.step(k * H, H)


@pytest.mark.parametrize("kind", ["discard", "error"])
def test_points_that_the_plant_refuses_are_a_status_and_no_end(
    modelled: Modelled, slave: Callable[..., Slave], kind: str
) -> None:
    fmu = slave(ukf(modelled(kind), sample_time=H))
    steps(fmu, 0, 20)
    for k in range(20, 25):
        far(fmu, k)
    assert fmu.get("diagnostics.solver_failures") > 0
    assert math.isfinite(fmu.get("estimate.x0"))
    words = [text for _, _, text in fmu.messages]
    assert any("too far: 100? of 2.5" in text for text in words) == (kind == "error")  # the plant's own words
    back = steps(fmu, 25, 200)
    assert abs(back[-1]["estimate.x0"] - measured(199)[0]) < 0.2


def test_a_plant_that_ends_for_good_is_an_error_for_good_that_says_so(
    modelled: Modelled, slave: Callable[..., Slave]
) -> None:
    model = modelled("fatal", attributes={"x0": {"nominal": 0.3}})  # the points of the trial stay near
    fmu = slave(ukf(model, sample_time=H))
    steps(fmu, 0, 5)
    model_wide = "the plant answered fmi2GetDerivatives with fmi2Fatal, after which it can't be asked any more"
    with pytest.raises(Exception, match="fmi2DoStep"):
        for k in range(5, 400):
            far(fmu, k)
    assert any(model_wide in text for _, _, text in fmu.messages)
    left = len(fmu.blocks)
    fmu.fmu.fmi2FreeInstance(fmu.fmu.component)
    assert left > len(fmu.blocks) == 1  # the plant's own, of which nothing may be called any more
    fmu.fmu.freeInstance = fmu.blocks.clear


def test_an_event_that_comes_later_is_a_status(modelled: Modelled, slave: Callable[..., Slave]) -> None:
    """The plant announces one once its parameters have changed: from then on it would be another function."""
    fmu = slave(ukf(modelled("late_event"), sample_time=H))
    steps(fmu, 0, 300)
    assert fmu.get("diagnostics.solver_failures") == 0
    steps(fmu, 300, 310)
    assert fmu.get("diagnostics.solver_failures") > 0


def test_a_plant_for_one_instance_a_process_makes_an_observer_for_one(
    modelled: Modelled, slave: Callable[..., Slave], tmp_path: Path
) -> None:
    fmu = slave(ukf(modelled("once"), sample_time=H))
    description = fmpy.read_model_description(str(fmu.fmu.unzipDirectory))
    assert description.coSimulation.canBeInstantiatedOnlyOncePerProcess
    with pytest.raises(Exception, match="Failed to instantiate"):
        Slave(Path(fmu.fmu.unzipDirectory))
    steps(fmu, 0, 3)


def test_what_the_plant_says_of_itself_is_what_the_model_says(modelled: Modelled) -> None:
    model = modelled("pendulum", attributes={"spring.c": {"nominal": 50.0, "max": 90.0}})
    assert [(v.name, v.unit, v.start) for v in model.states] == [
        ("mass_r", "m", 1.0),
        ("mass_phi", "rad", 0.3),
        ("mass_v", "m/s", 0.0),
        ("mass_w", "rad/s", 0.0),
    ]
    (c,) = model.unknown_parameters
    assert (c.name, c.start, c.nominal, c.min, c.max) == ("spring_c", 40.0, 50.0, 0.0, 90.0)
    (m,) = model.parameters
    assert (m.name, m.start, m.nominal) == ("mass_m", 2.0, 2.0)
    assert [(v.name, v.unit) for v in model.outputs] == [("y", "m")]


def test_a_state_can_be_measured_under_its_own_name(modelled: Modelled, slave: Callable[..., Slave]) -> None:
    fmu = slave(ukf(modelled("pendulum", outputs=["mass.r"]), sample_time=H, measurement_noise={"mass_r": 0.01}))
    fmu.set("mass_r", 1.02)
    fmu.step(0.0, H)
    assert {"estimate.mass_r", "mass_r", "measurement_valid.mass_r"} <= set(fmu.variables)


def test_licences_travel_and_the_owners_leave_is_asked_for(modelled: Modelled, tmp_path: Path) -> None:
    files = [
        ("documentation/licenses/license.txt", b"mine"),
        ("resources/map.txt", b"data"),
        ("sources/secret.c", b"no"),
    ]
    with pytest.raises(
        ExportError, match=r"says whose it is \(Dr\. Spring\), and its files would travel.*--redistribute"
    ):
        export(ukf(modelled("pendulum", copyright="Dr. Spring"), sample_time=H), tmp_path)
    allowed = modelled("pendulum", redistribute=True, files=files)
    with compiled_once():
        path = export(ukf(allowed, sample_time=H), tmp_path)
    with zipfile.ZipFile(path) as archive:
        names = set(archive.namelist())
        assert archive.read("documentation/licenses/plant/license.txt") == b"mine"
    assert {"resources/plant/resources/map.txt", "resources/plant/modelDescription.xml"} <= names
    assert not any("secret" in name for name in names)


@pytest.mark.long
def test_platforms_are_those_of_both_and_other_files_another_guid(modelled: Modelled, tmp_path: Path) -> None:
    one = ukf(modelled("van_der_pol"), sample_time=H)
    with pytest.raises(ExportError, match=r"plant 'van_der_pol.fmu' has no binary for win64; it has linux64"):
        export(one, tmp_path, platforms=["linux64", "win64"])
    guids = set()
    for n, files in enumerate(([], [], [("resources/a", b"1")])):
        with compiled_once():
            path = export(
                ukf(modelled("van_der_pol", files=files), sample_time=H), tmp_path / str(n), platforms=["all"]
            )
        guids.add((fmpy.read_model_description(str(path)).guid, path.read_bytes() if n < 2 else b""))
        assert [n for n in zipfile.ZipFile(path).namelist() if n.startswith("binaries/")] == [
            "binaries/linux64/van_der_pol_ukf.so"
        ]
    assert len(guids) == 2


def test_an_fmu_is_not_written_over_its_plant(modelled: Modelled) -> None:
    model = modelled("van_der_pol")
    with pytest.raises(ExportError, match="would be written over its plant"):
        export(plant(model), model.guest.source.parent)
    assert model.guest.source.is_file()


def test_the_python_target_is_refused(modelled: Modelled) -> None:
    with pytest.raises(ExportError, match=r"which the target 'python' cannot"):
        export(ukf(modelled("van_der_pol"), sample_time=H), "nowhere", target="python")


def test_the_checker_finds_nothing(modelled: Modelled, tmp_path: Path) -> None:
    with compiled_once():
        for component in (ukf(modelled("pendulum"), sample_time=H), plant(modelled("pendulum", name="swing"))):
            report = check(export(component, tmp_path))
            assert not report.findings, report.findings


def test_casadi_copies_arguments_that_mix_a_known_and_an_estimated_parameter(
    modelled: Modelled, tmp_path: Path
) -> None:
    """CasADi's generated code once read the wrong numbers there, which its interpreter did not."""
    known, unknown, x = ca.SX.sym("known", 3), ca.SX.sym("unknown", 3), ca.SX.sym("x", 2)
    inner = ca.Function("inner", [x], [x[0] * 100 + x[1]], {"never_inline": True})
    mixed = ca.Function("mixed", [known, unknown], [inner(ca.vertcat(known[0], unknown[1]))])
    generator = ca.CodeGenerator("mixed.c")
    generator.add(mixed)
    code = generator.generate(f"{tmp_path}/")
    library = tmp_path / "mixed.so"
    subprocess.run([sys.executable, "-m", "ziglang", "cc", "-shared", "-fPIC", "-o", library, code], check=True)
    found = ca.external("mixed", str(library))([6, 7, 8], [1, 2, 3])
    assert float(found) == float(mixed([6, 7, 8], [1, 2, 3])) == 602
