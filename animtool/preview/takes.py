"""Takes of a page: rest skeleton, motion, contacts, and quantization error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from animtool.core.array_types import Float32Array, FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.runs import runs
from animtool.motion.contacts import find_contacts
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import TakeStream
from animtool.preview.draft import PageDraft, number
from animtool.preview.streams import (
    Quantized,
    json_numbers,
    quantized_range,
    quantized_units,
)
from animtool.retarget.anatomy import anatomy
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.rig.kinematics import WorldTransforms, forward
from animtool.rig.skeleton import Rig

# Frames whose joints are in memory at once.
BLOCK_FRAMES = 1024
# Quantization error allowed for weights and scales [1].
WEIGHT_ERROR = 5e-5


@dataclass(frozen=True, slots=True)
class QuantizedTrack:
    """One component of all joints: animated columns and constant values."""

    static: FloatArray  # value of every joint, also animated ones ``(J, K)``
    animated: IntArray  # indices of animated joints ``(A,)``
    values: Float32Array  # of animated joints ``(F, A, K)``

    def dense(self, cut: slice) -> FloatArray:
        """Return the values of all joints in a range of frames ``(F, J, K)``."""
        frames = len(self.values[cut])
        values = np.repeat(self.static[None], frames, axis=0)
        values[:, self.animated] = self.values[cut]
        return values


@dataclass(slots=True)
class PageTake:
    """A take as stored on the page.

    Attributes:
        index: Index of the take on the page.
        rig: The rig.
        first: Page sample of its first frame.
        frames: Number of frames.
        weights: Weights of the rig's shapes ``(F, S)``; None without shapes.
        controls: Values of the rig's controls ``(F, C)``; None without controls.
        world: Returns the joint transforms of a range of frames, with quantization.
        entry: The manifest entry.
    """

    index: int
    rig: Rig
    first: int
    frames: int
    weights: FloatArray | None
    controls: FloatArray | None
    world: Callable[[slice], WorldTransforms]
    entry: dict[str, Any]


class BufferedMotion:
    """Motion of a take in memory as float32; constant joints are stored once.

    Values are rounded as a USD layer of the take would store them, so that a motion
    makes the same page from any file format.
    """

    def __init__(self, blocks: Iterator[Motion], unit: float) -> None:
        """Read all blocks of a motion; ``unit`` is the rig's unit of length [m]."""
        self._unit = unit
        self._rest: dict[str, Channel] = {}
        self._parts: dict[str, list[Float32Array]] = {}
        self.frames = 0
        for block in blocks:
            self.frames += block.frames
            for name in ("translations", "rotations", "scales", "weights", "controls"):
                channel: Channel | None = getattr(block, name)
                if channel is not None:
                    self._rest.setdefault(name, channel)
                    rows = self._stored(name, channel.values)
                    self._parts.setdefault(name, []).append(rows)

    def _stored(self, name: str, values: FloatArray) -> Float32Array:
        """Return values as they would be after writing a layer."""
        if name == "translations":
            exact = (values / self._unit).astype(np.float32).astype(np.float64)
            return (exact * self._unit).astype(np.float32)
        if name == "rotations":
            # Rotations are normalized again when a layer is read, after which they stay
            # equal.
            values_float32 = values.astype(np.float32)
            for _ in range(3):
                values_float32 = so3.normalize(
                    values_float32.astype(np.float64)
                ).astype(np.float32)
            return values_float32
        return values.astype(np.float32)

    def track(self, name: str) -> QuantizedTrack | None:
        """Return a channel; constant joints are not animated."""
        if name not in self._rest:
            return None
        channel, values = self._rest[name], np.concatenate(self._parts.pop(name))
        static = self._stored(name, channel.rest).astype(np.float64)
        is_animated = np.zeros(len(channel.animated), bool)
        if self.frames:
            is_animated = (values != values[:1]).any(axis=(0, 2))
            static[channel.animated] = values[0]
        return QuantizedTrack(
            static, channel.animated[is_animated], values[:, is_animated]
        )

    def rows(self, name: str) -> FloatArray | None:
        """Return the values of a channel of one component ``(F, N)``."""
        track = self.track(name)
        return None if track is None else track.dense(slice(None))[..., 0]


def add_take(
    draft: PageDraft, name: str, stream: TakeStream, motion: BufferedMotion, first: int
) -> PageTake:
    """Add a take to a page.

    Args:
        draft: The page.
        name: Name of the take on the page.
        stream: The take, Y up, at the page's rate.
        motion: Its motion.
        first: Page sample of its first frame.
    """
    rig = stream.rig
    translations, rotations = (
        motion.track(name) or _constant(rest)
        for name, rest in (
            ("translations", rig.rest_translations),
            ("rotations", rig.rest_rotations),
        )
    )
    rotations = _positive_w(rotations)
    scales = motion.track("scales")
    kinds = {"t": translations, "r": rotations, "s": scales}
    quantized = {kind: _stored(kind, track) for kind, track in kinds.items()}
    decoded_tracks = {
        kind: None if track is None else _decoded_track(track, quantized[kind])
        for kind, track in kinds.items()
    }

    def world(
        cut: slice, tracks: dict[str, QuantizedTrack | None] = decoded_tracks
    ) -> WorldTransforms:
        t, r, s = (
            None if track is None else track.dense(cut) for track in tracks.values()
        )
        assert t is not None
        assert r is not None
        return forward(rig, t, so3.normalize(r), s)

    contacts = _measure(draft, rig, motion.frames, world, kinds, stream)
    entry = {
        "name": name,
        "skeleton": _skeleton(rig),
        "still": {kind: _static(track) for kind, track in kinds.items()},
        "moving": {
            kind: [] if track is None else track.animated.tolist()
            for kind, track in kinds.items()
        },
        **{
            kind: None if data is None else draft.packer.add(data)
            for kind, data in quantized.items()
        },
        "shapes": None,
        "contacts": _named_spans(draft, contacts, first),
        "offset": [0.0, 0.0, 0.0],
        "visible": None,
        "span": [first, first + motion.frames - 1],
    }
    draft.takes.append(entry)
    return PageTake(
        len(draft.takes) - 1,
        rig,
        first,
        motion.frames,
        motion.rows("weights"),
        motion.rows("controls"),
        world,
        entry,
    )


def _constant(rest: FloatArray) -> QuantizedTrack:
    empty = np.zeros((0, 0, rest.shape[1]), np.float32)
    return QuantizedTrack(rest, np.zeros(0, np.int64), empty)


def _positive_w(track: QuantizedTrack) -> QuantizedTrack:
    """Return rotations whose first scalar part is positive."""
    static = np.where(track.static[:, 3:] < 0, -track.static, track.static)
    values = track.values
    if len(values):
        values = so3.align_signs(values).astype(np.float32)
        values = np.where(values[:1, :, 3:] < 0, -values, values)
    return QuantizedTrack(static, track.animated, values)


def _stored(kind: str, track: QuantizedTrack | None) -> Quantized | None:
    if track is None or not track.values.size:
        return None
    values = track.values.reshape(len(track.values), -1).astype(np.float64)
    if kind == "r":
        return quantized_units(values)
    return quantized_range(values, WEIGHT_ERROR if kind == "s" else 1e-4)


def _decoded_track(track: QuantizedTrack, data: Quantized | None) -> QuantizedTrack:
    if data is None:
        return track
    values = data.stored * np.asarray(data.scale) + np.asarray(data.offset)
    return QuantizedTrack(
        track.static, track.animated, values.reshape(track.values.shape)
    )


def _static(track: QuantizedTrack | None) -> list[Any] | None:
    return None if track is None else json_numbers(track.static)


def _skeleton(rig: Rig) -> dict[str, Any]:
    return {
        "names": rig.names,
        "parents": rig.parents.tolist(),
        "rest": {
            "t": json_numbers(rig.rest_translations),
            "r": json_numbers(_positive_w(_constant(rig.rest_rotations)).static),
            "s": None,
        },
        "tips": [
            [j, *json_numbers(np.array(tip))]
            for j, joint in enumerate(rig.joints)
            for tip in joint.tips
        ],
    }


def _measure(
    draft: PageDraft,
    rig: Rig,
    frames: int,
    world: Callable[..., WorldTransforms],
    exact: dict[str, QuantizedTrack | None],
    stream: TakeStream,
) -> list[tuple[int, Any]]:
    """Measure the quantization error of a take; return foot contacts."""
    if not rig.joints or not frames:
        return []
    person, legs = _legs(draft, rig)
    joints = sorted({j for leg in legs.values() for j in leg[2:] if j >= 0})
    positions = []
    for begin in range(0, frames, BLOCK_FRAMES):
        frames_ = slice(begin, min(begin + BLOCK_FRAMES, frames))
        stored_world, exact_world = world(frames_), world(frames_, exact)
        offsets = np.linalg.norm(
            stored_world.positions - exact_world.positions, axis=-1
        )
        draft.record_error(position=float(offsets.max(initial=0.0)))
        positions.append(exact_world.positions[:, joints])
    rotations = exact["r"]
    assert rotations is not None
    if rotations.values.size:
        quantized = quantized_units(rotations.values.astype(np.float64))
        stored_rotations = so3.normalize(quantized.stored / 32767.0)
        chords = np.linalg.norm(
            stored_rotations - so3.normalize(rotations.values), axis=-1
        )
        draft.record_error(rotation=2 * float(chords.max()))
    if person is None or frames < 2:
        return []
    feet = dict(zip(joints, np.concatenate(positions).swapaxes(0, 1), strict=True))
    rate = float(stream.fps / stream.step)
    return list(_contacts(person, legs, feet, rate))


Legs = dict[str, tuple[int, int, int, int]]


def _legs(draft: PageDraft, rig: Rig) -> tuple[RoledSkeleton | None, Legs]:
    """Return a rig with roles and its legs; None if it has none."""
    arrays = (rig.rest_translations, rig.rest_rotations, rig.parents)
    key = repr(rig.names).encode() + b"".join(array.tobytes() for array in arrays)
    if key not in draft.cache:
        draft.cache[key] = _find_legs(rig)
    legs: tuple[RoledSkeleton | None, Legs] = draft.cache[key]
    return legs


def _find_legs(rig: Rig) -> tuple[RoledSkeleton | None, Legs]:
    person = RoledSkeleton.of(rig, anatomy(rig).roles)
    legs = {side: leg for side in "lr" if (leg := person.leg(side)) is not None}
    return (person if legs else None), legs


def _contacts(
    person: RoledSkeleton,
    legs: Legs,
    feet: dict[int, FloatArray],
    rate: float,
) -> Iterator[tuple[int, Any]]:
    """Yield foot joints and their contact frames ``(F,)``."""
    for side, leg in legs.items():
        ankle, toe = leg[2:]
        length = person.leg_length(side)
        contacts = find_contacts(feet[ankle], feet.get(toe), rate, length)
        if toe < 0:
            yield ankle, contacts.any
        else:
            yield from ((ankle, contacts.ankle), (toe, contacts.toe))


def _named_spans(
    draft: PageDraft, contacts: list[tuple[int, Any]], first: int
) -> list[dict[str, Any]]:
    timeline = draft.timeline

    def code(frame: int) -> int | float:
        return number(timeline.first + (first + frame) * timeline.step)

    return [
        {
            "joint": joint,
            "spans": [[code(start), code(end - 1)] for start, end in runs(mask)],
        }
        for joint, mask in contacts
    ]
