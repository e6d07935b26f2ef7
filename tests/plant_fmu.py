"""FMUs for model exchange of plants/plants.c, and two of their plants from equations."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Sequence
from pathlib import Path

import casadi as ca

from fmu_src.native import compiler
from fmu_src.native.compiler import compile_library
from fmu_src.native.sources import FMI_HEADERS, fixed_sources
from fmu_src.platforms import PLATFORMS
from observers.model import Model, Variable
from once import LIBRARIES, once
from strict_fmu import HOST

SOURCE = Path(__file__).parent / "plants" / "plants.c"
NAMES = {"pendulum": ["mass.r", "mass.phi", "mass.v", "mass.w"]}
PARAMETERS = {"pendulum": ("spring.c", "mass.m")}
FLAGS = {"once": ' canBeInstantiatedOnlyOncePerProcess="true"', "tool": ' needsExecutionTool="true"'}
STARTS = {"pendulum": (40.0, 2.0)}


def compiled(folder: Path, platform: str = HOST) -> bytes:
    """The library of plants.c, built in `folder`."""
    (folder / "plants.c").write_bytes(SOURCE.read_bytes())
    for header in FMI_HEADERS:
        (folder / header).write_bytes(fixed_sources()[header])
    return compile_library("plants", folder, platform)


def library() -> bytes:
    """The library of plants.c for this machine, compiled once."""
    made_of = digest(SOURCE.read_bytes() + repr(compiler.FLAGS).encode())

    def fill(folder: Path) -> None:
        (folder / "library").write_bytes(compiled(folder))

    return (once(LIBRARIES / f"plants-{made_of}", fill) / "library").read_bytes()


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def states_of(kind: str) -> list[str]:
    """The names of its states."""
    return [f"T[{i + 1}]" for i in range(int(kind[3:]))] if kind.startswith("rod") else NAMES.get(kind, ["x0", "x1"])


def description(
    kind: str, copyright: str = "", slopes: bool = False, lies: bool = False, extra: str = "", version: str = "2.0"
) -> str:
    """modelDescription.xml. `slopes`: it provides directional derivatives; `lies`: the first derivative depends on nothing, it says;
    `extra`: the name of one more output."""
    states = states_of(kind)
    n = len(states)
    starts = STARTS.get(kind, (20.0, 2.0) if kind.startswith("rod") else (1.5, 2.0))
    tunable, fixed = PARAMETERS.get(kind, ("k", "m") if kind.startswith("rod") else ("mu", "m"))
    rows: list[str] = []

    def add(name: str, reference: int, kind_of: str, real: str) -> None:
        rows.append(
            f'<ScalarVariable name="{name}" valueReference="{reference}" {kind_of}><Real{real}/></ScalarVariable>'
        )

    units = {"mass.r": ' unit="m"', "mass.phi": ' unit="rad"', "mass.v": ' unit="m/s"', "mass.w": ' unit="rad/s"'}
    for i, name in enumerate(states):
        add(name, i, 'causality="local" variability="continuous" initial="calculated"', units.get(name, ""))
    for i, name in enumerate(states):
        add(
            f"der({name})",
            100 + i,
            'causality="local" variability="continuous" initial="calculated"',
            f' derivative="{i + 1}"',
        )
    add(tunable, 200, 'causality="parameter" variability="tunable" initial="exact"', f' start="{starts[0]}" min="0"')
    add(fixed, 201, 'causality="parameter" variability="fixed" initial="exact"', f' start="{starts[1]}"')
    add("force", 300, 'causality="input" variability="continuous"', ' start="0"')
    calculated = 'causality="output" variability="continuous" initial="calculated"'
    for k, name in enumerate(("y", "middle", "power")):
        add(name, 400 + k, calculated, ' unit="m"' if kind == "pendulum" and k == 0 else "")
    rows.append(
        '<ScalarVariable name="count" valueReference="0" causality="parameter" variability="fixed"><Integer start="1"/></ScalarVariable>'
    )
    add("twice", 202, 'causality="calculatedParameter" variability="fixed" initial="calculated"', "")
    add("switch", 303, 'causality="input" variability="discrete"', ' start="0"')
    if extra:
        add(extra, 400, calculated, "")
    near = [" ".join(str(j + 1) for j in range(max(i - 1, 0), min(i + 2, n))) for i in range(n)]
    said = [f' dependencies="{near[i]}"' if kind.startswith("rod") and i > 0 else "" for i in range(n)]
    if lies:
        said[0] = ' dependencies=""'
    derivatives = "".join(f'<Unknown index="{n + 1 + i}"{said[i]}/>' for i in range(n))
    outputs = "".join(f'<Unknown index="{2 * n + 4 + k}"/>' for k in range(3))
    owner = f' copyright="{copyright}"' if copyright else ""
    indicators = ' numberOfEventIndicators="2"' if kind == "indicators" else ""
    provided = ' providesDirectionalDerivative="true"' if slopes else ""
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="{version}" modelName="{kind}" guid="{kind}"{indicators}{owner}>
<ModelExchange modelIdentifier="plants"{provided}{FLAGS.get(kind, "")}/>
<UnitDefinitions><Unit name="m"><BaseUnit m="1"/></Unit><Unit name="m/s"><BaseUnit m="1" s="-1"/></Unit>
<Unit name="rad"><BaseUnit rad="1"/></Unit><Unit name="rad/s"><BaseUnit rad="1" s="-1"/></Unit></UnitDefinitions>
<DefaultExperiment startTime="0" stopTime="10" stepSize="0.05"/>
<ModelVariables>
{chr(10).join(rows)}
</ModelVariables>
<ModelStructure><Outputs>{outputs}</Outputs><Derivatives>{derivatives}</Derivatives></ModelStructure>
</fmiModelDescription>
"""


def write(
    path: Path,
    library: bytes,
    kind: str,
    others: dict[str, bytes] | None = None,
    files: Sequence[tuple[str, bytes]] = (),
    folder: str = HOST,
    **choices: object,
) -> Path:
    """The FMU of this kind at `path`, its library in `folder`, with `others` as libraries of other platforms and `files` beside."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description(kind, **choices))  # type: ignore[arg-type]
        for platform, content in {folder: library, **(others or {})}.items():
            archive.writestr(
                f"binaries/{platform}/plants{PLATFORMS[platform].suffix if platform in PLATFORMS else '.so'}", content
            )
        for name, content in files:
            archive.writestr(name, content)
    return path


def van_der_pol(known: bool = False) -> Model:
    """The plant of every kind that has no equations of its own; mu is estimated, or known."""
    mu = [Variable("mu", start=1.5, nominal=1.5, min=0.0)]
    return Model(
        name="twin",
        states=[Variable("x0", start=1.0), Variable("x1", start=0.5)],
        outputs=[Variable("y")],
        inputs=[Variable("force")],
        parameters=mu if known else [],
        unknown_parameters=[] if known else mu,
        ode=lambda x, u, p, t: [x.x1, p.mu * (1 - x.x0 * x.x0) * x.x1 - x.x0 + u.force],
        output=lambda x, u, p, t: [x.x0],
    )


def pendulum() -> Model:
    """The spring pendulum, its stiffness estimated."""
    return Model(
        name="twin",
        states=[
            Variable("mass_r", unit="m", start=1.0),
            Variable("mass_phi", unit="rad", start=0.3),
            Variable("mass_v", unit="m/s"),
            Variable("mass_w", unit="rad/s"),
        ],
        outputs=[Variable("y", unit="m")],
        inputs=[Variable("force")],
        parameters=[Variable("mass_m", start=2.0, nominal=2.0)],
        unknown_parameters=[Variable("spring_c", start=40.0, nominal=40.0, min=0.0)],
        ode=lambda x, u, p, t: [
            x.mass_v,
            x.mass_w,
            x.mass_r * x.mass_w * x.mass_w
            + 9.81 * ca.cos(x.mass_phi)
            - p.spring_c / p.mass_m * (x.mass_r - 1)
            + u.force / p.mass_m,
            -(9.81 * ca.sin(x.mass_phi) + 2 * x.mass_v * x.mass_w) / x.mass_r,
        ],
        output=lambda x, u, p, t: [x.mass_r],
    )
