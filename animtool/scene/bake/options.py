"""Options of a bake, shared by commands, scenes, batches and Python."""

from __future__ import annotations

from dataclasses import field, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from animtool.clip.reduction.tolerance import KEY_TOLERANCE
from animtool.core.arguments import argument
from animtool.core.errors import Fault, OptionError
from animtool.core.options import (
    Key,
    convert_option_values,
    inherits_docs,
    option,
)
from animtool.core.rates import FractionLike, OptionalFraction, rate_option
from animtool.core.record import dataclass
from animtool.core.shot import FrameRange, FrameRangeLike, OptionalRange, Shot
from animtool.core.units import LengthUnit, UpAxis
from animtool.scene.file.option_text import parse_frame, parse_frame_range
from animtool.scene.sources.open import SourceOptions

_ADOPTED_OPTIONS = (
    "a layer adopts its rig layer's units and up axis: remove "
    f"{argument('to_units')}, {argument('to_up')}"
)


@inherits_docs
@dataclass(frozen=True, slots=True)
class BakeOptions:
    """Options of a bake.

    Attributes:
        source: Properties of the source that its file does not state.
        shot: The shot to write: it determines the frames, unless there is a range, and
            the rate. Frames that the take lacks hold its nearest pose.
        root_motion: Whether the SkelRoot carries the motion of the first root joint.

    Raises:
        OptionError: fps is not a rate (SCN022), or start is not a frame (SCN033).
    """

    source: SourceOptions = field(default_factory=SourceOptions)
    form: str | None = option(
        None,
        "choice",
        not_for=("file",),
        flag="as",
        scene=Key(
            "One file, three, an animation layer, or a take added to a clip library. "
            "Default: `layer` with `rig_layer`, else `stage`.",
            "split",
            ("stage", "split", "layer", "library"),
            "as",
        ),
        batch=Key(
            "One file, three, or an animation layer. Default: `layer` with "
            "`rig_layer`, else `stage`.",
            "split",
            ("stage", "split", "layer"),
            "as",
        ),
        choices=("stage", "layer", "library"),
        help="One file with skeleton and animation, or only the animation, over a "
        "rig layer; or a clip library, for a glTF with all its clips.  "
        f"[default: layer with {argument('rig_layer')}, else stage]",
    )
    rig_layer: Path | None = option(
        None,
        "file",
        not_for=("systems", "file"),
        common_key=Key(
            "The USD rig that a layer goes over, or a shot that contains it.",
            "hero.usda",
        ),
        help="The USD rig that a layer is for, or a shot that contains it; the layer "
        "adopts its units, up axis, rate and start.",
    )
    force_fit: bool = option(
        False,
        "switch",
        common_key=Key("Write a take even if it does not match the rig.", True),
        help="Write a take even if it does not match the rig.",
    )
    take: str | None = option(
        None,
        "text",
        not_for=("file",),
        scene=Key(
            "With `as: library`: name of the take. Default: name of the scene.", "walk"
        ),
    )
    prim_path: str | None = option(
        None,
        "text",
        not_for=("file",),
        scene=Key(
            "Path of the character. Default: /NAME of the source, or its path in the "
            "rig layer.",
            "/World/hero",
        ),
        batch=Key("Path of the character. Default: as in `bake`.", "/World/hero"),
        metavar="PATH",
        help="Path of the character in the output, such as /World/hero.",
    )
    placement: str | None = option(
        None,
        "choice",
        not_for=("systems",),
        common_key=Key(
            "Keep or drop the placement of a USD source's character, its position "
            "and heading on the stage. Size and up axis are kept. Default: `keep`; "
            "for a layer over a rig with its own placement: `drop`.",
            "drop",
            ("keep", "drop"),
        ),
        choices=("keep", "drop"),
        help="Keep or drop the placement of a USD source's character, its position "
        "and heading on the stage. Size and up axis are kept.  [default: keep; "
        "drop in a layer over a rig with its own placement]",
    )
    bones: bool = option(
        False,
        "switch",
        not_for=("systems", "library", "deform", "file"),
        layer_refusal=f"{argument('bones', True)} has no effect on a layer",
        common_key=Key("Add geometry that shows the joints.", True),
        help="Add light geometry that shows the joints.",
    )
    strip_namespace: int = option(
        0,
        "count",
        not_for=("systems", "file"),
        metavar="N",
        help="Drop the first N 'ns:' parts of joint names; 1 drops 'mixamorig:'.",
    )
    rest_frame: int | None = option(
        None,
        "rest",
        flag="rest",
        not_for=("systems", "library", "deform", "file"),
        layer_refusal=f"{argument('rest_frame')} sets the rest pose of a skeleton, "
        "which a layer does not contain",
        metavar="offsets|frame:N",
        help="Source of the rest pose.  [default: offsets]",
    )
    fps: OptionalFraction = option(
        None,
        "rate",
        batch=Key(
            "Frames per second of the outputs. Default: the rig layer's, or each "
            "source's.",
            24,
        ),
        help="Frames per second of the output.",
    )
    frame_range: OptionalRange = option(
        None,
        "range",
        flag="range",
        batch=Key(
            "First and last frame to write, in frame numbers of the outputs. "
            "Default: all.",
            [1001, 1040],
            alias="range",
        ),
        help="Frames to write, such as 1-240, 1-240x2 or 12, in frame numbers of the "
        "output.",
    )
    shot: Shot | None = None
    start: OptionalFraction = option(
        None,
        "frame",
        scene=Key(
            "Time code of the first frame; with systems only, that of 0 s, while "
            "`range` keeps its numbers. Default: the rig layer's, the source's, the "
            "project's, or 1; with systems only the first of the range.",
            1001,
        ),
        batch=Key("Time code of the first frame. Default: as in `bake`.", 1001),
        help="Time code of the first frame; in a scene with systems only, that of 0 "
        "s, when the simulation starts: frames of the range keep their numbers. "
        " [default: the rig layer's, the project's, 1; for a shot the "
        "timeline's, the project's, 1001; with systems only the first of the range]",
    )
    samples: tuple[Fraction, ...] = option(
        (),
        "offsets",
        not_for=("file",),
        scene=Key(
            "Samples around each frame, in frames, for motion blur. Default: one on "
            "the frame.",
            [-0.25, 0, 0.25],
        ),
        help="Samples around each frame, such as -.25,0,.25.",
    )
    keep_samples: bool = option(
        False,
        "switch",
        not_for=("systems", "file"),
        excludes={"samples": ""},
        help="Keep the source's own samples.",
    )
    to_units: LengthUnit | None = option(
        None,
        "unit",
        not_for=("library", "file"),
        layer_refusal=_ADOPTED_OPTIONS,
        batch=Key("Unit of the outputs. Default: each source's.", "m"),
        help="Unit of the output.",
    )
    to_up: UpAxis | None = option(
        None,
        "axis",
        not_for=("library", "file"),
        layer_refusal=_ADOPTED_OPTIONS,
        batch=Key("Up axis of the outputs. Default: each source's.", "Y"),
        help="Up axis of the output.",
    )
    root_motion: bool = option(
        False,
        "switch",
        not_for=("systems", "deform", "file"),
        choices=("joint", "skelroot"),
        help="What carries the root motion.  [default: joint]",
    )
    sparse: bool = option(
        False,
        "switch",
        not_for=("systems", "deform", "file"),
        common_key=Key("Write only joints that leave their rest pose.", True),
        help="Write only joints that leave their rest pose.",
    )
    keep_curves: bool = option(
        False,
        "switch",
        not_for=("systems", "deform", "file"),
        scene=Key(
            "For a clip: also write the curves of its controls as splines.", True
        ),
        help="Also write the curves of a clip's controls, as editable splines.",
    )
    reduce: float | None = option(
        None,
        "length",
        not_for=("systems", "deform", "file"),
        excludes={
            "samples": "",
            "root_motion": f"{argument('reduce')} measures joints: remove "
            f"{argument('root_motion', True)}",
        },
        scene=Key(
            "Leave out samples that interpolation restores within this length. "
            f"Default: keep all; for keys: {KEY_TOLERANCE}.",
            "0.5mm",
        ),
        batch=Key(
            "Leave out samples that interpolation restores within this length. "
            "Default: keep all.",
            "0.5mm",
        ),
        help="Leave out samples that interpolation restores within this length, such "
        "as 0.5mm.",
    )
    reduce_at: tuple[tuple[str, float], ...] = option(
        (),
        "lengths",
        required_option="reduce",
        common_key=Key("Other tolerances, by joint or pattern.", {"hand_*": "0.1mm"}),
        help=f"Another tolerance of {argument('reduce')} for a joint or a pattern, "
        "such as 'hand_*=0.1mm'; repeatable.",
    )
    deform: bool = option(
        False,
        "switch",
        not_for=("systems", "library", "file"),
        scene=Key(
            "Write the meshes deformed, as point caches, instead of a skinned "
            "character.",
            True,
        ),
        help="Write the meshes and strands of the rig deformed, as point caches, "
        "instead of a skinned character: points, extent, and normals of meshes "
        "that have them.",
    )
    velocities: bool = option(
        False,
        "switch",
        not_for=("file",),
        required_option="deform",
        scene=Key("With `deform`: also write velocities of points, per second.", True),
        help=f"With {argument('deform', True)}, also write velocities of points, per "
        "second, for motion blur.",
    )
    normals: bool | None = option(
        None,
        "answer",
        not_for=("file",),
        required_option="deform",
        scene=Key("With `deform`: whether meshes keep normals. Default: yes.", False),
        help=f"With {argument('deform', True)}, whether meshes keep normals, which "
        "take half of the file.  [default: normals]",
    )
    chunk: int | None = option(
        None,
        "count",
        not_for=("file",),
        scene=Key(
            "For `deform` and systems: number of samples in each file. Default: one "
            "file.",
            500,
        ),
        metavar="N",
        min_count=1,
        help=f"For {argument('deform', True)} and systems of a scene: write long "
        "takes as a file for every N samples, joined as value clips; memory "
        "holds two or three files.",
    )
    keep_stopped: bool = option(
        False,
        "switch",
        not_for=("file",),
        scene=Key(
            "If a system stops before the last frame, write the frames before that. "
            "The bake still fails.",
            True,
        ),
        help="If a system of a scene blows up, write the frames before that; the "
        "exit code is still 4.",
    )
    strict: bool = option(
        False,
        "switch",
        batch=Key("Treat warnings as errors.", True),
        help="Treat warnings as errors and write nothing.",
    )
    overwrite: bool = option(False, "switch", help="Replace outputs that exist.")

    def __post_init__(self) -> None:
        """Convert rates, frames, units and lengths from numbers or text."""
        convert_option_values(self)
        if self.fps is not None:
            object.__setattr__(self, "fps", rate_option(self.fps))
        start: Any = self.start
        frame_range: Any = self.frame_range
        if not isinstance(start, Fraction | None):
            object.__setattr__(self, "start", _frame_option(start))
        if not isinstance(frame_range, FrameRange | None):
            object.__setattr__(self, "frame_range", _range_option(frame_range))
        if self.shot is not None:
            if self.frame_range is None:
                frames = FrameRange(self.shot.start, self.shot.end)
                object.__setattr__(self, "frame_range", frames)
            if self.fps is None:
                object.__setattr__(self, "fps", self.shot.fps)


def _range_option(frames: FrameRangeLike) -> FrameRange:
    """Parse a frame range from text, a pair of frames or a list (SCN003)."""
    try:
        if isinstance(frames, str):
            return parse_frame_range(frames)
        return FrameRange.of(frames)
    except (TypeError, ValueError) as error:
        raise OptionError(Fault("SCN003", f"frame_range: {error}")) from error


def _frame_option(start: FractionLike) -> Fraction:
    """Parse a time code from text or a number (SCN033)."""
    try:
        return parse_frame(start)
    except ValueError as error:
        raise OptionError(Fault("SCN033", f"start: {error}")) from error


def with_fallbacks(options: BakeOptions, fallback_options: BakeOptions) -> BakeOptions:
    """Return options in which default values are replaced by the fallback values."""
    defaults, names = BakeOptions(), [entry.name for entry in fields(BakeOptions)]
    overrides = {
        name: getattr(fallback_options, name)
        for name in names
        if getattr(options, name) == getattr(defaults, name)
    }
    return replace(options, **overrides)
