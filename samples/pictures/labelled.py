"""Rendered pictures side by side with words beside them, by matplotlib."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animtool import bake

DPI = 96
# Colours of a picture, to keep files small.
COLOURS = 240


def image_grid(
    rows: Sequence[Sequence[NDArray[np.float64]]],
    above: Sequence[str],
    props: Sequence[str] = ("",),
) -> Any:
    """Return a figure of pictures, with words above its columns and beside its rows."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    height, width = rows[0][0].shape[:2]
    size = (
        (len(rows[0]) * (width + 8) + 30) / DPI,
        (len(rows) * (height + 8) + 30) / DPI,
    )
    figure, axes = plt.subplots(
        len(rows),
        len(above),
        figsize=size,
        dpi=DPI,
        layout="constrained",
        squeeze=False,
    )
    for line, row, name in zip(axes, rows, props, strict=True):
        line[0].set_ylabel(name, fontsize=12)
        for axis, image in zip(line, row, strict=True):
            axis.imshow(image)
            axis.set(xticks=[], yticks=[])
            axis.spines[:].set_visible(False)
    for axis, title in zip(axes[0], above, strict=True):
        axis.set_title(title, fontsize=12)
    return figure


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
