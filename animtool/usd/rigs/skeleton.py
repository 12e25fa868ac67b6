"""Writes a rig's prims: model, SkelRoot, Skeleton and strands."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from pxr import Gf, Sdf, Vt

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, FormatError
from animtool.maths import so3
from animtool.rig.kinematics import bind_matrices
from animtool.rig.parts import Shape
from animtool.rig.placed import transform_rig
from animtool.rig.placement import Placement
from animtool.rig.skeleton import JointType, Rig
from animtool.rig.surfaces import Strands, strands_of
from animtool.rig.write import rig_text
from animtool.usd.layers.finite import ValueLabels, narrow_floats
from animtool.usd.layers.names import RigPaths, UsdNames, distinct_names
from animtool.usd.layers.sdf import (
    apply_schemas,
    attribute_spec,
    author_model,
    author_relationship,
    gf_quaternion,
    gf_vector,
    prim_spec,
)

if TYPE_CHECKING:
    from animtool.usd.layers.faults import PrimLocation


PLACEMENT_KEY = "stands"


def build_rest_metadata(rig: Rig, rest_pose_rig: Rig | None = None) -> dict[str, Any]:
    """Return the rest placement of a rig as customData; empty if it has none.

    ``rest_pose_rig`` is the rig whose rest pose the file has; None is the same rig. If
    it is placed, the identity is recorded for a take without placement.
    """
    rigs = (rig,) if rest_pose_rig is None else (rig, rest_pose_rig)
    if all(
        candidate.placement is None and not candidate.has_animated_parents
        for candidate in rigs
    ):
        return {}
    rest_placement = rig.placement or Placement.from_rotation(so3.IDENTITY)
    metadata: dict[str, Any] = {
        "translate": gf_vector(rest_placement.translations[0]),
        "rotate": gf_quaternion(rest_placement.rotations[0]),
    }
    return metadata | ({"rides": True} if rig.has_animated_parents else {})


def apply_recorded_rest(
    rig: Rig, skeleton: Any, animation: Any, location: PrimLocation
) -> Rig:
    """Return a rig at the rest placement that is recorded in customData.

    Args:
        rig: The rig.
        skeleton: Prim with the rest pose; None for none.
        animation: Prim with the motion; None is the rest pose.
        location: Location for faults.
    """
    rest_placement = (
        None if skeleton is None else _recorded_placement(skeleton, location)
    )
    motion_placement = (
        rest_placement
        if animation is None
        else _recorded_placement(animation, location)
    )
    if motion_placement is None:
        return rig
    motion_rest, is_animated = motion_placement
    if skeleton is not None and rest_placement is not motion_placement:
        # The Skeleton's rest pose is that of another library take, or has no placement.
        relative_placement = motion_rest
        if rest_placement is not None:
            relative_placement = motion_rest.after(rest_placement[0].inverse())
        rig = transform_rig(rig, relative_placement)
    return replace(
        rig,
        placement=None if motion_rest.is_identity else motion_rest,
        has_animated_parents=is_animated,
    )


def _recorded_placement(
    prim: Any, location: PrimLocation
) -> tuple[Placement, bool] | None:
    """Return a prim's recorded placement and whether it is animated; None if absent."""
    # Writing does not need stages.
    from animtool.usd.rigs.prims import stored_data

    metadata = stored_data(prim).get(PLACEMENT_KEY)
    if metadata is None:
        return None
    position, orientation = (
        metadata.get(key) if isinstance(metadata, dict) else None
        for key in ("translate", "rotate")
    )
    if not isinstance(position, Gf.Vec3d) or not isinstance(orientation, Gf.Quatd):
        location.fail("USD007", f"customData animtool:{PLACEMENT_KEY} is malformed")
    rotation = np.array([*orientation.GetImaginary(), orientation.GetReal()], float)
    translation = np.array(position, float)
    length = float(np.linalg.norm(rotation))
    if not np.isfinite(translation).all() or not abs(length - 1.0) < 1e-3:
        location.fail("USD007", f"customData animtool:{PLACEMENT_KEY} is malformed")
    placement = Placement(translation[None], rotation[None] / length, np.ones(1))
    return placement, bool(metadata.get("rides", False))


_TYPES = Sdf.ValueTypeNames
_EXTRAS_VERSION = 1
# Scope of the curves below the SkelRoot.
STRANDS_SCOPE = "Strands"
# Width of drawn curves [m]: rig files do not define it.
STRAND_WIDTH = 4e-4


def author_rig(
    layer: Any, rig: Rig, names: UsdNames, paths: RigPaths, meters_per_unit: float
) -> None:
    """Write the model, the SkelRoot and the Skeleton of a rig, with its strands."""
    author_model(layer, paths.model)
    prim_spec(layer, paths.root, "SkelRoot")
    spec = prim_spec(layer, paths.skeleton, "Skeleton")
    tokens = Vt.TokenArray(rig.paths(names.names))
    attribute_spec(spec, "joints", _TYPES.TokenArray, tokens, is_uniform=True)
    bind_world = bind_matrices(rig)
    bind = _row_matrices(bind_world[:, :3, 3] / meters_per_unit, bind_world[:, :3, :3])
    local_linear = so3.to_matrix(rig.rest_rotations)
    rest = _row_matrices(rig.rest_translations / meters_per_unit, local_linear)
    matrix_type = _TYPES.Matrix4dArray
    attribute_spec(spec, "bindTransforms", matrix_type, bind, is_uniform=True)
    attribute_spec(spec, "restTransforms", matrix_type, rest, is_uniform=True)
    if any(entry.points is not None for entry in rig.attach):
        paths_by_name = dict(zip(rig.names, map(str, tokens), strict=True))
        author_strands(layer, strands_of(rig), paths, paths_by_name, meters_per_unit)
    custom_data: dict[str, Any] = {}
    if has_extra_data(rig):
        custom_data["rig"] = rig_text(strip_arrays(rig))
        if pins := _pins_by_cloth(rig):
            custom_data["pins"] = pins
        custom_data["hash"] = skeleton_hash(tokens, rest, bind)
    if extras_json := joint_extras_json(rig, names.names):
        custom_data["joints"] = extras_json
    if names.sources_by_legal_name:
        custom_data["names"] = names.sources_by_legal_name
    if metadata := build_rest_metadata(rig):
        custom_data[PLACEMENT_KEY] = metadata
    if custom_data:
        spec.SetInfo("customData", {"animtool": custom_data})


def has_extra_data(rig: Rig) -> bool:
    """Return whether a rig contains data that USD cannot express.

    Joint types that follow from channels do not count, as channels are stored
    separately.
    """
    extras = (rig.controls, rig.chains, rig.attach, rig.colliders, rig.masses)
    has_products = any(shape.combine for shape in rig.shapes)
    return (
        has_products
        or any(map(bool, extras))
        or any(
            (joint.type is not JointType.FREE and joint.channels is None)
            or joint.limits is not None
            or joint.mimic is not None
            or joint.mirror
            for joint in rig.joints
        )
    )


def strip_arrays(rig: Rig) -> Rig:
    """Return a rig without the arrays that USD stores."""
    shapes = tuple(
        Shape(shape.name, combine=shape.combine, driven=shape.driven)
        for shape in rig.shapes
    )
    attach = tuple(replace(entry, pins=None, points=None) for entry in rig.attach)
    return replace(rig, meshes=(), shapes=shapes, attach=attach)


def _pins_by_cloth(rig: Rig) -> dict[str, Any]:
    """Return the pinned vertices by cloth name."""
    pins = {}
    for entry in rig.attach:
        if entry.pins is None:
            continue
        try:
            vertices = np.ascontiguousarray(entry.pins.load(), np.int32)
        except ValueError as error:
            raise FormatError(Fault("RIG018", f"{entry.name!r}: {error}")) from error
        pins[entry.name] = Vt.IntArray.FromNumpy(vertices)
    return pins


def skeleton_hash(tokens: Any, rest: Any, bind: Any) -> str:
    """Return a hash of the joints, rest and bind transforms of a Skeleton."""
    digest = hashlib.sha256("\n".join(map(str, tokens)).encode())
    for matrices in (rest, bind):
        digest.update(np.array(matrices, "<f8").tobytes())
    return digest.hexdigest()


def _row_matrices(positions: FloatArray, linear: FloatArray) -> Any:
    """Return the transforms as row-vector matrices, as in USD."""
    matrices = np.zeros((len(positions), 4, 4))
    matrices[:, :3, :3] = linear.swapaxes(-1, -2)
    matrices[:, 3, :3] = positions
    matrices[:, 3, 3] = 1.0
    return Vt.Matrix4dArray.FromNumpy(matrices)


def joint_extras_json(rig: Rig, names: list[str]) -> str:
    """Return joint data that USD cannot express as canonical JSON; empty if none.

    The data are channel orders and tips [m], by USD joint name.
    """
    joints: dict[str, dict[str, object]] = {}
    for joint, name in zip(rig.joints, names, strict=True):
        entry: dict[str, object] = {}
        if joint.channels is not None:
            entry["channels"] = list(joint.channels)
        if joint.tips:
            entry["tips"] = [list(tip) for tip in joint.tips]
        if entry:
            joints[name] = entry
    if not joints:
        return ""
    content = {"animtool": _EXTRAS_VERSION, "joints": joints}
    return json.dumps(content, sort_keys=True, separators=(",", ":"))


def bind_animation(
    layer: Any, paths: RigPaths, *, binds_skeleton: bool, binds_source: bool = True
) -> None:
    """Apply SkelBindingAPI; bind the animation, the skeleton, or both."""
    spec = layer.GetPrimAtPath(paths.binding)
    if spec is None:
        spec = prim_spec(layer, paths.binding, is_over=True)
    apply_schemas(spec, ["SkelBindingAPI"])
    if binds_source:
        author_relationship(spec, "skel:animationSource", paths.animation)
    if binds_skeleton:
        author_relationship(spec, "skel:skeleton", paths.skeleton)


def strand_paths(strands: Sequence[Strands], paths: RigPaths) -> tuple[str, ...]:
    """Return the prim paths of strands."""
    source_names = [entry.name for entry in strands]
    names = distinct_names(source_names, source_names, source_names).names
    return tuple(f"{paths.root}/{STRANDS_SCOPE}/{name}" for name in names)


def author_strands(
    layer: Any,
    strands: Sequence[Strands],
    paths: RigPaths,
    tokens: Mapping[str, str] | None,
    meters_per_unit: float,  # unit of the layer [m]
) -> None:
    """Write strands as linear curves below the SkelRoot, each bound to its joint.

    ``tokens`` has the path of each joint; None writes unbound curves.
    """
    if not strands:
        return
    prim_spec(layer, f"{paths.root}/{STRANDS_SCOPE}", "Scope")
    for entry, path in zip(strands, strand_paths(strands, paths), strict=True):
        spec = prim_spec(layer, path, "BasisCurves")
        if Sdf.Path(path).name != entry.name:
            spec.SetInfo("customData", {"animtool": {"name": entry.name}})
        _author_curves(
            spec, entry.points / meters_per_unit, STRAND_WIDTH / meters_per_unit
        )
        if tokens is not None:
            apply_schemas(spec, ["SkelBindingAPI"])
            joint = Vt.TokenArray([tokens[entry.joint]])
            attribute_spec(
                spec, "skel:joints", _TYPES.TokenArray, joint, is_uniform=True
            )
            author_influences(spec, np.zeros((1, 1)), np.ones((1, 1)), "constant")


def _author_curves(spec: Any, points: FloatArray, width: float) -> None:
    from pxr import UsdGeom

    from animtool.usd.caches.writer import POLYLINE_TOKENS, author_values, author_width

    count, length = points.shape[:2]
    labels = ValueLabels(f"{spec.path}.points", "point")
    points_array = np.ascontiguousarray(
        narrow_floats(points.reshape(-1, 3), "f", labels)
    )
    curve_points, widths = Vt.Vec3fArray.FromNumpy(points_array), Vt.FloatArray([width])
    values = {
        "extent": np.array(UsdGeom.Curves.ComputeExtent(curve_points, widths)),
        **POLYLINE_TOKENS,
        "curveVertexCounts": np.full(count, length, np.int32),
        "points": points_array,
    }
    author_values(spec, values)
    author_width(spec, width)


def author_influences(
    spec: Any,
    joints: npt.NDArray[Any],
    weights: npt.NDArray[Any],
    interpolation: str = "vertex",
) -> None:
    """Author the joint influences ``(V, I)`` of a prim.

    With the interpolation ``constant``, all points have those of a single row.
    """
    joint_indices = np.ascontiguousarray(joints.ravel(), np.int32)
    joint_weights = np.ascontiguousarray(weights.ravel(), np.float32)
    for name, value_type, values in (
        ("jointIndices", _TYPES.IntArray, Vt.IntArray.FromNumpy(joint_indices)),
        ("jointWeights", _TYPES.FloatArray, Vt.FloatArray.FromNumpy(joint_weights)),
    ):
        attr = attribute_spec(
            spec,
            f"primvars:skel:{name}",
            value_type,
            values,
            interpolation=interpolation,
        )
        attr.SetInfo("elementSize", joints.shape[1])
