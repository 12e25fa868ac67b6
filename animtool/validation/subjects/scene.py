"""Scene files as subjects."""

from __future__ import annotations

from dataclasses import fields, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path

import numpy as np

from animtool.core.errors import AnimtoolError, Fault, Severity
from animtool.core.files.reading import recorded_inputs
from animtool.core.record import dataclass
from animtool.core.rules import Kind
from animtool.documents.document import Document, Location
from animtool.documents.variables import SceneValues
from animtool.ik.take_pass import IkPassOptions, rig_and_tracks
from animtool.ik.tracks import TargetTracks
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.scene.file.entries import SceneOutput
from animtool.scene.file.read import scene_of_document
from animtool.scene.scene import Scene
from animtool.scene.systems.character_motion import motion_of
from animtool.validation.subjects.subject import CheckedFile, DocumentSubject

# Values that differ by less are the same [m], [1].
SAME = 1e-9
# Options of an output that a bake refuses, and the codes that the command has for them.
REFUSED, OF_OPTIONS = "SCN207", {"CLI002", "CLI004"}


@dataclass(frozen=True, eq=False)
class SceneSubject(DocumentSubject):
    """A scene with its source and the result of its passes."""

    scene: Scene  # what the file makes
    take: Take  # its source with all passes done
    # Time code of its first frame; None where nothing states one.
    start: Fraction | None
    curves: bool  # whether it has curves of controls
    idle: tuple[int, ...]  # which passes change nothing
    # The takes that passes of the kind `ik` are given, by index.
    solved: dict[int, Take]
    read: frozenset[Path]  # the files that were read for it

    @cached_property
    def asked(self) -> list[tuple[Take, TargetTracks]]:
        """Takes of IK passes, with their rigs and sampled targets."""
        folder = self.scene.path.resolve().parent
        takes = []
        for i, solved in self.solved.items():
            take, tracks = rig_and_tracks(solved, self.scene.passes[i].options, folder)
            takes.append((take, tracks.placed(take.clock)))
        return takes

    @property
    def targets(self) -> set[str]:
        """The targets files of its passes, as named in faults."""
        return {str(tracks.path) for _, tracks in self.asked}

    @cached_property
    def outputs(self) -> list[tuple[Location, SceneOutput]]:
        """Output files, and their locations in the scene file."""
        several = isinstance(self.document.value.get("output"), list)
        return [
            (("output", i) if several else ("output",), output)
            for i, output in enumerate(self.scene.outputs)
        ]

    def at_pass(self, i: int) -> Location:
        """Return the location of a pass."""
        return ("passes", i, self.scene.passes[i].pass_.name)


def open_scene(
    document: Document, batch_values: SceneValues | None = None
) -> CheckedFile:
    """Return the subject of a scene file; reads its source and runs its passes.

    ``given`` are values of its variables that a batch gives.
    """
    values = SceneValues() if batch_values is None else batch_values
    scene = scene_of_document(document, values.values, parts=values.parts)
    path = str(document.path)
    checked = CheckedFile(Kind.SCENE)
    if not scene.sources:
        # It has no take: its reader has checked all but how systems begin.
        checked.faults = [*scene.notices, *_refused(scene, None)]
        return checked
    try:
        checked.subject, notices = _played(document, scene)
    except AnimtoolError as error:
        faults = list(error.faults)
    else:
        # What is odd about another file is said of that one; but targets make no
        # sense alone.
        located = {None, path, *checked.subject.targets}
        faults = [fault for fault in notices if fault.path in located]
        faults += _refused(scene, checked.subject.take)
    faults = [fault.in_file(path) for fault in faults]
    checked.faults = [*scene.notices, *faults]
    return checked


def _refused(scene: Scene, take: Take | None) -> list[Fault]:
    """Return the errors of a bake, and warnings about initial states of systems."""
    from animtool.scene.bake.outline import outlined  # loads USD
    from animtool.scene.bake.plan import refusals

    refused = [
        replace(fault, code=REFUSED) if fault.code in OF_OPTIONS else fault
        for fault in refusals(outlined(scene, None), take)
    ]
    return [*refused, *_simulated(scene, take)]


def _simulated(scene: Scene, take: Take | None) -> list[Fault]:
    """Return errors and warnings of initializing the systems."""
    if not scene.systems:
        return []
    from animtool.scene.systems.run import SystemRun  # loads USD

    motion = None if take is None else motion_of(scene.path, take)
    rig = None if take is None else take.rig
    try:
        run = SystemRun(scene.systems, _seconds(scene, take), motion, main_rig=rig)
    except AnimtoolError as error:
        return list(error.faults)
    # Notes are of how it will be simulated.
    return [one for one in run.notices if one.severity is not Severity.NOTE]


def _seconds(scene: Scene, take: Take | None) -> float:
    """Return the duration of the simulation [s]."""
    if take is not None:
        return float(take.clock.duration)
    from animtool.scene.systems.bake import FPS

    frames = scene.bake.frame_range
    if frames is None:
        return 0.0
    return float((frames.last - frames.first) / (scene.bake.fps or FPS))


def _played(document: Document, scene: Scene) -> tuple[SceneSubject, list[Fault]]:
    """Return a scene with its passes run, and their notices."""
    idle: list[int] = []
    solved: dict[int, Take] = {}
    with recorded_inputs() as inputs:
        steps = scene.steps()
        take, stream = next(steps)
        for i, step in enumerate(steps):
            after, stream = step
            if isinstance(scene.passes[i].options, IkPassOptions):
                solved[i] = take
            if _equal_sources(take, after):
                idle.append(i)
            take = after
    subject = SceneSubject(
        document,
        scene,
        take,
        stream.start,
        bool(stream.control_curves),
        tuple(idle),
        solved,
        frozenset(inputs.opened),
    )
    return subject, stream.notices


def _equal_sources(before: Take, after: Take) -> bool:
    """Return whether a pass left a take unchanged."""
    if before.clock != after.clock or before.rig.names != after.rig.names:
        return False
    parts = [f.name for f in fields(Motion) if f.name != "points"]
    pairs = [
        (getattr(before.motion, part), getattr(after.motion, part)) for part in parts
    ]
    old, new = before.motion.points, after.motion.points
    pairs += [(old.get(name), new.get(name)) for name in {*old, *new}]
    return all(_same(one, other) for one, other in pairs)


def _same(one: Channel | None, two: Channel | None) -> bool:
    if one is None or two is None:
        return one is two
    return np.allclose(one.dense(), two.dense(), rtol=0.0, atol=SAME)
