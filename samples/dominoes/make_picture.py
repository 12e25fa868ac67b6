"""Draw the dominoes of this folder as they fall.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``dominoes.png`` here unless
given. Needs matplotlib.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.append(str(Path(__file__).parents[1] / "pictures"))

from bodies import View, draw_frames
from labelled import save

from animtool import bake

HERE = Path(__file__).parent

FRAMES = [1, 24, 40, 72]
COLOURS = ["#c96f3b", "#5b6770"]
LIMITS = ((-0.3, 0.55), (-0.42, 0.12))


def draw(baked: Path, out: Path) -> None:
    """Write the picture of a bake."""
    view = View(0.5, 0.7)
    figure = draw_frames(str(baked), "/dominoes/row", FRAMES, view, COLOURS, LIMITS, 2)
    save(figure, out)


def main(out: Path) -> None:
    """Bake the scene and write its picture."""
    with TemporaryDirectory() as folder:
        baked = Path(folder) / "dominoes.usdc"
        bake(HERE / "dominoes.scene.yaml", baked)
        draw(baked, out)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "dominoes.png")
