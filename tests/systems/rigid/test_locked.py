"""Joints that others keep from moving are named, and stay where they are."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.rigid import Rigid, box

from animtool.systems.rigid.locked import _closed_loops

X, Y, Z = [1, 0, 0], [0, 1, 0], [0, 0, 1]


def slides(folder: Path, axes: Any, *, free: bool, **keys: Any) -> Rigid:
    one = {**box((0.2, 0.2, 0.2), mass=1), "name": "one", "at": [0, 1, 0]}
    two = {**box((0.2, 0.2, 0.2), mass=2), "name": "two", "at": [0.5, 1, 0]}
    to = {"to": "one"} if free else {}
    joints = [
        {"type": "prismatic", "body": "two", "axis": axis, "at": [0.25, 1, 0]}
        | to
        | keys
        for axis in axes
    ]
    bodies = [one, two] if free else [two]
    return Rigid(folder, *bodies, joints=joints, sleep={"speed": 0})


@pytest.mark.parametrize("free", [True, False])
@pytest.mark.parametrize("axes", [[X, Y], [X, [1, 0.01, 0]], [X, Y, Z]])
def test_slides_along_different_ways_lock(
    tmp_path: Path, axes: Any, *, free: bool
) -> None:
    found = slides(tmp_path, axes, free=free)
    assert found.codes() == ["SIM172"] * len(axes)


@pytest.mark.parametrize("free", [True, False])
def test_slides_along_one_way_slide(tmp_path: Path, *, free: bool) -> None:
    assert slides(tmp_path, [X, X], free=free).codes() == []


@pytest.mark.parametrize("free", [True, False])
@pytest.mark.parametrize(
    "drive",
    [{"speed": 1}, {"stiffness": 1e4, "target": 0.3}, {"damping": 3, "speed": 9}],
)
def test_drives_of_what_is_locked_move_nothing(
    tmp_path: Path, drive: dict[str, float], *, free: bool
) -> None:
    found = slides(tmp_path, [X, [1, 2, 0]], free=free, drive=drive)
    begin = found.to(0)
    for t in (0.1, 1.0):
        now = found.to(t)
        moved = now[-1] - now[0] - (begin[-1] - begin[0]) if free else now - begin
        assert np.abs(moved).max() < 0.02
        assert np.abs(found.spins()).max() < 0.05


def test_a_loop_of_slides_stays_bounded(tmp_path: Path) -> None:
    """Three bodies in a ring, each on the next along a way of its own."""
    places = ([0, 0, 0], [0.4, 0, 0], [0.2, 0.35, 0])
    bodies = [
        {**box((0.1, 0.1, 0.1), mass=10.0**k), "name": f"b{k}", "at": at}
        for k, at in enumerate(places)
    ]
    axes = ([1, 0, 0], [0, 1, 1], [1, 1, 0])
    joints = [
        {"type": "prismatic", "body": f"b{a}", "to": f"b{b}", "axis": axis,
         "at": places[a], "drive": {"speed": 2}}
        for (a, b), axis in zip(itertools.pairwise((0, 1, 2, 0)), axes, strict=True)
    ]  # fmt: skip
    found = Rigid(tmp_path, *bodies, joints=joints, forces=[], sleep={"speed": 0})
    found.to(1.0)
    assert "SIM172" in found.codes()
    assert np.abs(found.velocities()).max() < 10


@pytest.mark.parametrize("lean", [0.0, 0.02])
def test_hinges_of_a_door_have_one_axis(tmp_path: Path, lean: float) -> None:
    joints = [
        {"type": "pin", "body": "box", "axis": [0, 1, 0], "at": [-0.4, -0.8, 0]},
        {"type": "pin", "body": "box", "axis": [lean, 1, 0], "at": [-0.4, 0.8, 0]},
    ]
    found = Rigid(tmp_path, box((0.8, 2, 0.04)), joints=joints)
    said = [one for one in found.run.notices if one.code == "SIM172"]
    assert len(said) == (2 if lean else 0)


@pytest.mark.parametrize(
    ("ends", "loops"),
    [
        ([(0, 1), (1, 2)], []),  # a chain
        ([(-1, 0), (0, 1)], []),  # one that hangs
        ([(0, 1), (0, 1)], [[0, 1]]),
        ([(0, 1), (1, 2), (2, 0), (2, 3)], [[0, 1, 2]]),  # with a branch
        ([(-1, 0), (0, 1), (-1, 1)], [[0, 1, 2]]),  # through the world
        ([(-1, 0), (-1, 0), (-1, 1), (-1, 1)], [[0, 1], [2, 3]]),  # each its own
        ([(0, 1), (2, 3), (0, 1), (2, 3), (1, 2)], [[0, 1, 2, 3, 4]]),
        ([], []),
    ],
)
def test_loops_are_of_joints_without_ends_that_are_open(
    ends: list[tuple[int, int]], loops: list[list[int]]
) -> None:
    rows = np.array([(0, *each) for each in ends], np.int64).reshape(-1, 3)
    assert _closed_loops(rows, 4) == loops
