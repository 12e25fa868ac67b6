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
    """What `write_usd` needs beside the blocks."""

    form: Form  # stage, split or layer
    output: Path | None  # the file; None writes usda to stdout
    rig: Rig  # the joints, as the blocks have them
    names: UsdNames  # their USD names
    joints: list[str]  # their paths as the Skeleton has them
    paths: RigPaths  # the character's prims
    fps: Fraction  # time codes a second
    meters_per_unit: float  # unit of the layer [m]
    target: RigTarget | None = None  # the rig of a layer
    bones: bool = False  # add geometry that shows the joints
    shot: Shot | None = None  # the shot that is written; None is no shot


@dataclass(frozen=True, slots=True)
class UsdTake:
    """One animation of a job."""

    blocks: Iterable[WrittenBlock]  # its frames, as the layer will hold them
    start: Fraction  # time code of the first sample
    step: Fraction  # time codes from one sample to the next
    # First and last time code; None takes those of the samples.
    frames: tuple[Fraction, Fraction] | None = None
    chosen: BoolArray | None = None  # joints to write ``(J,)``; None is all
    # Names of the rig's shapes, as the blocks have their weights.
    shapes: tuple[str, ...] = ()
    # Curves of controls, by their names, over time codes of the layer.
    curves: Mapping[str, Curves] = field(default_factory=dict)
    # Of a library's take, legal and distinct; empty where it is the only animation,
    # which needs no variant.
    name: str = ""
    source_name: str = ""  # what the source of a library's take is called
    # Things beside the rig, gathered while the blocks are drawn; None is none.
    props: PropSamples | None = None


@dataclass(slots=True)
class WrittenTake:
    """What was written of one take."""

    animation: str  # path of its SkelAnimation
    name: str = ""  # of a library's take; empty where it is the only one
    samples: int = 0  # number of time samples
    first: Fraction = Fraction(0)  # time code of the first frame
    last: Fraction = Fraction(0)  # time code of the last frame
    # Attributes of the SkelAnimation that change.
    sampled: list[str] = field(default_factory=list)
    joints: int = 0  # joints in the SkelAnimation
    # What rounding to float32, and of scales to float16, moved.
    rounding: Rounding = field(default_factory=Rounding)
    # What became of the curves of controls.
    curves: list[CurveReport] = field(default_factory=list)
    props: list[str] = field(default_factory=list)  # paths of the things beside the rig
    # What there is to say of its frames.
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
    """What was written."""

    span: FrameSpan  # first frame, last frame and rate that the written layer states
    outputs: list[Path] = field(default_factory=list)
    bytes: int = 0
    # Each animation, at least one.
    takes: list[WrittenTake] = field(default_factory=list)
    # Warnings and notes of `animtool.usd.write`.
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
