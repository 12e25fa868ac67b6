"""Functions φ of matrices against the exponential of a larger one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

from animtool.maths.phi import phi_functions


@pytest.mark.parametrize("size", [0.0, 1e-3, 0.1, 1.0, 30.0, 1e3])
def test_they_are_blocks_of_an_exponential(size: float) -> None:
    rng = np.random.default_rng(1)
    roots = rng.normal(size=(4, 6, 6))
    matrices = -size * roots @ roots.swapaxes(1, 2) / 6
    matrices[3] = matrices[0]
    one, two = phi_functions(matrices)
    for k, matrix in enumerate(matrices):
        whole = np.zeros((18, 18))
        whole[:6, :6], whole[:6, 6:12], whole[6:12, 12:] = matrix, np.eye(6), np.eye(6)
        blocks = expm(whole)
        assert_allclose(one[k], blocks[:6, 6:12], rtol=0, atol=1e-11)
        assert_allclose(two[k], blocks[:6, 12:], rtol=0, atol=1e-11)
    np.testing.assert_array_equal(one[3], one[0])
