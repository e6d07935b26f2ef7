"""The demonstrations of Ecos and libcosim, rebuilt in their structure (names, connections, files) with FMUs of our own.

Each runs in our master as Jacobi exchange does, by the recursion in numpy, and Ecos and libcosim give the same bits. The names
are those of the demonstrations, blanks and brackets in them; no FMU declares dependencies, as theirs do not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import strict_fmu
from cosim.master import watched
from cosim.masters import process
from mixer_fmu import Mixer
from ssp_text import binding, component, connection, connector, pack, parameter_set, ssd

pytestmark = pytest.mark.long
# Of times of another step libcosim takes differences, which are off by a last bit.
STEPS, H = 8, 0.125
SCALED = '<ssc:LinearTransformation offset="50" factor="1.3"/>'


@dataclass
class Demonstration:
    """`wires`: from "element.output" to "element.input"; `values`: of drive, pull, direct, by element; `scaled`: by SCALED;
    `files`: the parameter sets are files."""

    elements: Mapping[str, Mixer]
    wires: Sequence[tuple[str, str]]
    values: Mapping[str, Sequence[float]]
    scaled: bool = False
    files: bool = False
    more: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    def write(self, path: Path, library: bytes) -> Path:
        made, fmus, files = "", {}, {}
        for number, (name, mixer) in enumerate(self.elements.items()):
            fmu = f"{number}.fmu"
            fmus[fmu] = mixer.write(path.with_name(fmu), library)
            given = {
                label: f'<ssv:Real value="{value}"/>'
                for label, value in zip(mixer.parameters, self.values.get(name, ()), strict=False)
            } | dict(self.more.get(name, {}))
            bound = binding(given) if given else ""
            if self.files and given:
                files[f"ssv/initialValues_{number}.ssv"] = parameter_set(given)
                bound = f'<ssd:ParameterBinding source="ssv/initialValues_{number}.ssv"/>'
            ports = "".join(connector(n, "input") for n in mixer.inputs) + "".join(
                connector(n, "output") for n in mixer.outputs
            )
            made += component(name, fmu, ports, bound)
        wired = "".join(_wire(*ends, SCALED if self.scaled else "") for ends in self.wires)
        content = f"<ssd:Elements>{made}</ssd:Elements><ssd:Connections>{wired}</ssd:Connections>"
        structure = ssd(content, more="").replace('baseStepSize="0.1"', f'baseStepSize="{H}"')
        return pack(path, structure, fmus, files)

    def truth(self) -> dict[str, np.ndarray]:
        """Read all, set all, step all: what each output shows at the communication points, (STEPS + 1,)."""
        x = {name: np.zeros(len(mixer.outputs)) for name, mixer in self.elements.items()}
        y = {f"{e}.{o}": [0.0] for e, mixer in self.elements.items() for o in mixer.outputs}
        driver = {end: start for start, end in self.wires}
        for _ in range(STEPS):
            now = {name: column[-1] for name, column in y.items()}
            for e, mixer in self.elements.items():
                u = np.array([self._passed(now, driver.get(f"{e}.{i}")) for i in mixer.inputs])
                shown = mixer.step(x[e], u, H, *(*self.values.get(e, ()), 0.0, 0.0, 0.0)[:3])
                for output, value in zip(mixer.outputs, shown, strict=True):
                    y[f"{e}.{output}"].append(float(value))
        return {name: np.array(column) for name, column in y.items()}

    def _passed(self, now: Mapping[str, float], start: str | None) -> float:
        if start is None:
            return 0.0
        return 1.3 * now[start] + 50 if self.scaled else now[start]


def _wire(start: str, end: str, inside: str) -> str:
    """A connection between names with dots in them."""
    text = connection("a.b", "c.d", inside)
    for old, new in zip(("a", "b", "c", "d"), (*start.split(".", 1), *end.split(".", 1)), strict=True):
        text = text.replace(f'="{old}"', f'="{new}"', 1)
    return text


def numbered(name: str, count: int) -> list[str]:
    return [f"{name}[{i}]" for i in range(1, count + 1)]


def wired(one: str, other: str, names: Sequence[str], ends: Sequence[str] | None = None) -> list[tuple[str, str]]:
    return [(f"{one}.{a}", f"{other}.{b}") for a, b in zip(names, ends or names, strict=True)]


E, F, LIMITS = numbered("p_Crane.e", 3), numbered("p_Crane.f", 3), numbered("Act_Limits", 3)
REFERENCES = ["x_ref", "y_ref", "psi_ref", "dx_ref", "dy_ref", "dpsi_ref"]
ESTIMATES = [*numbered("y_hat", 3), *numbered("v_hat", 3)]
THRUST = ["F1c", "F2c", "F3c", "Fxg", "Fyg", "Mzg", "alpha1", "alpha2"]
FORCES = [f"additionalBodyForce[0].force.{d}" for d in ("surge", "sway", "heave")]
DEMONSTRATIONS = {
    "quarter truck": Demonstration(
        {
            "chassis": Mixer(["p.f"], ["p.e"], ["C.mChassis", "C.kChassis", "R.dChassis"]),
            "wheel": Mixer(["p.f", "p1.e"], ["p.e", "p1.f"], ["C.mWheel", "C.kWheel", "R.dWheel"]),
            "ground": Mixer(["p.e"], ["p.f"]),
        },
        [
            ("chassis.p.e", "wheel.p1.e"),
            ("wheel.p1.f", "chassis.p.f"),
            ("wheel.p.e", "ground.p.e"),
            ("ground.p.f", "wheel.p.f"),
        ],
        {"chassis": (4.0, -0.5, 0.25), "wheel": (0.4, 1.5, -0.125)},
        files=True,
    ),
    "ship with dynamic positioning": Demonstration(
        {
            "DP Controller": Mixer(
                [*REFERENCES, "x", "y", "psi", "dx", "dy", "dpsi"], ["Controlx", "Controly", "ControlMz"]
            ),
            "Observer": Mixer([*numbered("tau", 3), *numbered("y", 3)], ESTIMATES),
            "Reference Generator": Mixer(["x_wp", "y_wp"], REFERENCES),
            "Thrust Allocation": Mixer(["refx", "refy", "refMz"], THRUST),
            "Ship": Mixer([*numbered("Thrust_d", 3), *numbered("input", 2)], numbered("q", 3)),
        },
        [
            *wired(
                "Thrust Allocation",
                "Ship",
                [*THRUST[:3], *THRUST[6:]],
                [*numbered("Thrust_d", 3), *numbered("input", 2)],
            ),
            *wired("Observer", "DP Controller", ESTIMATES, ["x", "y", "psi", "dx", "dy", "dpsi"]),
            *wired("Ship", "Observer", numbered("q", 3), numbered("y", 3)),
            *wired(
                "DP Controller", "Thrust Allocation", ["Controlx", "Controly", "ControlMz"], ["refx", "refy", "refMz"]
            ),
            *wired("Thrust Allocation", "Observer", THRUST[3:6], numbered("tau", 3)),
            *wired("Reference Generator", "DP Controller", REFERENCES),
        ],
        {
            "Reference Generator": (1.0,),
            "DP Controller": (0.0, 0.02, 0.01),
            "Thrust Allocation": (0.0, 0.05, 0.01),
            "Ship": (0.0, 0.1, 0.0),
            "Observer": (0.0, 0.03, 0.02),
        },
    ),
    "knuckle boom crane": Demonstration(
        {
            "CraneController": Mixer([*F, *LIMITS], E),
            "KnuckleBoomCrane": Mixer(E, [*F, *LIMITS], ["Spring_Joint.k", "mt0_init", "direct"]),
        },
        [
            *wired("CraneController", "KnuckleBoomCrane", E),
            *wired("KnuckleBoomCrane", "CraneController", F),
            *wired("KnuckleBoomCrane", "CraneController", LIMITS),
        ],
        {"CraneController": (0.0, 0.01, 0.005), "KnuckleBoomCrane": (0.005, 0.69, -0.1)},
    ),
    "vessel with azimuth thrusters": Demonstration(
        {
            "vesselModel": Mixer(
                FORCES,
                ["cg_x_rel_ap", "cgShipMotion.linearVelocity.surge", "cgShipMotion.angularDisplacement.yaw"],
                others={
                    "additionalBodyForce[0].enabled": '<Boolean start="false"/>',
                    "vesselZipFile": '<String start=""/>',
                },
            ),
            "azimuth0": Mixer(
                ["input_act_revs", "input_cg_x_rel_ap", "input_cg_surge_vel", "input_yaw_vel"],
                [f"output_force_{d}" for d in ("surge", "sway", "heave")],
            ),
            "azimuth0_rpmActuator": Mixer(["ThrustCom", "Shaft.e"], ["Shaft.f"]),
        },
        [
            *wired("azimuth0", "vesselModel", [f"output_force_{d}" for d in ("surge", "sway", "heave")], FORCES),
            *wired(
                "vesselModel",
                "azimuth0",
                ["cg_x_rel_ap", "cgShipMotion.linearVelocity.surge", "cgShipMotion.angularDisplacement.yaw"],
                ["input_cg_x_rel_ap", "input_cg_surge_vel", "input_yaw_vel"],
            ),
            ("azimuth0_rpmActuator.Shaft.f", "azimuth0.input_act_revs"),
        ],
        {"azimuth0_rpmActuator": (1.5,), "azimuth0": (0.0, 0.2, 0.1), "vesselModel": (0.0, 0.3, 0.05)},
        more={
            "vesselModel": {
                "additionalBodyForce[0].enabled": '<ssv:Boolean value="true"/>',
                "vesselZipFile": '<ssv:String value="%fmu%/resources/ShipModel.zip"/>',
            }
        },
    ),
}
CHAIN = [f"identity{i}" for i in range(1, 4)]
LINEAR = Demonstration(
    {name: Mixer(["realIn"], ["realOut"]) for name in CHAIN},
    [(f"{a}.realOut", f"{b}.realIn") for a, b in pairwise(CHAIN)],
    {"identity1": (2.0,), "identity2": (0.0, 1.0), "identity3": (0.0, 1.0)},
    scaled=True,
    files=True,
)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return strict_fmu.compiled(tmp_path_factory.mktemp("mixer"), "mixer")


@pytest.mark.usefixtures("other_masters")
@pytest.mark.parametrize("name", [*DEMONSTRATIONS, "linear transformation"])
def test_a_demonstration_runs_as_the_recursion_says_and_gives_the_same_bits_in_ecos_and_libcosim(
    name: str, library: bytes, tmp_path: Path
) -> None:
    asked = DEMONSTRATIONS.get(name, LINEAR)
    path = asked.write(tmp_path / "demonstration.ssp", library)
    result = watched.run(path)
    truth = asked.truth()
    assert list(result.names) == list(truth) and any(column.any() for column in truth.values())
    for column, expected in truth.items():
        np.testing.assert_allclose(result[column], expected, rtol=1e-13, atol=1e-15, err_msg=column)
    for tool in ("ecos", "libcosim"):
        theirs = process.record(tool, path)
        for column in truth:
            np.testing.assert_array_equal(theirs[column], result[column], err_msg=f"{tool}: {column}")
