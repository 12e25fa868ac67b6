"""Draw argon of this folder at some frames.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``argon.png`` here unless given.
Needs matplotlib.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.append(str(Path(__file__).parents[1] / "pictures"))

from clouds import draw_clouds

from animtool import bake

HERE = Path(__file__).parent

FRAMES = (1, 50, 80, 120)
# Turned about y and tilted [rad], and half the width of the picture [m].
VIEW = (0.5, 0.35, 3.3)


def draw(baked: Path, out: Path) -> None:
    """Write the picture of a bake."""
    draw_clouds(baked, "/argon/atoms", FRAMES, VIEW, out)


def main(out: Path) -> None:
    """Bake the scene and write its picture."""
    with TemporaryDirectory() as folder:
        baked = Path(folder) / "argon.usdc"
        bake(HERE / "argon.scene.yaml", baked)
        draw(baked, out)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "argon.png")
