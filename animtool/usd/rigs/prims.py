"""Reads a Skeleton prim as a rig, finds its prims, and reads attribute arrays."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Sequence, Sized
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import Fault, Severity, excerpt, listed
from animtool.core.names import most_similar, numbered_names
from animtool.core.quantities import CONTROL_CHARACTERS
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.maths import so3
from animtool.rig.skeleton import CHANNEL_NAMES, Joint, Rig
from animtool.usd.layers.dependencies import open_composed, unresolved_arcs
from animtool.usd.layers.faults import (
    MAX_RATE_OR_UNIT,
    MIN_RATE_OR_UNIT,
    PrimLocation,
    joint_order_faults,
    joint_parents,
    unit_and_axis_faults,
)
from animtool.usd.layers.sdf import check_prim_path, open_layer
from animtool.usd.rigs.rest_pose import read_rest

# Maximum prims whose names are compared with an unknown one.
MAX_COMPARED_PATHS = 20_000


def array_value(attr: Any, time: Any = None) -> Any:
    """Return an attribute's array; empty if it has none.

    Without a time, returns the default, else the first sample.
    """
    value = attr.Get() if time is None else attr.Get(time)
    if value is None and time is None:
        value = attr.Get(Usd.TimeCode.EarliestTime())
    return array_or_empty(value)


def array_or_empty(value: Any) -> Any:
    """Return a value if it is an array, otherwise an empty tuple."""
    return value if isinstance(value, Sized) and not isinstance(value, str) else ()


def number_rows(attr: Any, width: int, time: Any = None) -> FloatArray:
    """Return an attribute's rows ``(N, width)``; empty if the type differs."""
    return value_rows(array_value(attr, time), width)


def value_rows(value: Any, width: int) -> FloatArray:
    """Return the rows of an array ``(N, width)``; empty if the type differs."""
    value = array_or_empty(value)
    numbers = np.array(value)
    if numbers.dtype.kind not in "fiu" or numbers.size != len(value) * width:
        return np.zeros((0, width))
    return numbers.astype(np.float64).reshape(-1, width)


def integer_array(attr: Any, time: Any = None) -> IntArray:
    """Return an attribute's integers ``(N,)``; empty if the type differs."""
    numbers = np.array(array_value(attr, time))
    if numbers.dtype.kind not in "iu" or numbers.ndim != 1:
        return np.zeros(0, np.int64)
    return numbers.astype(np.int64)


def stored_data(prim: Any) -> dict[str, Any]:
    """Return the ``animtool`` dictionary of a prim's customData, else an empty one."""
    data = prim.GetCustomDataByKey("animtool")
    return data if isinstance(data, dict) else {}


_CONTROL_CHARACTER = re.compile(f"[{CONTROL_CHARACTERS}]")
# Rest transforms are float32.
MAX_REST_VALUE = float(np.finfo(np.float32).max)


@dataclass(frozen=True, slots=True)
class SkeletonRig:
    """A rig read from a Skeleton prim."""

    rig: Rig  # joints named by the last component of their paths
    tokens: list[str]  # joint paths on the prim
    rest_scales: FloatArray  # scales of the rest transforms ``(J, 3)``
    notices: tuple[Fault, ...] = ()  # warnings and notes on the prim


def open_stage(path: Path) -> Any:
    """Open a stage; raise an error if its rate, range, unit or up axis is invalid."""
    stage = open_composed(open_layer(path), path)
    location = PrimLocation(str(path), "/")
    rate = stage.GetTimeCodesPerSecond()
    if not MIN_RATE_OR_UNIT <= rate <= MAX_RATE_OR_UNIT:
        location.fail(
            "USD253",
            f"timeCodesPerSecond is {rate}",
            "write a rate above 0, such as 24",
        )
    for name, code in (
        ("startTimeCode", stage.GetStartTimeCode()),
        ("endTimeCode", stage.GetEndTimeCode()),
    ):
        if not abs(code) <= MAX_RATE_OR_UNIT:
            location.fail("USD254", f"{name} is {code}", "write -1e9 to 1e9")
    location.raise_errors(unit_and_axis_faults(stage))
    return stage


def find_prim(stage: Any, name: str) -> Any:
    """Return the prim at an absolute path; None if missing."""
    is_valid = Sdf.Path.IsValidPathString(name) and Sdf.Path(name).IsAbsolutePath()
    return (stage.GetPrimAtPath(name) or None) if is_valid else None


def nearest_prim(stage: Any, name: str) -> str | None:
    """Return a hint that names the prim with the most similar path."""
    candidates = islice(stage.Traverse(), MAX_COMPARED_PATHS)
    names = [str(prim.GetPath()) for prim in candidates]
    similar_path = most_similar(name, names)
    return f"did you mean {similar_path}?" if similar_path else None


def self_and_ancestors(prim: Any) -> Iterator[Any]:
    """Yield a prim and its ancestors, without the pseudo-root."""
    while prim and not prim.IsPseudoRoot():
        yield prim
        prim = prim.GetParent()


def varying_xformables(prim: Any) -> Iterator[Any]:
    """Yield the xformables that determine a prim's world transform and may vary."""
    for ancestor in self_and_ancestors(prim):
        xformable = UsdGeom.Xformable(ancestor)
        if xformable and xformable.TransformMightBeTimeVarying():
            yield xformable
        if xformable and xformable.GetResetXformStack():
            return


def sample_times(sources: Iterable[Any]) -> list[float]:
    """Return the time codes at which attributes or xformables have samples, sorted."""
    return sorted({time for source in sources for time in source.GetTimeSamples()})


def transform_times(prim: Any) -> list[float]:
    """Return the sample times of a prim's world transform, sorted."""
    return sample_times(filter(None, map(UsdGeom.Xformable, self_and_ancestors(prim))))


def find_skeletons(stage: Any, root_path: str = "/") -> list[Any]:
    """Return the Skeleton prims of a stage, including instance proxies."""
    root_prim = stage.GetPrimAtPath(root_path)
    if not root_prim:
        return []
    prims = Usd.PrimRange(root_prim, Usd.TraverseInstanceProxies())
    return [UsdSkel.Skeleton(prim) for prim in prims if prim.IsA(UsdSkel.Skeleton)]


def animation_source(skeleton: Any) -> Any:
    """Return the animation prim that UsdSkel resolves; None if unbound."""
    root = UsdSkel.Root.Find(skeleton.GetPrim())
    if not root:
        return None
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.TraverseInstanceProxies())
    query = cache.GetSkelQuery(skeleton)
    source = query.GetAnimQuery() if query else None
    return source.GetPrim() if source else None


def decompose(matrices: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Split row-vector matrices ``(..., 4, 4)``, S·R·T, into T, R (quaternion) and S.

    A mirror becomes a negative scale on all three axes. Shear is dropped.
    """
    rotations, scales = so3.split_scale(matrices[..., :3, :3].swapaxes(-1, -2))
    return matrices[..., 3, :3], rotations, scales


def skeleton_rig(skeleton: Any, path: Path, *, is_animated: bool = True) -> SkeletonRig:
    """Return the rig of a Skeleton prim, in metres.

    A character with only blend shapes has no joints.

    ``is_animated`` says whether its bound animation applies, which a layer over the rig
    replaces.
    """
    stage = skeleton.GetPrim().GetStage()
    location = PrimLocation.from_prim(path, skeleton)
    tokens = [str(token) for token in array_value(skeleton.GetJointsAttr())]
    rest, notices = np.zeros((0, 4, 4)), list[Fault]()
    if tokens:
        rest, notices = read_rest(skeleton, tokens, location, is_animated=is_animated)
    custom_data = stored_data(skeleton.GetPrim())
    # Files written by animtool store the names.
    joint_names = () if custom_data else array_value(skeleton.GetJointNamesAttr())
    model = skeleton.GetPrim().GetParent().GetParent() or skeleton.GetPrim()
    name = model.GetName() if model.GetName() != "/" else skeleton.GetPrim().GetName()
    transform_attrs = (
        skeleton.GetRestTransformsAttr(),
        skeleton.GetBindTransformsAttr(),
    )
    authored_attrs = [attr for attr in transform_attrs if attr.HasAuthoredValue()]
    meters_per_unit, up = _authored_units((authored_attrs or transform_attrs)[0], stage)
    rig = rig_from_tokens(
        tokens,
        rest,
        name,
        location,
        meters_per_unit,
        up,
        custom_data,
        [str(name) for name in joint_names],
    )
    return replace(rig, notices=tuple(notices))


def check_animatable(
    joint_count: int, shape_count: int, location: PrimLocation
) -> None:
    """Refuse a character without joints or shapes to animate."""
    if not joint_count and not shape_count:
        location.fail("USD002", "there are no joints and no blend shapes")


def rig_from_tokens(
    tokens: Sequence[str],
    rest: FloatArray,
    name: str,
    location: PrimLocation,
    meters_per_unit: float,
    up: UpAxis,
    custom_data: dict[str, Any],
    source_names: Sequence[str] = (),
) -> SkeletonRig:
    """Return a rig with joint paths and rest transforms ``(J, 4, 4)`` in file units.

    Joints are named by the last component of their paths. Their source names come from
    ``custom_data``, else from ``source_names`` (the Skeleton's ``jointNames``) if
    valid.
    """
    location.raise_errors(joint_order_faults(f"{location.where}.joints", tokens))
    if not isinstance(custom_data, dict) or not all(
        isinstance(custom_data.get(key, {}), dict) for key in ("names", "pins")
    ):
        location.fail("USD007", "customData animtool is malformed")
    extras = _parse_joint_extras(custom_data, location)
    original_names = dict(custom_data.get("names", {}))
    are_printable = all(name.strip() and name.isprintable() for name in source_names)
    are_unique = len(set(source_names)) == len(source_names)
    if not (are_printable and are_unique and len(source_names) == len(tokens)):
        source_names = [""] * len(tokens)
    translations, rotations, scales = decompose(rest)
    joints: list[Joint] = []
    parents = joint_parents(tokens).tolist()
    unique_names = numbered_names(token.rpartition("/")[2] for token in tokens)
    for i, token in enumerate(tokens):
        leaf = token.rpartition("/")[2]
        if match := _CONTROL_CHARACTER.search(f"{leaf}{original_names.get(leaf, '')}"):
            message = f"joint {excerpt(token)} holds the control character {match[0]!r}"
            location.fail("DOC023", message)
        unique = unique_names[i]
        settings = extras.get(leaf, {})
        x, y, z = (translations[i] * meters_per_unit).tolist()
        a, b, c, w = rotations[i].tolist()
        joints.append(
            Joint(
                unique,
                parents[i],
                translation=(x, y, z),
                rotation=(a, b, c, w),
                source_name=_source_name(
                    original_names.get(leaf), source_names[i], leaf, unique
                ),
                channels=settings.get("channels"),
                tips=settings.get("tips", ()),
            )
        )
    rig = Rig(name, tuple(joints), meters_per_unit, up)
    return SkeletonRig(rig, list(tokens), scales)


def _source_name(stored_name: Any, joint_name: str, leaf: str, unique: str) -> str:
    """Return the original name of a joint; empty if unchanged."""
    if stored_name is not None:
        return str(stored_name)
    name = joint_name or leaf
    return "" if name == unique else name


def _parse_joint_extras(
    data: dict[str, Any], location: PrimLocation
) -> dict[str, dict[str, Any]]:
    text = data.get("joints", "")
    if not text:
        return {}
    try:
        content = json.loads(text)
        version, joints = content["animtool"], content["joints"]
        extras = {str(name): _joint_extras(entry) for name, entry in joints.items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        location.fail("USD007", f"customData animtool:joints is malformed: {error}")
    if version != 1:
        location.fail("USD007", f"customData animtool:joints needs animtool/{version}")
    return extras


def _joint_extras(entry: dict[str, Any]) -> dict[str, Any]:
    """Return a joint's stored channels and tips, validated."""
    channels, tips = entry.get("channels"), entry.get("tips", ())
    if channels is not None:
        channels = tuple(channels)
        known_channels = [name for name in CHANNEL_NAMES if name in channels]
        if len(known_channels) != len(channels):
            raise ValueError(f"channels must be among {', '.join(CHANNEL_NAMES)}")
    points = [(float(x), float(y), float(z)) for x, y, z in tips]
    if not all(map(math.isfinite, sum(points, ()))):
        raise ValueError("a tip is not finite")
    return {"channels": channels, "tips": tuple(points)}


def _authored_units(attr: Any, stage: Any) -> tuple[float, UpAxis]:
    """Return unit [m] and up axis of the layer that authors an attribute.

    A shot in metres may reference a rig in centimetres; the numbers of the rig and its
    animations stay in centimetres.
    """
    meters_per_unit, up = UsdGeom.GetStageMetersPerUnit(stage), up_axis(stage)
    stack = attr.GetPropertyStack(Usd.TimeCode.Default())
    root = stack[0].layer.pseudoRoot if stack else None
    if root is not None and root.HasInfo("metersPerUnit"):
        meters_per_unit = float(root.GetInfo("metersPerUnit"))
    if root is not None and root.HasInfo("upAxis"):
        up = UpAxis(str(root.GetInfo("upAxis")))
    return meters_per_unit, up


def up_axis(stage: Any) -> UpAxis:
    """Return the up axis of a stage."""
    return UpAxis(str(UsdGeom.GetStageUpAxis(stage)))


def search_root(stage: Any, prim_path: str | None) -> str:
    """Return the path to search below: as configured, else the default prim or root."""
    if prim_path is not None:
        check_prim_path(prim_path)
        return prim_path
    default_prim = stage.GetDefaultPrim()
    if default_prim and find_skeletons(stage, str(default_prim.GetPath())):
        return str(default_prim.GetPath())
    return "/"


def composition_notices(stage: Any, file_path: str) -> list[Fault]:
    """Return a warning for each unresolved reference of a stage."""
    hint = "what it holds is missing; correct the path, or restore the file"
    return [
        Fault("USD112", f"{prim}: {text}"[:300], file_path, (), hint, Severity.WARNING)
        for prim, text in sorted(unresolved_arcs(stage))
    ]


def skipped_skeletons_notice(skeletons: list[Any], file_path: str) -> list[Fault]:
    """Return a warning that lists skipped Skeletons if a stage has more than one."""
    if len(skeletons) < 2:
        return []
    first_path, *other_paths = [str(skeleton.GetPath()) for skeleton in skeletons]
    message = f"reading {first_path} of {len(skeletons)} skeletons; the others: "
    message += listed(other_paths)
    hint = f"choose one with {argument('source.prim_path')}"
    return [Fault("USD107", message, file_path, (), hint, Severity.WARNING)]
