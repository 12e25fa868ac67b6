"""Clips and a rig for them, made for tests."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np

from animtool.clip.channels import ClipChannel
from animtool.clip.clip import Clip
from animtool.clip.file import load_clip, open_clip
from animtool.core.array_types import ArrayLike
from animtool.maths.curves import Interp
from animtool.maths.tangents import Tangent
from animtool.rig.file import load_rig
from animtool.rig.skeleton import Rig

ARRAYS = {"times", "values", "in_handles", "out_handles", "tcb"}
# Every joint type, in centimetres and degrees; rest frames are turned.
RIG = """rig: animtool/1
name: hero
units: {length: cm, angle: deg}
joints:
- {name: hips, type: free, translate: [7, 95, -3], rotate: [0.6, 0.8, 0, 0]}
- {name: chest, parent: hips, type: ball, translate: [0, 40, 0],
   limits: {swing: 40, twist: [-45, 45], twist_axis: [0, 1, 0]}}
- {name: shoulder_l, parent: chest, type: ball, translate: [20, 10, 0],
   rotate: [0.8, 0, 0.6, 0]}
- {name: elbow_l, parent: shoulder_l, type: pin, axis: [0, 0, 1],
   translate: [28, 0, 0], rotate: [0.6, 0, 0, 0.8], limits: [-10, 150]}
- {name: wrist_l, parent: elbow_l, type: fixed, translate: [26, 0, 0]}
- {name: shoulder_r, parent: chest, type: ball, translate: [-20, 10, 0]}
- {name: piston, parent: hips, type: prismatic, axis: [0, 1, 0],
   translate: [5, 0, 0], rotate: [0.6, 0.8, 0, 0], limits: [0, 10]}
- {name: rod, parent: hips, type: prismatic, axis: [1, 0, 0],
   mimic: {joint: elbow_l, gain: 0.1, offset: 1}}
bind:
  hips: {translate: [5, 94, 2], rotate: [0.8, 0, 0.6, 0]}
  elbow_l: {translate: [28, 1, 0], rotate: [0.28, 0.96, 0, 0]}
controls:
- {name: grin, range: [0, 1], default: 0.25}
- {name: curl, range: [0, 1], drives: [{joint: elbow_l.angle, expr: "curl * 90"}]}
- {name: lean, drives: [{joint: shoulder_r.rotation.x, expr: "lean * 30"}]}
- {name: sway, drives: [{joint: shoulder_r.rotation.x, expr: "sway * 10"}]}
"""


def write_rig(folder: Path, text: str = RIG) -> Path:
    """Write a rig file."""
    path = folder / "hero.rig.yaml"
    path.write_text(text)
    return path


def hero(folder: Path) -> Rig:
    """Return the rig, from a file."""
    return load_rig(write_rig(folder))


def write_clip(folder: Path, channels: str, head: str = "fps: 24") -> Path:
    """Write a clip of the rig beside it."""
    path = folder / "shot.clip.yaml"
    path.write_text(
        f"clip: animtool/1\nrig: hero.rig.yaml\n{head}\nchannels:\n{channels}"
    )
    return path


def loaded(folder: Path, channels: str, head: str = "fps: 24") -> tuple[Clip, Rig]:
    """Return a clip and its rig, from files."""
    rig = hero(folder)
    return load_clip(open_clip(write_clip(folder, channels, head)), rig), rig


def assert_same_clip(found: Clip, expected: Clip) -> None:
    """Assert that two clips are equal to the last bit."""
    assert (found.name, found.fps) == (expected.name, expected.fps)
    assert (found.first, found.last) == (expected.first, expected.last)
    assert len(found.channels) == len(expected.channels)
    for ours, theirs in zip(found.channels, expected.channels, strict=True):
        for field in fields(ClipChannel):
            one, other = getattr(ours, field.name), getattr(theirs, field.name)
            same = np.array_equal(one, other) if field.name in ARRAYS else one == other
            assert same, f"{ours.target}, {field.name}: {one} and {other}"


def channel_of(
    times: ArrayLike,
    values: ArrayLike,
    interp: Interp | tuple[Interp, ...] = Interp.BEZIER,
    tangent: Tangent = Tangent.AUTO,
    **others: object,
) -> ClipChannel:
    """Return a channel; interp and tangent may be the same for all keys."""
    times = np.asarray(times, np.float64)
    values = np.asarray(values, np.float64).reshape(len(times), -1)
    count, width = values.shape
    given: dict[str, object] = {
        "in_handles": np.zeros((count, 1 + width)),
        "out_handles": np.zeros((count, 1 + width)),
        "tcb": np.zeros((count, 3)),
        "tangents": ((tangent, tangent),) * count,
        "interps": (interp,) * count if isinstance(interp, Interp) else interp,
        **others,
    }
    return ClipChannel("control/grin", times, values, **given)  # type: ignore[arg-type]
