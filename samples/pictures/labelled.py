"""Figures of samples that matplotlib draws, as small files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from animtool import bake

# Colours of a picture, to keep files small.
COLOURS = 240


def save(figure: Any, out: Path) -> None:
    """Write a figure as a small PNG file."""
    from PIL import Image

    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3]
    image = Image.fromarray(np.ascontiguousarray(pixels))
    image.quantize(COLOURS).save(out, optimize=True)


def make_picture(
    scene: Path, draw: Callable[[Path, Path], object], out: Path | None = None
) -> None:
    """Bake a scene and write its picture: `out`, or named as the folder it is in."""
    with TemporaryDirectory() as folder:
        baked = Path(folder) / f"{scene.name.partition('.')[0]}.usdc"
        bake(scene, baked)
        draw(baked, out or scene.parent / f"{scene.parent.name}.png")
