"""Finds accessors, views and buffers that only images and materials use.

These are not checked.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from animtool.core.record import dataclass
from animtool.formats.gltf.json_items import is_number

# Vertex attributes that are read, and those that only affect appearance.
_READ_ATTRIBUTE_PATTERN = re.compile(
    r"POSITION|NORMAL|(?:JOINTS|WEIGHTS)_(?:0|[1-9]\d{0,3})"
)
_APPEARANCE_ATTRIBUTE_PATTERN = re.compile(
    r"TANGENT|(?:TEXCOORD|COLOR)_(?:0|[1-9]\d*)|_.*", re.DOTALL
)


@dataclass(frozen=True, slots=True)
class UnusedIndices:
    """Indices used only by images and materials."""

    accessors: frozenset[int]
    views: frozenset[int]
    buffers: frozenset[int]


def find_unused_indices(json_root: dict[str, Any]) -> UnusedIndices:
    """Return indices that only ignored contents refer to."""
    used_accessors, unread_accessors = {*_other_accessors(json_root)}, set[int]()
    for primitive in _all_primitives(json_root):
        attribute_lists = _json_objects([primitive.get("attributes")])
        for attributes in (*attribute_lists, *_json_objects(primitive.get("targets"))):
            for name, index in attributes.items():
                if is_number(index):
                    is_read = is_supported_attribute(str(name))
                    (used_accessors if is_read else unread_accessors).add(int(index))
    unused_accessors = frozenset(unread_accessors - used_accessors)
    images = _json_objects(json_root.get("images"))
    unused_views = {_valid_index(i["bufferView"]) for i in images if "bufferView" in i}
    used_views = set[int]()
    for i, accessor in enumerate(_json_objects(json_root.get("accessors"))):
        view_set = unused_views if i in unused_accessors else used_views
        view_set.update(_accessor_views(accessor))
    views = frozenset(unused_views - used_views)
    used_buffers, unused_buffers = {-1}, set[int]()
    for i, view in enumerate(_json_objects(json_root.get("bufferViews"))):
        buffer = _valid_index(view.get("buffer"))
        (unused_buffers if i in views else used_buffers).add(buffer)
    return UnusedIndices(
        unused_accessors, views, frozenset(unused_buffers - used_buffers)
    )


def is_supported_attribute(attribute: str) -> bool:
    """Return whether a vertex attribute is read.

    >>> is_supported_attribute("JOINTS_1"), is_supported_attribute("TEXCOORD_0")
    (True, False)
    """
    return _READ_ATTRIBUTE_PATTERN.fullmatch(attribute) is not None


def is_known_attribute(attribute: str) -> bool:
    """Return whether a vertex attribute is standard or application-specific.

    >>> is_known_attribute("COLOR_0"), is_known_attribute("TEXCOORD_00")
    (True, False)
    """
    is_appearance = _APPEARANCE_ATTRIBUTE_PATTERN.fullmatch(attribute) is not None
    return is_appearance or is_supported_attribute(attribute)


def _json_objects(value: Any) -> Iterator[dict[str, Any]]:
    """Yield the objects of a JSON list, and {} for entries that are not objects."""
    for entry in value if isinstance(value, list) else ():
        yield entry if isinstance(entry, dict) else {}


def _valid_index(value: Any) -> int:
    return int(value) if is_number(value) and abs(value) < 2**53 else -1


def _all_primitives(json_root: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for mesh in _json_objects(json_root.get("meshes")):
        yield from _json_objects(mesh.get("primitives"))


def _other_accessors(json_root: dict[str, Any]) -> Iterator[int]:
    for primitive in _all_primitives(json_root):
        yield _valid_index(primitive.get("indices"))
    for skin in _json_objects(json_root.get("skins")):
        yield _valid_index(skin.get("inverseBindMatrices"))
    for animation in _json_objects(json_root.get("animations")):
        for sampler in _json_objects(animation.get("samplers")):
            yield _valid_index(sampler.get("input"))
            yield _valid_index(sampler.get("output"))


def _accessor_views(accessor: dict[str, Any]) -> Iterator[int]:
    yield _valid_index(accessor.get("bufferView"))
    for sparse in _json_objects([accessor.get("sparse")]):
        for entry in _json_objects([sparse.get("indices"), sparse.get("values")]):
            yield _valid_index(entry.get("bufferView"))
