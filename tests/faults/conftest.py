from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest


@pytest.fixture
def disk() -> Iterator[Path]:
    """Return a folder that anybody may enter, in memory where there is such a disk."""
    memory = Path("/dev/shm")
    usable = memory.is_dir() and os.access(memory, os.W_OK)
    with TemporaryDirectory(dir=memory if usable else None) as name:
        folder = Path(name)
        folder.chmod(0o755)
        yield folder
