from __future__ import annotations

import shutil
from pathlib import Path

import pytest


@pytest.fixture
def workplace(root: Path, tmp_path: Path) -> Path:
    """Return a project with the samples and the rigs that they name."""
    for name in ("samples", "rigs"):
        shutil.copytree(root / name, tmp_path / name)
    (tmp_path / "animtool.toml").touch()
    return tmp_path
