"""Strange but valid glTF files, drawn at random."""

from __future__ import annotations

from typing import Any

import numpy as np

from support.gltf import Maker
from support.gltf_reference import matrix_of

Rng = np.random.Generator


def strange_gltf(seed: int) -> tuple[dict[str, Any], bytes]:
    """Return a file of nodes, skins, meshes and clips of any kind."""
    return _Drawn(np.random.default_rng(seed)).done()


def _turn(rng: Rng) -> Any:
    value = rng.normal(size=4)
    return value / np.linalg.norm(value)


def _placed(rng: Rng) -> dict[str, Any]:
    """Return a transform, of one of the kinds that files have."""
    node: dict[str, Any] = {}
    parts = {
        "translation": rng.normal(size=3),
        "rotation": _turn(rng),
        "scale": rng.uniform(0.5, 2, 3),
    }
    if rng.random() < 0.12:
        return {"matrix": matrix_of(parts).T.ravel().tolist()}
    if rng.random() < 0.8:
        node["translation"] = parts["translation"].tolist()
    if rng.random() < 0.7:
        node["rotation"] = parts["rotation"].tolist()
    kinds = [None] * 5 + [
        parts["scale"],
        np.full(3, float(rng.uniform(0.3, 3))),
        parts["scale"] * np.where(rng.random(3) < 0.5, -1, 1),
        np.full(3, -2.0),
    ]
    scale = kinds[int(rng.integers(len(kinds)))]
    if scale is not None:
        node["scale"] = scale.tolist()
    return node


class _Drawn:
    """A file that is being drawn."""

    def __init__(self, rng: Rng) -> None:
        self.rng, self.made = rng, Maker()
        self.json = self.made.json
        self.packed = rng.random() < 0.3
        self.extensions: set[str] = set()
        self._tree(int(rng.integers(2, 14)))
        self.json["skins"] = [self._skin() for _ in range(int(rng.integers(4)))]
        skins = self.json["skins"]
        self.joints = min((len(skin["joints"]) for skin in skins), default=0)
        self.json["meshes"] = [self._mesh() for _ in range(int(rng.integers(4)))]
        self._hang()
        self._scenes()
        clips = [self._clip(k) for k in range(int(rng.integers(4)))]
        self.json["animations"] = [clip for clip in clips if clip["channels"]]

    def done(self) -> tuple[dict[str, Any], bytes]:
        """Return the JSON and its bytes."""
        if self.packed:
            self.extensions.add("KHR_mesh_quantization")
            self.json["extensionsRequired"] = ["KHR_mesh_quantization"]
        if self.extensions:
            self.json["extensionsUsed"] = sorted(self.extensions)
        for key in ("skins", "meshes", "animations"):
            if not self.json[key]:
                del self.json[key]
        self.made.view(np.zeros(1, "<f4"))
        return self.made.done()

    def _chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def _tree(self, count: int) -> None:
        nodes = [_placed(self.rng) for _ in range(count)]
        for node in nodes:
            if self._chance(0.8):
                node["name"] = f"n{int(self.rng.integers(2 * count))}"
        order = self.rng.permutation(count)
        for k in range(1, count):
            if self._chance(0.85):
                above = nodes[order[int(self.rng.integers(k))]]
                above.setdefault("children", []).append(int(order[k]))
        self.json["nodes"] = nodes

    def _skin(self) -> dict[str, Any]:
        count = len(self.json["nodes"])
        joints = self.rng.permutation(count)[: int(self.rng.integers(1, count + 1))]
        skin: dict[str, Any] = {"joints": joints.tolist()}
        if self._chance(0.7):
            size = 1.0 if self._chance(0.5) else float(self.rng.uniform(0.5, 2))
            rows = []
            for _ in range(len(joints) + int(self._chance(0.2))):
                where = self.rng.normal(size=3)
                parts = {"rotation": _turn(self.rng), "scale": np.full(3, size)}
                rows.append(matrix_of(parts | {"translation": where}).T.ravel())
            skin["inverseBindMatrices"] = self.made.accessor(np.array(rows))
        return skin

    def _sparse(self, rows: Any, *, base: bool) -> int:
        """Store some of the rows; the others are those of a base, or zeros."""
        count, width = rows.shape
        many = int(self.rng.integers(1, count + 1))
        at = np.sort(self.rng.choice(count, many, replace=False))
        kind, component = [("u1", 5121), ("<u2", 5123), ("<u4", 5125)][
            int(self.rng.integers(3))
        ]
        entry: dict[str, Any] = {
            "componentType": 5126,
            "count": count,
            "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[width],
            "sparse": {
                "count": many,
                "indices": {
                    "bufferView": self.made.view(at.astype(kind)),
                    "componentType": component,
                },
                "values": {"bufferView": self.made.view(rows[at].astype("<f4"))},
            },
        }
        if base:
            other = self.rng.normal(size=rows.shape).astype("<f4")
            entry["bufferView"] = self.made.view(other)
        self.json.setdefault("accessors", []).append(entry)
        return len(self.json["accessors"]) - 1

    def _small_points(self, count: int) -> int:
        kind = ["i1", "u1", "i2", "u2"][int(self.rng.integers(4))]
        rows = self.rng.integers(0, 100, (count, 4)).astype(f"<{kind}")
        index = self.made.accessor(rows[:, :3].copy(), kind)
        entry = self.json["accessors"][index]
        entry["bufferView"] = view = self.made.view(rows)
        self.json["bufferViews"][view]["byteStride"] = rows[0].nbytes
        if self._chance(0.5):
            entry["normalized"] = True
        return index

    def _mesh(self) -> dict[str, Any]:
        targets = int(self.rng.integers(4))
        skinned = bool(self.joints) and self._chance(0.8)
        mesh: dict[str, Any] = {
            "primitives": [
                self._primitive(targets, skinned=skinned)
                for _ in range(int(self.rng.integers(1, 3)))
            ]
        }
        if targets and self._chance(0.5):
            mesh["weights"] = self.rng.random(targets).tolist()
        if targets and self._chance(0.5):
            names = [f"t{k % 2}" for k in range(targets)]
            mesh["extras"] = {"targetNames": names}
        return mesh

    def _primitive(self, targets: int, *, skinned: bool) -> dict[str, Any]:
        count = int(self.rng.integers(3, 12))
        points = self.rng.normal(size=(count, 3))
        attributes: dict[str, int] = {}
        if self.packed and self._chance(0.5):
            attributes["POSITION"] = self._small_points(count)
        elif self._chance(0.2):
            attributes["POSITION"] = self._sparse(points, base=self._chance(0.5))
        else:
            attributes["POSITION"] = self.made.accessor(points)
        if self._chance(0.5):
            length = np.linalg.norm(points, axis=1, keepdims=True)
            attributes["NORMAL"] = self.made.accessor(points / length)
        for k in range(int(self.rng.integers(1, 3)) if skinned else 0):
            attributes |= self._influences(k, count)
        part: dict[str, Any] = {"attributes": attributes}
        if targets:
            part["targets"] = [
                self._target(count, with_normal="NORMAL" in attributes)
                for _ in range(targets)
            ]
        choice = self.rng.random()
        if choice < 0.4:
            kind = ["u1", "u2", "u4"][int(self.rng.integers(3))]
            part["indices"] = self.made.accessor(
                self.rng.integers(0, count, (6, 1)), kind
            )
        elif choice < 0.7:
            part["mode"] = int(self.rng.integers(4, 7))
        return part

    def _influences(self, number: int, count: int) -> dict[str, int]:
        joints = self.rng.integers(0, self.joints, (count, 4))
        shares = self.rng.random((count, 4)) * (self.rng.random((count, 4)) < 0.7)
        shares[:, 0] += 0.1
        shares /= shares.sum(axis=1, keepdims=True)
        kind = ["f4", "u1", "u2"][int(self.rng.integers(3))]
        more: dict[str, Any] = {}
        if kind != "f4":
            most = np.iinfo(kind).max
            shares = np.round(shares * most)
            shares[:, 0] += most - shares.sum(axis=1)
            more["normalized"] = True
        kinds = ["u1", "u2"][int(self.rng.integers(2))]
        return {
            f"JOINTS_{number}": self.made.accessor(joints, kinds),
            f"WEIGHTS_{number}": self.made.accessor(shares, kind, **more),
        }

    def _target(self, count: int, *, with_normal: bool) -> dict[str, int]:
        rows = 0.2 * self.rng.normal(size=(count, 3))
        if with_normal and self._chance(0.2):
            return {"NORMAL": self.made.accessor(rows)}
        if self._chance(0.4):
            return {"POSITION": self._sparse(rows, base=False)}
        return {"POSITION": self.made.accessor(rows)}

    def _hang(self) -> None:
        """Give meshes nodes: those of the tree, or others, anywhere."""
        nodes = self.json["nodes"]
        tree = len(nodes)
        for _ in range(int(self.rng.integers(1, 6)) if self.json["meshes"] else 0):
            mesh = int(self.rng.integers(len(self.json["meshes"])))
            parts = self.json["meshes"][mesh]["primitives"]
            if self._chance(0.5):
                node = nodes[int(self.rng.integers(tree))]
                if "mesh" in node:
                    continue
            else:
                node = {"name": f"mesh{len(nodes)}"}
                if self._chance(0.5):
                    node |= _placed(self.rng)
                if self._chance(0.5):
                    above = nodes[int(self.rng.integers(tree))]
                    above.setdefault("children", []).append(len(nodes))
                nodes.append(node)
            node["mesh"] = mesh
            skinned = all("JOINTS_0" in part["attributes"] for part in parts)
            if skinned and self._chance(0.8):
                node["skin"] = int(self.rng.integers(len(self.json["skins"])))
            targets = len(parts[0].get("targets", ()))
            if targets and self._chance(0.4):
                node["weights"] = self.rng.random(targets).tolist()

    def _scenes(self) -> None:
        nodes = self.json["nodes"]
        below = {child for node in nodes for child in node.get("children", ())}
        roots = [i for i in range(len(nodes)) if i not in below]
        choice = self.rng.random()
        if choice < 0.6:
            self.json["scenes"] = [{"nodes": roots}]
        elif choice < 0.8:
            self.json["scenes"] = [{"nodes": [root]} for root in roots]
            self.json["scene"] = len(roots) - 1

    def _clip(self, number: int) -> dict[str, Any]:
        clip: dict[str, Any] = {"channels": [], "samplers": []}
        if self._chance(0.8):
            clip["name"] = f"clip{number % 2}"
        taken: set[tuple[str, int, str]] = set()
        for _ in range(int(self.rng.integers(1, 10))):
            found = self._target_of_clip()
            if found is None or found[0] in taken:
                continue
            taken.add(found[0])
            clip["channels"].append(
                {"sampler": len(clip["samplers"]), "target": found[1]}
            )
            clip["samplers"].append(self._sampler(found[0][2], found[2]))
        return clip

    def _target_of_clip(self) -> Any:
        """Return what is moved, the target that says so, and its width; or None."""
        i = int(self.rng.integers(len(self.json["nodes"])))
        node = self.json["nodes"][i]
        path = ["translation", "rotation", "scale", "weights"][
            int(self.rng.integers(4))
        ]
        key, pointer = ("nodes", i, path), ""
        width = {"translation": 3, "rotation": 4, "scale": 3}.get(path, 0)
        if path == "weights":
            if "mesh" not in node:
                return None
            mesh = node["mesh"]
            parts = self.json["meshes"][mesh]["primitives"]
            width = len(parts[0].get("targets", ()))
            if not width:
                return None
            choice = self.rng.random()
            if choice < 0.3:
                key, pointer = ("meshes", mesh, path), f"/meshes/{mesh}/weights"
            elif choice < 0.5:
                pointer = f"/nodes/{i}/weights/{int(self.rng.integers(width))}"
                width = 1
        elif "matrix" in node:
            return None
        elif self._chance(0.15):
            pointer = f"/nodes/{i}/{path}"
        if not pointer:
            return key, {"node": i, "path": path}, width
        self.extensions.add("KHR_animation_pointer")
        own = {"KHR_animation_pointer": {"pointer": pointer}}
        return key, {"path": "pointer", "extensions": own}, width

    def _sampler(self, path: str, width: int) -> dict[str, Any]:
        how = ["LINEAR", "STEP", "CUBICSPLINE"][int(self.rng.integers(3))]
        count = int(self.rng.integers(2 if how == "CUBICSPLINE" else 1, 7))
        times = np.cumsum(self.rng.uniform(0.05, 0.7, count))
        times = times - times[0] if self._chance(0.6) else times
        if self._chance(0.4):
            times = np.unique(np.round(times * 30) / 30)
            how = "LINEAR" if how == "CUBICSPLINE" else how
        rows = len(times) * (3 if how == "CUBICSPLINE" else 1)
        values = self.rng.uniform(0.2, 1, size=(rows, width))
        if path == "rotation":
            values = np.array([_turn(self.rng) for _ in range(rows)])
        elif path == "translation":
            values = self.rng.normal(size=(rows, width))
        elif path == "weights":
            values = values.reshape(-1, 1)
        sampler: dict[str, Any] = {"input": self.made.accessor(times)}
        if how != "LINEAR":
            sampler["interpolation"] = how
        if path in {"rotation", "weights"} and self._chance(0.35):
            kind = ["i1", "i2"][int(self.rng.integers(2))]
            small = np.round(values * np.iinfo(kind).max)
            output = self.made.accessor(small, kind, normalized=True)
        elif path != "rotation" and self._chance(0.15):
            output = self._sparse(values, base=self._chance(0.5))
        else:
            output = self.made.accessor(values)
        return sampler | {"output": output}
