"""What a bake can be told, and reading it from text."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, fields, replace
from fractions import Fraction
from pathlib import Path

from animtool.edit.frame_range import FrameRange
from animtool.errors import Fault, OptionError, excerpt
from animtool.rates import LARGEST_FRAME, exact_number, rate_label, rate_option
from animtool.scene.sources import SourceOptions
from animtool.shot import Shot
from animtool.units import LengthUnit, UpAxis


@dataclass(frozen=True, slots=True)
class BakeOptions:
    """How to bake.

    Attributes:
        source: What the source is, where its file does not say.
        form: ``stage``, ``split``, ``layer`` or ``library``; None is a layer where
            there is a rig layer, else a stage.
        rig_layer: The rig, or a shot that holds it, for a layer.
        force_fit: Write a take that does not fit the rig all the same.
        take: Name of a library's take; None is that of the source.
        prim_path: Where the character stands; None is ``/{name of the source}``,
            or where the rig layer has it.
        bones: Add geometry that shows the joints.
        strip_namespace: Leading ``ns:`` parts of joint names to drop.
        rest_frame: Frame whose pose becomes the rest pose; None keeps the source's.
        fps: Frames a second of the output; a number or text such as ``23.976``
            becomes a fraction. None is the rig layer's or the source's.
        frame_range: Frames to write.
        shot: The shot that is written: its frames, where there is no range, at its
            rate. The pose of frames that the take lacks is held.
        start: Time code of the first frame of the take; None is where the shot has
            it, the rig layer's, the project's, or 1.
        samples: Sub-frame samples around each frame, in frames.
        keep_samples: Keep the source's samples at fractional time codes.
        to_units: Unit of the output; None is the rig layer's or the source's.
        to_up: Up axis of the output; likewise.
        root_motion: Let the SkelRoot carry the first root joint's motion.
        sparse: Write only the joints that are not at rest throughout.
        keep_curves: Write the curves of controls beside the samples that they made.
        reduce: Leave out samples that the others give back within so much [m]; None
            keeps all.
        reduce_at: Other tolerances for some joints: names or patterns, and [m].
        deform: Write deformed meshes as point caches, in place of a skinned character.
        velocities: Of points too, per second.
        normals: Of meshes that have them: None and True deform these too, False leaves
            meshes without.
        chunk: Samples of point caches, and of systems, in each of several files; None
            is one file.
        strict: Take warnings for errors.
        overwrite: Replace outputs that exist.

    Raises:
        OptionError: fps is no rate (CLI006).
    """

    source: SourceOptions = field(default_factory=SourceOptions)
    form: str | None = None
    rig_layer: Path | None = None
    force_fit: bool = False
    take: str | None = None
    prim_path: str | None = None
    bones: bool = False
    strip_namespace: int = 0
    rest_frame: int | None = None
    fps: Fraction | None = None
    frame_range: FrameRange | None = None
    shot: Shot | None = None
    start: Fraction | None = None
    samples: tuple[Fraction, ...] = ()
    keep_samples: bool = False
    to_units: LengthUnit | None = None
    to_up: UpAxis | None = None
    root_motion: bool = False
    sparse: bool = False
    keep_curves: bool = False
    reduce: float | None = None
    reduce_at: tuple[tuple[str, float], ...] = ()
    deform: bool = False
    velocities: bool = False
    normals: bool | None = None
    chunk: int | None = None
    strict: bool = False
    overwrite: bool = False

    def __post_init__(self) -> None:
        """Take the rate as it is written."""
        if self.fps is not None:
            object.__setattr__(self, "fps", rate_option(self.fps, "CLI006"))
        if self.shot is not None:
            if self.frame_range is None:
                frames = FrameRange(self.shot.start, self.shot.end)
                object.__setattr__(self, "frame_range", frames)
            if self.fps is None:
                object.__setattr__(self, "fps", self.shot.fps)


def merged(options: BakeOptions, others: BakeOptions) -> BakeOptions:
    """Return options, and where they are the usual ones, those of others."""
    usual = BakeOptions()
    taken = {
        field.name: getattr(others, field.name)
        for field in fields(BakeOptions)
        if getattr(options, field.name) == getattr(usual, field.name)
    }
    return replace(options, **taken)


_RANGE = re.compile(r"(-?\d{1,9})(?:-(-?\d{1,9})(?:x(\d{1,9}))?)?")


def parse_frame_range(text: str) -> FrameRange:
    """Return the range of ``1-240``, ``1-240x2`` or ``12``.

    Raises:
        ValueError: It is none.

    >>> parse_frame_range("1-240x2")
    FrameRange(first=1, last=240, step=2)
    """
    match = _RANGE.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"{text!r} is not a range such as 1-240 or 1-240x2")
    first = int(match[1])
    last, step = int(match[2] or first), int(match[3] or 1)
    if last < first or step < 1:
        raise ValueError(f"{text!r} has no frame")
    return FrameRange(first, last, step)


def parse_offsets(text: str) -> tuple[Fraction, ...]:
    """Return the offsets of ``-.25,0,.25``, ascending.

    Raises:
        ValueError: One is no number within a frame, or stands twice.

    >>> parse_offsets("-.25,0,.25")
    (Fraction(-1, 4), Fraction(0, 1), Fraction(1, 4))
    """
    offsets: list[Fraction] = []
    for part in text.split(","):
        try:
            offset = exact_number(part)
        except (ValueError, ArithmeticError) as error:
            message = f"{excerpt(text)} is not a list of offsets such as -.25,0,.25"
            raise ValueError(message) from error
        if not -1 < offset < 1:
            raise ValueError(f"offset {part.strip()} is not within a frame")
        offsets.append(offset)
    if len(set(offsets)) < len(offsets) or max(offsets) - min(offsets) >= 1:
        raise ValueError(f"offsets {text!r} meet those of the next frame")
    return tuple(sorted(offsets))


def parse_frame(text: str) -> Fraction:
    """Return a time code such as ``1001`` or ``1000.5``.

    Raises:
        ValueError: It is none, or beyond a thousand million.

    >>> parse_frame("1000.5")
    Fraction(2001, 2)
    """
    try:
        frame = exact_number(text)
    except (ValueError, ArithmeticError) as error:
        raise ValueError(f"{excerpt(text)} is not a frame such as 1001") from error
    if abs(frame) > LARGEST_FRAME:
        raise ValueError(f"frame {text!r} is beyond {LARGEST_FRAME}")
    return frame


def parse_rest(text: str) -> int | None:
    """Return the frame of ``frame:N``, None for ``offsets``.

    Raises:
        ValueError: It is neither.

    >>> parse_rest("frame:12")
    12
    """
    if text == "offsets":
        return None
    match = re.fullmatch(r"frame:(-?\d{1,9})", text)
    if match is None:
        raise ValueError(f"{text!r} is neither offsets nor frame:N")
    return int(match[1])


def check_options(
    options: BakeOptions, *, to_stdout: bool, simulated: bool = False
) -> None:
    """Raise `OptionError` where options exclude each other.

    Args:
        options: Of the bake.
        to_stdout: Whether the output is no file.
        simulated: Whether systems are written.
    """
    form = options.form or ("layer" if options.rig_layer else "stage")
    clashes = _layer_clashes(options, form)
    if form == "library":
        clashes += _library_clashes(options, to_stdout=to_stdout)
    clashes.append(
        (form == "split" and to_stdout, "--split writes three files, not stdout")
    )
    clashes += _sample_clashes(options)
    clashes += _shot_clashes(options, form)
    clashes += _deform_clashes(options, form)
    clashes += _chunk_clashes(options, to_stdout=to_stdout, simulated=simulated)
    faults = [Fault("CLI002", message) for wrong, message in clashes if wrong]
    if faults:
        raise OptionError(faults)


def _layer_clashes(options: BakeOptions, form: str) -> list[tuple[bool, str]]:
    """Return what animation over a rig layer does not go with, and whether it is so."""
    return [
        (form == "layer" and options.rig_layer is None, "--as layer needs --rig-layer"),
        (
            form != "layer" and options.rig_layer is not None,
            "--rig-layer goes with --as layer",
        ),
        (form == "layer" and options.bones, "--bones never goes into a layer"),
        (
            form == "layer" and options.rest_frame is not None,
            "--rest frame:N sets a skeleton's rest pose, which a layer does not hold",
        ),
        (
            form == "layer" and (options.to_units or options.to_up) is not None,
            "a layer adopts its rig layer's units and up axis: no --to-units, --to-up",
        ),
    ]


def _library_clashes(
    options: BakeOptions, *, to_stdout: bool
) -> list[tuple[bool, str]]:
    """Return what a take of a library does not go with, and whether it is asked for."""
    flags = [
        (to_stdout, "-o -"),
        (options.deform, "--deform"),
        (options.bones, "--bones"),
        (options.rest_frame is not None, "--rest frame:N"),
        (options.to_units is not None, "--to-units"),
        (options.to_up is not None, "--to-up"),
    ]
    return [
        (asked, f"a take of a library goes without {flag}") for asked, flag in flags
    ]


def _sample_clashes(options: BakeOptions) -> list[tuple[bool, str]]:
    """Return what of samples excludes each other, and whether it is asked for."""
    return [
        (
            options.keep_samples and bool(options.samples),
            "--keep-samples and --samples exclude each other",
        ),
        (
            options.reduce is not None and bool(options.samples),
            "--reduce and --samples exclude each other",
        ),
        (
            options.reduce is not None and options.root_motion,
            "--reduce measures joints: no --root-motion skelroot",
        ),
        (
            options.reduce is None and bool(options.reduce_at),
            "--reduce-at goes with --reduce",
        ),
    ]


def _shot_clashes(options: BakeOptions, form: str) -> list[tuple[bool, str]]:
    """Return what excludes a shot that places its media, and whether it is so."""
    shot = options.shot
    if shot is None or not shot.places_media or shot.fps is None:
        return []
    named = f"shot {shot.name}" if shot.name else "the shot"
    return [
        (
            options.fps != shot.fps,
            f"--fps {options.fps} is not the rate of {named}, {rate_label(shot.fps)}",
        ),
        (
            options.start is not None,
            f"--start: {named} begins at {shot.start}, as its timeline says",
        ),
        (form == "library", f"{named} is not a take of a library"),
    ]


def _chunk_clashes(
    options: BakeOptions, *, to_stdout: bool, simulated: bool
) -> list[tuple[bool, str]]:
    """Return what chunks do not go with, and whether it is asked for."""
    if options.chunk is None:
        return []
    if not (options.deform or simulated):
        return [(True, "--chunk goes with --deform, or a scene that has systems")]
    message = f"--chunk needs 1 sample a file or more, not {options.chunk}"
    return [
        (to_stdout, "--chunk writes several files, not stdout"),
        (options.chunk < 1, message),
    ]


def _deform_clashes(options: BakeOptions, form: str) -> list[tuple[bool, str]]:
    """Return what does not go with point caches, and whether it is asked for."""
    if not options.deform:
        return [
            (options.velocities, "--velocities goes with --deform"),
            (options.normals is False, "--no-normals goes with --deform"),
        ]
    joints = "--deform writes points, no joints"
    return [
        (form == "split", f"{joints}: no --split"),
        (options.bones, f"{joints}: no --bones"),
        (options.sparse, f"{joints}: no --sparse"),
        (options.reduce is not None, f"{joints}: no --reduce"),
        (options.root_motion, f"{joints}: no --root-motion skelroot"),
        (options.keep_curves, f"{joints}: no --keep-curves"),
        (options.rest_frame is not None, f"{joints}: no --rest frame:N"),
    ]
