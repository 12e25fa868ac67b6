"""Words for what is wrong many times."""

from __future__ import annotations

import numpy as np
import pytest

from animtool.systems.springs.checks import MAX_NAMED, excerpt_numbers


@pytest.mark.parametrize(("more", "words"), [(0, ""), (1, " and 1 more")])
def test_the_first_numbers_stand_for_many(more: int, words: str) -> None:
    named = ", ".join(str(i) for i in range(MAX_NAMED))
    assert excerpt_numbers(np.arange(MAX_NAMED + more)) == named + words
