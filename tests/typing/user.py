"""What a user writes, which mypy, with animtool, and pyright take as it is.

A comment that ignores a misspelt name is itself an error where the name is not noticed.
"""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import animtool
from animtool import BakeOptions, Channel, Clock, Motion, SourceOptions, edit, ik


def bake(folder: Path) -> list[float]:
    """Read, change and write a take."""
    rig = animtool.Rig.load("rigs/biped/biped.rig.yaml")
    clip = animtool.Clip.load("samples/stride/stride.clip.yaml", rig)
    take = clip.sample(rig, fps="29.97", step=0.5)
    rates: list[int | float | str | Fraction] = [
        24,
        23.976,
        "24",
        Fraction(24000, 1001),
    ]
    takes = [edit.resampled(take, rate) for rate in rates]
    shot = animtool.Shot(1001, 1040, fps=24)
    options = [
        *(BakeOptions(source=SourceOptions(fps=rate), fps=rate) for rate in rates),
        BakeOptions(fps=24),
        BakeOptions(fps="24000/1001", shot=shot),
        replace(BakeOptions(fps=23.976, start=1000.5), fps=None, start=1001),
    ]
    stored: Fraction | None = options[0].fps or options[0].source.fps or shot.fps
    first: Fraction | None = options[-1].start
    for one in options:
        animtool.bake("samples/walk/walk.bvh", folder / "walk.usda", one)
    walk = animtool.read_bvh("samples/walk/walk.bvh", fps=stored or 29.97)
    short = edit.trim(edit.mirror(takes[0]), first=5, last=12)
    frames: int = len(short)
    fps: Fraction = short.fps
    clock = Clock(fps, Fraction(1), Fraction(1), frames)
    motion = Motion(
        Channel.from_dense(short.motion.translations.dense()),
        Channel.from_dense(short.motion.rotations.dense()),
    )
    notices: list[animtool.Fault] = animtool.write_bvh(
        animtool.Take(rig, clock, motion), folder / "walk.bvh", overwrite=True
    )
    result = animtool.usd.write(take, str(folder / "walk.usdc"), overwrite=True)
    return [
        result.rounding.error,
        float(len(notices)),
        float(walk.fps),
        float(first or 1),
    ]


def reach(rig: animtool.Rig) -> animtool.Take:
    """Solve for a pose."""
    problem = ik.build(rig, [ik.Goal("wrist_l")])
    solved = ik.solve(problem, None, ik.Targets(positions=[[[0.3, 1.2, 0.4]]]))
    return solved.take(fps=24)


def misspelt() -> None:
    """Write names that there are none of, and rates that are none."""
    animtool.Rigg  # type: ignore[attr-defined]  # noqa: B018
    animtool.edit.trimm  # type: ignore[attr-defined]  # noqa: B018
    ik.sovle  # type: ignore[attr-defined]  # noqa: B018
    animtool.sim.integrat  # type: ignore[attr-defined]  # noqa: B018
    animtool.usd.wrte  # type: ignore[attr-defined]  # noqa: B018
    BakeOptions(fps=[24])  # type: ignore[arg-type]
    SourceOptions(fps=b"24")  # type: ignore[arg-type]
    animtool.Shot(1, 2, fps={})  # type: ignore[arg-type]
    BakeOptions().fps = 24  # type: ignore[misc]
    whole: int = SourceOptions(fps=24).fps  # type: ignore[assignment]  # noqa: F841
