"""Summarizes the characters of a stage: each extreme value and its character."""

from __future__ import annotations

from operator import attrgetter
from pathlib import Path

import numpy as np

from animtool.core.errors import AnimtoolError
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.motion.take import Take
from animtool.retarget.anatomy import find_anatomy
from animtool.retarget.facts import ground_speeds, joint_positions
from animtool.retarget.roled_skeleton import RoledSkeleton


@dataclass(frozen=True, slots=True)
class Extreme:
    """A largest or smallest value, with the character and frame at which it occurs."""

    value: float
    character: str  # path of its Skeleton
    frame: float  # time code


@dataclass(frozen=True, slots=True)
class CharactersFacts:
    """Summary of all characters of a stage."""

    count: int
    joints: int  # number of joints, over all characters
    unread: int  # characters whose motion cannot be read; see `validate`
    # Lowest and highest joint position over all characters and frames [m].
    bounds: tuple[list[float], list[float]] | None
    speed_mean: float | None  # mean horizontal speed of hips, over all people [m/s]
    speed: Extreme | None  # largest horizontal speed of hips [m/s]
    lowest: Extreme | None  # smallest height of hips [m]
    rise: Extreme | None  # largest vertical step of hips in a frame [m]


@dataclass(frozen=True, slots=True)
class _CharacterSummary:
    """Bounds and hip speeds of one character; speeds only for people."""

    # Lowest and highest joint position, axis by axis, over all frames [m].
    bounds_low: list[float]
    bounds_high: list[float]
    mean_speed: float | None = None  # mean horizontal speed of the hips [m/s]
    speed: Extreme | None = None  # largest horizontal speed of the hips [m/s]
    lowest: Extreme | None = None  # smallest height of the hips [m]
    rise: Extreme | None = None  # largest vertical step of the hips in a frame [m]


def describe_characters(path: Path | str) -> CharactersFacts | None:
    """Return a summary of a stage's characters; None for fewer than two.

    Args:
        path: A USD file.
    """
    from animtool.usd.takes.read import read_characters

    readers = read_characters(Path(path))
    if len(readers) < 2:
        return None
    summaries, joint_count, unreadable_count = [], 0, 0
    for name, open_take in readers.items():
        try:
            take = open_take().collect()
        except AnimtoolError:
            unreadable_count += 1
            continue
        joint_count += len(take.rig.joints)
        if take.rig.joints:
            summaries.append(_summarize(name, take))
    mean_speeds, speeds, heights, rises = (
        [v for v in map(attrgetter(name), summaries) if v is not None]
        for name in ("mean_speed", "speed", "lowest", "rise")
    )
    get_value = attrgetter("value")
    bounds = None
    if summaries:
        bounds_low = np.min([summary.bounds_low for summary in summaries], axis=0)
        bounds_high = np.max([summary.bounds_high for summary in summaries], axis=0)
        bounds = bounds_low.tolist(), bounds_high.tolist()
    return CharactersFacts(
        len(readers),
        joint_count,
        unreadable_count,
        bounds,
        float(np.mean(mean_speeds)) if mean_speeds else None,
        max(speeds, key=get_value, default=None),
        min(heights, key=get_value, default=None),
        max(rises, key=get_value, default=None),
    )


def _summarize(name: str, take: Take) -> _CharacterSummary:
    """Measure a character's bounds and, if it has legs, its hips' speed and height."""
    roles = RoledSkeleton.of(take.rig, find_anatomy(take.rig).roles)
    hips, positions = joint_positions(take, roles, range(len(take.rig.joints)))
    all_positions = np.stack(list(positions.values()), axis=1).reshape(-1, 3)
    bounds_low, bounds_high = (
        all_positions.min(axis=0).tolist(),
        all_positions.max(axis=0).tolist(),
    )
    if roles.leg("l") is None or roles.leg("r") is None or len(hips) < 2:
        return _CharacterSummary(bounds_low, bounds_high)
    up_index, time_codes = 1 if take.rig.up is UpAxis.Y else 2, take.clock.times
    speeds = ground_speeds(take, hips)
    heights = hips[:, up_index]
    vertical_steps = np.abs(np.diff(heights))

    def extreme_at(value: float, frame: int) -> Extreme:
        return Extreme(value, name, float(time_codes[frame]))

    fastest_step, lowest_frame, largest_step = (
        int(index)
        for index in (speeds.argmax(), heights.argmin(), vertical_steps.argmax())
    )
    return _CharacterSummary(
        bounds_low,
        bounds_high,
        float(speeds.mean()),
        extreme_at(float(speeds[fastest_step]), fastest_step + 1),
        extreme_at(float(heights[lowest_frame]), lowest_frame),
        extreme_at(float(vertical_steps[largest_step]), largest_step + 1),
    )
