"""Problem sets of the form animtool-ik-problems and -clip as rigs and problems."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.ik import Goal, Problem, Targets, build
from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig

Record = dict[str, Any]


@dataclass(frozen=True)
class Group:
    """Problems that one model and one list of goals share."""

    name: str
    model: Record
    effectors: list[Record]
    problem: Problem
    starts: FloatArray
    targets: Targets
    records: list[Record]


def read_rig(model: Record) -> Rig:
    """Return a model as a rig."""
    return Rig(model.get("name", "model"), tuple(map(_joint, model["joints"])))


def _joint(record: Record) -> Joint:
    limits: RangeLimit | BallLimit | None = None
    given = record.get("limits")
    if given and record["type"] == "ball":
        limits = BallLimit(
            (given["swing"], given["swing"]),
            tuple(given["twist"]),
            tuple(map(float, given["twist_axis"])),
        )
    elif given:
        limits = RangeLimit(*given)
    w, x, y, z = np.array(record["offset_r"]) / np.linalg.norm(record["offset_r"])
    return Joint(
        record["name"],
        record["parent"],
        JointType(record["type"]),
        translation=tuple(record["offset_t"]),
        rotation=(x, y, z, w),
        axis=tuple(map(float, record.get("axis", (0, 0, 1)))),
        limits=limits,
    )


def reorder(model: Record, q: FloatArray, order: list[int]) -> FloatArray:
    """Return rows of coordinates with their quaternions reordered."""
    out, at = q.copy(), 0
    for joint in model["joints"]:
        if joint["type"] == "ball":
            out[:, at : at + 4] = q[:, [at + i for i in order]]
        at += {"ball": 4, "fixed": 0}.get(joint["type"], 1)
    return out


def from_file(model: Record, q: FloatArray) -> FloatArray:
    """Return coordinates ``(B, Q)`` with quaternions x y z w."""
    return reorder(model, np.atleast_2d(np.asarray(q, np.float64)), [1, 2, 3, 0])


def to_file(model: Record, q: FloatArray) -> FloatArray:
    """Return coordinates ``(B, Q)`` with quaternions w x y z."""
    return reorder(model, q, [3, 0, 1, 2])


def read_goals(effectors: list[Record], target: list[Record]) -> list[Goal]:
    """Return what is asked of the effectors: a weight, and a target for it."""
    return [
        Goal(
            effector["joint"],
            tuple(effector["offset"]),
            position=effector["w_pos"] if wanted.get("pos") is not None else 0.0,
            orientation=effector["w_rot"] if wanted.get("quat") is not None else 0.0,
            aim=effector.get("w_aim", 0.0) if wanted.get("aim") is not None else 0.0,
            aim_axis=tuple(effector.get("aim_axis", (0.0, 0.0, 1.0))),
            pole=1.0 if wanted.get("pole") is not None else 0.0,
        )
        for effector, wanted in zip(effectors, target, strict=True)
    ]


def read_targets(targets: list[list[Record]]) -> Targets:
    """Return the targets of B problems; what one lacks is zero, and not asked for."""

    def rows(name: str, nothing: list[float]) -> FloatArray:
        return np.array(
            [[goal.get(name) or nothing for goal in row] for row in targets], np.float64
        )

    quaternions = rows("quat", [1.0, 0.0, 0.0, 0.0])
    zero = [0.0] * 3
    return Targets(
        rows("pos", zero),
        quaternions[..., [1, 2, 3, 0]],
        rows("aim", zero),
        rows("pole", zero),
    )


@cache
def read_groups(path: Path) -> tuple[Group, ...]:
    """Return the problems of a file, those of one model together."""
    return tuple(_groups(path))


def _groups(path: Path) -> Iterator[Group]:
    document = json.loads(path.read_text("utf-8"))
    for case in document.get("cases", [document]):
        model, effectors = case["model"], case["effectors"]
        records = case["problems"]
        rig = read_rig(model)
        goals = read_goals(effectors, records[0]["targets"])
        starts = from_file(model, np.array([r["q0"] for r in records]))
        yield Group(
            case.get("id", path.stem),
            model,
            effectors,
            build(rig, goals),
            starts,
            read_targets([r["targets"] for r in records]),
            records,
        )


@dataclass(frozen=True)
class Clip:
    """A clip of targets.

    Attributes:
        fps: Frames a second.
        witness: Poses that reach every frame ``(F, Q)``, if there are some.
        lock: Where goals stand still ``(F, E)``, if the file says it.
    """

    model: Record
    problem: Problem
    start: FloatArray
    targets: Targets
    fps: float
    witness: FloatArray | None
    lock: BoolArray | None

    @property
    def reachable(self) -> bool:
        """Whether every frame is known to be.

        There is a witness, or feet that are locked on steps planned for this.
        """
        return self.witness is not None or self.lock is not None


def read_clip(path: Path) -> Clip:
    """Return a clip and the arrays beside it."""
    document = json.loads(path.read_text("utf-8"))
    model, effectors = document["model"], document["effectors"]
    with np.load(path.parent / document["arrays"]) as arrays:
        positions = arrays["pos"].astype(np.float64)
        rotations = arrays["quat"].astype(np.float64)[..., [1, 2, 3, 0]]
        start = from_file(model, arrays["q0"])[0]
        witness = lock = None
        if "q_witness" in arrays.files:
            witness = from_file(model, arrays["q_witness"])
        if "lock" in arrays.files:
            lock = arrays["lock"]
    goals = read_goals(effectors, [{"pos": 1, "quat": 1}] * len(effectors))
    problem = build(read_rig(model), goals)
    targets = Targets(positions, rotations)
    return Clip(model, problem, start, targets, document["fps"], witness, lock)
