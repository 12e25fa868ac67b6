"""The keys of a clip file, as models; ``animtool schema clip`` prints them.

The tables of ``docs/reference`` are made of their descriptions and examples.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from annotated_types import Len
from pydantic import Field, WrapValidator

from animtool.clip.plain_keys import PlainKeys, plain_or_each
from animtool.core.array_types import FloatArray
from animtool.documents.check import FileModel
from animtool.documents.fields import IgnoreModel, Name, Pair, Real, Vector, key
from animtool.maths import curves, tangents
from animtool.maths.euler import ORDERS

if TYPE_CHECKING:
    Tangent = str
    Interp = str
    Extrapolated = str
    Parametrized = str
    Order = str
else:
    # A tangent that is free has a handle in place of a rule.
    Tangent = Literal[tuple(str(one) for one in tangents.Tangent if one != "free")]
    Interp = Literal[tuple(map(str, curves.Interp))]
    Extrapolated = Literal[tuple(map(str, curves.Extrapolation))]
    Parametrized = Literal[tuple(map(str, tangents.Parametrization))]
    Order = Literal[ORDERS]
Handle = Annotated[list[Real | list[Real]], Len(2, 2)]


class ClipUnitsModel(FileModel):
    """Units of the numbers in a clip; those of its rig where left out."""

    length: Literal["m", "cm", "mm", "in"] | None = key(
        "Of `translation`, `slide` and `local_translation`. Not given: the rig's.",
        "cm",
        default=None,
    )
    angle: Literal["deg", "rad"] | None = key(
        "Of `angle` and of Euler angles. Not given: the rig's.", "deg", default=None
    )


class KeyModel(FileModel):
    """A key: time [frames], value, and how the curve leaves and meets it."""

    t: Real = key("Frame at the file's `fps`, fractions allowed; keys ascend.", 12.5)
    v: Real | list[Real] = key(
        "The value: one number, three, or a quaternion [w, x, y, z], as "
        "the target has them.",
        80.0,
    )
    interp: Interp | None = key(
        "How it runs to the next key. Not given: as the channel says.",
        "step",
        default=None,
    )
    in_: Tangent | Handle | None = Field(
        default=None,
        alias="in",
        description="How it comes to the key: a rule, or a handle [dt, dv] from the "
        "key, dt ≤ 0 frames. Not given: the channel's `tangents`.",
        examples=[[-2.0, 5.0]],
    )
    out: Tangent | Handle | None = key(
        "How it leaves the key: likewise, dt ≥ 0.", "flat", default=None
    )
    tcb: Vector | None = key(
        "Tension, continuity and bias, for `interp: tcb`. Not given: 0 each.",
        [0.5, 0.0, 0.0],
        default=None,
    )


if TYPE_CHECKING:
    Keys = list[KeyModel] | PlainKeys
else:
    # Those that are plain have no models: these would take most of the time.
    Keys = Annotated[list[KeyModel], WrapValidator(plain_or_each)]


class _TargetModel(FileModel):
    target: Name = key(
        "What moves: control/NAME, shape/NAME or joint/NAME.PART. Each once.",
        "joint/elbow_l.angle",
    )


class JoinModel(FileModel):
    """How keys are joined up."""

    interp: Interp | None = key(
        "How keys run to the next. Not given: `bezier`, and `spline` for quaternions.",
        "linear",
        default=None,
    )
    tangents: Tangent = key(
        "The rule for keys without handles.", "flat", default="auto_clamped"
    )
    parametrization: Parametrized = key(
        "Which Catmull-Rom curve, for `interp: catmull_rom`.",
        "centripetal",
        default="uniform",
    )
    euler: Order | None = key(
        "Makes a rotation of three angles; ZXY is Rz · Rx · Ry, and `v` is "
        "in that order: [z, x, y]. Not given: quaternions.",
        "ZXY",
        default=None,
    )
    pre: Extrapolated = key("Behavior before the first key.", "cycle", default="hold")
    post: Extrapolated = key(
        "Behavior after the last key.", "cycle_offset", default="hold"
    )


class CurveModel(JoinModel):
    """Keys, and how they are joined up."""

    keys: Annotated[Keys, Len(1)] = key("At least one.", [{"t": 1.0, "v": 0.0}])


def key_times(model: CurveModel) -> FloatArray:
    """Return the times of keys ``(K,)``."""
    if isinstance(model.keys, PlainKeys):
        return model.keys.times
    return np.array([key.t for key in model.keys], np.float64)


class ChannelModel(CurveModel, _TargetModel):
    """The keys of one target."""


class ClipModel(FileModel):
    """A clip file."""

    clip: Literal["animtool/1"] = key("File type and format version.", "animtool/1")
    name: str | None = key(
        "What the clip is called. Not given: as the file.", "wave", default=None
    )
    rig: str | None = key(
        "The rig: a rig file, USD file or BVH. Not given: the command line or the "
        "scene names it.",
        "hero.rig.yaml",
        default=None,
    )
    units: ClipUnitsModel = key(
        "Units of the numbers in the file.", {"angle": "deg"}, default=ClipUnitsModel()
    )
    fps: Real | str = key(
        "Frames a second: a number, or a fraction as text.", "24000/1001"
    )
    range: Pair | None = key(
        "First and last frame. Not given: of the first and last key.",
        [1.0, 48.0],
        default=None,
    )
    channels: list[ChannelModel] = key(
        "What moves. None, with a range, holds the rig at rest.",
        [{"target": "control/grip", "keys": [{"t": 1.0, "v": 0.0}]}],
        default=[],
    )
    ignore: list[IgnoreModel] = key(
        "Findings of `animtool validate` that are known and stay.",
        [{"code": "CLIP201", "why": "it is meant"}],
        default=[],
    )
