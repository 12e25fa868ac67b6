"""Data files from ``$ANIMTOOL_DATA``, as parameters of tests."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest


def data_files(folder: str, pattern: str) -> list[Any]:
    """Return a parameter a file; one that skips, and says why, where there is none."""
    root = os.environ.get("ANIMTOOL_DATA")
    if not root:
        return [_skipped("ANIMTOOL_DATA is not set")]
    found = sorted(Path(root, folder).resolve().glob(pattern))
    if not found:
        return [_skipped(f"no {pattern} in ANIMTOOL_DATA/{folder}")]
    return [pytest.param(path, id=path.name) for path in found]


def _skipped(reason: str) -> Any:
    return pytest.param(None, marks=pytest.mark.skip(reason=reason), id="no-data")
