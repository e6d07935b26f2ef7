"""An observer from sample to sample as one compiled function: jump, then flow to the next sample instant, then output."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import casadi as ca
import numpy as np

from cosim.whole import whole
from fmu_src.native.compiler import cache_folder, compile_library
from fmu_src.plant.guest import Guest, guest_of, libraries
from fmu_src.platforms import PLATFORMS, resolve
from observers.component import Component

Sample = Callable[..., tuple[np.ndarray, np.ndarray]]  # (z, u, p, t) -> (z, y)


def sampled(component: Component, sample_time: float, linear: bool = False) -> Sample:
    """(z, u, p, t) -> (z, y) after a step of one sample time [s] from the sample instant t.

    `linear`: u holds the inputs, then by how much they change a second, and they follow that line.

    The same functions in the same order as `observers.instance.Instance` calls them, compiled: the interpreter takes 20 to 100 times as
    long.
    """
    function = _one_function(component, sample_time, linear)
    guest = guest_of(component)
    library = _library(function, guest)
    if guest:
        guest.tell(library)
    compiled = ca.external("sample", str(library))
    made: tuple[Any, Callable[[], None]] = compiled.buffer()
    buffer, evaluate = made
    arguments = [np.zeros(function.numel_in(i)) for i in range(4)]
    results = [np.zeros(function.numel_out(i)) for i in range(2)]
    for i, argument in enumerate(arguments):
        buffer.set_arg(i, argument.data)
    for i, result in enumerate(results):
        buffer.set_res(i, result.data)

    def call(*values: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        for argument, value in zip(arguments, values, strict=True):
            argument[...] = value
        evaluate()
        if buffer.ret() != 0:
            raise ArithmeticError(f"'{compiled.name()}' could not be evaluated")  # and the library stays loaded
        return results[0].copy(), results[1].copy()

    return call


def _one_function(component: Component, sample_time: float, linear: bool) -> ca.Function:
    n = len(component.inputs)
    z, u = ca.MX.sym("z", component.n_z), ca.MX.sym("u", 2 * n if linear else n)
    now, slope = (u[:n], u[n:]) if linear else (u, ca.DM.zeros(n))
    p, t = ca.MX.sym("p", len(component.parameters)), ca.MX.sym("t")
    substeps = max(1, math.ceil(sample_time / component.max_step - 1e-6))
    h, moved = sample_time / substeps, z
    if component.jump is not None:
        moved = component.jump(z, now, p, t)
    for i in range(substeps):
        if not linear:
            moved = component.flow(moved, now, p, t + i * h, h)
            continue
        for begin, held in ((0.0, h / 6), (h / 2, 5 * h / 6)):  # as an Instance treats inputs that change
            moved = component.flow(moved, now + slope * (i * h + held), p, t + i * h + begin, h / 2)
    shown = component.output(moved, now + slope * sample_time, p, t + sample_time)
    return ca.Function("sample", [z, u, p, t], [moved, shown])


def _library(function: ca.Function, guest: Guest | None) -> Path:
    """The compiled function, with the plant that it asks; one whose C is known is not compiled again."""
    platform = resolve(["host"])[0]
    with TemporaryDirectory() as scratch:
        generator = ca.CodeGenerator("sample.c")
        generator.add(function)
        source = Path(generator.generate(f"{scratch}/"))
        digest = hashlib.sha256(source.read_bytes())
        for name, content in sorted(guest.sources.items()) if guest else ():
            (Path(scratch) / name).write_bytes(content)
            digest.update(content)
        folder = cache_folder().with_name("samples")
        library = folder / f"{digest.hexdigest()[:24]}{PLATFORMS[platform].suffix}"
        if not library.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            flags = ("-O1", "-w", "-fvisibility=default")
            made = compile_library("sample", Path(scratch), platform, libraries(platform), flags)
            with whole(library) as unfinished:
                unfinished.write_bytes(made)
    return library
