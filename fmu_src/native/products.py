"""The product of dense matrices in the C that CasADi writes: the same sums in the same order, in loops that a compiler makes vectors of."""

from __future__ import annotations

import re

# z += x y. CasADi's loops add to z in memory, a column of x after the other for each entry of z.
_CASADI = re.compile(
    r"^(?P<head>(?:static )?void casadi_mtimes_dense\([^)]*\) \{\n)(?P<body>.*?)^\}\n", re.MULTILINE | re.DOTALL
)
# Four columns of x at a time go down a column of z; of fewer than four rows, each entry's sum stays in a register.
_FAST = """\
  casadi_int i, j, k;
  if (tr || nrow_x < 4) {
    const casadi_int across = tr ? 1 : nrow_x, down = tr ? nrow_x : 1;
    const casadi_int rows = tr ? ncol_x : nrow_x, terms = tr ? nrow_x : ncol_x;
    for (i=0; i<ncol_y; ++i) {
      for (j=0; j<rows; ++j) {
        casadi_real sum = z[j + i*rows];
        for (k=0; k<terms; ++k) sum += x[j*down + k*across] * y[k + i*terms];
        z[j + i*rows] = sum;
      }
    }
    return;
  }
  for (i=0; i<ncol_y; ++i) {
    casadi_real* restrict zi = z + i*nrow_x;
    const casadi_real *a = x, *b = y + i*ncol_x;
    for (k=0; k+4<=ncol_x; k+=4, a+=4*nrow_x, b+=4) {
      const casadi_real *a1 = a + nrow_x, *a2 = a1 + nrow_x, *a3 = a2 + nrow_x;
      const casadi_real b0 = b[0], b1 = b[1], b2 = b[2], b3 = b[3];
      for (j=0; j<nrow_x; ++j) zi[j] = zi[j] + a[j]*b0 + a1[j]*b1 + a2[j]*b2 + a3[j]*b3;
    }
    for (; k<ncol_x; ++k, a+=nrow_x, ++b) {
      const casadi_real b0 = b[0];
      for (j=0; j<nrow_x; ++j) zi[j] += a[j]*b0;
    }
  }
"""


def with_fast_products(code: str) -> str:
    """CasADi's C with its product of dense matrices in other loops; without one, as it is."""
    return _CASADI.sub(lambda found: f"{found['head']}{_FAST}}}\n", code)
