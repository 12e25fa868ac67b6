"""Describes scene files: sources, passes, systems and outputs, before a bake."""

from __future__ import annotations

from dataclasses import field
from fractions import Fraction
from typing import ClassVar

from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.core.shot import FrameRange
from animtool.core.writers import writer_of
from animtool.scene.bake.reading import default_output, layer_form, output_files
from animtool.scene.file.entries import SceneOutput, SceneSystem
from animtool.scene.scene import Scene


@dataclass(frozen=True, slots=True)
class PropDescription:
    """File and prim of a prop, and its path in the output."""

    file: str  # source file
    prim: str  # prim in the source file
    path: str  # prim path in the output


@dataclass(frozen=True, slots=True)
class PassDescription:
    """Name and line of a pass in a scene."""

    name: str  # name in the table of passes
    line: int  # line in the scene


@dataclass(frozen=True, slots=True)
class SystemDescription:
    """Summary of a system before simulation."""

    name: str  # name of its prim
    kind: str  # kind of simulation
    # Sizes by noun: springs have `particles`, `springs` and `curves` or `faces`;
    # particles have `emitters`, `forces` and the `most` at once.
    counts: dict[str, int]
    method: str  # solver or integrator; `auto` chooses when it is simulated
    step: float | None  # longest time step [s]; None lets the method choose
    # Its own colliders, meshes from files included; those of characters are not
    # counted.
    colliders: int
    joined: list[str]  # systems solved together with it
    meets: list[str]  # systems that it collides with
    tied: list[str]  # bodies that carry its pins, as system.body
    files: list[str]  # files it reads
    character: bool  # whether it collides with or is pinned to the scene's character
    line: int  # line in the scene


@dataclass(frozen=True, slots=True)
class OutputDescription:
    """Description of one output of a bake."""

    file: str  # path of the file
    kind: str  # format: `usd`, `clip` or `bvh`
    form: str  # for USD `stage`, `split`, `layer` or `library`; empty for others
    # Files that would be written; for chunks, the file that joins them and the existing
    # chunks.
    files: list[str]
    there: list[str]  # the files that already exist
    points: bool  # whether meshes are written deformed
    chunk: int | None  # samples per file; None is one file
    systems: list[str]  # names of its systems
    line: int  # line in the scene


@dataclass(frozen=True, slots=True)
class SceneDescription:
    """Description of a scene file, without reading the files it refers to."""

    path: str  # path of the file
    sources: list[str]  # source files
    rig: str | None  # its rig; None is the rig of the source
    props: list[PropDescription]
    passes: list[PassDescription]
    systems: list[SystemDescription]
    outputs: list[OutputDescription]
    fps: Fraction | None  # None is the rate of the source or rig layer
    frame_range: FrameRange | None  # frames to write; None is those of the source
    variables: list[str]  # names of variables it uses or defines
    # Always empty: `animtool validate` reports warnings.
    notices: list[Fault] = field(default_factory=list)
    json_keys: ClassVar[str] = (
        "path sources rig props passes systems outputs fps rate "
        "first=frame_range.first last=frame_range.last variables notices"
    )

    @property
    def rate(self) -> str:
        """Exact `fps` as text; empty if None."""
        return "" if self.fps is None else str(self.fps)


def describe_scene(scene: Scene) -> SceneDescription:
    """Describe a scene from its file alone; no file that it names is read."""
    return SceneDescription(
        str(scene.path),
        [str(source.path) for source in scene.sources],
        None if scene.rig is None else str(scene.rig),
        [PropDescription(str(prop.file), prop.prim, prop.path) for prop in scene.props],
        [PassDescription(e.pass_.name, e.location.line) for e in scene.passes],
        [_describe_system(scene, system) for system in scene.systems],
        [_describe_output(scene, output) for output in scene.outputs],
        scene.bake.fps,
        scene.bake.frame_range,
        sorted(scene.variables),
    )


def _describe_system(scene: Scene, system: SceneSystem) -> SystemDescription:
    setup = system.setup
    return SystemDescription(
        system.name,
        system.kind,
        setup.counts,
        setup.method,
        setup.spec.step,
        setup.surroundings.collider_count,
        list(dict.fromkeys(name for name, _ in setup.joined_systems)),
        list(dict.fromkeys(setup.surroundings.collided_systems)),
        setup.surroundings.carrier_bodies,
        [str(path) for path in dict.fromkeys(setup.files) if path != scene.path],
        scene.path in setup.files,
        system.location.line,
    )


def _describe_output(scene: Scene, output: SceneOutput) -> OutputDescription:
    path, bake = output.path or default_output(scene.path), output.bake
    writer = writer_of(path)
    is_usd = writer is None or writer.stage
    written_systems = [s for s in scene.for_output(output).systems if s.is_written]
    files = output_files(path, bake, has_systems=bool(written_systems))
    if writer is not None and not is_usd:
        files = writer.files(path)
    return OutputDescription(
        str(path),
        "usd" if writer is None else writer.name,
        str(layer_form(bake)) if is_usd else "",
        [str(path) for path in files],
        [str(path) for path in files if path.exists()],
        bake.deform,
        bake.chunk,
        [system.name for system in written_systems] if is_usd else [],
        output.location.line,
    )
