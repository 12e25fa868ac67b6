"""Settings, contents and results of writing takes to USD files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import field
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animtool.core.errors import Fault, OptionError
from animtool.core.files.output import STDOUT, is_utf8
from animtool.core.plugins import suffix_text
from animtool.core.record import dataclass

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from animtool.core.array_types import BoolArray, Float32Array, FloatArray
    from animtool.core.clock import FrameSpan
    from animtool.core.shot import Shot
    from animtool.maths.curves import Curves
    from animtool.rig.placement import Placement
    from animtool.rig.skeleton import Rig
    from animtool.usd.layers.names import RigPaths, UsdNames
    from animtool.usd.props.writer import PropSamples
    from animtool.usd.rigs.target import RigTarget
    from animtool.usd.takes.splines import CurveReport


LAYER_SUFFIXES = (".usd", ".usda", ".usdc")


class LayerForm(StrEnum):
    """Which layers to write.

    ``stage`` is one file with skeleton and animation, ``split`` the same in three
    layers, ``layer`` only the animation over a rig in another file, and ``library``
    adds a take to a clip library.
    """

    STAGE = "stage"
    SPLIT = "split"
    LAYER = "layer"
    LIBRARY = "library"


def output_paths(output: Path, form: LayerForm) -> list[Path]:
    """Return the files of a layer form in write order, ``output`` last."""
    if form is not LayerForm.SPLIT:
        return [output]
    return [
        output.with_name(f"{output.stem}.rig.usda"),
        output.with_name(f"{output.stem}.anim.usdc"),
        output,
    ]


def check_path(path: Path) -> None:
    """Refuse a path that USD cannot open (OUT006)."""
    if not is_utf8(str(path.absolute())):
        message = "its path contains bytes that are not UTF-8, which USD cannot open"
        raise OptionError(Fault("OUT006", message, str(path), (), "rename it"))


def check_suffix(path: Path) -> None:
    """Refuse a path without a USD suffix (OUT004)."""
    if path.suffix.lower() in LAYER_SUFFIXES:
        check_path(path)
        return
    message = f"{suffix_text(path)} is not a USD extension"
    hint = f"allowed: {', '.join(LAYER_SUFFIXES)}"
    raise OptionError(Fault("OUT004", message, str(path), (), hint))


@dataclass(frozen=True, slots=True)
class RootTrajectory:
    """The motion of the SkelRoot: translations ``(F, 3)``, rotations ``(F, 4)``.

    Stored in float64, so that it adds no error to the joints.
    """

    translations: FloatArray
    rotations: FloatArray


@dataclass(frozen=True, slots=True)
class WrittenBlock:
    """Joint transforms of a block of frames as written, in stage units."""

    codes: FloatArray  # time codes ``(F,)``
    translations: Float32Array  # ``(F, J, 3)`` float32
    rotations: Float32Array  # ``(F, J, 4)`` float32
    # ``(F, J, 3)`` float16; None if nothing is scaled.
    scales: npt.NDArray[np.float16] | None
    extents: Float32Array  # bounds of the joints, SkelRoot space ``(F, 2, 3)`` float32
    # Motion of the SkelRoot, if it has that of the root joint.
    root: RootTrajectory | None
    error: float  # largest displacement of a joint by rounding [m]
    error_code: float  # time code of the largest error
    error_joint_index: int  # joint with the largest error
    # Weights of the rig's shapes ``(F, S)`` float32; None if it has none.
    weights: Float32Array | None = None
    scale_error: float = 0.0  # largest relative change of a scale by float16


@dataclass(slots=True)
class RoundingError:
    """Largest rounding errors of all written blocks."""

    error: float = 0.0  # largest distance that rounding moved a joint [m]
    code: float = 0.0  # time code of the largest error
    joint_index: int = 0  # joint with the largest error
    # Largest relative change of a scale by UsdSkel's float16.
    scale_error: float = 0.0

    @property
    def has_rounded_scales(self) -> bool:
        """Whether scales were rounded."""
        return self.scale_error > 0.0

    def add_block(self, block: WrittenBlock) -> None:
        """Update the largest rounding errors with those of a block."""
        self.scale_error = max(self.scale_error, block.scale_error)
        if block.error > self.error:
            self.error, self.code = block.error, block.error_code
            self.joint_index = block.error_joint_index


@dataclass(frozen=True, slots=True)
class UsdJob:
    """Rig, prim paths, units and layers of the takes that `write_usd` writes."""

    form: LayerForm
    output: Path  # path of the file, or `STDOUT` for usda
    rig: Rig  # the rig, with joints in the order of the blocks
    names: UsdNames  # USD names of the joints
    joints: list[str]  # joint paths in the Skeleton
    paths: RigPaths  # prim paths of the character
    fps: Fraction  # time codes per second
    meters_per_unit: float  # unit of the layer [m]
    target: RigTarget | None = None  # rig below a layer
    show_bones: bool = False  # whether to add geometry that shows the joints
    shot: Shot | None = None  # shot to record

    @property
    def fault_path(self) -> str | None:
        """Path of the file in faults; None for stdout."""
        return None if self.output == STDOUT else str(self.output)


@dataclass(frozen=True, slots=True)
class UsdTake:
    """One animation that a job writes."""

    blocks: Iterable[WrittenBlock]  # frames, as stored in the layer
    start: Fraction  # time code of the first sample
    step: Fraction  # time codes from one sample to the next
    # First and last time code; None is the range of the samples.
    frames: tuple[Fraction, Fraction] | None = None
    joint_mask: BoolArray | None = None  # joints to write ``(J,)``; None is all
    # Names of the rig's shapes, in the order of the blocks' weights.
    shapes: tuple[str, ...] = ()
    # Curves of controls by name, over time codes of the layer.
    curves: Mapping[str, Curves] = field(default_factory=dict)
    # Legal, unique name in a clip library; empty for a single animation.
    name: str = ""
    source_name: str = ""  # name of a library take's source
    # Props next to the rig, collected while blocks are read; None if there are none.
    props: PropSamples | None = None
    # Placement from take space to the space of a rig layer; see `PropPlacements`.
    rig_from_take: Callable[[FloatArray], Placement] | None = None
    is_reduced: bool = False  # whether redundant samples are removed
    # Recorded rest placement; empty if there is none, or if a rig layer has it.
    rest_metadata: Mapping[str, Any] = field(default_factory=dict)


@dataclass(slots=True)
class WrittenTake:
    """Counts, errors and warnings of one written take, as reported."""

    animation: str  # path of its SkelAnimation
    span: FrameSpan  # first and last frame, and time codes per second
    name: str = ""  # name in a library; empty for a single animation
    samples: int = 0  # number of time samples
    # Attributes of the SkelAnimation with time samples.
    sampled: list[str] = field(default_factory=list)
    joints: int = 0  # joints in the SkelAnimation
    # Errors of rounding to float32, and of scales to float16.
    rounding: RoundingError = field(default_factory=RoundingError)
    # Reports on the control curves.
    curves: list[CurveReport] = field(default_factory=list)
    props: list[str] = field(default_factory=list)  # paths of the props
    # Warnings and notes about its frames.
    notices: list[Fault] = field(default_factory=list)


@dataclass(slots=True)
class UsdResult:
    """Result of `write_usd`: the layer's range and a report per take."""

    span: FrameSpan  # range and rate of the written layer
    outputs: list[Path] = field(default_factory=list)
    bytes: int = 0
    # Written animations, at least one.
    takes: list[WrittenTake] = field(default_factory=list)
    # Warnings and notes of `animtool.usd.write`.
    notices: list[Fault] = field(default_factory=list)

    @property
    def first(self) -> Fraction:
        """Time code of the first frame of all takes."""
        return self.span.first

    @property
    def last(self) -> Fraction:
        """Time code of the last frame of all takes."""
        return self.span.last

    @property
    def samples(self) -> int:
        """Number of time samples of all takes."""
        return sum(take.samples for take in self.takes)

    @property
    def sampled(self) -> list[str]:
        """SkelAnimation attributes that change over time in at least one take."""
        return list(dict.fromkeys(name for take in self.takes for name in take.sampled))

    @property
    def joints(self) -> int:
        """Largest joint count of all SkelAnimations."""
        return max(take.joints for take in self.takes)

    @property
    def rounding(self) -> RoundingError:
        """Rounding errors of the take with the largest joint error."""
        return max((take.rounding for take in self.takes), key=lambda r: r.error)

    @property
    def curves(self) -> list[CurveReport]:
        """Reports on the control curves of all takes."""
        return [curve for take in self.takes for curve in take.curves]
