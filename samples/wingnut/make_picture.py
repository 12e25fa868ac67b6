"""Draw the handle of this folder while it flips over.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``wingnut.png`` here unless
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

FRAMES = list(range(58, 94, 5))
COLOURS = ["#8f9aa8"]
LIMITS = ((-0.11, 0.11), (0.17, 0.41))


def draw(baked: Path, out: Path) -> None:
    """Write the picture of a bake."""
    view = View(0.5, 0.3)
    figure = draw_frames(str(baked), "/wingnut/nut", FRAMES, view, COLOURS, LIMITS, 4)
    save(figure, out)


def main(out: Path) -> None:
    """Bake the scene and write its picture."""
    with TemporaryDirectory() as folder:
        baked = Path(folder) / "wingnut.usdc"
        bake(HERE / "wingnut.scene.yaml", baked)
        draw(baked, out)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "wingnut.png")
