"""Files of maps of joints alone, as `documents` spoils and loads them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from fuzz.targets import documents

ABOUT = "files of maps of joints, spoiled as bytes or as values"


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    return documents.make(folder, ("map",))
