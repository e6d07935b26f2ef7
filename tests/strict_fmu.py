"""FMUs of strict/strict.c: what each declares is the test's choice."""

from __future__ import annotations

import zipfile
from pathlib import Path

from fmu_src.native.compiler import compile_library
from fmu_src.native.sources import FMI_HEADERS, fixed_sources
from fmu_src.platforms import PLATFORMS, resolve

HOST = resolve(["host"])[0]
SOURCES = Path(__file__).parent / "strict"
# By their numbers, from 0: values of the parameter `failure`.
FAILURES = (
    "none",
    "exit",
    "crash",
    "endless",
    "pending_for_ever",
    "pending_once",
    "abort_at_get",
    "set_for_ever",
    "noise",
    "report_tolerance",
    "garble",
    "lose",
    "log_for_ever",
    "obey_me",
    "read_stdin",
)
UNITS = {
    "m": '<BaseUnit m="1"/>',
    "km": '<BaseUnit m="1" factor="1000"/>',
    "s": '<BaseUnit s="1"/>',
    "K": '<BaseUnit K="1"/>',
    "degC": '<BaseUnit K="1" offset="273.15"/>',
    "degF": '<BaseUnit K="1" factor="0.5555555555555556" offset="255.3722222222222"/>',
}


def compiled(folder: Path, name: str = "strict") -> bytes:
    """The library of strict/<name>.c, built in `folder`."""
    for file in (f"{name}.c", "absent.h"):
        (folder / file).write_text((SOURCES / file).read_text())
    for header in FMI_HEADERS:
        (folder / header).write_bytes(fixed_sources()[header])
    return compile_library(name, folder, HOST)


def description(
    unit_in: str = "",
    unit_out: str = "",
    dependencies: bool = True,
    tolerance: float | None = None,
    static: bool = False,
) -> str:
    """modelDescription.xml: `dependencies`, whether those of the outputs are declared; `static`, as our own FMUs say it."""

    def real(name: str, reference: int, attributes: str, unit: str, start: str = "") -> str:
        unit = f' unit="{unit}"' if unit else ""
        return f'<ScalarVariable name="{name}" valueReference="{reference}" {attributes}><Real{unit}{start}/></ScalarVariable>'

    fixed = 'causality="parameter" variability="fixed"'
    discrete = 'causality="input" variability="discrete"'
    calculated = 'causality="output" initial="calculated"'
    units = "".join(f'<Unit name="{name}">{base}</Unit>' for name, base in UNITS.items())
    items = '<Item name="{}" value="1"/><Item name="{}" value="2"/>'
    # Names, and the place among the variables (from 1) of the input that each output follows.
    outputs = {2: 1, 6: 5, 9: 8, 11: 10}
    unknowns = "".join(
        f'<Unknown index="{o}"' + (f' dependencies="{i}"' if dependencies else "") + "/>" for o, i in outputs.items()
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="strict" guid="{{strict}}">
<CoSimulation modelIdentifier="strict" canHandleVariableCommunicationStepSize="true"/>
<UnitDefinitions>{units}</UnitDefinitions>
<TypeDefinitions>
<SimpleType name="In"><Enumeration>{items.format("off", "on")}</Enumeration></SimpleType>
<SimpleType name="Out"><Enumeration>{items.format("shut", "open")}</Enumeration></SimpleType>
</TypeDefinitions>
<DefaultExperiment stopTime="1" stepSize="0.1"{f' tolerance="{tolerance}"' if tolerance else ""}/>
{'<VendorAnnotations><Tool name="observer-fmus"><Static/></Tool></VendorAnnotations>' if static else ""}
<ModelVariables>
{real("u", 0, 'causality="input"', unit_in, ' start="0"')}
{real("y", 1, calculated, unit_out)}
{real("gain", 2, fixed, "", ' start="1"')}
{real("fail_time", 3, fixed, "s", ' start="0"')}
<ScalarVariable name="n" valueReference="0" {discrete}><Integer start="0"/></ScalarVariable>
<ScalarVariable name="m" valueReference="1" {calculated} variability="discrete"><Integer/></ScalarVariable>
<ScalarVariable name="failure" valueReference="2" {fixed}><Integer start="0"/></ScalarVariable>
<ScalarVariable name="e" valueReference="3" {discrete}><Enumeration declaredType="In" start="1"/></ScalarVariable>
<ScalarVariable name="f" valueReference="4" {calculated} variability="discrete"><Enumeration declaredType="Out"/></ScalarVariable>
<ScalarVariable name="b" valueReference="0" {discrete}><Boolean start="false"/></ScalarVariable>
<ScalarVariable name="c" valueReference="1" {calculated} variability="discrete"><Boolean/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs>{unknowns}</Outputs></ModelStructure>
</fmiModelDescription>
"""


def write(path: Path, library: bytes, **choices: object) -> Path:
    """The FMU at `path` with the `description` of these choices."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description(**choices))  # type: ignore[arg-type]
        archive.writestr(f"binaries/{HOST}/strict{PLATFORMS[HOST].suffix}", library)
    return path
