"""Systems beside the character of a scene, in the same output."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animtool.errors import Fault, FormatError
from animtool.scene.entries import SceneSystem
from animtool.scene.progress import Progress
from animtool.scene.report import MeshReport
from animtool.scene.scene import Scene
from animtool.scene.systems.character_watch import CharacterWatch
from animtool.scene.systems.job import system_job
from animtool.scene.systems.run import Save, SystemRun, write_systems
from animtool.transforms import Track
from animtool.units import UpAxis
from animtool.usd.author_props import prop_paths
from animtool.usd.layers import StageMetadata
from animtool.usd.paths import RigPaths
from animtool.usd.simulated import SimulatedJob

if TYPE_CHECKING:
    from animtool.usd.target import RigTarget


@dataclass(frozen=True, slots=True)
class WrittenSystems:
    """What became of systems beside a character.

    Attributes:
        files: Written beside the layer.
        reports: On each system.
        simulated: What those say of themselves that have something to say.
        notices: What is odd about them.
    """

    files: list[Path]
    reports: list[MeshReport]
    simulated: list[dict[str, object]]
    notices: list[Fault]


@dataclass(frozen=True, slots=True)
class SystemsWithTake:
    """Systems that are ready to be simulated beside a take, and what it shows of it.

    Attributes:
        scene: The file.
        systems: What is simulated.
        job: What is written; its layer has the frames of the take.
        start: Time code of the take's first frame, at 0 s.
        chunk: Samples in each of several files; None is the layer's own.
        strict: Whether warnings are errors.
        watch: Sees the take.
    """

    scene: Path
    systems: tuple[SceneSystem, ...]
    job: SimulatedJob
    start: Fraction
    chunk: int | None
    strict: bool
    watch: CharacterWatch

    def write(
        self,
        layer: Any,
        output: Path | None,
        finish: Callable[[Save], object],
        progress: Progress = None,
    ) -> WrittenSystems:
        """Simulate, and write a layer whose take is in it already.

        Args:
            layer: In memory, with the character.
            output: The file of the whole; None is stdout.
            finish: Writes the layer with what it is given, and others that belong to
                it.
            progress: Called with the share done, 0 to 1.

        Raises:
            FormatError: A system makes no sense, or has no colliders to run into.
            OutputError: A file cannot be written.
            StrictError: There were warnings, and ``strict`` is on.
            ToleranceError: A system blew up.
        """
        codes = [Fraction(code) for code in self.watch.codes.tolist()]
        metadata = replace(self.job.metadata, first=codes[0], last=codes[-1])
        job = replace(self.job, metadata=metadata)
        # Where a shot begins before its take, the take's first pose is held.
        start = min(self.start, Fraction(ceil(codes[0])))
        last = float((codes[-1] - start) / metadata.fps)
        motion = self.watch.motion(self.scene)
        if motion is not None and start < self.start:
            held = float((self.start - start) / metadata.fps)
            motion = replace(motion, times=motion.times + held)
        run = SystemRun(self.systems, last, motion, progress)
        rows = run.rows(codes, start, metadata.fps)
        made = write_systems(
            job, run, rows, layer, output, self.chunk, finish, strict=self.strict
        )
        reports = run.reports(made.prims)
        return WrittenSystems(made.files, reports, run.simulated, run.notices)


def plan_with_take(
    scene: Scene,
    paths: RigPaths,
    target: RigTarget | None,
    *,
    fps: Fraction,
    start: Fraction,
    meters_per_unit: float,
    up: UpAxis,
    chunk: int | None,
    strict: bool,
    tracks: Sequence[Track],
) -> SystemsWithTake:
    """Return what is to become of the systems of a scene that has a source.

    They are below the character's model, so that both are in one world wherever that
    stands: in its unit, turned to its up axis.

    Args:
        scene: It has both.
        paths: The character's prims.
        target: The rig of a layer.
        fps: Time codes a second.
        start: Time code of the take's first frame.
        meters_per_unit: Of what is below the model [m].
        up: Its up axis.
        chunk: Samples in each of several files; None is one.
        strict: Whether warnings are errors.
        tracks: Things beside the character.

    Raises:
        FormatError: A system has the place of something else (SCN068).
    """
    unit, axis = (meters_per_unit, up) if target is None else (target.unit, target.up)
    metadata = StageMetadata(
        paths.model.split("/")[1], fps, Fraction(0), Fraction(0), unit, axis
    )
    job = system_job(scene.systems, paths.model, metadata, meters_per_unit, up)
    _check_places(scene, job, paths, target, tracks)
    watch = CharacterWatch(
        wanted=any(scene.path in system.setup.files for system in scene.systems)
    )
    return SystemsWithTake(scene.path, scene.systems, job, start, chunk, strict, watch)


def _check_places(
    scene: Scene,
    job: SimulatedJob,
    paths: RigPaths,
    target: RigTarget | None,
    tracks: Sequence[Track],
) -> None:
    """Refuse systems whose prims something else has."""
    taken = {paths.root: "the character"}
    taken |= {path: "a thing beside it" for path in prop_paths(tracks, paths.model)}
    faults = []
    written = [system for system in scene.systems if system.written]
    for system, path in zip(written, job.paths, strict=True):
        whose = [owner for place, owner in taken.items() if _meet(path, place)]
        if not whose and target is not None and _is_other(target, path):
            whose = ["the rig layer"]
        if whose:
            message = f"{path} is of {whose[0]}"
            faults.append(system.place.fault("SCN068", message, "give it another name"))
    if faults:
        raise FormatError(faults)


def _meet(one: str, other: str) -> bool:
    return f"{one}/".startswith(f"{other}/") or f"{other}/".startswith(f"{one}/")


def _is_other(target: RigTarget, path: str) -> bool:
    """Return whether a shot has another prim there than an earlier bake's."""
    prim = target.stage.GetPrimAtPath(target.on_stage(path))
    return bool(prim) and not prim.IsA("PointBased")
