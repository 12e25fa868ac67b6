"""Problem sets of inverse kinematics, and how far poses are from what they ask.

numpy alone is imported: the driver and every peer read the same files with this. The
kinematics are those of the data's ``reference_fk.py``, over many poses at once.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Record = dict[str, Any]

WIDTHS = {"pin": 1, "prismatic": 1, "ball": 4, "fixed": 0}
PARTS = ("pos", "rot", "aim")


def matrices(quaternions: npt.ArrayLike) -> Array:
    """Return rotations ``(..., 3, 3)`` of quaternions w x y z ``(..., 4)``."""
    given = np.asarray(quaternions, np.float64)
    w, x, y, z = np.moveaxis(
        given / np.linalg.norm(given, axis=-1, keepdims=True), -1, 0
    )
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def angles(rotations: Array) -> Array:
    """Return the angle of rotations ``(..., 3, 3)`` [rad], accurate near 0 and pi."""
    skew = rotations - np.swapaxes(rotations, -1, -2)
    sine = np.sqrt((skew**2).sum((-1, -2)) / 8)
    cosine = (np.trace(rotations, axis1=-2, axis2=-1) - 1) / 2
    return np.asarray(np.arctan2(sine, cosine))


@dataclass(frozen=True)
class Case:
    """Problems of one model and one list of effectors.

    Attributes:
        name: Of the case in its file.
        model: Joints, as the file has them.
        effectors: As the file has them.
        starts: Poses ``(B, Q)``, or one for a clip ``(1, Q)``.
        targets: ``pos (B, E, 3)``, ``rot (B, E, 3, 3)``, ``aim (B, E, 3)``; those that
            are asked for.
        expected: What the best pose misses of each, ``(B, E)``.
    """

    name: str
    model: Record
    effectors: list[Record]
    starts: Array
    targets: dict[str, Array]
    expected: dict[str, Array]

    @property
    def joints(self) -> list[Record]:
        """The model's joints, parents first."""
        found: list[Record] = self.model["joints"]
        return found

    @cached_property
    def slices(self) -> list[slice]:
        """Where each joint's coordinates are."""
        ends = np.cumsum([WIDTHS[joint["type"]] for joint in self.joints]).tolist()
        return [
            slice(end - WIDTHS[joint["type"]], end)
            for joint, end in zip(self.joints, ends, strict=True)
        ]

    @cached_property
    def owners(self) -> list[int]:
        """The joint of each effector."""
        names = [joint["name"] for joint in self.joints]
        return [names.index(effector["joint"]) for effector in self.effectors]

    @cached_property
    def length(self) -> float:
        """The longest chain from the world to an effector, along its joints [m]."""
        reaches = []
        for effector, joint in zip(self.effectors, self.owners, strict=True):
            reach, at = float(np.linalg.norm(effector["offset"])), joint
            while at >= 0:
                reach += float(np.linalg.norm(self.joints[at]["offset_t"]))
                at = self.joints[at]["parent"]
            reaches.append(reach)
        return max(reaches)

    @property
    def problems(self) -> int:
        """How many problems, or frames of a clip."""
        return len(next(iter(self.targets.values())))

    def weights(self, part: str) -> list[float]:
        """Return the weight of a part for each effector; 0 is not asked for."""
        if part not in self.targets:
            return [0.0] * len(self.effectors)
        return [float(e.get(f"w_{part}", 0.0)) for e in self.effectors]

    def first(self, count: int) -> Case:
        """Return the same with fewer problems."""
        return Case(
            self.name,
            self.model,
            self.effectors,
            self.starts[:count],
            {part: rows[:count] for part, rows in self.targets.items()},
            {part: rows[:count] for part, rows in self.expected.items()},
        )

    def effector_poses(self, coordinates: Array) -> tuple[Array, Array]:
        """Return rotations ``(B, E, 3, 3)`` and points ``(B, E, 3)`` of poses."""
        turns: list[Array] = []
        points: list[Array] = []
        batch = len(coordinates)
        for joint, place in zip(self.joints, self.slices, strict=True):
            turn = np.broadcast_to(np.eye(3), (batch, 3, 3))
            point = np.zeros((batch, 3))
            if joint["parent"] >= 0:
                turn, point = turns[joint["parent"]], points[joint["parent"]]
            point = point + turn @ np.asarray(joint["offset_t"], np.float64)
            turn = turn @ matrices(joint["offset_r"])
            own = coordinates[:, place]
            if joint["type"] == "pin":
                turn = turn @ about(joint["axis"], own[:, 0])
            elif joint["type"] == "prismatic":
                point = point + (turn @ np.asarray(joint["axis"], np.float64)) * own
            elif joint["type"] == "ball":
                turn = turn @ matrices(own)
            turns.append(turn)
            points.append(point)
        offsets = [np.asarray(e["offset"], np.float64) for e in self.effectors]
        ends = zip(self.owners, offsets, strict=True)
        return (
            np.stack([turns[j] for j in self.owners], 1),
            np.stack([points[j] + turns[j] @ offset for j, offset in ends], 1),
        )

    def misses(self, coordinates: Array) -> dict[str, Array]:
        """Return what poses miss of the targets ``(B, E)`` [m] or [rad]."""
        turns, points = self.effector_poses(coordinates)
        found = {}
        if "pos" in self.targets:
            found["pos"] = np.linalg.norm(self.targets["pos"] - points, axis=-1)
        if "rot" in self.targets:
            found["rot"] = angles(self.targets["rot"] @ np.swapaxes(turns, -1, -2))
        if "aim" in self.targets:
            axes = np.array([e.get("aim_axis", (0, 0, 1)) for e in self.effectors])
            axes = (turns @ axes[..., None])[..., 0]
            wanted = self.targets["aim"] - points
            sine = np.linalg.norm(np.cross(axes, wanted), axis=-1)
            found["aim"] = np.arctan2(sine, (axes * wanted).sum(-1))
        return {part: rows * self._asked(part) for part, rows in found.items()}

    def _asked(self, part: str) -> Flags:
        return np.array(self.weights(part)) > 0

    def beyond_limits(self, coordinates: Array) -> Array:
        """Return the largest violation of a limit ``(B,)`` [rad] or [m]."""
        worst = np.zeros(len(coordinates))
        for joint, place in zip(self.joints, self.slices, strict=True):
            limits, own = joint.get("limits"), coordinates[:, place]
            if not limits:
                continue
            if joint["type"] == "ball":
                swing, twist = _swing_twist(own, limits["twist_axis"])
                worst = np.maximum(worst, swing - limits["swing"])
                low, high = limits["twist"]
            else:
                twist, (low, high) = own[:, 0], limits
            worst = np.maximum(worst, np.maximum(low - twist, twist - high))
        return worst


def about(axis: npt.ArrayLike, radians: Array) -> Array:
    """Return turns ``(B, 3, 3)`` about a unit axis."""
    x, y, z = np.asarray(axis, np.float64)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, cosine = np.sin(radians)[:, None, None], np.cos(radians)[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + (1 - cosine) * (cross @ cross))


def _swing_twist(quaternions: Array, axis: npt.ArrayLike) -> tuple[Array, Array]:
    given = quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
    given = np.where(given[:, :1] < 0, -given, given)
    along = given[:, 1:] @ np.asarray(axis, np.float64)
    kept = np.hypot(given[:, 0], along)
    swing = 2 * np.arctan2(np.sqrt(np.clip(1 - kept**2, 0, None)), kept)
    return swing, 2 * np.arctan2(along, given[:, 0])


def read_cases(path: Path) -> list[Case]:
    """Return a file's problems; a clip is one case whose frames are its problems."""
    document = json.loads(path.read_text("utf-8"))
    if "arrays" in document:
        return [_clip(path, document)]
    return [_case(path, case) for case in document.get("cases", [document])]


def _case(path: Path, record: Record) -> Case:
    problems = record["problems"]
    keys = {"pos": "pos", "rot": "quat", "aim": "aim"}
    targets = {
        part: np.array([[t[key] for t in p["targets"]] for p in problems], np.float64)
        for part, key in keys.items()
        if problems[0]["targets"][0].get(key) is not None
    }
    if "rot" in targets:
        targets["rot"] = matrices(targets["rot"])
    return Case(
        record.get("id", path.stem),
        record["model"],
        record["effectors"],
        np.array([problem["q0"] for problem in problems], np.float64),
        targets,
        {
            part: np.array([problem["expect"][part] for problem in problems])
            for part in targets
            if part in problems[0]["expect"]
        },
    )


def _clip(path: Path, record: Record) -> Case:
    with np.load(path.parent / record["arrays"]) as arrays:
        positions = arrays["pos"].astype(np.float64)
        rotations = matrices(arrays["quat"])
        start = arrays["q0"].astype(np.float64)[None]
    targets = {"pos": positions, "rot": rotations}
    nothing = np.zeros(positions.shape[:2])
    expected = dict.fromkeys(targets, nothing)
    return Case(
        path.stem, record["model"], record["effectors"], start, targets, expected
    )
