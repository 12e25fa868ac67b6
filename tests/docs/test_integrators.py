"""The tables of integrators are what they measure, times apart."""

from __future__ import annotations

import re

import pytest
from support.integrator_tables import PAGE, errors, listed, properties

from animtool.sim import INTEGRATORS

TEXT = PAGE.read_text("utf-8")
AGAIN = "run tests/support/integrator_tables.py"


def test_what_methods_are() -> None:
    assert listed(TEXT, "properties") == properties(), AGAIN


@pytest.mark.slow(0.5)
def test_their_errors_and_what_these_take(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("support.integrator_tables.RUNS", 0)
    said, found = listed(TEXT, "errors"), errors()
    assert said[0] == found[0], AGAIN
    for old, new in zip(said[1:], found[1:], strict=True):
        assert old[0] == new[0]
        for i in (1, 4):
            assert old[i] == new[i] or float(old[i]) == pytest.approx(
                float(new[i]), rel=0.5
            ), (old[0], AGAIN)
            assert int(old[i + 1]) == pytest.approx(int(new[i + 1]), rel=0.1), AGAIN


def test_every_integrator_is_spoken_of() -> None:
    chapter = TEXT.split("\n## ")[0]
    advice = chapter.split("<!-- integrators: properties -->")[0]
    named = set(re.findall(r"`(\w+)`", advice))
    assert set(INTEGRATORS) <= named
