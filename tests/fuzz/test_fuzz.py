"""Some cases of each target, in every run of the tests."""

from __future__ import annotations

import os

import pytest

from fuzz.engine import fuzz, targets

CASES = 100


@pytest.mark.skipif(os.name == "nt", reason="a case is contained by a fork")
@pytest.mark.parametrize("name", targets())
def test_spoiled_inputs_end_in_a_result_or_a_typed_error(name: str) -> None:
    outcome = fuzz(name, CASES)
    assert outcome.findings == {}
    assert outcome.words.total() == CASES
