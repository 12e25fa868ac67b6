"""Results of commands, right and wrong, for checks to judge."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from support.bvh import small_bvh
from support.cli import Done
from support.reported.made import (
    made_bodies,
    made_cloth,
    made_points,
    made_rope,
    made_skeleton,
    made_trc,
    sheet,
)

GRAVITY = 9.81
SILENT = Done(0, "", "")
# Writes files into a folder; what is said where it is not silence.
Make = Callable[[Path], Done | None]


# Two markers for 3 frames at 60 Hz, one of which goes 6 mm a frame along x.
WALK = np.zeros((3, 2, 3))
WALK[:, 0, 0] = [0, 6, 12]
WALK[:, 1] = [0, 1000, 50]
GONE = WALK.copy()
GONE[1, 1] = np.nan
UNSEEN = np.full((3, 2, 3), np.nan)
BOUNDS = [[0, 0, 0], [0.012, 1, 0.05]]
# Hips that go 1 m a second along x, 1 m up, and a head 0.6 m above them.
RIDE = np.zeros((9, 2, 3))
RIDE[:, 0, 0] = np.arange(9) / 24
RIDE[:, 0, 1], RIDE[:, 1, 1] = 1.0, 0.6
LAID = RIDE[..., [0, 2, 1]]
# A joint that turns by 10 degrees a frame, and by 40 to frame 5.
TURNS = np.stack([np.zeros(9), [0, 10, 20, 30, 70, 80, 90, 100, 110]], axis=1)
FALL = np.linspace(0, 90, 9)


def says(stdout: str, stderr: str = "", peak: float = 0.0) -> Make:
    return lambda _: Done(0, stdout, stderr, peak)


def writes(name: str, content: str | bytes) -> Make:
    def make(out: Path) -> None:
        data = content.encode() if isinstance(content, str) else content
        (out / name).write_bytes(data)

    return make


def trc(points: Any, **more: Any) -> Make:
    names = more.pop("names", ["LASI", "RASI"])
    return writes("o.trc", made_trc(points, names, **more))


def skeleton(translations: Any, **more: Any) -> Make:
    names = more.pop("names", ["Hips", "Head"])
    file = more.pop("file", "o.usda")
    return lambda out: made_skeleton(out / file, names, translations, **more)


def bodies(centres: Any, **more: Any) -> Make:
    return lambda out: made_bodies(out / "o.usda", centres, **more)


def told(make: Make, report: dict[str, Any]) -> Make:
    """Return what writes the same, and says a report in JSON."""

    def both(out: Path) -> Done:
        make(out)
        return Done(0, json.dumps(report), "")

    return both


def info(**facts: Any) -> Make:
    return says(json.dumps({"info": "animtool/1", "files": [facts]}))


def nothing(_: Path) -> None:
    pass


def turned_taken(stop: int) -> Make:
    return skeleton(RIDE[:stop], turns=TURNS[:stop])


def somersault(angles: Any) -> Make:
    """Return a body that turns about its hips."""
    return skeleton(RIDE, turns=np.stack([angles, np.zeros(9)], axis=1))


def walk_bvh(dip: float, *, leg: float = 40.0) -> str:
    """Return hips that go up and down by some centimetres, on legs of a length."""
    header = (
        "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition "
        "Zposition Zrotation Xrotation Yrotation\nJOINT LeftUpLeg\n{\nOFFSET 10 0 0\n"
        "CHANNELS 3 Zrotation Xrotation Yrotation\nJOINT LeftLeg\n{\nOFFSET 0 "
        f"-{leg} 0\nCHANNELS 3 Zrotation Xrotation Yrotation\nJOINT LeftFoot\n{{\n"
        f"OFFSET 0 -{leg} 0\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{{\n"
        "OFFSET 0 -5 10\n}\n}\n}\n}\n}\n"
    )
    rows = np.zeros((24, 15))
    rows[:, 1] = 90 + dip / 2 * np.cos(np.arange(24) * np.pi / 6)
    return small_bvh(rows, header=header)


def falls(bounce: float, *, frames: int = 90) -> Any:
    """Return a body that falls 1 m to a rest of 0.1 m, and bounces for ever."""
    times = np.arange(frames) / 24 * 0.25
    heights = []
    for t in times:
        left, speed = t - np.sqrt(2 / GRAVITY), np.sqrt(2 * GRAVITY)
        height = 1 - 0.5 * GRAVITY * t**2
        while left > 0:
            speed *= bounce
            height = max(0.0, speed * left - 0.5 * GRAVITY * left**2)
            flight = 2 * speed / GRAVITY
            if left < flight or flight < 1e-3:
                break
            left -= flight
        heights.append(0.1 + height)
    return np.stack([np.zeros(frames), heights, np.zeros(frames)], axis=1)[:, None]


@cache
def swing(frames: int, start: float, substeps: int = 200) -> Any:
    """Return the angle of a pendulum of 1 m from a start at rest [rad]."""
    dt, angle, rate, found = 1 / 24 / substeps, start, 0.0, []
    for step in range(frames * substeps):
        if step % substeps == 0:
            found.append(angle)
        half = rate - 0.5 * dt * GRAVITY * np.sin(angle)
        angle += dt * half
        rate = half - 0.5 * dt * GRAVITY * np.sin(angle)
    return np.array(found)


def cradle(left: float) -> Any:
    """Return three balls of which the outer ones swing, with a share of the angle."""
    angle = swing(49, np.radians(-40))
    angles = np.stack([angle.clip(None, 0), 0 * angle, left * angle.clip(0)], axis=1)
    pivots = 0.2 * np.arange(3)
    return np.stack([pivots + np.sin(angles), 2 - np.cos(angles), 0 * angles], axis=2)


def pendulum_rope(left: float) -> Make:
    """Return a straight rope that swings by 20 degrees, and by a share of it late."""

    def make(out: Path) -> Done | None:
        angles = swing(480, np.radians(20)) * np.linspace(1, left, 480)
        along = np.linspace(0, 1, 5)
        x, y = np.outer(np.sin(angles), along), 2 - np.outer(np.cos(angles), along)
        return made_rope(out / "o.usda", np.stack([x, y, 0 * x], axis=2))

    return make


def cloth(*heights: float, lift: float = 0.0, tilt: float = 0.0) -> Make:
    """Return a sheet at heights, frame by frame; one of its corners is lifted."""
    points = np.stack([sheet(5, height) for height in heights])
    points[:, :, 1] += tilt * points[:, :, 0]
    points[1:, 0, 1] += lift
    return lambda out: made_cloth(out / "o.usda", points)


def rope(*lengths: float) -> Make:
    points = np.array([[[0, 2, 0], [0, 2 - n / 2, 0], [0, 2 - n, 0]] for n in lengths])
    return lambda out: made_rope(out / "o.usda", points)


def dust(points: Any) -> Make:
    return lambda out: made_points(out / "o.usda", points)


def pinned(apart: float = 0.0, out_of_plane: float = 0.0) -> Make:
    """Return a wheel that turns, and a rod whose end is pinned to it."""
    angles = np.linspace(0, 300, 10)
    ends = 0.15 * np.stack([np.cos(np.radians(angles)), np.sin(np.radians(angles))], 1)
    places = np.zeros((10, 2, 3))
    places[:, 1, :2] = ends + np.array([0.3, 0])
    places[5, 1, 0] += apart
    places[5, 1, 2] += out_of_plane
    return bodies(places, turns=np.stack([angles, np.zeros(10)], axis=1))


def agents(*last: float) -> Make:
    """Return two agents that go from x = -8 and 8."""
    places = np.zeros((25, 2, 3))
    places[:, :, 0] = np.linspace([-8, 8], last, 25)
    return dust(places)


def person(heights: Any, tilts: Any) -> Make:
    """Return one whose hips are so high, and whose trunk leans so far."""
    moves = np.zeros((len(heights), 2, 3))
    moves[:, 0, 1], moves[:, 1, 1] = heights, 0.6
    turns = np.stack([tilts, np.zeros(len(heights))], axis=1)
    return skeleton(moves, names=["hips", "head"], turns=turns)


def npz(*values: float) -> Make:
    def make(out: Path) -> None:
        np.savez(out / "o.npz", markers_m=np.array(values, float))

    return make
