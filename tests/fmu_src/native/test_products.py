"""The product of dense matrices in the FMUs' C: other loops than CasADi's, the same bits."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from benchmarks.compiler import compile_c
from fmu_src.native.products import with_fast_products

SHAPES = ((1, 7, 1), (2, 5, 3), (3, 3, 3), (4, 4, 4), (5, 9, 2), (8, 1, 6), (11, 6, 5))


def summed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """x y, each entry's terms added one after the other."""
    z = np.zeros((x.shape[0], y.shape[1]))
    for k in range(x.shape[1]):
        z = z + np.outer(x[:, k], y[k, :])
    return z


def test_the_product_of_any_shape_is_the_sum_in_casadis_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    symbols = [(ca.MX.sym("x", n, k), ca.MX.sym("y", k, m)) for n, k, m in SHAPES]
    values = [(rng.normal(size=(n, k)), rng.normal(size=(k, m))) for n, k, m in SHAPES]
    products = ca.Function("products", [s for pair in symbols for s in pair], [ca.densify(x @ y) for x, y in symbols])
    monkeypatch.chdir(tmp_path)
    code = ca.CodeGenerator("products")
    code.add(products)
    given = code.dump()
    assert "casadi_mtimes_dense(" in given
    fast = with_fast_products(given)
    assert "restrict" in fast and "z[j + i*nrow_x] += x[j + k*nrow_x]" not in fast
    (tmp_path / "products.c").write_text(fast)
    compile_c(
        [tmp_path / "products.c"],
        tmp_path / "products.so",
        "-shared",
        "-lm",
        "-Wno-unused-parameter",
        "-fvisibility=default",
    )
    compiled = ca.external("products", str(tmp_path / "products.so"))
    found = compiled(*[value for pair in values for value in pair])
    for result, (x, y) in zip(found, values, strict=True):
        assert np.array_equal(result.full(), summed(x, y))
