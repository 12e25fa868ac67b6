"""Make the pictures of README, rigs and samples: the commands that bake and show them.

Usage: ``make_pictures.py [NAME ...] [--size WxH] [--out DIR]``; without names all
of them, into the folders that they belong to. Needs the extra ``pictures``. The name of
a tutorial follows it, and keeps the pictures that its own commands draw.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
LOOKS = "samples/pictures/{}.look.usdc"
HEAD, BIPED = (LOOKS.format(rig) for rig in ("head", "biped"))
PLAIN = "--show meshes --no-numbers"
GROUND = "--show meshes,grid,shadows"


@dataclass(frozen=True)
class Made:
    """A picture, and the commands that make it.

    Attributes:
        path: The picture, seen from the project.
        source: The scene that is shown, or what is baked first: ``bake``, ``ik`` or
            ``retarget`` and its arguments.
        show: How it is shown.
        over: Layers over it: looks and props.
    """

    path: str
    source: str
    show: str
    over: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Its name without suffix."""
        return Path(self.path).stem


def scene(name: str) -> str:
    """Return the scene of a sample."""
    return f"samples/{name}/{name}.scene.yaml"


PICTURES = (
    Made(
        "samples/pictures/walk.webp",
        scene("cape"),
        "--show meshes,shadows --no-numbers --camera 145,8 --size 640x480",
        (BIPED,),
    ),
    Made(
        "samples/pictures/expressions.png",
        "bake samples/pictures/expressions.clip.yaml",
        f"{PLAIN} --range 1,2,3,4,5,6,7,8 --sheet 4x2 --size 220x260 "
        "--camera 0,0.03,0.62,0,0.19,0.02",
        (HEAD,),
    ),
    Made(
        "samples/pictures/lids.png",
        "bake samples/pictures/lids.clip.yaml",
        f"{PLAIN} --range 1,2,3,4,5,6,7,8 --sheet 4x2 --size 200x160 "
        "--camera 0,0,0.12,0.0315,0.217,0.08",
        (HEAD,),
    ),
    Made(
        "samples/pictures/correctives.png",
        "bake samples/pictures/correctives.clip.yaml",
        f"{PLAIN} --range 1,2 --sheet 4x1 --size 220x220 "
        "--camera 0,0,0.2,0,0.138,0.08 --camera 0.7,0.07,0.25,0,0.138,0.05",
        (HEAD,),
    ),
    Made(
        "samples/pictures/speech.png",
        "bake samples/speech/speech.clip.yaml",
        "--show meshes --range 3,20,34,46,53,67,76,101 --sheet 4x2 --size 200x230 "
        "--camera 0,0.03,0.62,0,0.19,0.02",
        (HEAD,),
    ),
    Made(
        "samples/pictures/body.png",
        "bake samples/pictures/poses.clip.yaml",
        f"{GROUND} --no-numbers --range 1,2,3 --camera 25,6 --size 320x320",
        (BIPED,),
    ),
    Made(
        "samples/pictures/cape.png",
        "bake samples/pictures/poses.clip.yaml",
        f"{GROUND} --no-numbers --range 1,2,4 --camera 150,10 --size 320x320",
        (BIPED,),
    ),
    Made(
        "samples/pictures/strides.png",
        scene("cape"),
        f"{GROUND} --range 1,7,13,19 --camera side --camera 150,8 --size 280x280",
        (BIPED,),
    ),
    Made(
        "samples/pictures/carry.png",
        scene("carry"),
        f"{GROUND} --range 1,36,48,68,108 --camera=-50,10 --size 260x260",
        ("samples/carry/prop.usda", BIPED),
    ),
    Made(
        "samples/pictures/weld.png",
        "ik rigs/arm/arm.rig.yaml --targets samples/weld/weld.targets.yaml",
        "--show meshes,bones,grid,shadows --range 100,200,290,360,430 --camera 35,15 "
        "--size 260x220",
        ("samples/weld/pipes.usda",),
    ),
    Made(
        "samples/flag/flag.png",
        scene("flag"),
        f"{GROUND} --sheet 4x1 --size 280x220",
    ),
    Made(
        "samples/drape/drape.png",
        scene("drape"),
        f"{GROUND} --sheet 4x1 --size 260x240",
        ("samples/drape/vase.usda",),
    ),
    Made(
        "samples/dominoes/dominoes.png",
        scene("dominoes"),
        f"{GROUND} --range 1,24,40,72 --sheet 2x2 --size 400x240 --camera 30,40",
    ),
    Made(
        "samples/galaxies/galaxies.png",
        scene("galaxies"),
        "--show meshes --range 1,36,56,80 --sheet 2x2 --size 400x300 --camera 23,52",
    ),
    Made(
        "samples/argon/argon.png",
        scene("argon"),
        "--show meshes --range 1,50,80,120 --sheet 4x1 --size 260x260 --camera 30,20",
    ),
    Made(
        "samples/swing/swing.png",
        scene("swing"),
        f"{GROUND} --range 1,7,13,21,29,40 --sheet 6x1 --size 170x200 --camera 20,8",
    ),
    Made(
        "samples/wingnut/wingnut.png",
        scene("wingnut"),
        "--show meshes --range 58,63,68,73,78,83,88,93 --sheet 4x2 --size 200x160 "
        "--camera 0.5,0.3,0.5,0,0.29,0",
    ),
    Made(
        "samples/wrecking_ball/wrecking_ball.png",
        scene("wrecking_ball"),
        f"{GROUND} --range 1,24,30,40 --sheet 2x2 --size 400x300 --camera=-52,14",
    ),
    Made(
        "samples/sheets/sheets.png",
        scene("sheets"),
        f"{GROUND} --range 96 --no-numbers --camera 15,14 --size 960x420",
        ("samples/sheets/tables.usda",),
    ),
    Made(
        "samples/fall/fall.png",
        scene("fall"),
        "--show meshes --range 1,20,26,32,38,44,52,92 --sheet 4x2 --size 240x200 "
        "--camera 1.35,0.12,6,0,0,0.2",
        ("samples/fall/stairs.usda", BIPED),
    ),
    Made(
        "samples/murmuration/murmuration.png",
        scene("murmuration"),
        f"{GROUND} --range 30,38,46 --size 300x260 --camera 60,5",
        ("samples/murmuration/tower.usda",),
    ),
    Made(
        "samples/crowd/crowd.png",
        "bake samples/crowd/square.scene.yaml",
        f"{GROUND} --range 40,420 --size 640x400 --camera 0.5,0.36,30,0,0.5,0",
    ),
    Made(
        "samples/dam/dam.png",
        scene("dam"),
        f"{GROUND} --range 8,14,22 --camera 25,18 --size 380x300",
        ("samples/dam/pillar.usda",),
    ),
    Made(
        "samples/rope/rope.png",
        scene("rope"),
        f"{GROUND} --sheet 6x1 --size 170x240 --camera 20,6",
    ),
    Made(
        "samples/fox/leap.png",
        "bake samples/fox/fox.glb --take leap",
        "--show meshes,shadows --sheet 6x1 --size 260x220 --camera side",
    ),
    Made(
        "samples/figure/figure.png",
        "retarget samples/figure/figure.fbx --to rigs/biped/biped.rig.yaml",
        "--show meshes,grid,shadows --sheet 6x1 --size 250x300 --camera 40,8",
    ),
    Made(
        "samples/robot/reach.png",
        "ik samples/robot/arm.urdf --targets samples/robot/reach.targets.yaml",
        "--show meshes,grid,shadows --range 1,13,25,37 --sheet 4x1 --size 320x300 "
        "--camera 0.9,0.25,2.0,0.25,0.5,0",
    ),
    Made(
        "samples/dance/dance.png",
        scene("dance"),
        "--show meshes,shadows --range 5,13,21,29,37,45 --sheet 6x1 --size 250x330 "
        "--camera 0.3,0.08,3.5,0,0.92,0",
        ("samples/dance/dance.look.usda",),
    ),
    Made(
        "samples/dance/dance_cape.png",
        "samples/dance/cape.scene.yaml",
        "--show meshes,shadows --range 5,13,21,29,37,45 --sheet 6x1 --size 250x330 "
        "--camera 3.4,0.08,3.5,0,0.92,0",
        (BIPED,),
    ),
)


def commands(made: Made, out: Path, work: Path, size: str | None) -> list[list[str]]:
    """Return the command lines that make a picture, without their first word.

    Args:
        made: The picture.
        out: Where it is written.
        work: A folder for what is baked.
        size: Of each part of it, in place of its own; None is its own.
    """
    show = shlex.split(made.show)
    if size is not None:
        show[show.index("--size") + 1] = size
    for layer in made.over:
        show += ["--over", layer]
    lines, shown = [], made.source
    if not made.source.endswith(".scene.yaml"):
        shown = str(work / f"{made.name}.usdc")
        lines = [[*shlex.split(made.source), "-o", shown, "--overwrite"]]
    return [*lines, ["preview", shown, "-o", str(out), "--overwrite", *show]]


def make(
    made: Made, out: Path, work: Path, size: str | None = None, root: Path = ROOT
) -> None:
    """Make a picture; root: the project, in which its files are."""
    for words in commands(made, out, work, size):
        print("animtool", shlex.join(words), flush=True)
        subprocess.run(
            [sys.executable, "-m", "animtool", *words, "-q"], cwd=root, check=True
        )


def tutorials() -> dict[str, Path]:
    """Return the pages of tutorials, by name."""
    return {path.stem: path for path in (ROOT / "animtool/docs/tutorials").glob("*.md")}


def follow_tutorial(page: Path, work: Path) -> None:
    """Follow a tutorial; what its commands draw becomes the pictures of the page."""
    sys.path.insert(0, str(ROOT / "tests"))
    from support.tutorials import make_pictures

    make_pictures(page, work)


def main() -> None:
    """Make the pictures named on the command line."""
    pages = tutorials()
    names = [*(made.name for made in PICTURES), *sorted(pages)]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[[], *names])
    parser.add_argument("--size", help="of each part of a picture, such as 96x72")
    parser.add_argument("--out", type=Path, help="a folder for all of them")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        for made in PICTURES:
            if not options.names or made.name in options.names:
                own = ROOT / made.path
                out = own if options.out is None else options.out / own.name
                make(made, out.resolve(), Path(work), options.size)
        for name, page in sorted(pages.items()):
            if not options.names or name in options.names:
                follow_tutorial(page, Path(work))


if __name__ == "__main__":
    main()
