"""States of a glTF as the specification has them, one node and vertex after another."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
TYPES = {
    **{5120: "i1", 5121: "u1", 5122: "<i2"},
    **{5123: "<u2", 5125: "<u4", 5126: "<f4"},
}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
PATHS = {"translation": 3, "rotation": 4, "scale": 3}
RESTS = {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]}


def matrix_of(parts: dict[str, Any]) -> Floats:
    """Return the transform of a node ``(4, 4)``."""
    if "matrix" in parts:
        return np.array(parts["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = parts["rotation"] / np.linalg.norm(parts["rotation"])
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    made = np.eye(4)
    made[:3, :3] = turn * parts["scale"]
    made[:3, 3] = parts["translation"]
    return made


class Reference:
    """A file, and its states."""

    def __init__(self, document: dict[str, Any], binary: bytes) -> None:
        self.json, self.binary = document, binary
        self.nodes = document["nodes"]
        self.parents = [-1] * len(self.nodes)
        for i, node in enumerate(self.nodes):
            for child in node.get("children", ()):
                self.parents[child] = i

    def _rows(self, part: dict[str, Any], count: int, kind: str, width: int) -> Any:
        view = self.json["bufferViews"][part["bufferView"]]
        step = view.get("byteStride", np.dtype(kind).itemsize * width)
        first = view.get("byteOffset", 0) + part.get("byteOffset", 0)
        rows = [
            np.frombuffer(self.binary, kind, width, first + k * step)
            for k in range(count)
        ]
        return np.array(rows).reshape(count, width)

    def numbers(self, index: int, *, normalized: bool = False) -> Floats:
        """Return the numbers of an accessor ``(count, width)``."""
        entry = self.json["accessors"][index]
        kind, width = TYPES[entry["componentType"]], WIDTHS[entry["type"]]
        count = entry["count"]
        rows = np.zeros((count, width), kind)
        if "bufferView" in entry:
            rows = self._rows(entry, count, kind, width)
        if "sparse" in entry:
            sparse = entry["sparse"]
            at = TYPES[sparse["indices"]["componentType"]]
            indices = self._rows(sparse["indices"], sparse["count"], at, 1)[:, 0]
            rows[indices] = self._rows(sparse["values"], sparse["count"], kind, width)
        found = rows.astype(np.float64)
        if kind != "<f4" and (normalized or entry.get("normalized")):
            found = np.maximum(found / np.iinfo(kind).max, -1.0)
        return found

    def targets(self, mesh: int) -> int:
        """Return how many morph targets a mesh has."""
        parts = self.json["meshes"][mesh]["primitives"]
        return max(len(part.get("targets", ())) for part in parts)

    def _sample(self, sampler: dict[str, Any], time: float, path: str, width: int):
        times = self.numbers(sampler["input"])[:, 0]
        small = path in {"rotation", "weights"}
        table = self.numbers(sampler["output"], normalized=small)
        table = table.reshape(len(times), -1, width)
        how = sampler.get("interpolation", "LINEAR")
        keys = table[:, 1] if how == "CUBICSPLINE" else table[:, 0]

        def unit(value: Floats) -> Floats:
            return value / np.linalg.norm(value) if path == "rotation" else value

        if time <= times[0] or time >= times[-1]:
            return unit(keys[0 if time <= times[0] else -1])
        k = int(np.searchsorted(times, time, "right")) - 1
        length = times[k + 1] - times[k]
        t = (time - times[k]) / length
        a, b = keys[k], keys[k + 1]
        if how == "STEP":
            return unit(a)
        if how == "CUBICSPLINE":
            out, into = length * table[k, 2], length * table[k + 1, 0]
            found = (2 * t**3 - 3 * t**2 + 1) * a + (t**3 - 2 * t**2 + t) * out
            return unit(found + (3 * t**2 - 2 * t**3) * b + (t**3 - t**2) * into)
        if path != "rotation":
            return a + (b - a) * t
        a, b = unit(a), unit(b)
        b = -b if a @ b < 0 else b
        angle = 2 * np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b))
        if angle < 1e-9:
            return unit(a + (b - a) * t)
        return (np.sin((1 - t) * angle) * a + np.sin(t * angle) * b) / np.sin(angle)

    def _animated(
        self, clip: int | None, time: float
    ) -> tuple[list[dict[str, Any]], dict[tuple[str, int], dict[int, float]]]:
        """Return transforms of the nodes, and weights by node or mesh and target."""
        parts = []
        for node in self.nodes:
            own = {key: np.array(node.get(key, RESTS[key]), float) for key in PATHS}
            parts.append(own | {k: node[k] for k in ("matrix",) if k in node})
        weights: dict[tuple[str, int], dict[int, float]] = {}
        if clip is None:
            return parts, weights
        animation = self.json["animations"][clip]
        for channel in animation["channels"]:
            target = channel["target"]
            sampler = animation["samplers"][channel["sampler"]]
            words = ["nodes", str(target.get("node")), target["path"]]
            if target["path"] == "pointer":
                pointer = target["extensions"]["KHR_animation_pointer"]["pointer"]
                words = pointer.strip("/").split("/")
            owner, index, path = words[0], int(words[1]), words[2]
            if path in PATHS:
                value = self._sample(sampler, time, path, PATHS[path])
                parts[index][path] = value
                continue
            mesh = index if owner == "meshes" else self.nodes[index]["mesh"]
            width = 1 if len(words) > 3 else self.targets(mesh)
            value = self._sample(sampler, time, "weights", width)
            first = int(words[3]) if len(words) > 3 else 0
            own = weights.setdefault((owner, index), {})
            own.update({first + k: float(one) for k, one in enumerate(value)})
        return parts, weights

    def weights(self, node: int, moved: dict[tuple[str, int], dict[int, float]]):
        """Return the weights of the targets of a node's mesh."""
        own = self.nodes[node]
        count = self.targets(own["mesh"])
        found = list(self.json["meshes"][own["mesh"]].get("weights", [0.0] * count))
        for k, value in moved.get(("meshes", own["mesh"]), {}).items():
            found[k] = value
        found = list(own.get("weights", found))
        for k, value in moved.get(("nodes", node), {}).items():
            found[k] = value
        return np.array(found)

    def state(self, clip: int | None, time: float):
        """Return positions of nodes ``(N, 3)``, and by node points and weights."""
        parts, moved = self._animated(clip, time)
        world: list[Floats] = [np.eye(4)] * len(parts)
        done = [False] * len(parts)

        def place(node: int) -> Floats:
            if not done[node]:
                above = self.parents[node]
                upper = np.eye(4) if above < 0 else place(above)
                world[node] = upper @ matrix_of(parts[node])
                done[node] = True
            return world[node]

        positions = np.array([place(node)[:3, 3] for node in range(len(parts))])
        points, weights = {}, {}
        for i, node in enumerate(self.nodes):
            if "mesh" in node:
                weights[i] = self.weights(i, moved)
                points[i] = self._points(i, weights[i], world)
        return positions, points, weights

    def _points(self, node: int, weights: Floats, world: list[Floats]) -> Floats:
        own, rows = self.nodes[node], []
        for part in self.json["meshes"][own["mesh"]]["primitives"]:
            names = part["attributes"]
            local = self.numbers(names["POSITION"])
            for weight, target in zip(weights, part.get("targets", ()), strict=True):
                if "POSITION" in target:
                    local = local + weight * self.numbers(target["POSITION"])
            local = np.c_[local, np.ones(len(local))]
            if "skin" not in own:
                rows.append((local @ world[node].T)[:, :3])
                continue
            skin = self.json["skins"][own["skin"]]
            bound = np.tile(np.eye(4), (len(skin["joints"]), 1, 1))
            if "inverseBindMatrices" in skin:
                columns = self.numbers(skin["inverseBindMatrices"])
                bound = columns[: len(bound)].reshape(-1, 4, 4).swapaxes(1, 2)
            whole = np.array([world[joint] for joint in skin["joints"]]) @ bound
            sets = sorted(name[7:] for name in names if name.startswith("JOINTS_"))
            joints = np.hstack([self.numbers(names[f"JOINTS_{k}"]) for k in sets])
            shares = np.hstack([self.numbers(names[f"WEIGHTS_{k}"]) for k in sets])
            shares /= shares.sum(axis=1, keepdims=True)
            each = whole[joints.astype(int)]
            rows.append(np.einsum("vk,vkij,vj->vi", shares, each, local)[:, :3])
        return np.concatenate(rows)
