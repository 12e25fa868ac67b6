"""What is to be written as USD, and what was."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animtool._types import BoolArray
from animtool.clock import FrameSpan, time_fraction
from animtool.errors import Fault
from animtool.maths.curves import Curves
from animtool.rates import rate_from_float
from animtool.rig.skeleton import Rig
from animtool.shot import Shot
from animtool.usd.animation import Rounding, WrittenBlock
from animtool.usd.forms import Form
from animtool.usd.names import RigPaths, UsdNames

if TYPE_CHECKING:
    from animtool.usd.author_props import PropSamples
    from animtool.usd.curves import CurveReport
    from animtool.usd.target import RigTarget


@dataclass(frozen=True, slots=True)
class UsdJob:
    """What `write_usd` needs beside the blocks.

    Attributes:
        form: Stage, split or layer.
        output: The file; None writes usda to stdout.
        rig: The joints, as the blocks have them.
        names: Their USD names.
        joints: Their paths as the Skeleton has them.
        paths: The character's prims.
        fps: Time codes a second.
        meters_per_unit: Unit of the layer [m].
        target: The rig of a layer.
        bones: Add geometry that shows the joints.
        shot: The shot that is written; None is no shot.
    """

    form: Form
    output: Path | None
    rig: Rig
    names: UsdNames
    joints: list[str]
    paths: RigPaths
    fps: Fraction
    meters_per_unit: float
    target: RigTarget | None = None
    bones: bool = False
    shot: Shot | None = None


@dataclass(frozen=True, slots=True)
class UsdTake:
    """One animation of a job.

    Attributes:
        blocks: Its frames, as the layer will hold them.
        start: Time code of the first sample.
        step: Time codes from one sample to the next.
        frames: First and last time code; None takes those of the samples.
        chosen: Joints to write ``(J,)``; None is all.
        shapes: Names of the rig's shapes, as the blocks have their weights.
        curves: Curves of controls, by their names, over time codes of the layer.
        name: Of a library's take, legal and distinct; empty where it is the only
            animation, which needs no variant.
        source_name: What the source of a library's take is called.
        props: Things beside the rig, gathered while the blocks are drawn; None is
            none.
    """

    blocks: Iterable[WrittenBlock]
    start: Fraction
    step: Fraction
    frames: tuple[Fraction, Fraction] | None = None
    chosen: BoolArray | None = None
    shapes: tuple[str, ...] = ()
    curves: Mapping[str, Curves] = field(default_factory=dict)
    name: str = ""
    source_name: str = ""
    props: PropSamples | None = None


@dataclass(slots=True)
class WrittenTake:
    """What was written of one take.

    Attributes:
        animation: Path of its SkelAnimation.
        name: Of a library's take; empty where it is the only one.
        samples: Number of time samples.
        first: Time code of the first frame.
        last: Time code of the last frame.
        sampled: Attributes of the SkelAnimation that change.
        joints: Joints in the SkelAnimation.
        rounding: What rounding to float32, and of scales to float16, moved.
        curves: What became of the curves of controls.
        props: Paths of the things beside the rig.
        notices: What there is to say of its frames.
    """

    animation: str
    name: str = ""
    samples: int = 0
    first: Fraction = Fraction(0)
    last: Fraction = Fraction(0)
    sampled: list[str] = field(default_factory=list)
    joints: int = 0
    rounding: Rounding = field(default_factory=Rounding)
    curves: list[CurveReport] = field(default_factory=list)
    props: list[str] = field(default_factory=list)
    notices: list[Fault] = field(default_factory=list)


def layer_span(layer: Any) -> FrameSpan:
    """Return the frames that a layer states, as reports print them."""
    return FrameSpan(
        time_fraction(layer.startTimeCode),
        time_fraction(layer.endTimeCode),
        rate_from_float(layer.timeCodesPerSecond),
    )


@dataclass(slots=True)
class UsdResult:
    """What was written.

    Attributes:
        span: First frame, last frame and rate that the written layer states.
        outputs: The files.
        bytes: Their size.
        takes: Each animation, at least one.
        notices: Warnings and notes of `animtool.usd.write`.
    """

    span: FrameSpan
    outputs: list[Path] = field(default_factory=list)
    bytes: int = 0
    takes: list[WrittenTake] = field(default_factory=list)
    notices: list[Fault] = field(default_factory=list)

    @property
    def first(self) -> Fraction:
        """Time code of the first frame of any take."""
        return self.span.first

    @property
    def last(self) -> Fraction:
        """Time code of the last frame of any take."""
        return self.span.last

    @property
    def samples(self) -> int:
        """Number of time samples of all takes."""
        return sum(take.samples for take in self.takes)

    @property
    def sampled(self) -> list[str]:
        """Attributes of a SkelAnimation that change in some take."""
        return list(dict.fromkeys(name for take in self.takes for name in take.sampled))

    @property
    def joints(self) -> int:
        """Joints in the SkelAnimation that has most."""
        return max(take.joints for take in self.takes)

    @property
    def rounding(self) -> Rounding:
        """What rounding moved most in any take."""
        return max((take.rounding for take in self.takes), key=lambda r: r.error)

    @property
    def curves(self) -> list[CurveReport]:
        """What became of the curves of controls of all takes."""
        return [curve for take in self.takes for curve in take.curves]
