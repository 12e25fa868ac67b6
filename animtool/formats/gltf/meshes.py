"""glTF meshes, morph targets and skins, checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.record import dataclass
from animtool.formats.characters.nodes import SkinEntry
from animtool.formats.file_notices import FileNotices
from animtool.formats.gltf.accessors import COMPONENTS, FLOAT, Accessor, Accessors
from animtool.formats.gltf.json_items import JsonItem, animtool_extras, is_number
from animtool.formats.gltf.unused import is_known, is_read

# Component types: signed and unsigned 8 and 16 bits, unsigned 32.
I8, U8, I16, U16, U32 = 5120, 5121, 5122, 5123, 5125
QUANTIZATION = "KHR_mesh_quantization"
QUANTIZED_TYPES = (FLOAT, I8, U8, I16, U16)
TRIANGLES, STRIP, FAN = 4, 5, 6
# Tolerance of a vertex's weight sum [1]: float32 rounding is smaller, and integers are
# exact.
SUM_TOLERANCE = 1e-5
# Tolerance of min and max, relative to the size of the data [1].
BOUNDS_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class MorphTarget:
    """A morph target: accessor indices of its offsets; -1 for none."""

    position: int
    normal: int


@dataclass(frozen=True, slots=True)
class Primitive:
    """A primitive of a mesh: accessor indices of its vertices."""

    position: int  # -1 without points
    normal: int
    joints: tuple[int, ...]
    weights: tuple[int, ...]
    indices: int
    mode: int
    targets: tuple[MorphTarget, ...]
    where: str

    @property
    def vertices(self) -> tuple[Any, ...]:
        """Accessors that identify the vertices; equal for sharing primitives."""
        return self.position, self.normal, self.joints, self.weights, self.targets


@dataclass(frozen=True, slots=True)
class MeshEntry:
    """A mesh."""

    name: str | None
    primitives: tuple[Primitive, ...]
    # Default weights of its targets; nodes may override them.
    weights: tuple[float, ...]
    target_names: tuple[str, ...]  # empty if the file has none
    where: str
    original_name: str | None = None  # written by animtool if the node's name differs

    @property
    def targets(self) -> int:
        """Count of morph targets."""
        return max((len(primitive.targets) for primitive in self.primitives), default=0)


def read_meshes(root: JsonItem, accessors: Accessors) -> tuple[MeshEntry, ...]:
    """Return the meshes of a file, with checked numbers."""
    return tuple(_read_mesh(item, accessors) for item in root.children("meshes"))


def _read_mesh(item: JsonItem, accessors: Accessors) -> MeshEntry:
    if "primitives" not in item.values:
        item.missing("primitives")
    primitives = tuple(
        _read_primitive(primitive, accessors)
        for primitive in item.children("primitives")
    )
    counts = [len(primitive.targets) for primitive in primitives]
    for i, count in enumerate(counts):
        if count != counts[0]:
            message = f"{count} targets, but the first primitive has {counts[0]}"
            where = f"{item.pointer}/primitives/{i}/targets"
            item.notes.fail("GLT011", where, message)
    targets = max(counts, default=0)
    weights = item.floats("weights", None)
    if weights is not None and len(weights) != targets:
        message = f"{len(weights)} weights for {targets} targets"
        item.notes.fail("GLT011", item.at("weights"), message)
    extras = item.values.get("extras")
    names = extras.get("targetNames") if isinstance(extras, dict) else None
    is_list = isinstance(names, list) and len(names) == targets
    texts = tuple(map(str, names)) if is_list and names is not None else ()
    zeros = (0.0,) * targets
    original_name = animtool_extras(item).get("name")
    return MeshEntry(
        item.text("name"),
        primitives,
        zeros if weights is None else tuple(weights),
        texts,
        item.pointer,
        original_name if isinstance(original_name, str) else None,
    )


def _read_primitive(item: JsonItem, accessors: Accessors) -> Primitive:
    attributes = item.required("attributes")
    read = _read_attributes(attributes, len(accessors.entries))
    vertex_count = _check_vertices(attributes, read, accessors)
    sets = _skin_sets(attributes, read)
    targets = [
        _morph_target(target, vertex_count, accessors)
        for target in item.children("targets")
    ]
    mode = item.number("mode")
    if mode is not None and not 0 <= mode <= FAN:
        message = f"mode {mode} is unknown: the primitive has no faces"
        item.notes.warn("GLT106", item.at("mode"), message)
    indices = item.index("indices", len(accessors.entries), "accessor")
    if indices >= 0:
        _check_indices(item, indices, vertex_count, accessors)
    return Primitive(
        read.get("POSITION", -1),
        read.get("NORMAL", -1),
        tuple(read[f"JOINTS_{set_index}"] for set_index in sets),
        tuple(read[f"WEIGHTS_{set_index}"] for set_index in sets),
        indices,
        TRIANGLES if mode is None else mode,
        tuple(targets),
        item.pointer,
    )


def _read_attributes(attributes: JsonItem, count: int) -> dict[str, int]:
    """Return the accessors of attributes that are read; warn of unknown ones."""
    read: dict[str, int] = {}
    for name in attributes.values:
        if is_read(name):
            read[name] = attributes.index(name, count, "accessor")
        elif not is_known(name):
            message = f"unknown attribute {name!r}: ignored"
            attributes.notes.warn("GLT106", attributes.at(name), message)
    return read


def _skin_sets(attributes: JsonItem, read: Mapping[str, int]) -> list[int]:
    """Return the numbers of the sets of joints and weights."""
    joints, weights = (
        sorted(int(name.removeprefix(kind)) for name in read if name.startswith(kind))
        for kind in ("JOINTS_", "WEIGHTS_")
    )
    if joints != weights:
        message = f"JOINTS {joints} and WEIGHTS {weights} do not match"
        attributes.notes.fail("GLT011", attributes.pointer, message)
    return joints


def _morph_target(
    target: JsonItem, vertex_count: int, accessors: Accessors
) -> MorphTarget:
    """Return the accessors of a morph target."""
    _check_target(target)
    read = {
        name: target.index(name, len(accessors.entries), "accessor")
        for name in ("POSITION", "NORMAL")
        if name in target.values
    }
    for name, index in read.items():
        accessor = _typed_accessor(
            target, name, index, accessors, "VEC3", QUANTIZED_TYPES
        )
        if accessor.count != vertex_count:
            message = f"{accessor.count} rows for {vertex_count} vertices"
            target.notes.fail("GLT011", target.at(name), message)
        if accessors.has_data(index):
            check_bounds(accessor.item, accessors.numbers(index))
    return MorphTarget(read.get("POSITION", -1), read.get("NORMAL", -1))


def _check_target(target: JsonItem) -> None:
    """Warn about attributes of a morph target that are not read."""
    if not target.values:
        message = "a morph target without attributes moves nothing"
        target.notes.warn("GLT106", target.pointer, message)
    for name in target.values:
        if not is_known(name):
            message = f"unknown attribute {name!r}: ignored"
            target.notes.warn("GLT106", target.at(name), message)


def _typed_accessor(
    item: JsonItem,
    key: str,
    index: int,
    accessors: Accessors,
    kind: str,
    components: tuple[int, ...],
) -> Accessor:
    """Return an accessor of a type allowed for an attribute."""
    accessor = accessors.entries[index]
    if accessor is None or not accessor.is_of(kind, *components):
        text = "of an unknown type"
        if accessor is not None:
            text = f"{accessor.kind} of {COMPONENTS[accessor.component].name}"
        item.notes.fail("GLT011", item.at(key), f"{key} cannot be {text}")
    is_quantized = components is QUANTIZED_TYPES and accessor.component != FLOAT
    if is_quantized and not accessors.declares(QUANTIZATION):
        message = f"{key} are integers, and {QUANTIZATION} is not declared"
        item.notes.warn("GLT106", item.at(key), message)
    if accessors.has_data(index):
        accessors.numbers(index)
    return accessor


def _check_vertices(
    attributes: JsonItem, indices: dict[str, int], accessors: Accessors
) -> int:
    """Check types and counts of vertex attributes; return the vertex count."""
    vertex_count = -1
    for name, index in indices.items():
        kind = "VEC4"
        components: tuple[int, ...] = (U8, U16)
        if name in {"POSITION", "NORMAL"}:
            kind, components = "VEC3", QUANTIZED_TYPES
        elif name.startswith("WEIGHTS_"):
            components = (FLOAT, U8, U16)
        accessor = _typed_accessor(attributes, name, index, accessors, kind, components)
        _check_packing(attributes, name, accessor)
        if vertex_count < 0:
            vertex_count = accessor.count
        elif accessor.count != vertex_count:
            message = (
                f"{name} has {accessor.count} rows, but others have {vertex_count}"
            )
            attributes.notes.fail("GLT011", attributes.at(name), message)
        if not accessors.has_data(index):
            continue
        if name == "POSITION":
            where = attributes.at(name)
            check_bounds(accessor.item, accessors.numbers(index), missing=where)
        if name.startswith("WEIGHTS_") and (accessors.numbers(index) < 0).any():
            message = "a weight of a vertex is negative"
            attributes.notes.fail("GLT010", attributes.at(name), message)
    return vertex_count


def _check_packing(attributes: JsonItem, name: str, accessor: Accessor) -> None:
    """Warn about integer weights that are not normalised."""
    if not name.startswith("WEIGHTS_") or accessor.component == FLOAT:
        return
    if not accessor.normalized:
        message = f"{name} are integers that are not normalized: divided by their sum"
        attributes.notes.warn("GLT104", attributes.at(name), message)


def _check_indices(
    item: JsonItem, index: int, vertex_count: int, accessors: Accessors
) -> None:
    _typed_accessor(item, "indices", index, accessors, "SCALAR", (U8, U16, U32))
    accessors.check_packed(index, item.at("indices"))
    if not accessors.has_data(index):
        return
    largest = int(accessors.numbers(index).max())
    if vertex_count >= 0 and largest >= vertex_count:
        message = f"a face refers to vertex {largest} of {vertex_count}"
        item.notes.fail("GLT006", item.at("indices"), message)


def check_bounds(item: JsonItem, values: Any, *, missing: str = "") -> None:
    """Warn about min and max that differ from the data.

    ``missing`` names what requires them, if anything does.
    """
    stated = [item.values.get(key) for key in ("min", "max")]
    if not any(stated_value is not None for stated_value in stated):
        if missing:
            message = "min and max are missing: computed from the data"
            item.notes.warn("GLT102", missing, message)
        return
    actual = (values.min(axis=0), values.max(axis=0))
    for key, stated_bound, bound in zip(("min", "max"), stated, actual, strict=True):
        size = BOUNDS_TOLERANCE * max(
            1.0, float(np.abs(bound.astype(np.float64)).max())
        )
        if stated_bound is None and key not in item.values:
            item.notes.warn("GLT102", item.at(key), f"{key} is missing")
        if not isinstance(stated_bound, list) or len(stated_bound) != len(bound):
            continue
        for i, (stated_value, number) in enumerate(
            zip(stated_bound, bound.tolist(), strict=True)
        ):
            if is_number(stated_value) and not abs(stated_value - number) <= size:
                message = (
                    f"{key} is {stated_value!r}, but the data has {number:.9g}: using "
                )
                message += "the data"
                item.notes.warn("GLT102", f"{item.at(key)}/{i}", message)
                break


def read_skins(
    root: JsonItem, accessors: Accessors, nodes: int
) -> tuple[SkinEntry, ...]:
    """Return the skins of a file, with checked matrices."""
    return tuple(_read_skin(item, accessors, nodes) for item in root.children("skins"))


def _read_skin(item: JsonItem, accessors: Accessors, nodes: int) -> SkinEntry:
    if "joints" not in item.values:
        item.missing("joints")
    joints = item.indices("joints", nodes, "node")
    if not joints:
        item.notes.fail("GLT011", item.at("joints"), "a skin without joints")
    if len(set(joints)) < len(joints):
        item.notes.warn("GLT106", item.at("joints"), "a joint is listed twice")
    matrices = np.tile(np.eye(4), (len(joints), 1, 1))
    index = item.index("inverseBindMatrices", len(accessors.entries), "accessor")
    where = item.at("inverseBindMatrices")
    if index >= 0:
        accessor = _typed_accessor(
            item, "inverseBindMatrices", index, accessors, "MAT4", (FLOAT,)
        )
        accessors.check_packed(index, where)
        if accessor.count < len(joints):
            message = f"{accessor.count} matrices for {len(joints)} joints"
            item.notes.fail("GLT011", where, message)
        matrices_ = np.zeros((len(joints), 4, 4))
        if accessors.has_data(index):
            matrices_ = accessors.floats(index)[: len(joints)].reshape(-1, 4, 4)
        matrices = np.ascontiguousarray(matrices_.swapaxes(1, 2))
        row_error = np.abs(matrices[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1)
        if (row_error > 1e-4).any() and accessors.has_data(index):
            joint = int(row_error.argmax())
            message = f"the last row of matrix {joint} is not 0 0 0 1"
            item.notes.fail("GLT010", where, message)
        matrices[:, 3] = [0.0, 0.0, 0.0, 1.0]
    skeleton = item.number("skeleton")
    if skeleton is not None and not 0 <= skeleton < nodes:
        message = f"node {skeleton} does not exist: the hint is ignored"
        item.notes.warn("GLT106", item.at("skeleton"), message)
        skeleton = None
    return SkinEntry(
        item.text("name"),
        tuple(joints),
        -1 if skeleton is None else skeleton,
        matrices,
        item.pointer,
    )


def skin_weights(
    primitive: Primitive, joints: int, accessors: Accessors, notes: FileNotices
) -> tuple[IntArray, FloatArray]:
    """Return joints and weights of vertices ``(V, I)``; weights sum to 1.

    ``joints`` is the number of joints of the skin.
    """
    indices = np.concatenate(
        [accessors.numbers(accessor).astype(np.int64) for accessor in primitive.joints],
        axis=1,
    )
    weights = np.concatenate(
        [accessors.floats(accessor) for accessor in primitive.weights], axis=1
    )
    _check_distinct(primitive, indices, weights, notes)
    out_of_range = indices >= joints
    if out_of_range.any():
        has_weight = out_of_range & (weights > 0)
        index = np.argwhere(has_weight if has_weight.any() else out_of_range)[0, 1] // 4
        where = f"{primitive.where}/attributes/JOINTS_{int(index)}"
        message = f"joint {int(indices[out_of_range].max())} of a skin with {joints}"
        if has_weight.any():
            notes.fail("GLT006", where, message)
        notes.warn("GLT106", where, f"{message}, without weight: ignored")
        indices[out_of_range] = 0
    weight_sums = weights.sum(axis=1)
    worst = (
        float(weight_sums[np.abs(weight_sums - 1.0).argmax()])
        if len(weight_sums)
        else 1.0
    )
    where = f"{primitive.where}/attributes/WEIGHTS_0"
    has_data = all(accessors.has_data(accessor) for accessor in primitive.weights)
    if has_data and abs(worst - 1.0) > SUM_TOLERANCE:
        message = f"weights of a vertex have the sum {worst:.6g}"
        notes.warn("GLT104", where, f"{message}: they are normalised")
    is_unweighted = weight_sums == 0.0
    if is_unweighted.any():
        if has_data:
            message = f"{int(is_unweighted.sum())} vertices have no weights"
            notes.warn("GLT104", where, f"{message}: they follow the first joint")
        weights[is_unweighted, 0], indices[is_unweighted, 0] = 1.0, 0
        weight_sums = np.where(is_unweighted, 1.0, weight_sums)
    return indices, weights / weight_sums[:, None]


def _check_distinct(
    primitive: Primitive, indices: IntArray, weights: FloatArray, notes: FileNotices
) -> None:
    """Warn about joints with two weights on a vertex, which are added."""
    # Influences without weight get distinct numbers that no joint has.
    idle = -1 - np.arange(indices.shape[1])
    order = np.sort(np.where(weights > 0, indices, idle), axis=1)
    has_duplicate = (order[:, 1:] == order[:, :-1]).any(axis=1)
    if has_duplicate.any():
        message = f"{int(has_duplicate.sum())} vertices have two weights of one joint"
        where = f"{primitive.where}/attributes/JOINTS_0"
        notes.warn("GLT104", where, f"{message}: they are added")


def triangles(
    primitive: Primitive, vertex_count: int, accessors: Accessors
) -> IntArray:
    """Return a primitive's faces ``(N, 3)``; no faces for points and lines."""
    if primitive.mode not in {TRIANGLES, STRIP, FAN}:
        return np.zeros((0, 3), np.int64)
    run = np.arange(vertex_count)
    if primitive.indices >= 0:
        run = accessors.numbers(primitive.indices)[:, 0].astype(np.int64)
    if primitive.mode == TRIANGLES:
        return run[: len(run) // 3 * 3].reshape(-1, 3)
    if len(run) < 3:
        return np.zeros((0, 3), np.int64)
    if primitive.mode == FAN:
        fan_center = np.full(len(run) - 2, run[0])
        return np.stack([run[1:-1], run[2:], fan_center], axis=1)
    faces = np.stack([run[:-2], run[1:-1], run[2:]], axis=1)
    faces[1::2] = faces[1::2][:, [1, 0, 2]]
    is_degenerate = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2])
    return np.asarray(faces[~(is_degenerate | (faces[:, 0] == faces[:, 2]))])
