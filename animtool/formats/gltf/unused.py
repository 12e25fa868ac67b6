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
_READ_ATTRIBUTES = re.compile(r"POSITION|NORMAL|(?:JOINTS|WEIGHTS)_(?:0|[1-9]\d{0,3})")
_APPEARANCE_ATTRIBUTES = re.compile(
    r"TANGENT|(?:TEXCOORD|COLOR)_(?:0|[1-9]\d*)|_.*", re.DOTALL
)


@dataclass(frozen=True, slots=True)
class UnusedIndices:
    """Indices used only by images and materials."""

    accessors: frozenset[int]
    views: frozenset[int]
    buffers: frozenset[int]


def find_unused_indices(root: dict[str, Any]) -> UnusedIndices:
    """Return indices that only ignored contents refer to."""
    read_accessors: set[int] = set()
    unread_accessors: set[int] = set()
    for primitive in _all_primitives(root):
        for attributes in _primitive_accessors(primitive):
            for name, index in attributes.items():
                if is_number(index):
                    (
                        read_accessors
                        if is_supported_attribute(str(name))
                        else unread_accessors
                    ).add(int(index))
    used_accessors = {*read_accessors, *_other_accessors(root)}
    accessors = frozenset(unread_accessors - used_accessors)
    images = set(_image_views(root))
    entries = list(enumerate(_objects(root.get("accessors"))))
    used_views = {
        v for i, e in entries if i not in accessors for v in _accessor_views(e)
    }
    unused_views = {v for i, e in entries if i in accessors for v in _accessor_views(e)}
    views = frozenset((images | unused_views) - used_views)
    buffer_views = list(enumerate(_objects(root.get("bufferViews"))))
    used_buffers = {
        _valid_index(view.get("buffer")) for i, view in buffer_views if i not in views
    }
    unused_buffers = {
        _valid_index(view.get("buffer")) for i, view in buffer_views if i in views
    }
    return UnusedIndices(
        accessors, views, frozenset(unused_buffers - used_buffers - {-1})
    )


def is_supported_attribute(attribute: str) -> bool:
    """Return whether a vertex attribute is read.

    >>> is_supported_attribute("JOINTS_1"), is_supported_attribute("TEXCOORD_0")
    (True, False)
    """
    return _READ_ATTRIBUTES.fullmatch(attribute) is not None


def is_known_attribute(attribute: str) -> bool:
    """Return whether a vertex attribute is standard or application-specific.

    >>> is_known_attribute("COLOR_0"), is_known_attribute("TEXCOORD_00")
    (True, False)
    """
    return _APPEARANCE_ATTRIBUTES.fullmatch(
        attribute
    ) is not None or is_supported_attribute(attribute)


def _objects(value: Any) -> Iterator[dict[str, Any]]:
    """Yield the objects of a JSON list, and {} for entries that are not objects."""
    for entry in value if isinstance(value, list) else ():
        yield entry if isinstance(entry, dict) else {}


def _valid_index(value: Any) -> int:
    return int(value) if is_number(value) and abs(value) < 2**53 else -1


def _all_primitives(root: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for mesh in _objects(root.get("meshes")):
        yield from _objects(mesh.get("primitives"))


def _primitive_accessors(primitive: dict[str, Any]) -> Iterator[dict[str, Any]]:
    attributes = primitive.get("attributes")
    if isinstance(attributes, dict):
        yield attributes
    yield from _objects(primitive.get("targets"))


def _other_accessors(root: dict[str, Any]) -> Iterator[int]:
    for primitive in _all_primitives(root):
        yield _valid_index(primitive.get("indices"))
    for skin in _objects(root.get("skins")):
        yield _valid_index(skin.get("inverseBindMatrices"))
    for animation in _objects(root.get("animations")):
        for sampler in _objects(animation.get("samplers")):
            yield _valid_index(sampler.get("input"))
            yield _valid_index(sampler.get("output"))


def _image_views(root: dict[str, Any]) -> Iterator[int]:
    for image in _objects(root.get("images")):
        if "bufferView" in image:
            yield _valid_index(image["bufferView"])


def _accessor_views(accessor: dict[str, Any]) -> Iterator[int]:
    yield _valid_index(accessor.get("bufferView"))
    sparse = accessor.get("sparse")
    for name in ("indices", "values"):
        sparse_entry = sparse.get(name) if isinstance(sparse, dict) else None
        if isinstance(sparse_entry, dict):
            yield _valid_index(sparse_entry.get("bufferView"))
