"""Captures, robots and USD files as subjects: reader faults, and takes."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from io import BufferedReader, TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING

from animtool.core.errors import Fault
from animtool.core.files.reading import open_input, record_input
from animtool.core.record import dataclass
from animtool.core.rules import Kind
from animtool.motion.take import Take, TakeStream
from animtool.rig.skeleton import Rig
from animtool.scene.sources.open import open_source
from animtool.validation.motion.subject import MotionSubject, fault_factory_at
from animtool.validation.subjects.subject import CheckedFile

if TYPE_CHECKING:
    from animtool.usd.checks.takes import AnimationTake


@dataclass(frozen=True, eq=False)
class TakeSubject:
    """Subject of capture rules: a BVH take, with the lines of its joints."""

    path: Path  # the file
    take: Take  # the full take

    def fault_at(
        self, code: str, joint: str, frame: float | None, message: str, hint: str
    ) -> Fault:
        """Return a fault at a frame, of a joint or by default the root."""
        del frame
        return self.fault(code, joint or self.take.rig.names[0], message, hint)

    def fault(self, code: str, joint: str, message: str, hint: str) -> Fault:
        """Return a fault of a joint, at the line that declares it."""
        line = self._line_of_joint.get(joint)
        declared_lines = () if line is None else (line,)
        return Fault(code, message, str(self.path), declared_lines, hint, where=joint)

    @cached_property
    def _line_of_joint(self) -> dict[str, int]:
        """Line that declares each joint, by name; generated names have none."""
        line_by_joint: dict[str, int] = {}
        raw_file = open_input(self.path, None)
        with TextIOWrapper(BufferedReader(raw_file), "utf-8", "replace") as file:
            for line_number, line in enumerate(file, 1):
                keyword, _, name = line.strip().partition(" ")
                if keyword.upper() == "MOTION":
                    break
                if keyword.upper() in {"ROOT", "JOINT"}:
                    line_by_joint.setdefault(name.strip(), line_number)
        return line_by_joint


def open_bvh(path: Path) -> CheckedFile:
    """Read a BVH file with all its rows, for BVH rules and motion rules."""
    take = open_source(path).collect()
    faults = [notice.in_file(path) for notice in take.notices]
    subject = TakeSubject(path, take)
    motion = MotionSubject(take, subject.fault_at, has_units=False)
    return CheckedFile(Kind.BVH, faults, subject, takes=(motion,))


def open_livelink(path: Path) -> CheckedFile:
    """Read a Live Link Face recording; only its reader reports faults."""
    return _open_with_notices(Kind.LIVELINK, path)[0]


def open_take(path: Path) -> CheckedFile:
    """Read a take in a format that has no rules of its own, for motion rules."""
    checked_file, stream, take = _open_with_notices(Kind.TAKE, path)
    has_units = "units" in stream.details
    motion = MotionSubject(take, fault_factory_at(path), has_units=has_units)
    return replace(checked_file, takes=(motion,))


def _open_with_notices(kind: Kind, path: Path) -> tuple[CheckedFile, TakeStream, Take]:
    stream = open_source(path)
    take = stream.collect()
    faults = [notice.in_file(path) for notice in stream.notices]
    return CheckedFile(kind, faults), stream, take


def open_urdf(path: Path) -> CheckedFile:
    """Read a URDF robot; only its reader reports faults."""
    return _read_robot(Kind.URDF, path)


def open_mjcf(path: Path) -> CheckedFile:
    """Read an MJCF robot; only its reader reports faults."""
    return _read_robot(Kind.MJCF, path)


def _read_robot(kind: Kind, path: Path) -> CheckedFile:
    record_input(path)
    return CheckedFile(kind, list(Rig.load(path).notices))


def open_usd(path: Path) -> CheckedFile:
    """Inspect a USD layer and its dependencies; motion rules check its takes."""
    from animtool.usd.checks import inspect_layer

    layer = inspect_layer(path)
    takes = tuple(_layer_subject(path, take) for take in layer.takes)
    profile = "layer" if layer.has_only_overs else None
    return CheckedFile(Kind.USD, layer.faults, takes=takes, profile=profile)


def _layer_subject(path: Path, take: AnimationTake) -> MotionSubject:
    """Return a layer's take for motion rules, with faults located at its prim."""
    return MotionSubject(
        take.take,
        fault_factory_at(path, take.path),
        take.codes,
        take.frame_range,
        has_rest=take.has_rest,
        influencing_joints=take.influencing_joints,
        bind_positions=take.bind_positions,
        playback_rate=take.frames_per_second,
        file_format="USD",
        is_reduced=take.is_reduced,
    )
