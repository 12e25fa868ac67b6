from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from faults.calls import Children, small_children


@pytest.fixture(scope="module")
def children() -> Iterator[Children]:
    """Return what does work in processes of their own."""
    with small_children() as found:
        yield found


@pytest.fixture
def disk() -> Iterator[Path]:
    """Return a folder that anybody may enter, in memory where there is such a disk."""
    memory = Path("/dev/shm")
    usable = memory.is_dir() and os.access(memory, os.W_OK)
    with TemporaryDirectory(dir=memory if usable else None) as name:
        folder = Path(name)
        folder.chmod(0o755)
        yield folder
