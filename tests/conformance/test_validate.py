"""What `validate` says of real files: no error in good ones, one in bad ones."""

from __future__ import annotations

import json
from collections import Counter
from functools import cache
from pathlib import Path

import pytest
from support.data import data_files
from support.suite import some_quick

from animtool.core.errors import Severity
from animtool.validation.run import validate

NOTE = Severity.NOTE
# Captures have glitches of their own: no code warns of more than this share of them.
LARGEST_SHARE = 0.25
RARE_SHARE = 0.15


@cache
def severities(path: Path) -> dict[str, Severity]:
    """Return the codes found in a file, with how severe each is."""
    return {fault.code: fault.severity for fault in validate(path)}


@pytest.mark.parametrize("path", some_quick(data_files("bvh", "*.bvh"), 3))
def test_good_captures(path: Path) -> None:
    found = severities(path)
    assert Severity.ERROR not in found.values()
    warnings = [code for code, severity in found.items() if severity is not NOTE]
    assert len(warnings) <= 2


@pytest.mark.slow
def test_few_captures_have_the_same_warning() -> None:
    paths = [p.values[0] for p in data_files("bvh", "*.bvh") if not p.marks]
    if not paths:
        pytest.skip("no captures in ANIMTOOL_DATA")
    often = Counter(
        code
        for path in paths
        for code, severity in severities(path).items()
        if severity is not NOTE
    )
    assert max(often.values(), default=0) <= LARGEST_SHARE * len(paths)
    # What good captures hardly have, though one or another may.
    rare = {"MOT205", "MOT206", "MOT208", "MOT209", "MOT210", "MOT213"}
    assert max(often[code] for code in rare) <= max(1, RARE_SHARE * len(paths))


@pytest.mark.parametrize("path", data_files("bvh_hard", "*.bvh"))
def test_hard_captures(path: Path) -> None:
    cases = json.loads(path.with_name("expected.json").read_text("utf-8"))
    if path.name not in cases:
        pytest.skip(f"expected.json says nothing of {path.name}")
    severities = {fault.severity for fault in validate(path)}
    outcome = cases[path.name]["outcome"]
    assert (Severity.ERROR in severities) == (outcome == "error")
    if outcome != "error":
        assert (Severity.WARNING in severities) == (outcome == "warn")
