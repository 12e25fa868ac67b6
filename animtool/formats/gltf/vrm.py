"""Which nodes of a VRM are the bones of a person."""

from __future__ import annotations

from typing import Any

from animtool.formats.gltf.document import Gltf
from animtool.formats.gltf.places import is_number


def humanoid_bones(gltf: Gltf) -> list[tuple[str, int]]:
    """Return the humanoid bones that a VRM 1.0 or 0.x names, with their nodes."""
    extensions = gltf.root.values.get("extensions")
    if not isinstance(extensions, dict):
        return []
    found: list[tuple[str, Any]] = []
    for key in ("VRMC_vrm", "VRM"):
        own = extensions.get(key)
        humanoid = own.get("humanoid") if isinstance(own, dict) else None
        bones = humanoid.get("humanBones") if isinstance(humanoid, dict) else None
        if isinstance(bones, dict):
            found += [(str(name), bone) for name, bone in bones.items()]
        elif isinstance(bones, list):
            named = [bone for bone in bones if isinstance(bone, dict)]
            found += [(str(bone.get("bone")), bone) for bone in named]
    return [
        (name, int(bone["node"]))
        for name, bone in found
        if isinstance(bone, dict)
        and is_number(bone.get("node"))
        and 0 <= bone["node"] < len(gltf.nodes)
    ]
