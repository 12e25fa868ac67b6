"""Samples long clips block by block, in flat memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from animtool.clip.channels import ClipChannel, evaluate_channels, is_static
from animtool.clip.sample import (
    ClipNotice,
    SampledMotion,
    sample_channels,
    sample_values,
    with_keys,
)
from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.maths import so3
from animtool.maths.curves import Extrapolation
from animtool.motion.motion import CURVE_CHANNELS, Channel, Motion
from animtool.rig.joints import KEYED_PARTS, split_part
from animtool.rig.skeleton import Rig

if TYPE_CHECKING:
    from animtool.motion.driver_run import DriverRun

# Values of joints, shapes and controls in a block: some 10 MB an array.
BLOCK_ROWS = 2**17
# Keys before and after a block that its segments depend on.
MARGIN_KEYS = 3
# Channels with fewer keys are evaluated with all of them.
MANY_KEYS = 256
_ACYCLIC_EXTRAPOLATIONS = frozenset({Extrapolation.HOLD, Extrapolation.LINEAR})


def sample_blocks(
    channels: Sequence[ClipChannel], rig: Rig, times: FloatArray, *, clamp: bool = False
) -> Iterator[SampledMotion]:
    """Yield the motion of `sample_channels` in blocks of consecutive times.

    Blocks share their rest and animated joints. The last one has the notices of all.
    """
    row_count = max(1, len(rig.joints) + len(rig.shapes) + len(rig.controls))
    block_size = max(1, BLOCK_ROWS // row_count)
    if len(times) <= block_size:
        yield sample_channels(channels, rig, times, clamp=clamp)
        return
    block_starts = range(0, len(times), block_size)
    # Each begins with the last time of the one before: signs and moves continue there.
    time_spans = [
        times[max(0, block_start - 1) : block_start + block_size]
        for block_start in block_starts
    ]
    layout = _find_layout(channels, rig, time_spans, clamp=clamp)
    sampler = _BlockSampler(channels, rig, clamp)
    for i, span in enumerate(time_spans):
        motion = layout.arrange(sampler.sample_motion(span), skipped_frames=min(i, 1))
        is_last = i == len(time_spans) - 1
        yield SampledMotion(motion, sampler.notices(times) if is_last else [])


@dataclass(slots=True)
class _BlockSampler:
    """Samples consecutive blocks, and keeps the worst notice of each target."""

    channels: Sequence[ClipChannel]
    rig: Rig
    clamp: bool
    _worst_notice_by_target: dict[tuple[str, str], ClipNotice] = field(
        default_factory=dict, init=False
    )
    _driver_run: DriverRun | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        if self.rig.is_driven:
            from animtool.motion.driver_run import DriverRun

            self._driver_run = DriverRun(self.rig, reports_replaced=True)

    def sample_motion(self, times: FloatArray) -> Motion:
        """Return the motion of the rig at the given times."""
        first, last = float(times.min()), float(times.max())
        channels = [_with_nearby_keys(c, first, last) for c in self.channels]
        values = evaluate_channels(channels, times)
        sampled_motion = sample_values(
            values, self.rig, times, clamp=self.clamp, run=self._driver_run
        )
        for notice in sampled_motion.clip_notices:
            key = notice.fault.code, notice.target
            if (
                key not in self._worst_notice_by_target
                or notice.excess > self._worst_notice_by_target[key].excess
            ):
                self._worst_notice_by_target[key] = notice
        return sampled_motion.motion

    def notices(self, times: FloatArray) -> list[ClipNotice]:
        """Return the worst notice of each target, given the ``times`` of all blocks."""
        notices = [
            with_keys(notice, self.channels, self.rig, times)
            for notice in self._worst_notice_by_target.values()
        ]
        driver_notices = (
            [] if self._driver_run is None else self._driver_run.located_notices()
        )
        return [*notices, *(ClipNotice(*notice) for notice in driver_notices)]


def _with_nearby_keys(channel: ClipChannel, first: float, last: float) -> ClipChannel:
    """Return a channel with only the keys that affect values between two times."""
    has_few_keys = len(channel.times) < MANY_KEYS
    if has_few_keys or not {channel.pre, channel.post} <= _ACYCLIC_EXTRAPOLATIONS:
        return channel
    first_key = int(np.searchsorted(channel.times, first, "right")) - 1 - MARGIN_KEYS
    end_key = int(np.searchsorted(channel.times, last)) + 1 + MARGIN_KEYS
    nearby_keys = slice(max(first_key, 0), end_key)
    return replace(
        channel,
        times=channel.times[nearby_keys],
        values=channel.values[nearby_keys],
        interps=channel.interps[nearby_keys],
        tangents=channel.tangents[nearby_keys],
        in_handles=channel.in_handles[nearby_keys],
        out_handles=channel.out_handles[nearby_keys],
        tcb=channel.tcb[nearby_keys],
    )


@dataclass(slots=True)
class _BlockLayout:
    """Masks of the rows that move in any block, by channel name."""

    is_moving_by_part: dict[str, BoolArray] = field(default_factory=dict)
    _rest_by_channel: dict[str, FloatArray] = field(default_factory=dict, init=False)
    # Rotations at the end of the block before.
    _last_rotations: FloatArray = field(default_factory=so3.IDENTITY.copy, init=False)

    def add_moving_parts(self, motion: Motion) -> None:
        """Mark the rows that move in a block's motion."""
        for part in CURVE_CHANNELS:
            channel: Channel | None = getattr(motion, part)
            if channel is not None:
                no_rows = np.zeros(len(channel.rest), np.bool_)
                is_moving = self.is_moving_by_part.setdefault(part, no_rows)
                is_moving[channel.animated] = True

    def covers(self, targets: set[tuple[str, int]]) -> bool:
        """Return whether all targets, pairs of channel name and row, are moving."""
        return all(
            part in self.is_moving_by_part and self.is_moving_by_part[part][i]
            for part, i in targets
        )

    def arrange(self, motion: Motion, skipped_frames: int) -> Motion:
        """Return a block's motion with the rest values and animated rows of the layout.

        The first ``skipped_frames`` of the block are in the previous block already.
        """
        channel_by_name: dict[str, Any] = {
            part: self._arrange_channel(
                part, getattr(motion, part), motion.frames, skipped_frames
            )
            for part in self.is_moving_by_part
        }
        return replace(motion, **channel_by_name)

    def _arrange_channel(
        self,
        channel_name: str,
        channel: Channel | None,
        frames: int,
        skipped_frames: int,
    ) -> Channel:
        """Return a channel with the rows that move in any block animated."""
        if channel is None:
            row_count = len(self.is_moving_by_part[channel_name])
            channel = Channel.static(np.zeros((row_count, 1)), frames)
        rest = self._rest_by_channel.setdefault(channel_name, channel.rest)
        animated_rows = np.flatnonzero(self.is_moving_by_part[channel_name])
        is_complete = np.array_equal(channel.animated, animated_rows)
        values = channel.values if is_complete else channel.gather(animated_rows)
        if channel_name == "rotations":
            # Within a block signs continue already.
            is_flipped = (values[0] * self._last_rotations).sum(
                axis=-1, keepdims=True
            ) < 0
            if is_flipped.any():
                values = np.where(is_flipped, -values, values)
            self._last_rotations = values[-1]
        return Channel(rest, animated_rows, values[skipped_frames:])


def _find_layout(
    channels: Sequence[ClipChannel],
    rig: Rig,
    time_spans: Sequence[FloatArray],
    *,
    clamp: bool,
) -> _BlockLayout:
    """Return the layout of rows that move in a span; stop once all keyed rows moved."""
    layout, sampler = _BlockLayout(), _BlockSampler(channels, rig, clamp)
    targets = _moving_targets(channels, rig)
    for span in time_spans:
        layout.add_moving_parts(sampler.sample_motion(span))
        if targets is not None and layout.covers(targets):
            break
    return layout


def _moving_targets(
    channels: Sequence[ClipChannel], rig: Rig
) -> set[tuple[str, int]] | None:
    """Return the targets that keys move; None if controls or drivers move others."""
    has_indirect_motion = (
        rig.controls
        or rig.is_driven
        or any(joint.mimic is not None for joint in rig.joints)
        or any(shape.combine for shape in rig.shapes)
    )
    if has_indirect_motion:
        return None
    shape_index_by_name = {shape.name: i for i, shape in enumerate(rig.shapes)}
    moving_targets = set()
    for channel in channels:
        if is_static(channel):
            continue
        group, _, name = channel.target.partition("/")
        if group == "shape":
            moving_targets.add(("weights", shape_index_by_name[name]))
            continue
        joint, part = split_part(name, KEYED_PARTS)
        component = {"angle": "rotation", "slide": "translation"}.get(part, part)
        moving_targets.add((f"{component.removeprefix('local_')}s", rig.index(joint)))
    return moving_targets
