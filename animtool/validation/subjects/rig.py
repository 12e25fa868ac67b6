"""A rig file as its rules see it."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.core.rules import Kind
from animtool.documents.document import Document, Location
from animtool.maths import so3
from animtool.rig.skeleton import Rig
from animtool.validation.subjects.subject import CheckedFile, DocumentSubject


@dataclass(frozen=True, eq=False)
class RigSubject(DocumentSubject):
    """A rig, and the file that says it."""

    rig: Rig  # what it makes

    def written(self, key: str) -> list[Any]:
        """Return a list of the file; empty where it has none."""
        entries = self.document.value.get(key)
        return entries if isinstance(entries, list) else []

    def at(self, key: str, name: str) -> Location:
        """Return where an entry of a list stands, by its name.

        A joint that a mirror wrote is where the other side is; what comes from
        another file is where that is named.
        """
        pointer = self._pointers.get((key, name))
        if pointer is not None:
            return pointer
        return ("from",) if "from" in self.document.value else (key,)

    @cached_property
    def _pointers(self) -> dict[tuple[str, str], Location]:
        """Where the entries of lists stand, by list and name, then by mirror."""
        pointers: dict[tuple[str, str], Location] = {}
        for label in ("name", "mirror"):
            for key in self.document.value:
                for i, entry in enumerate(self.written(key)):
                    if isinstance(entry, dict) and isinstance(entry.get(label), str):
                        pointers.setdefault((key, entry[label]), (key, i))
        return pointers

    @cached_property
    def mirrored(self) -> frozenset[str]:
        """The joints that a mirror wrote, which share their entry's faults."""
        entries = self.written("joints")
        return frozenset(entry["mirror"] for entry in entries if "mirror" in entry)

    @cached_property
    def rest(self) -> tuple[FloatArray, FloatArray]:
        """World positions ``(J, 3)`` [m] and rotations ``(J, 4)`` at rest.

        One step for all joints of a depth: rules on rigs do without the kernels.
        """
        rig, depths = self.rig, np.zeros(len(self.rig.joints), np.int64)
        for i, joint in enumerate(rig.joints):
            depths[i] = 0 if joint.parent < 0 else depths[joint.parent] + 1
        positions, rotations = rig.rest_translations.copy(), rig.rest_rotations.copy()
        for depth in range(1, int(depths.max(initial=0)) + 1):
            at_depth = np.flatnonzero(depths == depth)
            above = rig.parents[at_depth]
            turned = so3.rotate(rotations[above], positions[at_depth])
            positions[at_depth] = positions[above] + turned
            rotations[at_depth] = so3.multiply(rotations[above], rotations[at_depth])
        return positions, rotations

    @cached_property
    def size(self) -> float:
        """Diagonal of the bounds of joints and tips at rest [m]."""
        positions, rotations = self.rest
        points = [positions]
        for i, joint in enumerate(self.rig.joints):
            if joint.tips:
                tips = np.array(joint.tips)
                points.append(positions[i] + so3.rotate(rotations[i], tips))
        cloud = np.concatenate(points)
        if not len(cloud):
            return 0.0
        return float(np.linalg.norm(cloud.max(axis=0) - cloud.min(axis=0)))

    @cached_property
    def children(self) -> list[list[int]]:
        """Children of each joint."""
        children: list[list[int]] = [[] for _ in self.rig.joints]
        for i, joint in enumerate(self.rig.joints):
            if joint.parent >= 0:
                children[joint.parent].append(i)
        return children


def open_rig(document: Document) -> CheckedFile:
    """Return a rig file as its rules see it."""
    from animtool.rig.file import rig_of_document  # loads the models of a rig

    rig = rig_of_document(document)
    return CheckedFile(Kind.RIG, list(rig.notices), RigSubject(document, rig))
