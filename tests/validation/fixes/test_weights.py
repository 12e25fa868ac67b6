"""Weights summed to 1 in a new file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.example_rig import write_example_rig

from animtool.rig.file import load_rig
from animtool.validation.fixes.plan import plan_fixes
from animtool.validation.fixes.run import fix_files
from animtool.validation.options import ValidateOptions
from animtool.validation.run import validate


@pytest.fixture
def loose(tmp_path: Path) -> Path:
    """Return a rig whose weights are not summed to 1."""
    path = write_example_rig(tmp_path)
    with np.load(tmp_path / "body.npz") as file:
        arrays = dict(file)
    arrays["weights"] = (
        arrays["weights"] * np.linspace(0.2, 3, len(arrays["weights"]))[:, None]
    )
    np.savez(tmp_path / "body.npz", **arrays)
    return path


def codes(path: Path) -> list[str]:
    return [fault.code for fault in validate(path)]


def test_they_go_into_a_file_of_their_own(loose: Path) -> None:
    assert "RIG210" in codes(loose)
    before, old = loose.read_text("utf-8"), loose.with_name("body.npz").read_bytes()
    skin = load_rig(loose).meshes[0].skin
    assert skin is not None
    values = skin.weights.load()
    fixes = fix_files([loose])
    assert [fault.code for fault, _ in fixes.report.mended] == ["RIG210"]
    assert "RIG210" not in codes(loose)
    assert loose.with_name("body.npz").read_bytes() == old
    after = loose.read_text("utf-8")
    assert after == before.replace(
        "weights: body.npz}", "weights: body_weights.npz#weights}"
    )
    mended = load_rig(loose).meshes[0].skin
    assert mended is not None
    summed = mended.weights.load()
    assert_allclose(summed.sum(axis=1), 1.0, atol=1e-6)
    assert_allclose(summed, values / values.sum(axis=1, keepdims=True), atol=1e-7)


def test_no_file_is_written_over(loose: Path) -> None:
    taken = loose.with_name("body_weights.npz")
    taken.write_bytes(b"mine")
    fix_files([loose])
    assert taken.read_bytes() == b"mine"
    assert "body_weights_2.npz#weights" in loose.read_text("utf-8")
    assert "RIG210" not in codes(loose)


def test_a_plan_writes_nothing(loose: Path) -> None:
    before = sorted(path.name for path in loose.parent.iterdir())
    plan = plan_fixes(loose, ValidateOptions())
    assert [path.name for path in plan.draft.arrays] == ["body_weights.npz"]
    assert "+" in plan.draft.diff_text()
    assert sorted(path.name for path in loose.parent.iterdir()) == before


def test_arrays_of_a_file_that_cannot_be_written_go_too(
    loose: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError("disk")

    monkeypatch.setattr("animtool.validation.fixes.texts.write_parts", fail)
    before = loose.read_text("utf-8")
    with pytest.raises(OSError, match="disk"):
        fix_files([loose])
    assert not loose.with_name("body_weights.npz").exists()
    assert loose.read_text("utf-8") == before
