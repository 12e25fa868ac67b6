"""How much memory a process holds."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from support.sanitized import SANITIZED

from animtool.scene import stats
from animtool.scene.stats import PeakMemory

SIZE = 64_000_000


def test_nothing_is_known_before_it_begins() -> None:
    assert PeakMemory().taken() is None


@pytest.mark.skipif(sys.platform != "linux", reason="/proc")
@pytest.mark.skipif(SANITIZED, reason="sanitizers keep memory")
def test_each_peak_is_one_since_the_last() -> None:
    peak = PeakMemory()
    peak.begin()
    for _ in range(2):
        np.ones(SIZE // 8)
        assert (peak.taken() or 0) > 0.9 * SIZE
        assert (peak.taken() or 0) < 0.5 * SIZE


@pytest.mark.skipif(sys.platform == "win32", reason="no resource")
def test_systems_without_a_peak_of_their_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(stats, "_STATUS", str(tmp_path / "none"))
    peak = PeakMemory()
    peak.begin()
    assert (peak.base or 0) > 1_000_000
    assert (peak.taken() or 0) >= 0
    (tmp_path / "none").write_text("Name: python\n")
    assert peak.taken() is not None
    monkeypatch.setattr(sys, "platform", "win32")
    assert peak.taken() is None
