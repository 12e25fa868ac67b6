"""A take as a glTF animation: sampled, reduced, or with its clip's keys."""

from __future__ import annotations

from dataclasses import field
from fractions import Fraction
from typing import Any

import numpy as np

from animtool.clip.keyed_curve import clip_of, is_of_curve
from animtool.clip.reduction.points import SHELL_DISTANCE, joint_bounds
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, Severity, listed
from animtool.core.record import dataclass
from animtool.formats.gltf.clip_keys import Keys, keys_of_clip, native_keys
from animtool.formats.gltf.glb import GlbBuilder
from animtool.formats.gltf.reduce import linear_keys
from animtool.formats.gltf.sampling import NativeKeys
from animtool.formats.gltf.write_rig import WrittenRig
from animtool.motion.motion import Channel
from animtool.motion.take import Take

# A static value this near to that of the node needs no channel.
SAME = 1e-9


@dataclass(slots=True)
class _Animation:
    """Builder of an animation's samplers and channels."""

    builder: GlbBuilder
    samplers: list[dict[str, Any]] = field(default_factory=list)
    channels: list[dict[str, Any]] = field(default_factory=list)
    parts: list[tuple[int, str, Keys]] = field(default_factory=list)
    # By their identity, times and the accessor that has them.
    inputs: dict[int, tuple[FloatArray, int]] = field(default_factory=dict)

    def input(self, times: FloatArray) -> int:
        """Return the accessor of key times; equal times are stored once."""
        if id(times) not in self.inputs:
            rows = times.astype(np.float32)[:, None]
            self.inputs[id(times)] = (times, self.builder.accessor(rows, bounds=True))
        return self.inputs[id(times)][1]

    def add(self, node: int, path: str, keys: Keys) -> None:
        """Add the keys of a property."""
        self.parts.append((node, path, keys))

    def lasts_until(self, end: float) -> bool:
        """Return whether keys last until a time [s], static ones extended.

        The latter is given a second key there, where it is needed.
        """
        if any(keys.times[-1] >= end for *_, keys in self.parts):
            return True
        for k, (node, path, keys) in enumerate(self.parts):
            if len(keys.times) == 1:
                times = np.array([keys.times[0], end])
                extended = Keys(times, np.repeat(keys.values, 2, axis=0))
                self.parts[k] = (node, path, extended)
                return True
        return False

    def write(self) -> None:
        """Write all samplers and channels."""
        for node, path, keys in self.parts:
            self._write(node, path, keys)

    def _write(self, node: int, path: str, keys: Keys) -> None:
        rows = keys.rows(scalars=path == "weights")
        sampler: dict[str, Any] = {
            "input": self.input(keys.times),
            "output": self.builder.accessor(rows.astype(np.float32, copy=False)),
        }
        if keys.interpolation != "LINEAR":
            sampler["interpolation"] = keys.interpolation
        target = {"node": node, "path": path}
        self.channels.append({"sampler": len(self.samplers), "target": target})
        self.samplers.append(sampler)


def write_clip(
    builder: GlbBuilder,
    take: Take,
    name: str,
    written: WrittenRig,
    scales: FloatArray,
    tolerance: float | None,
) -> list[Fault]:
    """Write a take as an animation; return notices about lost data.

    The first frame is time 0. What stands still is a channel with one key, where it is
    not as the node has it. A take that is still what the keys of its clip say has these
    keys; others have a key a frame, or with a tolerance those that linear keys need.

    Args:
        builder: What it is added to.
        take: Y up.
        name: Of the animation.
        written: Where the rig is in it.
        scales: Of the nodes ``(J, 3)``.
        tolerance: How far keys may move a joint [m]; None keeps a key a frame.
    """
    clock = take.clock
    seconds = (clock.times - float(clock.start)) / float(clock.fps)
    animation = _Animation(builder)
    keyed = {} if tolerance is not None else _source_keys(take)
    bounds = None
    if tolerance is not None:
        bounds = joint_bounds(take.rig, tolerance, {})
    motion, rig = take.motion, take.rig
    parts: list[tuple[str, Channel | None, FloatArray]] = [
        ("translation", motion.translations, rig.rest_translations),
        ("rotation", motion.rotations, rig.rest_rotations),
        ("scale", motion.scales, scales),
    ]
    for path, channel, rest in parts:
        if channel is None:
            continue
        samples = _by_joint(channel, narrow=bounds is None)
        for j in range(len(rig.joints)):
            values = samples.get(j, channel.rest[j][None])
            keys = _joint_keys(path, values, rest[j], seconds)
            if keys is not None and len(keys.times) > 1:
                if (j, path) in keyed:
                    keys = keyed[j, path]
                elif bounds is not None:
                    keys = linear_keys(keys, _tolerance(path, j, bounds, take))
            if keys is not None:
                animation.add(written.joints[j], path, keys)
    left = _weights(animation, take, written, seconds, keyed, tolerance)
    end = float(seconds[-1])
    if tolerance is None and is_of_curve(take):
        native = getattr(take.curve, "native", None)
        end = native.last if isinstance(native, NativeKeys) else end
    if not animation.lasts_until(end):
        # glTF requires a channel: a static joint keeps the name and length of the clip.
        _hold(animation, take, written, seconds[:1])
        animation.lasts_until(end)
    animation.write()
    entry = {
        "name": name,
        "channels": animation.channels,
        "samplers": animation.samplers,
        "extras": {"animtool": _stated(clock.fps, clock.start)},
    }
    builder.add("animations", entry)
    return left


def _source_keys(take: Take) -> dict[tuple[int, str], Keys]:
    """Return the keys of the clip or glTF that a take still equals."""
    start = take.clock.start
    if not is_of_curve(take):
        return {}
    native = getattr(take.curve, "native", None)
    if isinstance(native, NativeKeys):
        return native_keys(native, start)
    clip = clip_of(take)
    return {} if clip is None else keys_of_clip(clip, take, start)


def _hold(
    animation: _Animation, take: Take, written: WrittenRig, times: FloatArray
) -> None:
    """Add a static key for a joint, of the first part without keys."""
    rig = take.rig
    taken = {(node, path) for node, path, _ in animation.parts}
    rests = {"translation": rig.rest_translations, "rotation": rig.rest_rotations}
    for path, rest in rests.items():
        for node, row in zip(written.joints, rest, strict=True):
            if (node, path) not in taken:
                animation.add(node, path, _one(row, times))
                return
    if not rig.joints:
        animation.add(0, "translation", _one(np.zeros(3), times))


def _stated(fps: Fraction, start: Fraction) -> dict[str, Any]:
    """Return the extras from which the reader restores the frames."""
    return {"fps": str(fps), "start": str(start)}


def _one(row: FloatArray, times: FloatArray) -> Keys:
    return Keys(times[:1], row.reshape(1, -1))


def _by_joint(channel: Channel, *, narrow: bool) -> dict[int, FloatArray]:
    """Yield samples of each animated joint ``(F, K)``.

    narrow: whether they are float32, as files have them.
    """
    values = channel.values
    if not len(values):
        return {}
    table = _by_column(values, np.float32 if narrow else np.float64)
    return dict(zip(channel.animated.tolist(), table, strict=True))


def _by_column(values: FloatArray, kind: type[np.floating[Any]]) -> Any:
    """Return samples ``(F, J, K)`` as ``(J, F, K)`` of a dtype.

    Numbers of a joint go as one element, some frames at a time, which stay in the
    cache of the processor.
    """
    frames, joints, width = values.shape
    element = np.dtype((np.void, width * np.dtype(kind).itemsize))
    table = np.empty((joints, frames), element)
    for at in range(0, frames, _FRAMES):
        rows = np.ascontiguousarray(values[at : at + _FRAMES], kind)
        table[:, at : at + _FRAMES] = rows.view(element)[:, :, 0].T
    return table.view(kind).reshape(joints, frames, width)


_FRAMES = 256


def _joint_keys(
    path: str, values: FloatArray, rest: FloatArray, seconds: FloatArray
) -> Keys | None:
    """Return the keys of a joint's samples; None if equal to the node."""
    first = values[0]
    if len(values) > 1 and (values[-1] != first).any():
        return Keys(seconds, values)
    if len(values) > 1 and (values != values[:1]).any():
        return Keys(seconds, values)
    off = np.abs(first - rest).max()
    if path == "rotation":
        off = min(off, np.abs(first + rest).max())
    return None if off <= SAME else _one(first, seconds)


def _tolerance(path: str, joint: int, bounds: FloatArray, take: Take) -> float:
    """Return the key tolerance of a joint: [m], [rad] or [1]."""
    bound = float(bounds[joint])
    if path == "translation":
        return bound
    return bound / max(SHELL_DISTANCE, float(_reach(take)[joint]))


def _reach(take: Take) -> FloatArray:
    """Return the distance from each joint to its farthest descendant ``(J,)`` [m]."""
    rig = take.rig
    reach = np.zeros(len(rig.joints))
    lengths = np.linalg.norm(rig.rest_translations, axis=1)
    for j in range(len(rig.joints) - 1, -1, -1):
        parent = rig.joints[j].parent
        if parent >= 0:
            reach[parent] = max(reach[parent], reach[j] + lengths[j])
    return reach


def _weights(
    animation: _Animation,
    take: Take,
    written: WrittenRig,
    seconds: FloatArray,
    keyed: dict[tuple[int, str], Keys],
    tolerance: float | None,
) -> list[Fault]:
    """Write morph target weights of each mesh."""
    weights = take.motion.weights
    if weights is None:
        return []
    names = [shape.name for shape in take.rig.shapes]
    dense = weights.dense()[:, :, 0]
    rest = animation.builder.json
    for node, shapes in written.targets.items():
        rows = [names.index(shape) for shape in shapes]
        values = dense[:, rows]
        mesh = rest["meshes"][rest["nodes"][node]["mesh"]]
        if (values == values[:1]).all():
            if np.abs(values[0] - mesh["weights"]).max() > SAME:
                animation.add(node, "weights", _weight_keys(values[:1], seconds))
            continue
        keys = Keys(seconds, values)
        if tolerance is not None:
            keys = linear_keys(keys, WEIGHT)
        joined = _joined([keyed.get((row, "weight")) for row in rows], values)
        animation.add(node, "weights", keys if joined is None else joined)
    homeless = [
        names[row]
        for row in weights.animated.tolist()
        if names[row] not in written.shapes
    ]
    if not homeless:
        return []
    message = f"weights of shapes without a mesh are skipped: {listed(homeless)}"
    return [Fault("GLT117", message, severity=Severity.NOTE)]


WEIGHT = 1e-3


def _weight_keys(values: FloatArray, seconds: FloatArray) -> Keys:
    return Keys(seconds[:1], values)


def _same_times(one: Keys, other: Keys) -> bool:
    same = one.interpolation == other.interpolation
    return same and np.array_equal(one.times, other.times)


def _static_keys(like: Keys, value: float) -> Keys:
    """Return keys of one value at another track's times."""
    values = np.full((len(like.times), 1), value)
    slopes = None if like.ins is None else np.zeros_like(values)
    return Keys(like.times, values, like.interpolation, slopes, slopes)


def _merged(parts: list[Keys]) -> Keys | None:
    """Return linear or stepped weight keys at the union of their times."""
    how = parts[0].interpolation
    if how == "CUBICSPLINE" or any(one.interpolation != how for one in parts):
        return None
    times = np.unique(np.concatenate([one.times for one in parts]))
    columns = []
    for one in parts:
        values = one.values[:, 0]
        if how == "STEP":
            before = np.searchsorted(one.times, times, "right") - 1
            columns.append(values[np.clip(before, 0, None)])
        else:
            columns.append(np.interp(times, one.times, values))
    return Keys(times, np.stack(columns, axis=1), how)


def _joined(parts: list[Keys | None], samples: FloatArray) -> Keys | None:
    """Return several weights as one track; None if glTF has none such.

    samples: of the weights ``(F, S)``; those that stand still take the times of others.
    """
    first = next((part for part in parts if part is not None), None)
    if first is None:
        return None
    static = (samples == samples[:1]).all(axis=0).tolist()
    parts = [
        _static_keys(first, float(samples[0, k]))
        if part is None and static[k]
        else part
        for k, part in enumerate(parts)
    ]
    present = [part for part in parts if part is not None]
    if len(present) < len(parts):
        return None
    if not all(_same_times(one, first) for one in present):
        return _merged(present)

    def columns(name: str) -> FloatArray | None:
        rows = [getattr(one, name) for one in present]
        return None if rows[0] is None else np.concatenate(rows, axis=1)

    values = columns("values")
    assert values is not None
    return Keys(
        first.times, values, first.interpolation, columns("ins"), columns("outs")
    )
