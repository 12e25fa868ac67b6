"""Reads and checks the meshes, morph targets and skins of a glTF."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import counted
from animtool.core.record import dataclass
from animtool.formats.characters.nodes import FileSkin
from animtool.formats.file_diagnostics import FileDiagnostics
from animtool.formats.gltf.accessors import (
    COMPONENT_TYPES,
    FLOAT_COMPONENT,
    Accessor,
    Accessors,
)
from animtool.formats.gltf.json_items import JsonItem, animtool_extras, is_number
from animtool.formats.gltf.unused import is_known_attribute, is_supported_attribute

# Component types: signed and unsigned 8 and 16 bits, unsigned 32.
I8, U8, I16, U16, U32 = 5120, 5121, 5122, 5123, 5125
QUANTIZATION_EXTENSION = "KHR_mesh_quantization"
QUANTIZED_TYPES = (FLOAT_COMPONENT, I8, U8, I16, U16)
TRIANGLES, STRIP, FAN = 4, 5, 6
# Tolerance of a vertex's weight sum [1]: float32 rounding is smaller, and integers are
# exact.
WEIGHT_SUM_TOLERANCE = 1e-5
# Tolerance of min and max, relative to the size of the data [1].
BOUNDS_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class MorphTarget:
    """A morph target: accessor indices of its offsets; -1 if there is none."""

    position_accessor: int
    normal_accessor: int


@dataclass(frozen=True, slots=True)
class Primitive:
    """A primitive of a mesh: accessor indices of its vertices."""

    position_accessor: int  # -1 if there are no points
    normal_accessor: int
    joint_accessors: tuple[int, ...]
    weight_accessors: tuple[int, ...]
    index_accessor: int
    mode: int
    targets: tuple[MorphTarget, ...]
    pointer: str

    @property
    def vertex_key(self) -> tuple[Any, ...]:
        """Accessors of the vertices; equal if primitives share vertices."""
        return (
            self.position_accessor,
            self.normal_accessor,
            self.joint_accessors,
            self.weight_accessors,
            self.targets,
        )


@dataclass(frozen=True, slots=True)
class GltfMesh:
    """A mesh of a glTF: its primitives, and the names and weights of morph targets."""

    name: str | None
    primitives: tuple[Primitive, ...]
    # Default weights of its targets; nodes may override them.
    weights: tuple[float, ...]
    target_names: tuple[str, ...]  # empty if the file has none
    pointer: str
    original_name: str | None = None  # written by animtool if the node's name differs

    @property
    def target_count(self) -> int:
        """Number of morph targets."""
        return max((len(primitive.targets) for primitive in self.primitives), default=0)


def read_meshes(json_root: JsonItem, accessors: Accessors) -> tuple[GltfMesh, ...]:
    """Return the meshes of a file with primitives and morph targets, checked."""
    return tuple(_read_mesh(item, accessors) for item in json_root.children("meshes"))


def _read_mesh(item: JsonItem, accessors: Accessors) -> GltfMesh:
    if "primitives" not in item.values:
        item.fail_missing("primitives")
    primitive_items = item.children("primitives")
    primitives = tuple(_read_primitive(child, accessors) for child in primitive_items)
    target_counts = [len(primitive.targets) for primitive in primitives]
    for i, count in enumerate(target_counts):
        if count != target_counts[0]:
            message = f"{count} targets, but the first primitive has {target_counts[0]}"
            pointer = f"{item.pointer}/primitives/{i}/targets"
            item.diagnostics.fail("GLT011", pointer, message)
    target_count = max(target_counts, default=0)
    weights = item.floats("weights", None)
    if weights is not None and len(weights) != target_count:
        message = f"{len(weights)} weights for {target_count} targets"
        item.diagnostics.fail("GLT011", item.pointer_to("weights"), message)
    extras = item.values.get("extras")
    stated_names = extras.get("targetNames") if isinstance(extras, dict) else None
    is_valid = isinstance(stated_names, list) and len(stated_names) == target_count
    target_names = (
        tuple(map(str, stated_names)) if is_valid and stated_names is not None else ()
    )
    zeros = (0.0,) * target_count
    original_name = animtool_extras(item).get("name")
    return GltfMesh(
        item.text("name"),
        primitives,
        zeros if weights is None else tuple(weights),
        target_names,
        item.pointer,
        original_name if isinstance(original_name, str) else None,
    )


def _read_primitive(item: JsonItem, accessors: Accessors) -> Primitive:
    attributes = item.required_child("attributes")
    accessor_indices = _read_attributes(attributes, len(accessors.by_index))
    vertex_count = _check_vertices(attributes, accessor_indices, accessors)
    set_indices = _skin_set_indices(attributes, accessor_indices)
    target_items = item.children("targets")
    targets = [_read_morph_target(t, vertex_count, accessors) for t in target_items]
    mode = item.integer("mode")
    if mode is not None and not 0 <= mode <= FAN:
        message = f"mode {mode} is unknown: the primitive has no faces"
        item.diagnostics.warn("GLT106", item.pointer_to("mode"), message)
    index_accessor = item.index("indices", len(accessors.by_index), "accessor")
    if index_accessor >= 0:
        _check_indices(item, index_accessor, vertex_count, accessors)
    return Primitive(
        accessor_indices.get("POSITION", -1),
        accessor_indices.get("NORMAL", -1),
        tuple(accessor_indices[f"JOINTS_{set_index}"] for set_index in set_indices),
        tuple(accessor_indices[f"WEIGHTS_{set_index}"] for set_index in set_indices),
        index_accessor,
        TRIANGLES if mode is None else mode,
        tuple(targets),
        item.pointer,
    )


def _read_attributes(attributes: JsonItem, accessor_count: int) -> dict[str, int]:
    """Return the accessors of attributes that are read; warn about unknown ones."""
    accessor_indices: dict[str, int] = {}
    for name in attributes.values:
        if is_supported_attribute(name):
            accessor_indices[name] = attributes.index(name, accessor_count, "accessor")
        elif not is_known_attribute(name):
            message = f"unknown attribute {name!r} is ignored"
            attributes.diagnostics.warn("GLT106", attributes.pointer_to(name), message)
    return accessor_indices


def _skin_set_indices(
    attributes: JsonItem, accessor_indices: Mapping[str, int]
) -> list[int]:
    """Return the set indices of the JOINTS_n and WEIGHTS_n attributes."""
    joints, weights = (
        sorted(int(n.removeprefix(p)) for n in accessor_indices if n.startswith(p))
        for p in ("JOINTS_", "WEIGHTS_")
    )
    if joints != weights:
        message = f"JOINTS {joints} and WEIGHTS {weights} do not match"
        attributes.diagnostics.fail("GLT011", attributes.pointer, message)
    return joints


def _read_morph_target(
    target: JsonItem, vertex_count: int, accessors: Accessors
) -> MorphTarget:
    """Return the accessors of a morph target, checked against the vertices."""
    _check_morph_attributes(target)
    accessor_indices = {
        name: target.index(name, len(accessors.by_index), "accessor")
        for name in ("POSITION", "NORMAL")
        if name in target.values
    }
    types = "VEC3", QUANTIZED_TYPES
    for name, index in accessor_indices.items():
        accessor = _require_accessor(target, name, index, accessors, *types)
        if accessor.count != vertex_count:
            message = f"{accessor.count} rows for {vertex_count} vertices"
            target.diagnostics.fail("GLT011", target.pointer_to(name), message)
        if accessors.has_data(index):
            check_bounds(accessor.item, accessors.numbers(index))
    return MorphTarget(
        accessor_indices.get("POSITION", -1), accessor_indices.get("NORMAL", -1)
    )


def _check_morph_attributes(target: JsonItem) -> None:
    """Warn about attributes of a morph target that are not read."""
    if not target.values:
        message = "a morph target without attributes moves nothing"
        target.diagnostics.warn("GLT106", target.pointer, message)
    for name in target.values:
        if not is_known_attribute(name):
            message = f"unknown attribute {name!r} is ignored"
            target.diagnostics.warn("GLT106", target.pointer_to(name), message)


def _require_accessor(
    item: JsonItem,
    key: str,
    index: int,
    accessors: Accessors,
    element_type: str,
    component_types: tuple[int, ...],
) -> Accessor:
    """Return the accessor of an attribute; raise for a wrong type (GLT011)."""
    accessor = accessors.by_index[index]
    if accessor is None or not accessor.has_type(element_type, *component_types):
        type_text = "of an unknown type"
        if accessor is not None:
            type_text = f"{accessor.element_type} of "
            type_text += f"{COMPONENT_TYPES[accessor.component_type].name}"
        item.diagnostics.fail(
            "GLT011", item.pointer_to(key), f"{key} cannot be {type_text}"
        )
    is_integer = accessor.component_type != FLOAT_COMPONENT
    is_quantized = component_types is QUANTIZED_TYPES and is_integer
    declared_extensions = accessors.container.json_root.values.get("extensionsUsed", ())
    if is_quantized and QUANTIZATION_EXTENSION not in declared_extensions:
        message = f"{key} are integers, and {QUANTIZATION_EXTENSION} is not declared"
        item.diagnostics.warn("GLT106", item.pointer_to(key), message)
    if accessors.has_data(index):
        accessors.numbers(index)
    return accessor


def _check_vertices(
    attributes: JsonItem, indices: dict[str, int], accessors: Accessors
) -> int:
    """Check types and counts of vertex attributes; return the vertex count."""
    vertex_count = -1
    for name, index in indices.items():
        types: tuple[str, tuple[int, ...]] = "VEC4", (U8, U16)
        if name in {"POSITION", "NORMAL"}:
            types = "VEC3", QUANTIZED_TYPES
        elif name.startswith("WEIGHTS_"):
            types = "VEC4", (FLOAT_COMPONENT, U8, U16)
        accessor = _require_accessor(attributes, name, index, accessors, *types)
        if name.startswith("WEIGHTS_") and not (
            accessor.is_normalized or accessor.component_type == FLOAT_COMPONENT
        ):
            message = f"the integers of {name} are not normalized; each vertex's "
            message += "weights are divided by their sum"
            attributes.diagnostics.warn("GLT104", attributes.pointer_to(name), message)
        if vertex_count < 0:
            vertex_count = accessor.count
        elif accessor.count != vertex_count:
            message = f"{name} has {accessor.count} rows, but others have "
            message += f"{vertex_count}"
            attributes.diagnostics.fail("GLT011", attributes.pointer_to(name), message)
        if not accessors.has_data(index):
            continue
        if name == "POSITION":
            pointer = attributes.pointer_to(name)
            check_bounds(accessor.item, accessors.numbers(index), required_by=pointer)
        if name.startswith("WEIGHTS_") and (accessors.numbers(index) < 0).any():
            message = "a weight of a vertex is negative"
            attributes.diagnostics.fail("GLT010", attributes.pointer_to(name), message)
    return vertex_count


def _check_indices(
    item: JsonItem, index: int, vertex_count: int, accessors: Accessors
) -> None:
    _require_accessor(item, "indices", index, accessors, "SCALAR", (U8, U16, U32))
    accessors.warn_about_stride(index, item.pointer_to("indices"))
    if not accessors.has_data(index):
        return
    max_index = int(accessors.numbers(index).max())
    if vertex_count >= 0 and max_index >= vertex_count:
        message = f"a face refers to vertex {max_index} of {vertex_count}"
        item.diagnostics.fail("GLT006", item.pointer_to("indices"), message)


def check_bounds(item: JsonItem, values: Any, *, required_by: str = "") -> None:
    """Warn if min and max differ from the data.

    ``required_by`` is the pointer of an attribute that requires bounds; empty for none.
    """
    stated_bounds = [item.values.get(key) for key in ("min", "max")]
    if stated_bounds == [None, None]:
        if required_by:
            message = "min and max are missing: computed from the data"
            item.diagnostics.warn("GLT102", required_by, message)
        return
    actual_bounds = values.min(axis=0), values.max(axis=0)
    bounds = zip(("min", "max"), stated_bounds, actual_bounds, strict=True)
    for key, stated_bound, bound in bounds:
        max_value = float(np.abs(bound.astype(np.float64)).max())
        tolerance = BOUNDS_TOLERANCE * max(1.0, max_value)
        if stated_bound is None and key not in item.values:
            item.diagnostics.warn("GLT102", item.pointer_to(key), f"{key} is missing")
        if not isinstance(stated_bound, list) or len(stated_bound) != len(bound):
            continue
        numbers = zip(stated_bound, bound.tolist(), strict=True)
        for i, (stated_value, value) in enumerate(numbers):
            if is_number(stated_value) and not abs(stated_value - value) <= tolerance:
                message = f"{key} is {stated_value!r}, but the data has "
                message += f"{value:.9g}: using the data"
                item.diagnostics.warn("GLT102", f"{item.pointer_to(key)}/{i}", message)
                break


def read_skins(
    json_root: JsonItem, accessors: Accessors, node_count: int
) -> tuple[FileSkin, ...]:
    """Return the skins of a file with joints and inverse bind matrices, checked."""
    return tuple(
        _read_skin(i, accessors, node_count) for i in json_root.children("skins")
    )


def _read_skin(item: JsonItem, accessors: Accessors, node_count: int) -> FileSkin:
    if "joints" not in item.values:
        item.fail_missing("joints")
    joints = item.indices("joints", node_count, "node")
    if not joints:
        item.diagnostics.fail(
            "GLT011", item.pointer_to("joints"), "a skin without joints"
        )
    if len(set(joints)) < len(joints):
        item.diagnostics.warn(
            "GLT106", item.pointer_to("joints"), "a joint is listed twice"
        )
    matrices = np.tile(np.eye(4), (len(joints), 1, 1))
    key = "inverseBindMatrices"
    accessor_index = item.index(key, len(accessors.by_index), "accessor")
    pointer = item.pointer_to(key)
    if accessor_index >= 0:
        types = "MAT4", (FLOAT_COMPONENT,)
        accessor = _require_accessor(item, key, accessor_index, accessors, *types)
        accessors.warn_about_stride(accessor_index, pointer)
        if accessor.count < len(joints):
            message = f"{accessor.count} matrices for {len(joints)} joints"
            item.diagnostics.fail("GLT011", pointer, message)
        columns = np.zeros((len(joints), 4, 4))
        if accessors.has_data(accessor_index):
            columns = accessors.floats(accessor_index)[: len(joints)].reshape(-1, 4, 4)
        matrices = np.ascontiguousarray(columns.swapaxes(1, 2))
        row_errors = np.abs(matrices[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1)
        if (row_errors > 1e-4).any() and accessors.has_data(accessor_index):
            joint = int(row_errors.argmax())
            message = f"the last row of matrix {joint} is not 0 0 0 1"
            column_error = np.abs(columns[:, 3] - [0.0, 0.0, 0.0, 1.0]).max()
            hint = "glTF stores columns, each with four numbers"
            if column_error <= 1e-4:
                message += ", but its last column is: they are stored by rows"
                hint = "transpose all matrices: glTF stores columns"
            item.diagnostics.fail("GLT010", pointer, message, hint)
        matrices[:, 3] = [0.0, 0.0, 0.0, 1.0]
    skeleton = item.integer("skeleton")
    if skeleton is not None and not 0 <= skeleton < node_count:
        message = f"node {skeleton} does not exist: the hint is ignored"
        item.diagnostics.warn("GLT106", item.pointer_to("skeleton"), message)
        skeleton = None
    skeleton = -1 if skeleton is None else skeleton
    name = item.text("name")
    return FileSkin(name, tuple(joints), skeleton, matrices, item.pointer)


def read_skin_weights(
    primitive: Primitive, joint_count: int, accessors: Accessors
) -> tuple[IntArray, FloatArray]:
    """Return joint indices and weights of vertices ``(V, I)``; weights sum to 1.

    ``joint_count`` is the number of joints of the skin.
    """
    index_sets = [
        accessors.numbers(a).astype(np.int64) for a in primitive.joint_accessors
    ]
    indices = np.concatenate(index_sets, axis=1)
    weights = np.concatenate(
        [accessors.floats(a) for a in primitive.weight_accessors], axis=1
    )
    diagnostics = accessors.diagnostics
    _check_duplicate_joints(primitive, indices, weights, diagnostics)
    is_out_of_range = indices >= joint_count
    if is_out_of_range.any():
        has_weight = is_out_of_range & (weights > 0)
        set_index = (
            np.argwhere(has_weight if has_weight.any() else is_out_of_range)[0, 1] // 4
        )
        pointer = f"{primitive.pointer}/attributes/JOINTS_{int(set_index)}"
        message = f"joint {int(indices[is_out_of_range].max())} of a skin with "
        message += f"{joint_count}"
        if has_weight.any():
            diagnostics.fail("GLT006", pointer, message)
        diagnostics.warn("GLT106", pointer, f"{message} has no weight and is ignored")
        indices[is_out_of_range] = 0
    weight_sums = weights.sum(axis=1)
    sum_errors = np.abs(weight_sums - 1.0)
    pointer = f"{primitive.pointer}/attributes/WEIGHTS_0"
    has_data = all(
        accessors.has_data(accessor) for accessor in primitive.weight_accessors
    )
    if has_data and sum_errors.max(initial=0.0) > WEIGHT_SUM_TOLERANCE:
        weight_sum = weight_sums[sum_errors.argmax()]
        message = f"the weights of a vertex add up to {weight_sum:.6g} instead of 1; "
        message += "they were normalised"
        diagnostics.warn(
            "GLT104", pointer, message, "normalise the weights before exporting"
        )
    is_unweighted = weight_sums == 0.0
    if is_unweighted.any():
        if has_data:
            vertices = counted(int(is_unweighted.sum()), "vertex", "vertices")
            message = f"the first joint moves {vertices} without weights"
            diagnostics.warn("GLT104", pointer, message, "give each vertex a weight")
        weights[is_unweighted, 0], indices[is_unweighted, 0] = 1.0, 0
        weight_sums = np.where(is_unweighted, 1.0, weight_sums)
    return indices, weights / weight_sums[:, None]


def _check_duplicate_joints(
    primitive: Primitive,
    indices: IntArray,
    weights: FloatArray,
    diagnostics: FileDiagnostics,
) -> None:
    """Warn about joints listed twice for a vertex; their weights are added."""
    # Influences without weight get distinct numbers that no joint has.
    placeholders = -1 - np.arange(indices.shape[1])
    sorted_indices = np.sort(np.where(weights > 0, indices, placeholders), axis=1)
    has_duplicate = (sorted_indices[:, 1:] == sorted_indices[:, :-1]).any(axis=1)
    if has_duplicate.any():
        vertices = counted(int(has_duplicate.sum()), "vertex", "vertices")
        message = f"a joint appears twice in the weights of {vertices}"
        pointer = f"{primitive.pointer}/attributes/JOINTS_0"
        diagnostics.warn("GLT104", pointer, f"{message}; its weights are added")


def build_triangles(
    primitive: Primitive, vertex_count: int, accessors: Accessors
) -> IntArray:
    """Return the triangles of a primitive ``(N, 3)``; empty for points and lines."""
    if primitive.mode not in {TRIANGLES, STRIP, FAN}:
        return np.zeros((0, 3), np.int64)
    vertex_indices = np.arange(vertex_count)
    if primitive.index_accessor >= 0:
        vertex_indices = accessors.numbers(primitive.index_accessor)[:, 0].astype(
            np.int64
        )
    if primitive.mode == TRIANGLES:
        return vertex_indices[: len(vertex_indices) // 3 * 3].reshape(-1, 3)
    if len(vertex_indices) < 3:
        return np.zeros((0, 3), np.int64)
    if primitive.mode == FAN:
        fan_center = np.full(len(vertex_indices) - 2, vertex_indices[0])
        return np.stack([vertex_indices[1:-1], vertex_indices[2:], fan_center], axis=1)
    columns = vertex_indices[:-2], vertex_indices[1:-1], vertex_indices[2:]
    faces = np.stack(columns, axis=1)
    faces[1::2] = faces[1::2][:, [1, 0, 2]]
    is_degenerate = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2])
    return np.asarray(faces[~(is_degenerate | (faces[:, 0] == faces[:, 2]))])
