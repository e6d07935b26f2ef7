"""How long the compliance check takes by the number of variables: `python -m benchmarks.compliance`."""

from __future__ import annotations

import tempfile
import time
import zipfile
from pathlib import Path

from lxml import etree

from fmu_src import export
from fmu_src.compliance.check import check
from reference_models.duffing import DUFFING
from reference_models.plant import plant

SIZES = (0, 20_000, 100_000)


def enlarged(fmu: Path, count: int, path: Path) -> Path:
    """The FMU with `count` local variables more, all aliases of its first output, with structured names."""
    with zipfile.ZipFile(fmu) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    root = etree.fromstring(contents["modelDescription.xml"])
    variables = root.find("ModelVariables")
    assert variables is not None
    output = next(variable for variable in variables if variable.get("causality") == "output")
    unit = output[0].get("unit")
    for i in range(count):
        name = f"section{i // 1000}.cell[{i // 10 % 100},{i % 10}].temperature"
        alias = etree.SubElement(
            variables, "ScalarVariable", name=name, valueReference=output.get("valueReference", ""), causality="local"
        )
        alias.set("variability", output.get("variability", "continuous"))
        etree.SubElement(alias, output[0].tag, {"unit": unit} if unit else {})
    contents["modelDescription.xml"] = etree.tostring(root, xml_declaration=True, encoding="UTF-8")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(name, content)
    return path


def main() -> None:
    print("further variables   time [s]   findings")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        fmu = export(plant(DUFFING), folder)
        for count in SIZES:
            path = enlarged(fmu, count, folder / f"{count}.fmu")
            begin = time.perf_counter()
            report = check(path)
            print(f"{count:17d} {time.perf_counter() - begin:10.1f} {len(report.findings):10d}")


if __name__ == "__main__":
    main()
