"""Describes files: their take, or the other contents of a stage."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from animtool.core.errors import Fault, FormatError, OptionError
from animtool.core.readers import FBX, GLTF, reader_of
from animtool.core.record import dataclass
from animtool.core.units import unit_name
from animtool.motion.take import Take, TakeStream
from animtool.retarget.facts import CaptureFacts, measure_capture
from animtool.scene.sources.open import SourceOptions, is_usd, open_checked

if TYPE_CHECKING:
    from animtool.edit.cycle import Cycle
    from animtool.report.describe_characters import CharactersFacts
    from animtool.report.describe_gltf import GltfContents
    from animtool.usd.caches.info import PointPrimSummary


BLOCK_FRAMES = 1024
# Frames at the start of a long take that are searched for a cycle.
MAX_CYCLE_FRAMES = 6000


@dataclass(frozen=True, slots=True)
class TakeDescription:
    """Facts about a take and its file, as `animtool info` prints them."""

    path: str  # path of the file
    format: str  # BVH or USD
    joints: int  # number of joints
    roots: list[str]  # names of joints without a parent
    frames: int  # number of frames
    fps: Fraction  # frames a second, exact
    step: Fraction  # time codes from one frame to the next
    start: Fraction  # time code of the first frame
    end: Fraction  # time code of the last frame
    duration: Fraction  # from the first to the last frame [s]
    channels: int | None  # numbers per frame in a BVH; None for USD
    animated: dict[str, int]  # joints that move, by kind of channel
    shapes: int  # number of blend shapes
    moving_shapes: list[str]  # names of shapes with changing weights
    # Lowest and highest joint position over all frames, in ``units``.
    bounds: tuple[list[float], list[float]]
    units: str  # unit of the file
    up: str  # up axis of the file
    # Names of the takes in a clip library; empty for other files.
    takes: list[str]
    take: str  # name of the described take
    points: list[PointPrimSummary]  # other prims of a USD file with animated points
    notices: list[Fault]  # warnings and notes
    # The shot recorded in a USD layer, as in bake reports; None if there is none.
    shot: dict[str, object] | None = None
    capture: CaptureFacts | None = None  # facts of a captured person; else None
    cycle: Cycle | None = None  # cycle of a person's repeating motion
    # All characters of the stage if it has several and none is selected.
    characters: CharactersFacts | None = None
    contents: GltfContents | None = None  # contents of a glTF or FBX, used or not
    json_keys: ClassVar[str] = "* rate=fps#"

    @property
    def has_frame_step(self) -> bool:
        """Whether the step between frames is not one time code."""
        return self.step != 1

    @property
    def cycle_period(self) -> float | None:
        """Duration of the take's motion cycle [s]."""
        if self.cycle is None:
            return None
        return (self.cycle.last - self.cycle.first) / float(self.fps * self.step)


def describe(path: Path | str, options: SourceOptions | None = None) -> TakeDescription:
    """Read a file and describe its take.

    Args:
        path: A file that `open_source` reads.
        options: How to read it; None is the defaults.

    Raises:
        FormatError: It cannot be read or is malformed.
        OptionError: The suffix is not supported.
    """
    stream = _open_take(path, options)
    take = stream.collect()
    motion, rig = take.motion, take.rig
    block_minima, block_maxima = [], []
    for first_frame in range(0, motion.frames, BLOCK_FRAMES):
        block = motion.select(slice(first_frame, first_frame + BLOCK_FRAMES))
        positions = block.world(rig).positions
        if not rig.joints:
            positions = np.zeros((block.frames, 1, 3))
        block_minima.append(positions.min(axis=(0, 1)))
        block_maxima.append(positions.max(axis=(0, 1)))
    meters = rig.meters_per_unit
    animated_counts = {
        "translation": len(motion.translations.animated),
        "rotation": len(motion.rotations.animated),
    }
    if motion.scales is not None:
        animated_counts["scale"] = len(motion.scales.animated)
    clock = take.clock
    capture = measure_capture(take)
    channel_count = stream.details.get("channels")
    take_names = stream.details.get("takes")
    moving_shapes = [] if motion.weights is None else motion.weights.animated.tolist()
    bounds = np.min(block_minima, axis=0), np.max(block_maxima, axis=0)
    point_prims, shot, characters = _describe_stage(Path(path), options)
    return TakeDescription(
        str(path),
        str(stream.details.get("format", "")),
        len(rig.joints),
        [rig.names[root] for root in rig.roots],
        clock.count,
        clock.rate,
        clock.step,
        clock.start,
        clock.span.last,
        clock.duration,
        channel_count if isinstance(channel_count, int) else None,
        animated_counts,
        len(rig.shapes),
        [rig.shapes[shape].name for shape in moving_shapes],
        ((bounds[0] / meters).tolist(), (bounds[1] / meters).tolist()),
        unit_name(meters),
        rig.up.value,
        take_names if isinstance(take_names, list) else [],
        str(stream.details.get("take", "")),
        point_prims,
        stream.notices,
        shot,
        capture,
        None if capture is None else _find_cycle(take),
        characters,
        _describe_contents(Path(path)),
    )


def _open_take(path: Path | str, options: SourceOptions | None) -> TakeStream:
    """Open a take, without its placement if joints cannot represent it."""
    try:
        return open_checked(Path(path), options)
    except FormatError as error:
        if all(fault.code != "USD035" for fault in error.faults):
            raise
        options_without_placement = replace(
            options or SourceOptions(), placement="drop"
        )
        return open_checked(Path(path), options_without_placement)


def _find_cycle(take: Take) -> Cycle | None:
    """Return the motion cycle of a take if its ends match closely enough."""
    from animtool.edit.cycle import find_cycle
    from animtool.edit.looping import MAX_GOOD_SEAM

    last_frame = min(take.clock.count, MAX_CYCLE_FRAMES) - 1
    try:
        cycle = find_cycle(take, None, float(take.clock.times[last_frame]))
    except OptionError:  # nothing moves, or it is shorter than any cycle
        return None
    return cycle if cycle.share <= MAX_GOOD_SEAM else None


def _describe_stage(
    path: Path, options: SourceOptions | None
) -> tuple[list[PointPrimSummary], dict[str, object] | None, CharactersFacts | None]:
    """Return the animated points, recorded shot and characters of a USD file.

    Characters are None if there is one, or if one is selected.
    """
    if not is_usd(path):
        return [], None, None
    from animtool.report.describe_characters import describe_characters
    from animtool.usd.caches.info import animated_point_prims
    from animtool.usd.layers.sdf import layer_shot, open_layer

    point_prims, shot = animated_point_prims(path), layer_shot(open_layer(path))
    is_selected = options is not None and (options.prim_path or options.take)
    return point_prims, shot, None if is_selected else describe_characters(path)


def _describe_contents(path: Path) -> GltfContents | None:
    """Return the contents of a glTF or FBX file; None for other formats."""
    if reader_of(path) not in {FBX, GLTF}:
        return None
    from animtool.report.describe_gltf import fbx_contents, gltf_contents

    return fbx_contents(path) if reader_of(path) is FBX else gltf_contents(path)
