"""Each kernel has arguments to be fuzzed with, and these are valid."""

from __future__ import annotations

import numpy as np
import pytest

from fuzz.kernels import exported, makers
from fuzz.targets.kernels import call


def test_every_kernel_is_fuzzed() -> None:
    assert exported() == set(makers())


@pytest.mark.parametrize("name", sorted(makers()))
def test_arguments_made_are_valid(name: str) -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        call(name, makers()[name](rng))
