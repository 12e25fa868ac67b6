"""Faults planted in real captures: how many each rule finds."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from conftest import data_folder
from support.planted_takes import (
    codes,
    eased,
    edited,
    held,
    repeated,
    sides_renamed,
    sides_swapped,
    step,
    travel,
    turned,
    without,
)
from support.suite import some_quick

from animtool.core.errors import AnimtoolError, Fault
from animtool.motion.take import Take
from animtool.rig.body_size import find_feet
from animtool.scene.sources.open import open_source
from animtool.validation.motion.size import tilted_stance
from animtool.validation.motion.subject import MotionSubject

HEADING = "faults planted in real captures: found | of"
# Shorter takes show no usual motion; of longer ones the middle is enough.
MIN_FRAMES, MAX_FRAMES = 60, 360
EACH = 4
Plant = Callable[[Take, int, str], Take]


def at_joint(degrees: float, *, stays: bool) -> Plant:
    def plant(take: Take, frame: int, joint: str) -> Take:
        frames = slice(frame, None if stays else frame + 1)
        return turned(joint, degrees, frames, frame % 3)(take)

    return plant


def whole(edit: Callable[[Take], Take]) -> Plant:
    return lambda take, _, __: edit(take)


def at_frame(edit: Callable[[int], Callable[[Take], Take]]) -> Plant:
    return lambda take, frame, _: edit(frame)(take)


# What is planted, the code that must find it, and the share that it finds at least: far
# below what is found, as other captures are as rough as these, or rougher.
CASES: dict[str, tuple[Plant, str, float]] = {
    "20° in one frame": (at_joint(20, stays=False), "MOT202", 0.6),
    "20° from a frame on": (at_joint(20, stays=True), "MOT202", 0.6),
    "45° in one frame": (at_joint(45, stays=False), "MOT202", 0.8),
    "the root aside by 8%": (whole(step(0.08, 0)), "MOT203", 0.7),
    "one frame lost": (at_frame(without), "MOT205", 0.2),
    "five frames frozen": (at_frame(lambda f: held(f, 5)), "MOT206", 0.7),
    "every fifth repeated": (whole(repeated(5)), "MOT207", 0.7),
    "1.5 times as far": (whole(travel(1.5)), "MOT208", 0.2),
    "sunk by a tenth": (whole(eased(-0.1, 1, 0.3, 0.6)), "MOT209", 0.2),
    "names swapped": (whole(sides_renamed), "MOT210", 0.5),
    "sides exchanged": (whole(sides_swapped(0.5)), "MOT210", 0.4),
}


@cache
def captures() -> list[tuple[str, Take, frozenset[str]]]:
    """Return the captures with motion and feet, upright, and what is found in them."""
    folder = data_folder("bvh")
    found = []
    for path in sorted(folder.glob("*.bvh")) if folder else ():
        try:
            take = _middle(open_source(path).collect())
        except AnimtoolError:
            continue
        motion = take.motion
        enough = motion.frames >= MIN_FRAMES and len(motion.rotations.animated) > 9
        if enough and len(find_feet(take.rig.names)) and not _lies(take):
            found.append((path.name, take, frozenset(codes(take))))
    return found


def _middle(take: Take) -> Take:
    moves, turns, _ = take.motion.dense()
    # A reference pose in the first frame is left out.
    first = max(1, (len(turns) - MAX_FRAMES) // 2)
    if len(turns) < MIN_FRAMES:
        return take
    return edited(
        take, moves[first : first + MAX_FRAMES], turns[first : first + MAX_FRAMES]
    )


def _lies(take: Take) -> bool:
    return tilted_stance(MotionSubject(take, lambda *_: Fault("", ""))) is not None


@pytest.mark.slow(0.5)
@pytest.mark.skipif(data_folder("bvh") is None, reason="no $ANIMTOOL_DATA/bvh")
@pytest.mark.parametrize("name", some_quick(CASES, 6, 1))
def test_faults_in_captures(name: str, record_property: Any) -> None:
    plant, code, share = CASES[name]
    rng = np.random.default_rng(7)
    hits = planted = 0
    for _, take, clean in captures():
        if code in clean:
            continue
        moving = np.setdiff1d(take.motion.rotations.animated, take.rig.roots)
        for _ in range(EACH):
            frame = int(rng.integers(8, take.motion.frames - 8))
            joint = take.rig.names[int(rng.choice(moving))]
            hits += code in codes(plant(take, frame, joint))
            planted += 1
            if plant.__name__ == "<lambda>" and code not in {"MOT205", "MOT206"}:
                break
    if not planted:
        pytest.skip("no capture is fit for it")
    record_property(HEADING, f"  {name:<24} {code} | {hits} | {planted}")
    # Of few captures as few may be found by chance.
    assert hits >= share * planted - 2 * np.sqrt(planted * share * (1 - share))
