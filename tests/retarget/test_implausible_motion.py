"""Motions too fast for a body, and bodies off the ground."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from support.cli import animtool

from animtool import Take
from animtool.core.errors import Fault
from animtool.formats.bvh.write import write_bvh
from animtool.motion.motion import Channel
from animtool.scene.sources.open import SourceOptions, open_checked, open_source


def said(path: Path, options: SourceOptions | None = None) -> list[Fault]:
    """Return the warnings about the rate and the ground of a file."""
    stream = open_checked(path, options)
    list(stream.blocks)
    return [n for n in stream.notices if n.code in {"TAKE012", "MOT209"}]


@pytest.mark.parametrize(("fps", "found"), [(30, False), (60, True), (120, True)])
def test_a_run_at_a_wrong_rate(root: Path, fps: int, found: bool) -> None:
    path = root / "samples/retarget/takes/run.bvh"
    notices = said(path, SourceOptions(fps=fps))  # type: ignore[arg-type]
    assert [notice.code for notice in notices] == ["TAKE012"] * found
    assert all("at 30 fps" in str(notice.hint) for notice in notices)


def raised(take: Take, height: float) -> Take:
    places = take.motion.translations.dense()
    places[:, 0, 1] += height
    motion = replace(take.motion, translations=Channel.from_dense(places))
    return replace(take, motion=motion)


@pytest.mark.parametrize(
    ("height", "side"),
    [(-0.95, "below"), (-0.2, "below"), (-0.03, ""), (0.03, ""), (0.3, "above")],
)
def test_feet_that_are_planted_off_the_ground(
    root: Path, tmp_path: Path, height: float, side: str
) -> None:
    path = tmp_path / "a.bvh"
    take = open_source(root / "samples/retarget/takes/sneak.bvh").collect()
    write_bvh(raised(take, height), path)
    notices = said(path)
    assert [notice.code for notice in notices] == ["MOT209"] * bool(side)
    assert all(f"{abs(1000 * height):g} mm {side}" in one.message for one in notices)


def test_every_command_says_that_the_feet_are_off_the_ground_once(
    root: Path, tmp_path: Path
) -> None:
    path = tmp_path / "a.bvh"
    take = open_source(root / "samples/retarget/takes/sneak.bvh").collect()
    write_bvh(raised(take, -0.95), path)
    rig = str(root / "rigs/biped/biped.rig.yaml")
    for command in (
        ("info", str(path)),
        ("bake", str(path), "-o", str(tmp_path / "a.usda")),
        ("retarget", str(path), "--to", rig),
        ("validate", str(path)),
    ):
        done = animtool(*command)
        assert (done.stdout + done.stderr).count("MOT209") == 1
        if command[0] == "retarget":
            assert "check: the height of the take" in done.stderr
