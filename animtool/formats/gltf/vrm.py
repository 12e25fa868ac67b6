"""Finds the humanoid bones of a VRM."""

from __future__ import annotations

from typing import Any

from animtool.formats.gltf.document import Gltf
from animtool.formats.gltf.json_items import is_number


def humanoid_bones(gltf: Gltf) -> list[tuple[str, int]]:
    """Return the humanoid bones of a VRM 1.0 or 0.x with their nodes."""
    extensions = gltf.root.values.get("extensions")
    if not isinstance(extensions, dict):
        return []
    bones_by_name: list[tuple[str, Any]] = []
    for key in ("VRMC_vrm", "VRM"):
        extension = extensions.get(key)
        humanoid = extension.get("humanoid") if isinstance(extension, dict) else None
        bones = humanoid.get("humanBones") if isinstance(humanoid, dict) else None
        if isinstance(bones, dict):
            bones_by_name += [(str(name), bone) for name, bone in bones.items()]
        elif isinstance(bones, list):
            bone_entries = [bone for bone in bones if isinstance(bone, dict)]
            bones_by_name += [(str(bone.get("bone")), bone) for bone in bone_entries]
    return [
        (name, int(bone["node"]))
        for name, bone in bones_by_name
        if isinstance(bone, dict)
        and is_number(bone.get("node"))
        and 0 <= bone["node"] < len(gltf.nodes)
    ]
