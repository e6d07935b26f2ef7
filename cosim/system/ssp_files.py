"""The files in an .ssp file: XML of SSP 1.0, found in the zip, checked against SSP's schemas."""

from __future__ import annotations

import posixpath
import re
import zipfile
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from urllib.parse import unquote

import fmpy
from lxml import etree

from cosim.archive import LARGEST, parsed
from cosim.errors import SystemFileError, suggest

SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"
SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
SSM = "http://ssp-standard.org/SSP1/SystemStructureParameterMapping"
OSP = "http://opensimulationplatform.com/SSP/OSPAnnotations"
NAMESPACES = {"ssd": SSD, "ssc": SSC, "ssv": SSV, "ssm": SSM, "osp": OSP}
STRUCTURE = "SystemStructure.ssd"
OSP_ANNOTATION = "com.opensimulationplatform"

# The first tag, if its prefix is one of ours.
_ROOT = re.compile(rb"<(?P<name>(?P<prefix>ssd|ssv|ssm):\w+)[^>]*>")
DEEPEST = 16  # systems in systems: a file that holds itself never ends otherwise
MOST_ELEMENTS = 100_000  # systems that hold others several times multiply


@dataclass
class Package:
    """An opened .ssp file, and what reading it has used up.

    Attributes:
        archive: the open file.
        label: how messages call it.
        directory: where its FMUs are written.
        depth: how many .ssp files it lies in.
        inflated: bytes written so far, by it and by what it lies in: one list for all.
        elements: elements read so far, likewise.
        written: the members in the directory.
    """

    archive: zipfile.ZipFile
    label: str
    directory: Path
    depth: int = 0
    inflated: list[int] = field(default_factory=lambda: [0])
    elements: list[int] = field(default_factory=lambda: [0])
    written: dict[str, Path] = field(default_factory=dict)

    def member(self, source: str, base: str = "") -> str:
        """The archive's member that a URI relative to the file `base` means.

        Raises:
            SystemFileError: there is none.
        """
        member = posixpath.normpath(posixpath.join(posixpath.dirname(base), unquote(source)))
        if member not in self.archive.NameToInfo:
            raise SystemFileError(f"{self.label}: '{source}' is not in it; {suggest(member, self.archive.namelist())}")
        return member

    def xml(self, member: str, schema: str) -> etree._Element:
        """The root of an XML file that is valid by `schema`.

        Raises:
            SystemFileError: there is no such member, or it is no such file (with its line).
        """
        root = parsed(self.archive, member, self.label, _declared)
        validate(root, schema, f"{self.label}: {member}")
        return root

    def extract(self, member: str) -> Path:
        """Write a member into the directory, the first time that it is asked for.

        Raises:
            SystemFileError: this file and those that it lies in would inflate beyond the limit.
        """
        if member in self.written:
            return self.written[member]
        self.inflated[0] += self.archive.getinfo(member).file_size
        if self.inflated[0] > LARGEST:
            raise SystemFileError(
                f"{self.label}: more than {LARGEST / 2**30:g} GiB when inflated, the most that is unpacked"
            )
        self.written[member] = Path(self.archive.extract(member, self.directory))
        return self.written[member]


def validate(element: etree._Element, schema: str, where: str) -> None:
    """Check `element` against one of SSP's schemas, such as "SystemStructureDescription".

    Files of SSP 2.0 use the same namespaces: what they have of SSP 1.0 is read, what SSP 1.0 does not know is refused.

    Raises:
        SystemFileError: it is invalid; the message names `where` and the line.
    """
    later = element.get("version", "").startswith("2.")
    if later:
        element.set("version", "1.0")
    checker = _schema(schema)
    if not checker.validate(element):
        problem = checker.error_log[0]
        reason = problem.message
        for namespace in NAMESPACES.values():
            reason = reason.replace(f"{{{namespace}}}", "")
        more = " (the file is of SSP 2.0: only what SSP 1.0 has, too, is supported)" if later else ""
        raise SystemFileError(f"{where}, line {problem.line}: {reason}{more}")


def _declared(text: bytes) -> bytes:
    """The text of a file whose root has a prefix of SSP that it does not declare, as in parameter sets of Ecos's demonstrations."""
    root = _ROOT.search(text)
    if root is None or f"xmlns:{root['prefix'].decode()}".encode() in root[0]:
        return text
    at, namespace = root.end("name"), NAMESPACES[root["prefix"].decode()]
    return text[:at] + f' xmlns:{root["prefix"].decode()}="{namespace}"'.encode() + text[at:]


@cache
def _schema(name: str) -> etree.XMLSchema:
    return etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "ssp" / "schema" / f"{name}.xsd"))
