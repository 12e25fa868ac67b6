"""Surfaces that scripts make."""

from __future__ import annotations

import sys
from pathlib import Path
from runpy import run_path

import numpy as np
import pytest

# Stored places are rounded to 1e-6 m, normals and weights more coarsely; another
# processor may round the other way.
STEP = {"normals": 2e-4, "weights": 2e-3}
PLACES = 1.5e-6


def check_made(
    script: Path, kept: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Check that a script makes the arrays that are kept, twice the same bytes.

    What is kept is what it made before; where another processor rounds otherwise, it
    makes them again.
    """
    made = folder / kept.name
    monkeypatch.setattr(sys, "argv", [script.name, str(made)])
    # As if run by itself, which puts the script's own folder first.
    monkeypatch.setattr(sys, "path", [str(script.parent), *sys.path])
    run_path(str(script), run_name="__main__")
    first = made.read_bytes()
    if first == kept.read_bytes():
        return
    run_path(str(script), run_name="__main__")
    assert made.read_bytes() == first
    with np.load(made) as new, np.load(kept) as old:
        assert new.files == old.files
        for name in old.files:
            assert new[name].dtype == old[name].dtype
            if old[name].dtype.kind == "f":
                kind = name.rpartition("_")[2]
                step = STEP.get(kind, PLACES)
                assert np.abs(new[name] - old[name]).max() <= step, name
            else:
                assert np.array_equal(new[name], old[name]), name
