"""The script of the pictures: what it says makes them, and the committed ones."""

from __future__ import annotations

import sys
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
import pytest
from support.drawing import need_drawing
from support.printed import shorten

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "samples/pictures"
# Mean difference of a channel, of 255: rasterisers differ at edges.
SAME = 2.0
# Bytes of a picture, and of one that moves.
MOST, MOST_MOVING = 300_000, 1_500_000


@pytest.fixture(scope="module")
def script() -> dict[str, Any]:
    # Classes of it are looked up in a module.
    name = "make_pictures"
    found = run_path(str(PICTURES / f"{name}.py"), run_name=name)
    sys.modules.pop(name, None)
    return found


def pixels(path: Path) -> np.ndarray:
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"), np.float64)


def test_each_picture_is_committed_and_small(script: dict[str, Any]) -> None:
    paths = [made.path for made in script["PICTURES"]]
    assert len(set(paths)) == len(paths)
    for made in script["PICTURES"]:
        size = (ROOT / made.path).stat().st_size
        assert size < (MOST_MOVING if made.path.endswith(".webp") else MOST), made.path
        for layer in made.over:
            assert (ROOT / layer).is_file(), layer


def test_no_other_picture_is_in_its_folder(script: dict[str, Any]) -> None:
    made = {ROOT / picture.path for picture in script["PICTURES"]}
    found = {path for path in PICTURES.iterdir() if path.suffix in {".png", ".webp"}}
    # `page.py` makes it.
    assert found - made == {PICTURES / "page.png"}


@pytest.mark.slow(seconds=3)
@pytest.mark.parametrize("name", ["expressions", "lids", "correctives", "body"])
def test_a_committed_picture_is_what_is_drawn(
    script: dict[str, Any], tmp_path: Path, name: str
) -> None:
    need_drawing()
    (made,) = [each for each in script["PICTURES"] if each.name == name]
    out = tmp_path / Path(made.path).name
    script["make"](made, out, tmp_path)
    drawn, committed = pixels(out), pixels(ROOT / made.path)
    assert drawn.shape == committed.shape
    assert np.abs(drawn - committed).mean() < SAME


@pytest.mark.slow(seconds=6)
def test_each_is_made_of_fewer_frames(
    script: dict[str, Any], workplace: Path, tmp_path: Path
) -> None:
    need_drawing()
    shorten(workplace)
    small = [made for made in script["PICTURES"] if made.name in {"rope", "walk"}]
    assert len(small) == 2
    for made in small:
        out = tmp_path / Path(made.path).name
        script["make"](made, out, tmp_path, "64x48", workplace)
        image = pixels(out)
        assert np.ptp(image.reshape(-1, 3), axis=0).min() > 20


def test_looks_are_what_their_script_makes(tmp_path: Path) -> None:
    script = run_path(str(PICTURES / "make_looks.py"))
    from pxr import Sdf

    for rig in script["LOOKS"]:
        path = tmp_path / f"{rig}.look.usdc"
        script["look"](rig, path)
        made, kept = (
            Sdf.Layer.FindOrOpen(str(each)).ExportToString()
            for each in (path, PICTURES / path.name)
        )
        assert made == kept
