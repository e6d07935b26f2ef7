"""Constants in ball arithmetic: right to the last bit, and refused where they would not be."""

import os
import subprocess
import sys

import numpy as np
import pytest
from flint import arb

from observers.numerics.exact import product, rounded

CONSTANTS = """
import hashlib
from observers.pseudospectral.window import lgl
from observers.pseudospectral.window.collocation import segment
from observers.numerics.semilinear import split
from reference_models.duffing import DUFFING
eq = DUFFING.equations
w = segment(split(eq.ode, eq.x, eq.u), 15, 8, 0.1)
print(hashlib.sha256(b"".join(part.tobytes() for part in (*w.at(w.node_times), *w.node0, lgl.weights(15)))).hexdigest())
"""


def test_a_product_is_rounded_once():
    a, b = np.array([[1e16, 1.0, -1e16]]), np.ones((3, 1))
    assert product(a, b)[0, 0] == 1.0  # left to right in doubles gives 0
    assert product(np.zeros((0, 3)), b).shape == (0, 1)


def test_constants_that_are_lost_to_ill_conditioning_are_refused():
    with pytest.raises(ValueError, match="lost to ill-conditioning"):
        rounded(np.array([arb(1.0, 1e-12)], dtype=object))


def test_the_constants_do_not_depend_on_the_machines_linear_algebra():
    found = set()
    for core in ("Nehalem", "Sandybridge", "Haswell"):
        environment = {**os.environ, "OPENBLAS_CORETYPE": core}
        run = subprocess.run(
            [sys.executable, "-c", CONSTANTS], env=environment, capture_output=True, text=True, check=True
        )
        found.add(run.stdout)
    assert len(found) == 1
