"""SSP files written by hand, as other tools make them."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

from cosim.system.ssp_files import NAMESPACES

ROOT = " ".join(f'xmlns:{prefix}="{namespace}"' for prefix, namespace in NAMESPACES.items())
UNITS = """<ssd:Units>
<ssc:Unit name="m"><ssc:BaseUnit m="1"/></ssc:Unit>
<ssc:Unit name="km"><ssc:BaseUnit m="1" factor="1000"/></ssc:Unit>
<ssc:Unit name="s"><ssc:BaseUnit s="1"/></ssc:Unit>
<ssc:Unit name="degC"><ssc:BaseUnit K="1" offset="273.15"/></ssc:Unit>
</ssd:Units>"""


def ssd(content: str, more: str = UNITS, version: str = "1.0", attributes: str = "") -> str:
    """An .ssd file whose system holds `content`; 1 s in steps of 0.1 s."""
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription {ROOT} version="{version}" name="foreign">
<ssd:System name="top" {attributes}>{content}</ssd:System>{more}
<ssd:DefaultExperiment startTime="0" stopTime="1"><ssd:Annotations><ssc:Annotation type="com.opensimulationplatform">
<osp:Algorithm><osp:FixedStepAlgorithm baseStepSize="0.1"/></osp:Algorithm></ssc:Annotation></ssd:Annotations>
</ssd:DefaultExperiment></ssd:SystemStructureDescription>"""


def system(elements: str, connections: str = "", connectors: str = "", bindings: str = "") -> str:
    """What a System holds: the contents of its four elements."""
    return (
        (f"<ssd:Connectors>{connectors}</ssd:Connectors>" if connectors else "")
        + (f"<ssd:ParameterBindings>{bindings}</ssd:ParameterBindings>" if bindings else "")
        + f"<ssd:Elements>{elements}</ssd:Elements>"
        + (f"<ssd:Connections>{connections}</ssd:Connections>" if connections else "")
    )


def component(name: str, fmu: str, connectors: str = "", bindings: str = "", kind: str = "") -> str:
    """A Component; `connectors` and `bindings` are what their elements hold."""
    kind = f' type="{kind}"' if kind else ""
    return (
        f'<ssd:Component name="{name}" source="resources/{fmu}"{kind}>'
        + (f"<ssd:Connectors>{connectors}</ssd:Connectors>" if connectors else "")
        + (f"<ssd:ParameterBindings>{bindings}</ssd:ParameterBindings>" if bindings else "")
        + "</ssd:Component>"
    )


def connector(name: str, kind: str, typed: str = "<ssc:Real/>") -> str:
    return f'<ssd:Connector name="{name}" kind="{kind}">{typed}</ssd:Connector>'


def connection(start: str, end: str, inside: str = "", attributes: str = "") -> str:
    """A Connection; ends are `element.connector`, or the name of a connector of the system."""
    ends = ""
    for side, path in (("start", start), ("end", end)):
        element, dot, name = path.rpartition(".")
        ends += (f' {side}Element="{element}"' if dot else "") + f' {side}Connector="{name}"'
    return f"<ssd:Connection{ends} {attributes}>{inside}</ssd:Connection>"


def binding(parameters: Mapping[str, str], units: str = "", mapping: str = "", attributes: str = "") -> str:
    """A ParameterBinding with an inline set; the values are elements such as `<ssv:Real value="1"/>`."""
    values = f"<ssd:ParameterValues>{parameter_set(parameters, units)}</ssd:ParameterValues>"
    return f"<ssd:ParameterBinding {attributes}>{values}{mapping}</ssd:ParameterBinding>"


def parameter_set(parameters: Mapping[str, str], units: str = "", version: str = "1.0") -> str:
    inside = "".join(f'<ssv:Parameter name="{name}">{value}</ssv:Parameter>' for name, value in parameters.items())
    return (
        f'<ssv:ParameterSet {ROOT} version="{version}" name="initialValues">'
        f"<ssv:Parameters>{inside}</ssv:Parameters>{units}</ssv:ParameterSet>"
    )


def mapped(kind: str, source: str, target: str) -> str:
    """A transformation of the given kind, "Integer", "Boolean" or "Enumeration", with one entry."""
    return f'<ssc:{kind}MappingTransformation><ssc:MapEntry source="{source}" target="{target}"/></ssc:{kind}MappingTransformation>'


def pack(path: Path, structure: str, fmus: Mapping[str, Path], more: Mapping[str, str | bytes] | None = None) -> Path:
    """The .ssp file at `path`."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", structure)
        for name, fmu in fmus.items():
            archive.write(fmu, f"resources/{name}")
        for name, content in (more or {}).items():
            archive.writestr(name, content)
    return path
