"""The keys of a clip file, as models; ``animtool schema clip`` prints them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from annotated_types import Len
from pydantic import Field, WrapValidator

from animtool.core.array_types import FloatArray
from animtool.core.options import key
from animtool.documents.check import FileModel
from animtool.documents.fields import IgnoreModel, Name, NumberPair, Real, Vector
from animtool.maths import curves, tangents
from animtool.maths.euler import ORDERS

if TYPE_CHECKING:
    TangentName = str
    InterpName = str
    ExtrapolationName = str
    ParametrizationName = str
    EulerOrder = str
else:
    # A free tangent has a handle.
    TangentName = Literal[
        tuple(str(rule) for rule in tangents.Tangent if rule != "free")
    ]
    InterpName = Literal[tuple(map(str, curves.Interp))]
    ExtrapolationName = Literal[tuple(map(str, curves.Extrapolation))]
    ParametrizationName = Literal[tuple(map(str, tangents.Parametrization))]
    EulerOrder = Literal[ORDERS]
from collections.abc import Callable
from itertools import chain
from typing import Any

from animtool.core.record import dataclass
from animtool.documents.fields import MAX_NUMBER

_NUMBERS = {int, float}
_PLAIN_KEYS = {"t", "v"}


@dataclass(frozen=True, slots=True, eq=False)
class PlainKeys:
    """K keys of D components without interpolation settings."""

    times: FloatArray  # key times ``(K,)`` [frames]
    values: FloatArray  # key values ``(K, D)``, in the units of the file
    name: str = ""  # reference to their array; empty for key lists

    def __len__(self) -> int:
        """Return the number of keys."""
        return len(self.times)

    @staticmethod
    def from_entries(entries: Any) -> PlainKeys | None:
        """Return keys as columns; None if one is invalid or has more than `t` and `v`.

        >>> keys = PlainKeys.from_entries([{"t": 1, "v": [0.5, 2]}])
        >>> keys.values.tolist()
        [[0.5, 2.0]]
        >>> PlainKeys.from_entries([{"t": 1, "v": 0.5, "out": "flat"}]) is None
        True
        """
        if entries.__class__ is not list or not entries:
            return None
        if not all(e.__class__ is dict and e.keys() == _PLAIN_KEYS for e in entries):
            return None
        times = [entry["t"] for entry in entries]
        values = [entry["v"] for entry in entries]
        component_count = 1
        if all(value.__class__ is list for value in values):
            component_count = len(values[0])
            if not component_count or any(len(v) != component_count for v in values):
                return None
            values = list(chain.from_iterable(values))
        if not {number.__class__ for number in (*times, *values)} <= _NUMBERS:
            return None
        try:
            value_rows = np.array(values, np.float64).reshape(-1, component_count)
            return PlainKeys.from_arrays(np.array(times, np.float64), value_rows)
        except OverflowError:
            return None

    @staticmethod
    def from_arrays(times: FloatArray, values: FloatArray) -> PlainKeys | None:
        """Return keys from arrays; None if a number exceeds the file limits."""
        is_valid = (np.abs(times) <= MAX_NUMBER).all()
        is_valid &= (np.abs(values) <= MAX_NUMBER).all()
        return PlainKeys(times, values) if is_valid else None

    def entries(self) -> list[dict[str, Any]]:
        """Return the keys as mappings, as in a file."""
        values = self.values[:, 0] if self.values.shape[1] == 1 else self.values
        time_value_pairs = zip(self.times.tolist(), values.tolist(), strict=True)
        return [{"t": time, "v": value} for time, value in time_value_pairs]


def plain_keys_or_check(entries: Any, check: Callable[[Any], Any]) -> Any:
    """Return keys of only time and value as columns, else the result of ``check``."""
    keys = PlainKeys.from_entries(entries)
    return check(entries) if keys is None else keys


# Time [frame] and value of a handle, relative to its key.
TangentHandle = Annotated[list[Real | list[Real]], Len(2, 2)]


class ClipUnitsModel(FileModel):
    """Units of the numbers in a clip; those of its rig where left out."""

    length: Literal["m", "cm", "mm", "in"] | None = key(
        "Unit of `translation`, `slide` and `local_translation`. Default: the rig's.",
        "cm",
        default=None,
    )
    angle: Literal["deg", "rad"] | None = key(
        "Unit of `angle` and of Euler angles. Default: the rig's.", "deg", default=None
    )


class KeyModel(FileModel):
    """A key: time [frame], value and tangents."""

    t: Real = key(
        "Frame at the file's `fps`, which may be fractional; keys ascend.", 12.5
    )
    v: Real | list[Real] = key(
        "The value: one number, three, or a quaternion [w, x, y, z], as the target "
        "needs.",
        80.0,
    )
    interp: InterpName | None = key(
        "Interpolation to the next key. Default: that of the channel.",
        "step",
        default=None,
    )
    in_: TangentName | TangentHandle | None = Field(
        default=None,
        alias="in",
        description="Incoming tangent: a rule, or a handle [dt, dv] from the key, dt "
        "≤ 0 frames. Default: the channel's `tangents`.",
        examples=[[-2.0, 5.0]],
    )
    out: TangentName | TangentHandle | None = key(
        "Outgoing tangent: likewise, dt ≥ 0.", "flat", default=None
    )
    tcb: Vector | None = key(
        "Tension, continuity and bias, for `interp: tcb`. Default: 0 each.",
        [0.5, 0.0, 0.0],
        default=None,
    )


if TYPE_CHECKING:
    Keys = list[KeyModel] | PlainKeys
    ChannelKeys = Keys  # references to arrays are resolved first
else:
    # Plain keys have no models, which would take most of the time.
    Keys = Annotated[list[KeyModel], WrapValidator(plain_keys_or_check)]
    ChannelKeys = Annotated[list[KeyModel] | str, WrapValidator(plain_keys_or_check)]


class _TargetModel(FileModel):
    target: Name = key(
        "The target: control/NAME, shape/NAME or joint/NAME.PART, each once.",
        "joint/elbow_l.angle",
    )


class JoinModel(FileModel):
    """Interpolation of keys."""

    interp: InterpName | None = key(
        "Interpolation between keys. Default: `bezier`, or `spline` for quaternions.",
        "linear",
        default=None,
    )
    tangents: TangentName = key(
        "Tangent rule for keys without handles.", "flat", default="auto_clamped"
    )
    parametrization: ParametrizationName = key(
        "Type of Catmull-Rom curve, for `interp: catmull_rom`.",
        "centripetal",
        default="uniform",
    )
    euler: EulerOrder | None = key(
        "Keys a rotation by three angles; ZXY is Rz · Rx · Ry, and `v` has the same "
        "order: [z, x, y]. Default: quaternions.",
        "ZXY",
        default=None,
    )
    pre: ExtrapolationName = key(
        "Behaviour before the first key.", "cycle", default="hold"
    )
    post: ExtrapolationName = key(
        "Behaviour after the last key.", "cycle_offset", default="hold"
    )


class CurveModel(JoinModel):
    """Keys and their interpolation."""

    keys: Annotated[Keys, Len(1)] = key("One key or more.", [{"t": 1.0, "v": 0.0}])


def key_times(model: CurveModel) -> FloatArray:
    """Return the times of keys ``(K,)``."""
    if isinstance(model.keys, PlainKeys):
        return model.keys.times
    return np.array([key.t for key in model.keys], np.float64)


class ChannelModel(CurveModel, _TargetModel):
    """The keys of one target."""

    keys: Annotated[ChannelKeys, Len(1)] = key(
        "One key or more, or the array `file.npz#name` of times and values.",
        [{"t": 1.0, "v": 0.0}],
    )


class ClipModel(FileModel):
    """A clip file."""

    clip: Literal["animtool/1"] = key("File type and format version.", "animtool/1")
    name: str | None = key(
        "Name of the clip. Default: the name of the file.", "wave", default=None
    )
    rig: str | None = key(
        "The rig: a rig file, USD file or BVH. Default: the command line or the "
        "scene names it.",
        "hero.rig.yaml",
        default=None,
    )
    units: ClipUnitsModel = key(
        "Units of the numbers in the file.", {"angle": "deg"}, default=ClipUnitsModel()
    )
    fps: Real | str = key(
        "Frames per second: a number, or a fraction as text.", "24000/1001"
    )
    range: NumberPair | None = key(
        "First and last frame. Default: those of the first and last key.",
        [1.0, 48.0],
        default=None,
    )
    channels: list[ChannelModel] = key(
        "The channels. Without any, a range holds the rig at rest.",
        [{"target": "control/grip", "keys": [{"t": 1.0, "v": 0.0}]}],
        default=[],
    )
    ignore: list[IgnoreModel] = key(
        "Findings of `animtool validate` that are accepted.",
        [{"code": "CLIP201", "why": "this is intended"}],
        default=[],
    )
