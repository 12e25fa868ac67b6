from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault
from animtool.formats.bvh.write import write_bvh
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.retarget.root_position import root_warning
from animtool.scene.sources.open import open_source

SAMPLES = Path(__file__).parents[2] / "samples"
RIG = SAMPLES.parent / "rigs/biped/biped.rig.yaml"


@pytest.fixture(scope="module")
def walk() -> Take:
    return open_source(SAMPLES / "walk/walk.bvh").collect()


def with_root(take: Take, positions: FloatArray) -> Take:
    translations = take.motion.translations.dense()
    translations[:, 0] = positions
    motion = Motion(Channel.from_dense(translations), take.motion.rotations)
    return Take(take.rig, take.clock, motion)


def problem(take: Take, positions: FloatArray) -> Fault | None:
    return root_warning(take.rig, with_root(take, positions).motion)


@pytest.mark.parametrize(
    ("factor", "hint"),
    [
        (30.0, "divide them by 39.37"),
        (100.0, "divide them by 100"),
        (1000.0, "divide them by 1000"),
        (12.0, None),
        (1.0, None),
        (0.5, None),
    ],
)
def test_roots_in_another_unit(walk: Take, factor: float, hint: str | None) -> None:
    found = problem(walk, factor * walk.motion.translations.dense()[:, 0])
    assert (None if found is None else (found.code, found.hint)) == (
        None if hint is None else ("MOT213", hint)
    )


def test_roots_below_the_ground(walk: Take) -> None:
    roots = walk.motion.translations.dense()[:, 0]
    found = problem(walk, roots * [1, -1, 1])
    assert found is not None
    assert (found.code, found.hint) == ("MOT214", "negate its Y translations")
    # Relative to the start of the take.
    assert problem(walk, roots - roots[0]) is None


@pytest.mark.parametrize("order", [(0, 2, 1), (1, 2, 0), (1, 0, 2)])
def test_roots_with_another_up_axis(walk: Take, order: tuple[int, int, int]) -> None:
    roots = walk.motion.translations.dense()[:, 0]
    path = np.linspace(0, 3, len(roots))[:, None] * [1, 0, 1]
    found = problem(walk, (roots * [0, 1, 0] + path)[:, order])
    assert found is not None
    assert found.code == "MOT214"
    # With the other axis pointing down.
    below = problem(walk, -(roots * [0, 1, 0] + path)[:, order])
    assert below is not None
    assert below.code == "MOT214"
    # Climbing, not walking.
    assert problem(walk, roots + path[:, [1, 0, 1]]) is None


@pytest.mark.parametrize(
    ("factor", "hint"),
    [
        (0.001, "multiply them by 1000"),
        (0.01, "multiply them by 100"),
        (1 / 39.37, "multiply them by 39.37"),
        (0.1, None),
        (0.5, None),
        (1.0, None),
    ],
)
def test_roots_that_are_too_low(walk: Take, factor: float, hint: str | None) -> None:
    roots = walk.motion.translations.dense()[:, 0]
    motion = with_root(walk, factor * roots).motion
    found = root_warning(walk.rig, motion, 1 / 30)
    assert (None if found is None else (found.code, found.hint)) == (
        None if hint is None else ("MOT213", hint)
    )
    # Relative to the start of the take, or without the time between frames.
    motion = with_root(walk, factor * (roots - roots[0])).motion
    assert root_warning(walk.rig, motion, 1 / 30) is None
    assert problem(walk, factor * roots) is None


@pytest.mark.parametrize("factor", [100, 0.01])
def test_commands_report_it_once(walk: Take, tmp_path: Path, factor: float) -> None:
    roots = walk.motion.translations.dense()[:, 0]
    path, output = tmp_path / "walk.bvh", tmp_path / "walk.usdc"
    write_bvh(with_root(walk, factor * roots), path)
    for command in (
        ("bake", path, "-o", output),
        ("validate", path),
        ("retarget", path, "--to", RIG, "-o", tmp_path / "biped.usdc"),
    ):
        done = animtool(*command)
        assert (done.stdout + done.stderr).count("MOT213") == 1


def test_no_frames_and_one_frame(walk: Take) -> None:
    for count in (0, 1):
        assert root_warning(walk.rig, walk.motion.select(slice(0, count))) is None


@pytest.mark.parametrize(
    ("offset", "step", "found"),
    [(1000.0, 0.0, True), (200.0, 0.0, False), (1000.0, 20.0, False)],
)
def test_roots_far_from_the_origin(
    walk: Take, offset: float, step: float, found: bool
) -> None:
    roots = walk.motion.translations.dense()[:, 0]
    roots[:, 2] += offset + step * np.arange(len(roots))
    fault = problem(walk, roots)
    assert (fault is not None and fault.code == "MOT223") == found
