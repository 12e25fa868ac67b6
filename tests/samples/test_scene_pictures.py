"""The committed pictures of scenes are what their scripts draw of the scenes' bakes."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
import pytest
from support.printed import ROOT, Printed

# The mean difference of a channel, of 255: fonts and the folds of cloth differ from
# machine to machine. Frames that are three further differ by 5 and more.
SAME = 3.0
NAMES = ["embers"]


def script_of(name: str) -> dict[str, Any]:
    return run_path(str(ROOT / f"samples/{name}/make_picture.py"))


def baked_by(printed: Printed, name: str) -> Path:
    scene = f"samples/{name}/{name}.scene.yaml"
    return printed(f"animtool bake {scene} -o {name}.usdc") / f"{name}.usdc"


def pixels(path: Path) -> np.ndarray:
    image = pytest.importorskip("PIL.Image", reason="no Pillow")
    with image.open(path) as opened:
        return np.asarray(opened.convert("RGB"), np.float64)


@pytest.mark.slow(1)
@pytest.mark.parametrize("name", NAMES)
def test_the_committed_picture_is_what_is_drawn(
    printed: Printed, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str
) -> None:
    pytest.importorskip("matplotlib", reason="no matplotlib (extra: preview)")
    monkeypatch.setattr(sys, "path", [str(ROOT / "samples/pictures"), *sys.path])
    out = tmp_path / f"{name}.png"
    script_of(name)["draw"](baked_by(printed, name), out)
    drawn, committed = pixels(out), pixels(ROOT / f"samples/{name}/{name}.png")
    assert drawn.shape == committed.shape
    assert np.abs(drawn - committed).mean() < SAME


@pytest.mark.parametrize("name", NAMES)
def test_a_script_draws_its_scene(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str
) -> None:
    monkeypatch.setattr(sys, "path", [str(ROOT / "samples/pictures"), *sys.path])
    labelled, calls = import_module("labelled"), []
    monkeypatch.setattr(labelled, "make_picture", lambda *given: calls.append(given))
    monkeypatch.setattr(sys, "argv", ["make_picture.py", str(tmp_path / "a.png")])
    script = ROOT / f"samples/{name}/make_picture.py"
    run_path(str(script), run_name="__main__")
    ((scene, draw, out),) = calls
    assert scene == ROOT / f"samples/{name}/{name}.scene.yaml"
    assert (draw.__name__, out) == ("draw", tmp_path / "a.png")
