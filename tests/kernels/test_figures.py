"""Figures of what kernels make of irregular numbers, as `test_portable` has them."""

from __future__ import annotations

import numpy as np
import pytest
from kernels import test_portable as portable
from support.figures import check_figures

KINDS = ("springs", "strands", "skins", "flocks", "fluids", "bodies", "molecules")


@pytest.mark.parametrize("kind", KINDS)
def test_kernels(kind: str) -> None:
    made = getattr(portable, kind)(np.random.default_rng(4))
    check_figures(__file__, kind, made)
