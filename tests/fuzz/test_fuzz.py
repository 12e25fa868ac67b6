"""Some cases of each target, in every run of the tests."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from support.suite import examples, some_quick

from fuzz.engine import fuzz, targets

CASES = 30


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="a case is contained by a fork")
@pytest.mark.parametrize("name", some_quick(targets(), 4))
def test_spoiled_inputs_end_in_a_result_or_a_typed_error(name: str) -> None:
    cases = examples(CASES)
    outcome = fuzz(name, cases)
    assert outcome.findings == {}
    assert outcome.words.total() == cases


def test_the_table_names_each_target() -> None:
    text = Path(__file__).with_name("README.md").read_text("utf-8")
    assert re.findall(r"^\| `(\w+)`", text, re.MULTILINE) == targets()
