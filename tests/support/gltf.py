"""Small glTF files, made of numbers that are known."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Maker:
    """Collects JSON and numbers."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}}
        self.binary = b""

    def view(self, values: npt.NDArray[Any]) -> int:
        """Store bytes; return their view."""
        content = np.ascontiguousarray(values).tobytes()
        views = self.json.setdefault("bufferViews", [])
        views.append(
            {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(content)}
        )
        self.binary += content + b"\0" * (-len(content) % 4)
        return len(views) - 1

    def accessor(self, values: Any, kind: str = "f4", **more: Any) -> int:
        """Store numbers ``(count, width)``; return their accessor."""
        table = np.asarray(values, f"<{kind}")
        table = table.reshape(len(table), -1)
        entry = {
            "bufferView": self.view(table),
            "componentType": COMPONENTS[kind],
            "count": len(table),
            "type": KINDS[table.shape[1]],
            "min": table.min(axis=0).tolist(),
            "max": table.max(axis=0).tolist(),
            **more,
        }
        entries = self.json.setdefault("accessors", [])
        entries.append(entry)
        return len(entries) - 1

    def animation(
        self, name: str | None, *tracks: tuple[int, str, str, Any, Any]
    ) -> None:
        """Add a clip: node, path, interpolation, times and values of each track."""
        entry: dict[str, Any] = {"channels": [], "samplers": []}
        if name is not None:
            entry["name"] = name
        for node, path, how, times, values in tracks:
            sampler = {"input": self.accessor(times), "output": self.accessor(values)}
            if how != "LINEAR":
                sampler["interpolation"] = how
            target = {"node": node, "path": path}
            index = len(entry["samplers"])
            entry["channels"].append({"sampler": index, "target": target})
            entry["samplers"].append(sampler)
        self.json.setdefault("animations", []).append(entry)

    def done(self) -> tuple[dict[str, Any], bytes]:
        """Return the JSON and the bytes of its buffer."""
        if self.binary:
            self.json["buffers"] = [{"byteLength": len(self.binary)}]
        return self.json, self.binary


def turned(axis: int, *degrees: float) -> npt.NDArray[np.float64]:
    """Return rotations about an axis ``(K, 4)``."""
    half = np.radians(degrees) / 2
    rows = np.zeros((len(half), 4))
    rows[:, axis], rows[:, 3] = np.sin(half), np.cos(half)
    return rows


def strip(made: Maker, joints: int, *, targets: bool = False) -> dict[str, Any]:
    """Return a primitive of a strip of triangles that joints move."""
    points = np.array([[x, y, 0.0] for y in range(joints + 1) for x in (0.0, 1.0)])
    faces = [
        row
        for y in range(0, 2 * joints, 2)
        for row in ([y, y + 1, y + 2], [y + 2, y + 1, y + 3])
    ]
    indices = np.zeros((len(points), 4))
    indices[:, 0] = np.minimum(np.arange(len(points)) // 2, joints - 1)
    weights = np.zeros((len(points), 4))
    weights[:, 0] = 1.0
    primitive = {
        "attributes": {
            "POSITION": made.accessor(points),
            "NORMAL": made.accessor(np.tile([0.0, 0.0, 1.0], (len(points), 1))),
            "JOINTS_0": made.accessor(indices, "u1"),
            "WEIGHTS_0": made.accessor(weights),
        },
        "indices": made.accessor(np.ravel(faces), "u2"),
    }
    if targets:
        moved = [{"POSITION": made.accessor(points * k)} for k in (0.1, 0.2)]
        primitive["targets"] = moved
    return primitive


def chain(made: Maker, names: list[str], at: float = 0.0) -> list[int]:
    """Add joints, each a metre above the one before; return their nodes."""
    nodes = made.json.setdefault("nodes", [])
    first = len(nodes)
    for k, name in enumerate(names):
        node: dict[str, Any] = {"name": name}
        node["translation"] = [0.0, 1.0, 0.0] if k else [at, 0.0, 0.0]
        if k + 1 < len(names):
            node["children"] = [first + k + 1]
        nodes.append(node)
    return list(range(first, first + len(names)))


def skinned(made: Maker, joints: list[int], name: str, at: float = 0.0) -> int:
    """Add a mesh with two shapes on a skin of joints; return its node."""
    inverse = np.tile(np.eye(4), (len(joints), 1, 1))
    inverse[:, 3, 0], inverse[:, 3, 1] = -at, -np.arange(len(joints))
    skins = made.json.setdefault("skins", [])
    matrices = made.accessor(inverse.reshape(-1, 16))
    skins.append({"joints": joints, "inverseBindMatrices": matrices})
    meshes = made.json.setdefault("meshes", [])
    primitive = strip(made, len(joints), targets=True)
    meshes.append({"primitives": [primitive], "extras": {"targetNames": ["a", "b"]}})
    node = {"name": name, "mesh": len(meshes) - 1, "skin": len(skins) - 1}
    made.json["nodes"].append(node)
    return len(made.json["nodes"]) - 1


def _pack(made: Maker, mesh: int, joints: list[int]) -> None:
    """Add what is packed: small integers, second influences, pointers, a VRM."""
    primitive = made.json["meshes"][made.json["nodes"][mesh]["mesh"]]["primitives"][0]
    attributes, count = primitive["attributes"], 2 * (len(joints) + 1)
    points = np.zeros((count, 4), "<i2")
    points[:, 0], points[:, 1] = np.arange(count) % 2, np.arange(count) // 2
    attributes["POSITION"] = made.accessor(points[:, :3].copy(), "i2")
    entry = made.json["accessors"][attributes["POSITION"]]
    entry["bufferView"] = made.view(points)
    made.json["bufferViews"][entry["bufferView"]]["byteStride"] = 8
    second = np.zeros((count, 4))
    attributes["JOINTS_1"] = made.accessor(second + 1, "u2")
    halves = second.copy()
    halves[:, 0] = 255
    attributes["WEIGHTS_1"] = made.accessor(halves, "u1", normalized=True)
    times = made.accessor(np.array([0.0, 0.5, 1.0]))
    keys = np.round(turned(1, 0, 40, 0) * 32767)
    pointers = [
        (f"/nodes/{joints[0]}/rotation", made.accessor(keys, "i2", normalized=True)),
        (f"/nodes/{mesh}/weights/1", made.accessor([0.0, 1.0, 0.0])),
        (
            f"/nodes/{mesh}/extensions/KHR_node_visibility/visible",
            made.accessor([1, 0, 1], "u1"),
        ),
    ]
    made.json["animations"].append(
        {
            "name": "pointed",
            "samplers": [{"input": times, "output": one} for _, one in pointers],
            "channels": [
                {
                    "sampler": k,
                    "target": {
                        "path": "pointer",
                        "extensions": {"KHR_animation_pointer": {"pointer": text}},
                    },
                }
                for k, (text, _) in enumerate(pointers)
            ],
        }
    )
    made.json["nodes"][mesh]["extensions"] = {"KHR_node_visibility": {"visible": True}}
    names = ["hips", "spine", "head"]
    bones = {name: {"node": j} for name, j in zip(names, joints, strict=True)}
    made.json["extensions"] = {"VRMC_vrm": {"humanoid": {"humanBones": bones}}}
    made.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    made.json["extensionsUsed"] = [
        *("KHR_mesh_quantization", "KHR_animation_pointer"),
        *("KHR_node_visibility", "VRMC_vrm"),
    ]


def small_gltf(kind: str = "plain") -> tuple[dict[str, Any], bytes]:
    """Return a character: ``plain``, ``cubic``, ``sparse``, ``packed`` or ``skins``."""
    made = Maker()
    joints = chain(made, ["hips", "chest", "head"])
    mesh = skinned(made, joints, "body")
    roots = [joints[0], mesh]
    times = np.array([0.0, 0.5, 1.0])
    if kind == "skins":
        others = chain(made, ["hips", "tail"], at=3.0)
        roots += [others[0], skinned(made, others, "other", at=3.0)]
        made.animation(
            "wag", (others[1], "rotation", "LINEAR", times, turned(0, 0, 40, 0))
        )
    weights = np.array([0.0, 0.0, 1.0, 0.5, 0.0, 0.0])
    if kind == "cubic":
        moves = np.zeros((9, 3))
        moves[1::3] = [[0, 0, 0], [0.2, 0.1, 0], [0, 0.3, 0]]
        moves[2::3] = [[0.5, 0, 0]] * 3
        turns = np.zeros((9, 4))
        turns[1::3] = turned(2, 0, 50, 10)
        turns[2::3] = [[0, 0, 0.4, 0]] * 3
        made.animation(
            "wave",
            (joints[0], "translation", "CUBICSPLINE", times, moves),
            (joints[1], "rotation", "CUBICSPLINE", times, turns),
            (mesh, "weights", "LINEAR", times, weights),
        )
    else:
        made.animation(
            "wave",
            (joints[0], "translation", "LINEAR", times, np.eye(3)),
            (joints[1], "rotation", "LINEAR", times, turned(2, 0, 50, 10)),
            (joints[2], "scale", "STEP", times, [[1, 1, 1], [2, 2, 2], [1, 1, 1]]),
            (mesh, "weights", "LINEAR", times, weights),
        )
        made.animation(
            "nod", (joints[2], "rotation", "STEP", times, turned(0, 0, 9, 0))
        )
    if kind == "packed":
        _pack(made, mesh, joints)
    if kind == "sparse":
        attributes = made.json["meshes"][0]["primitives"][0]["attributes"]
        entry = made.json["accessors"][attributes["POSITION"]]
        entry["sparse"] = {
            "count": 2,
            "indices": {
                "bufferView": made.view(np.array([0, 3], "<u2")),
                "componentType": 5123,
            },
            "values": {
                "bufferView": made.view(np.array([[0, 9, 0], [1, 2, 3.0]], "<f4"))
            },
        }
        entry.pop("min"), entry.pop("max")
    made.json["scenes"], made.json["scene"] = [{"nodes": roots}], 0
    return made.done()


def as_glb(document: dict[str, Any], binary: bytes) -> bytes:
    """Return a GLB."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    parts = struct.pack("<II", len(text), 0x4E4F534A) + text
    if binary:
        parts += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(parts)) + parts


def as_gltf(document: dict[str, Any], binary: bytes) -> bytes:
    """Return a .gltf whose buffer is a data URI."""
    data = base64.b64encode(binary).decode()
    uri = f"data:application/octet-stream;base64,{data}"
    buffers = [{"byteLength": len(binary), "uri": uri}]
    return json.dumps({**document, "buffers": buffers}).encode()


def write_small(path: Path, kind: str = "plain") -> Path:
    """Write a character."""
    made = small_gltf(kind)
    write = as_gltf if path.suffix == ".gltf" else as_glb
    path.write_bytes(write(*made))
    return path
