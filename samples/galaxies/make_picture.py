"""Draw two galaxies of this folder at some frames.

Usage: ``python make_picture.py [OUT]``; ``OUT`` is ``galaxies.png`` here unless given.
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

FRAMES = (1, 36, 56, 80)
# Turned about y and tilted [rad], and half the width of the picture [m].
VIEW = (0.4, 0.9, 5.2)


def draw(baked: Path, out: Path) -> None:
    """Write the picture of a bake."""
    draw_clouds(baked, "/galaxies/stars", FRAMES, VIEW, out)


def main(out: Path) -> None:
    """Bake the scene and write its picture."""
    with TemporaryDirectory() as folder:
        baked = Path(folder) / "galaxies.usdc"
        bake(HERE / "galaxies.scene.yaml", baked)
        draw(baked, out)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "galaxies.png")
