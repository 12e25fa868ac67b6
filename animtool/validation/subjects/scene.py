"""Scene files as subjects."""

from __future__ import annotations

from dataclasses import fields, replace
from fractions import Fraction
from functools import cached_property
from itertools import starmap
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
from animtool.scene.file.read import parse_scene
from animtool.scene.scene import Scene
from animtool.scene.systems.character_motion import motion_from_take
from animtool.validation.subjects.subject import CheckedFile, DocumentSubject

# Values that differ by less are equal [m], [1].
VALUE_TOLERANCE = 1e-9
# Options of an output that a bake refuses, and the corresponding codes of the command.
REFUSED_CODE, OPTION_CODES = "SCN207", {"CLI002", "CLI004"}


@dataclass(frozen=True, eq=False)
class SceneSubject(DocumentSubject):
    """Subject of scene rules: a scene, and its take after all passes."""

    scene: Scene  # the scene of the file
    take: Take  # its source with all passes applied
    # Time code of its first frame; None if unspecified.
    start: Fraction | None
    has_control_curves: bool  # whether its controls have curves
    idle_passes: tuple[int, ...]  # indices of passes that change nothing
    # Input takes of the `ik` passes, by pass index.
    ik_input_takes: dict[int, Take]
    read_files: frozenset[Path]  # files that were read for the scene

    @cached_property
    def sampled_targets(self) -> list[tuple[Take, TargetTracks]]:
        """Takes of IK passes, with their rigs and sampled targets."""
        folder = self.scene.path.resolve().parent
        takes_and_tracks = []
        for pass_index, input_take in self.ik_input_takes.items():
            options = self.scene.passes[pass_index].options
            take, tracks = rig_and_tracks(input_take, options, folder)
            takes_and_tracks.append((take, tracks.at_clock(take.clock)))
        return takes_and_tracks

    @property
    def targets(self) -> set[str]:
        """Names of the targets files of its passes, as faults spell them."""
        return {str(tracks.path) for _, tracks in self.sampled_targets}

    @cached_property
    def outputs(self) -> list[tuple[Location, SceneOutput]]:
        """Each output with its location in the scene file."""
        has_several = isinstance(self.document.value.get("output"), list)
        return [
            (("output", i) if has_several else ("output",), output)
            for i, output in enumerate(self.scene.outputs)
        ]

    def pass_location(self, pass_index: int) -> Location:
        """Return the location of a pass."""
        return ("passes", pass_index, self.scene.passes[pass_index].pass_.name)


def open_scene(
    document: Document, batch_values: SceneValues | None = None
) -> CheckedFile:
    """Read a scene file and its source, run its passes, and plan its bake.

    ``batch_values``: values of its variables from a batch.
    """
    values = SceneValues() if batch_values is None else batch_values
    scene = parse_scene(document, values.values, parts=values.component_names)
    path = str(document.path)
    checked_file = CheckedFile(Kind.SCENE)
    if not scene.sources:
        # Without a take: its reader has checked everything but the initial states of
        # systems.
        from animtool.scene.systems.bake import unmoved_frames_warning  # loads USD

        checked_file.faults = [*scene.notices, *_planning_faults(scene, None)]
        for output in scene.outputs:
            checked_file.faults += unmoved_frames_warning(scene, output.bake)
        return checked_file
    try:
        checked_file.subject, notices = _run_passes(document, scene)
    except AnimtoolError as error:
        faults = list(error.faults)
    else:
        # Notices about other files are reported for those files; but targets cannot be
        # checked alone.
        named_files = {None, path, *checked_file.subject.targets}
        faults = [fault for fault in notices if fault.path in named_files]
        faults += _planning_faults(scene, checked_file.subject.take)
    faults = [fault.in_file(path) for fault in faults]
    checked_file.faults = [*scene.notices, *faults]
    return checked_file


def _planning_faults(scene: Scene, take: Take | None) -> list[Fault]:
    """Return errors of planning a bake, and warnings about initial system states."""
    from animtool.scene.bake.plan import planning_faults
    from animtool.scene.bake.request import create_request  # loads USD

    refused_faults = [
        replace(fault, code=REFUSED_CODE) if fault.code in OPTION_CODES else fault
        for fault in planning_faults(create_request(scene, None), take)
    ]
    return [*refused_faults, *_system_faults(scene, take)]


def _system_faults(scene: Scene, take: Take | None) -> list[Fault]:
    """Return errors and warnings of building the systems, without simulating them."""
    if not scene.systems:
        return []
    from animtool.scene.systems.run import SystemRun  # loads USD

    motion = None if take is None else motion_from_take(scene.path, take)
    rig = None if take is None else take.rig
    seconds = _simulated_seconds(scene, take)
    try:
        run = SystemRun(scene.systems, seconds, motion, main_rig=rig)
    except AnimtoolError as error:
        return list(error.faults)
    # A start that looks like a frame is reported where it is written.
    reported_locations = [notice.where or "" for notice in scene.notices]
    notices = run.notices + [
        notice
        for notice in (run.late_start_notices(seconds) if seconds else ())
        if not any(where.startswith(notice.where or "") for where in reported_locations)
    ]
    # Notes are about how it will be simulated.
    return [notice for notice in notices if notice.severity is not Severity.NOTE]


def _simulated_seconds(scene: Scene, take: Take | None) -> float:
    """Return the duration of the take, or else of the frame range [s]; 0 if unknown."""
    if take is not None:
        return float(take.clock.duration)
    from animtool.scene.scene import DEFAULT_FPS

    frame_range = scene.bake.frame_range
    if frame_range is None:
        return 0.0
    return float(
        (frame_range.last - frame_range.first) / (scene.bake.fps or DEFAULT_FPS)
    )


def _run_passes(document: Document, scene: Scene) -> tuple[SceneSubject, list[Fault]]:
    """Run the passes of a scene; return its subject and the notices of the passes."""
    idle_passes: list[int] = []
    ik_input_takes: dict[int, Take] = {}
    with recorded_inputs() as inputs:
        steps = scene.steps()
        take, stream = next(steps)
        for i, step in enumerate(steps):
            new_take, stream = step
            if isinstance(scene.passes[i].options, IkPassOptions):
                ik_input_takes[i] = take
            if _is_unchanged(take, new_take):
                idle_passes.append(i)
            take = new_take
    subject = SceneSubject(
        document,
        scene,
        take,
        stream.start,
        bool(stream.control_curves),
        tuple(idle_passes),
        ik_input_takes,
        frozenset(inputs.opened_paths),
    )
    return subject, stream.notices


def _is_unchanged(old_take: Take, new_take: Take) -> bool:
    """Return whether a pass left a take unchanged."""
    if old_take.clock != new_take.clock or old_take.rig.names != new_take.rig.names:
        return False
    old, new = old_take.motion, new_take.motion
    channel_names = [field.name for field in fields(Motion) if field.name != "points"]
    channel_pairs = [(getattr(old, name), getattr(new, name)) for name in channel_names]
    point_names = {*old.points, *new.points}
    channel_pairs += [(old.points.get(k), new.points.get(k)) for k in point_names]
    return all(starmap(_is_same_channel, channel_pairs))


def _is_same_channel(first: Channel | None, second: Channel | None) -> bool:
    if first is None or second is None:
        return first is second
    return np.allclose(first.dense(), second.dense(), rtol=0.0, atol=VALUE_TOLERANCE)
