"""Targets files that are written are read as what they were."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support.targets import HEAD, legs, tracks_of

from animtool.clip.channels import ClipUnits
from animtool.ik.file import load_targets
from animtool.ik.tracks import TargetTracks
from animtool.ik.values import ArrayRows, ConstantValue, KeyedValue, SampledValue
from animtool.ik.write import TargetsText, targets_text
from animtool.rig.skeleton import Rig

EVERYTHING = """\
- effector: leg_l
  offset: [0.01, 0, 0.05]
  position: {keys: [{t: 1, v: [0.1, 0.2, 0.3]}, {t: 9.5, v: [0.3, 0.2, 0.1]}]}
  orientation: {euler: ZXY, keys: [{t: 1, v: [10, 20, 30], out: [2, [0, 1, 0]]}]}
  pole: [0.1, 0.4, 2]
  weight: {position: 10, pole: {keys: [{t: 1, v: 0}, {t: 9, v: 1}]}}
  stretch: 0.1
  soft: 0.05
  hold: [[3, 5], [7, 9.5]]
  during: [[2, 9.5], [11, 12]]
  ease: 1.5
- effector: tail
  root: hips
  position: rows.npz#place
  orientation: rows.npz
  weight: 0.3
  priority: 2
- {effector: hips, aim: {axis: [0, 3, 4], at: [0, 1, 2]}, weight: 2}
- {effector: knee_r, aim: {axis: [1, 0, 0], at: rows.npz#place}}
- {effector: leg_r, orientation: [0.6, 0, 0.8, 0]}
"""
RANGE = HEAD + "range: [1, 12]\n"


def given(folder: Path, goals: str = EVERYTHING, head: str = RANGE) -> TargetTracks:
    rng = np.random.default_rng(5)
    turns = rng.normal(size=(12, 4))
    turns /= np.linalg.norm(turns, axis=1)[:, None]
    np.savez(folder / "rows.npz", place=rng.normal(size=(12, 3)), orientation=turns)
    return tracks_of(folder, goals, legs(), head)


def read_back(folder: Path, made: TargetsText, rig: Rig) -> TargetTracks:
    path = folder / "back.targets.yaml"
    path.write_text(made.text, "utf-8")
    named = {name.partition("#")[2]: rows for name, rows in made.arrays.items()}
    if named:
        file = next(iter(made.arrays)).partition("#")[0]
        np.savez(folder / file, allow_pickle=False, **named)
    return load_targets(path, rig)


def check_same(
    a: SampledValue | None, b: SampledValue | None, tolerance: float
) -> None:
    match a, b:
        case ConstantValue(first), ConstantValue(second):
            assert_allclose(first, second, atol=tolerance, rtol=0)
        case ArrayRows(values=first), ArrayRows(values=second):
            assert_allclose(first, second, atol=tolerance, rtol=0)
            assert isinstance(a, ArrayRows)
            assert isinstance(b, ArrayRows)
            assert a.first == b.first
        case KeyedValue(first), KeyedValue(second):
            assert_array_equal(first.times, second.times)
            for name in ("values", "in_handles", "out_handles", "tcb"):
                one, other = getattr(first, name), getattr(second, name)
                assert_allclose(one, other, atol=tolerance, rtol=0)
            for name in ("interps", "tangents", "euler", "pre", "post"):
                assert getattr(first, name) == getattr(second, name)
        case _:
            assert a is None
            assert b is None


@pytest.mark.parametrize(
    ("units", "tolerance"),
    [
        (ClipUnits(1.0, float(np.radians(1.0))), 0.0),
        (ClipUnits(0.01, 1.0), 1e-15),
        (ClipUnits(0.0254, 1.0), 1e-15),
    ],
)
def test_tracks_come_back(tmp_path: Path, units: ClipUnits, tolerance: float) -> None:
    tracks = given(tmp_path)
    # One array is named in the file by the key that it stands under.
    goals = list(tracks.goals)
    values = dict(goals[1].values)
    turns = values["orientation"]
    assert isinstance(turns, ArrayRows)
    values["orientation"] = replace(turns, name="rows.npz#orientation")
    goals[1] = replace(goals[1], values=values)
    tracks = replace(tracks, goals=tuple(goals))
    back = read_back(tmp_path, targets_text(tracks, units), legs())
    assert (back.fps, back.first, back.last) == (tracks.fps, tracks.first, tracks.last)
    assert len(back.goals) == len(tracks.goals)
    for ours, theirs in zip(back.goals, tracks.goals, strict=True):
        for name in ("name", "chain", "spans", "ease", "hold_parts"):
            assert getattr(ours, name) == getattr(theirs, name)
        plain = replace(ours.goal, offset=theirs.goal.offset)
        assert plain == theirs.goal
        assert_allclose(ours.goal.offset, theirs.goal.offset, atol=tolerance, rtol=0)
        assert ours.weights.keys() == theirs.weights.keys()
        for part in ours.values:
            check_same(ours.values[part], theirs.values[part], tolerance)
        for part in ours.weights:
            check_same(ours.weights[part], theirs.weights[part], 0.0)


def test_what_is_written_twice_is_the_same(tmp_path: Path) -> None:
    units = ClipUnits(0.01, float(np.radians(1.0)))
    goals = "- {effector: leg_l, position: rows.npz#place, pole: [0.1, 0.7, 0.3]}\n"
    once = targets_text(given(tmp_path, goals), units)
    again = targets_text(read_back(tmp_path, once, legs()), units)
    assert again.text == once.text


def test_what_the_file_does_not_say_is_not_written(tmp_path: Path) -> None:
    tracks = tracks_of(tmp_path, "- {effector: leg_l, hold: [[1, 4]]}\n", legs())
    made = targets_text(replace(tracks, fps=None), ClipUnits(1.0, 1.0))
    assert made.text == (
        "targets: animtool/1\nunits: {length: m, angle: rad}\n"
        "goals:\n- effector: leg_l\n  hold: [[1, 4]]\n"
    )


def test_what_follows_a_prim_is_not_written(tmp_path: Path) -> None:
    class Elsewhere:
        def at(
            self, frames: object
        ) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
            del frames
            return np.zeros((1, 3))

    tracks = tracks_of(tmp_path, "- {effector: leg_l, position: [0, 1, 2]}\n", legs())
    goal = tracks.goals[0]
    values = {**goal.values, "position": Elsewhere()}
    tracks = replace(tracks, goals=(replace(goal, values=values),))
    with pytest.raises(ValueError, match="follows a prim"):
        targets_text(tracks, ClipUnits(1.0, 1.0))
