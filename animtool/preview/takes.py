"""Adds takes to a page: skeleton, motion, foot contacts and quantization error."""

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
from animtool.preview.draft import PageDraft, json_number
from animtool.preview.streams import (
    POSITION_TOLERANCE,
    QuantizedValues,
    json_numbers,
    quantize_range,
    quantize_units,
)
from animtool.retarget.anatomy import find_anatomy
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.skeleton import Rig

# Frames whose joints are in memory at once.
BLOCK_FRAMES = 1024
# Quantization error allowed for scales [1].
SCALE_TOLERANCE = 5e-5


@dataclass(frozen=True, slots=True)
class QuantizedTrack:
    """One transform component of all joints, with constant joints stored once."""

    static_values: FloatArray  # value of every joint, also animated ones ``(J, K)``
    animated_joints: IntArray  # indices of animated joints ``(A,)``
    animated_values: Float32Array  # of animated joints ``(F, A, K)``

    def dense_values(self, frame_slice: slice) -> FloatArray:
        """Return the values of all joints in a range of frames ``(F, J, K)``."""
        frame_count = len(self.animated_values[frame_slice])
        values = np.repeat(self.static_values[None], frame_count, axis=0)
        values[:, self.animated_joints] = self.animated_values[frame_slice]
        return values


@dataclass(slots=True)
class PageTake:
    """A take as stored on the page.

    Attributes:
        index: Index of the take on the page.
        rig: The rig.
        first_sample: Page sample of its first frame.
        frames: Number of frames.
        weights: Weights of the rig's shapes ``(F, S)``; None if it has none.
        controls: Values of the rig's controls ``(F, C)``; None if it has none.
        world: Returns the joint transforms of a range of frames, with quantization.
        entry: The manifest entry.
    """

    index: int
    rig: Rig
    first_sample: int
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

    def __init__(self, blocks: Iterator[Motion], meters_per_unit: float) -> None:
        """Read all blocks of a motion; ``meters_per_unit`` is that of its rig."""
        self._meters_per_unit = meters_per_unit
        self._first_channel_by_name: dict[str, Channel] = {}
        self._value_blocks_by_name: dict[str, list[Float32Array]] = {}
        self.frames = 0
        for block in blocks:
            self.frames += block.frames
            for name in ("translations", "rotations", "scales", "weights", "controls"):
                channel: Channel | None = getattr(block, name)
                if channel is not None:
                    self._first_channel_by_name.setdefault(name, channel)
                    rounded_values = self._round_like_layer(name, channel.values)
                    self._value_blocks_by_name.setdefault(name, []).append(
                        rounded_values
                    )

    def _round_like_layer(self, name: str, values: FloatArray) -> Float32Array:
        """Return values rounded as a written USD layer would store them."""
        if name == "translations":
            stored_values = (
                (values / self._meters_per_unit).astype(np.float32).astype(np.float64)
            )
            return (stored_values * self._meters_per_unit).astype(np.float32)
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

    def pop_track(self, name: str) -> QuantizedTrack | None:
        """Remove and return a channel; joints with constant values are not animated."""
        if name not in self._first_channel_by_name:
            return None
        channel, values = (
            self._first_channel_by_name[name],
            np.concatenate(self._value_blocks_by_name.pop(name)),
        )
        static_values = self._round_like_layer(name, channel.rest).astype(np.float64)
        is_animated = np.zeros(len(channel.animated), bool)
        if self.frames:
            is_animated = (values != values[:1]).any(axis=(0, 2))
            static_values[channel.animated] = values[0]
        return QuantizedTrack(
            static_values, channel.animated[is_animated], values[:, is_animated]
        )

    def pop_values(self, name: str) -> FloatArray | None:
        """Remove and return the values of a scalar channel ``(F, N)``."""
        track = self.pop_track(name)
        return None if track is None else track.dense_values(slice(None))[..., 0]


def add_take(
    draft: PageDraft,
    name: str,
    stream: TakeStream,
    motion: BufferedMotion,
    first_sample: int,
) -> PageTake:
    """Add the skeleton, motion and contacts of a take to a page.

    Args:
        draft: The page.
        name: Name of the take on the page.
        stream: The take, Y up, at the page's rate.
        motion: Its motion.
        first_sample: Page sample of its first frame.
    """
    rig = stream.rig
    translations, rotations = (
        motion.pop_track(name) or _constant_track(rest)
        for name, rest in (
            ("translations", rig.rest_translations),
            ("rotations", rig.rest_rotations),
        )
    )
    rotations = _with_positive_w(rotations)
    scales = motion.pop_track("scales")
    tracks_by_component = {"t": translations, "r": rotations, "s": scales}
    quantized_by_component = {
        component: _quantize_track(component, track)
        for component, track in tracks_by_component.items()
    }
    decoded_by_component = {
        component: None
        if track is None
        else _decoded_track(track, quantized_by_component[component])
        for component, track in tracks_by_component.items()
    }

    def world(
        frame_slice: slice,
        tracks: dict[str, QuantizedTrack | None] = decoded_by_component,
    ) -> WorldTransforms:
        """Return the joint transforms of a range of frames from stored tracks."""
        translations_, rotations_, scales_ = (
            None if track is None else track.dense_values(frame_slice)
            for track in tracks.values()
        )
        assert translations_ is not None
        assert rotations_ is not None
        return forward_kinematics(
            rig, translations_, so3.normalize(rotations_), scales_
        )

    contacts = _measure_errors_and_contacts(
        draft, rig, motion.frames, world, tracks_by_component, stream
    )
    entry = {
        "name": name,
        "skeleton": _skeleton_entry(rig),
        "still": {
            component: None if track is None else json_numbers(track.static_values)
            for component, track in tracks_by_component.items()
        },
        "moving": {
            component: [] if track is None else track.animated_joints.tolist()
            for component, track in tracks_by_component.items()
        },
        **{
            component: None if data is None else draft.packer.add(data)
            for component, data in quantized_by_component.items()
        },
        "shapes": None,
        "contacts": _contact_spans(draft, contacts, first_sample),
        "offset": [0.0, 0.0, 0.0],
        "visible": None,
        "span": [first_sample, first_sample + motion.frames - 1],
    }
    draft.takes.append(entry)
    return PageTake(
        len(draft.takes) - 1,
        rig,
        first_sample,
        motion.frames,
        motion.pop_values("weights"),
        motion.pop_values("controls"),
        world,
        entry,
    )


def _constant_track(rest: FloatArray) -> QuantizedTrack:
    """Return a track in which no joint is animated."""
    no_values = np.zeros((0, 0, rest.shape[1]), np.float32)
    return QuantizedTrack(rest, np.zeros(0, np.int64), no_values)


def _with_positive_w(track: QuantizedTrack) -> QuantizedTrack:
    """Return quaternions with continuous signs and a positive first scalar part."""
    static_values = np.where(
        track.static_values[:, 3:] < 0, -track.static_values, track.static_values
    )
    values = track.animated_values
    if len(values):
        values = so3.align_signs(values).astype(np.float32)
        values = np.where(values[:1, :, 3:] < 0, -values, values)
    return QuantizedTrack(static_values, track.animated_joints, values)


def _quantize_track(
    component: str, track: QuantizedTrack | None
) -> QuantizedValues | None:
    """Return the quantized values of a component; None if no joint is animated."""
    if track is None or not track.animated_values.size:
        return None
    values = track.animated_values.reshape(len(track.animated_values), -1).astype(
        np.float64
    )
    if component == "r":
        return quantize_units(values)
    return quantize_range(
        values, SCALE_TOLERANCE if component == "s" else POSITION_TOLERANCE
    )


def _decoded_track(
    track: QuantizedTrack, quantized: QuantizedValues | None
) -> QuantizedTrack:
    """Return a track with the values that the viewer decodes."""
    if quantized is None:
        return track
    values = quantized.stored_values * np.asarray(quantized.scale) + np.asarray(
        quantized.offset
    )
    return QuantizedTrack(
        track.static_values,
        track.animated_joints,
        values.reshape(track.animated_values.shape),
    )


def _skeleton_entry(rig: Rig) -> dict[str, Any]:
    """Return the manifest entry of a rig's skeleton."""
    return {
        "names": rig.names,
        "parents": rig.parents.tolist(),
        "rest": {
            "t": json_numbers(rig.rest_translations),
            "r": json_numbers(
                _with_positive_w(_constant_track(rig.rest_rotations)).static_values
            ),
            "s": None,
        },
        "tips": [
            [j, *json_numbers(np.array(tip))]
            for j, joint in enumerate(rig.joints)
            for tip in joint.tips
        ],
    }


def _measure_errors_and_contacts(
    draft: PageDraft,
    rig: Rig,
    frame_count: int,
    world: Callable[..., WorldTransforms],
    exact_by_component: dict[str, QuantizedTrack | None],
    stream: TakeStream,
) -> list[tuple[int, Any]]:
    """Record the quantization error of a take; return its foot contacts."""
    if not rig.joints or not frame_count:
        return []
    skeleton, leg_by_side = _roles_and_legs(draft, rig)
    foot_joints = sorted({j for leg in leg_by_side.values() for j in leg[2:] if j >= 0})
    foot_positions = []
    for begin in range(0, frame_count, BLOCK_FRAMES):
        block = slice(begin, min(begin + BLOCK_FRAMES, frame_count))
        stored_world, exact_world = world(block), world(block, exact_by_component)
        position_errors = np.linalg.norm(
            stored_world.positions - exact_world.positions, axis=-1
        )
        draft.record_error(position=float(position_errors.max(initial=0.0)))
        foot_positions.append(exact_world.positions[:, foot_joints])
    rotations = exact_by_component["r"]
    assert rotations is not None
    if rotations.animated_values.size:
        quantized_rotations = quantize_units(
            rotations.animated_values.astype(np.float64)
        )
        stored_rotations = so3.normalize(quantized_rotations.stored_values / 32767.0)
        chords = np.linalg.norm(
            stored_rotations - so3.normalize(rotations.animated_values), axis=-1
        )
        draft.record_error(rotation=2 * float(chords.max()))
    if skeleton is None or frame_count < 2:
        return []
    positions_by_foot = dict(
        zip(foot_joints, np.concatenate(foot_positions).swapaxes(0, 1), strict=True)
    )
    rate = float(stream.fps / stream.step)
    return list(_foot_contacts(skeleton, leg_by_side, positions_by_foot, rate))


LegJointsBySide = dict[str, tuple[int, int, int, int]]


def _roles_and_legs(
    draft: PageDraft, rig: Rig
) -> tuple[RoledSkeleton | None, LegJointsBySide]:
    """Return a rig's roles (None if it has no legs) and its legs, cached by rig."""
    arrays = (rig.rest_translations, rig.rest_rotations, rig.parents)
    key = repr(rig.names).encode() + b"".join(array.tobytes() for array in arrays)
    if key not in draft.rig_cache:
        skeleton = RoledSkeleton.of(rig, find_anatomy(rig).roles)
        leg_by_side = {
            side: leg for side in "lr" if (leg := skeleton.leg(side)) is not None
        }
        draft.rig_cache[key] = (skeleton if leg_by_side else None), leg_by_side
    skeleton_and_legs: tuple[RoledSkeleton | None, LegJointsBySide] = draft.rig_cache[
        key
    ]
    return skeleton_and_legs


def _foot_contacts(
    skeleton: RoledSkeleton,
    leg_by_side: LegJointsBySide,
    positions_by_foot: dict[int, FloatArray],
    rate: float,
) -> Iterator[tuple[int, Any]]:
    """Yield each foot joint with a mask of the frames in contact ``(F,)``."""
    for side, leg in leg_by_side.items():
        ankle, toe = leg[2:]
        length = skeleton.leg_length(side)
        contacts = find_contacts(
            positions_by_foot[ankle], positions_by_foot.get(toe), rate, length
        )
        if toe < 0:
            yield ankle, contacts.any
        else:
            yield from ((ankle, contacts.ankle), (toe, contacts.toe))


def _contact_spans(
    draft: PageDraft, contacts: list[tuple[int, Any]], first_sample: int
) -> list[dict[str, Any]]:
    """Return the manifest entries of contacts as spans of page frames."""
    timeline = draft.timeline

    def page_frame(frame: int) -> int | float:
        """Return the page frame of a take's frame."""
        return json_number(timeline.first + (first_sample + frame) * timeline.step)

    return [
        {
            "joint": joint,
            "spans": [
                [page_frame(start), page_frame(end - 1)]
                for start, end in runs(is_in_contact)
            ],
        }
        for joint, is_in_contact in contacts
    ]
