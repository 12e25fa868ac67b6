"""Draw the ball of this folder on its way through the wall.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``wrecking_ball.png`` here unless
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

FRAMES = [1, 24, 30, 40]
COLOURS = ["#6b7078"] * 6 + ["#3d434b", "#b5673a"]
LIMITS = ((-4.2, 4.2), (-1.4, 5.6))


def draw(baked: Path, out: Path) -> None:
    """Write the picture of a bake."""
    view = View(-0.9, 0.25)
    figure = draw_frames(
        str(baked), "/wrecking_ball/yard", FRAMES, view, COLOURS, LIMITS, 2
    )
    save(figure, out)


def main(out: Path) -> None:
    """Bake the scene and write its picture."""
    with TemporaryDirectory() as folder:
        baked = Path(folder) / "wrecking_ball.usdc"
        bake(HERE / "wrecking_ball.scene.yaml", baked)
        draw(baked, out)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "wrecking_ball.png")
