"""A component becomes a PythonFMU: serialised CasADi functions and JSON in `resources/`, run by the one slave of `python_slave`.

For models that cannot be compiled, and as a check of the native FMU that shares none of its C. What stock PythonFMU lacks is completed
here: InitialUnknowns and units (the model description is the native one's), a fixed GUID and archive, module names of the FMU's own, and
by `relay/` fmi2Error where PythonFMU knows only fmi2Fatal.
"""

from __future__ import annotations

import ast
import dataclasses
import hashlib
import json
import re
import tempfile
from collections.abc import Sequence
from importlib.metadata import files as files_of
from importlib.resources import files
from pathlib import Path

import casadi as ca

from fmu_src.errors import ExportError
from fmu_src.native.compiler import compile_library
from fmu_src.native.sources import FMI_HEADERS
from fmu_src.platforms import PLATFORMS
from fmu_src.python.slave import PORTS
from observers.component import Component

# By platform: the library in the pythonfmu package, and what the relay in front of it is linked with.
LIBRARIES = {
    "linux64": ("linux64/libpythonfmu-export.so", ("-ldl",)),
    "win64": ("win64/pythonfmu-export.dll", ()),
}
# Attributes of CoSimulation that differ from the native FMU's.
CAPABILITIES = {
    "needsExecutionTool": "true",  # a Python with casadi and numpy
    "canNotUseMemoryManagementFunctions": "true",  # the memory is Python's
}
# The component's attributes that are neither ports nor functions.
PLAIN = (
    "name",
    "description",
    "sample_time",
    "samples_inputs",
    "breaks",
    "max_step",
    "stop_time",
    "step_size",
    "counters",
    "documentation",
)


def resources(component: Component) -> dict[str, bytes]:
    """What the slave reads and imports, by path in the FMU: modules, functions, and the rest of the component as JSON.

    Raises:
        ExportError: a function that CasADi cannot serialise and read back, such as a Callback.
    """
    modules = _modules()
    slave = next(name for name in modules if name.startswith("slave_"))
    return {
        **{f"resources/{name}": content for name, content in modules.items()},
        **{f"resources/{name}.casadi": _serialised(component, name) for name in component.functions},
        "resources/component.json": _fields(component),
        "resources/slavemodule.txt": slave.removesuffix(".py").encode(),
    }


def _fields(component: Component) -> bytes:
    fields = {name: getattr(component, name) for name in PLAIN}
    fields["failures"] = [dataclasses.asdict(failure) for failure in component.failures]
    fields |= {group: [dataclasses.asdict(port) for port in getattr(component, group)] for group in PORTS}
    return json.dumps(fields, indent=1).encode()


def _serialised(component: Component, name: str) -> bytes:
    try:
        text: str = component.functions[name].serialize()
        ca.Function.deserialize(text)
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise ExportError(
            f"component '{component.name}': CasADi cannot serialise the function '{name}': {reason}"
        ) from None
    return text.encode()


def _modules() -> dict[str, bytes]:
    """PythonFMU's modules, the slave, and what it imports of `observers`, under names that no other version has."""
    own = _observers()
    slave = (files("fmu_src.python") / "slave.py").read_text()
    digest = hashlib.sha256("".join([slave, *own.values()]).encode()).hexdigest()[:16]
    package = f"observers_{digest}"
    renamed = {f"{package}/{path}": text for path, text in own.items()} | {f"slave_{digest}.py": slave}
    found = {name: re.sub(r"^from observers\b", f"from {package}", text, flags=re.M) for name, text in renamed.items()}
    pythonfmu = {f"pythonfmu/{p.name}": p.read_text() for p in files("pythonfmu").iterdir() if p.name.endswith(".py")}
    return {name: text.encode() for name, text in (found | pythonfmu).items()}


def _observers() -> dict[str, str]:
    """By path in the package: the modules of `observers` that the slave imports, and those that these import."""
    found: dict[str, str] = {}
    waiting = [(files("fmu_src.python") / "slave.py").read_text()]
    while waiting:
        for node in ast.walk(ast.parse(waiting.pop())):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("observers."):
                path = "/".join(node.module.split(".")[1:]) + ".py"
                if path not in found:
                    found[path] = (files("observers") / path).read_text()
                    waiting.append(found[path])
    return found


def relay(component: Component, guid: str) -> dict[str, bytes]:
    """The C sources of the relay, which knows the FMU's name, GUID and inputs; by file name."""
    fixed = {entry.name: entry.read_bytes() for entry in (files("fmu_src.python") / "relay").iterdir()}
    headers = {name: (files("fmpy") / "c-code" / name).read_bytes() for name in FMI_HEADERS}
    # Those that have derivatives: a null pointer stands for the others.
    names = "".join(f"{json.dumps(port.name) if port.kind == 'Real' else 'NULL'}, " for port in component.inputs)
    named = f"#define MODEL {json.dumps(component.name)}\n#define GUID {json.dumps(guid)}\n#define INPUTS {names}\n"
    return {**fixed, **headers, "identity.h": named.encode()}


def binaries(component: Component, guid: str, platforms: Sequence[str]) -> dict[str, bytes]:
    """By path in the FMU: for each platform the relay under the model's name, and PythonFMU's library beside it.

    Raises:
        ExportError: a platform for which PythonFMU has no library; the compiler refused.
    """
    found: dict[str, bytes] = {}
    for platform in platforms:
        if platform not in LIBRARIES:
            raise ExportError(f"PythonFMU has no library for {platform}; it has {', '.join(LIBRARIES)}")
        library, linked = LIBRARIES[platform]
        with tempfile.TemporaryDirectory() as scratch:
            for name, content in relay(component, guid).items():
                (Path(scratch) / name).write_bytes(content)
            made = compile_library(component.name, Path(scratch), platform, linked)
        found[f"binaries/{platform}/{component.name}{PLATFORMS[platform].suffix}"] = made
        stock = files("pythonfmu") / "resources" / "binaries" / library
        found[f"binaries/{platform}/{library.split('/')[1]}"] = stock.read_bytes()
    return found


def license_text() -> bytes:
    """The licence of PythonFMU, whose modules and library travel in the FMU."""
    return next(f for f in files_of("pythonfmu") or () if f.name == "LICENSE").read_binary()
