"""Describes scenes."""

from __future__ import annotations

from dataclasses import field
from fractions import Fraction
from typing import ClassVar

from animtool.core.errors import Fault
from animtool.core.record import dataclass
from animtool.core.shot import FrameRange
from animtool.core.writers import writer_of
from animtool.scene.bake.reading import default_output, form_of, output_files
from animtool.scene.file.entries import SceneOutput, SceneSystem
from animtool.scene.scene import Scene


@dataclass(frozen=True, slots=True)
class PropDescription:
    """A prop next to the character."""

    file: str  # that it is read from
    prim: str  # its prim there
    path: str  # where it is written


@dataclass(frozen=True, slots=True)
class PassDescription:
    """A pass."""

    name: str  # as the table of passes has it
    line: int  # of the scene


@dataclass(frozen=True, slots=True)
class SystemDescription:
    """Summary of a system before simulation."""

    name: str  # of its prim
    kind: str  # kind of simulation
    # What it is made of: of springs `particles`, `springs` and `curves` or `faces`; of
    # particles `emitters`, `forces` and the `most` at once.
    counts: dict[str, int]
    method: str  # its solver, or its integrator; `auto` chooses when it is simulated
    step: float | None  # the longest that it takes [s]; None leaves it to the method
    # Of its own, meshes of files among them; those of characters are not counted.
    colliders: int
    joined: list[str]  # systems that it is one with
    meets: list[str]  # systems that it runs into
    tied: list[str]  # bodies that carry its pins, as system.body
    files: list[str]  # files read for it
    character: bool  # whether it runs into, or hangs on, the scene's own character
    line: int  # of the scene


@dataclass(frozen=True, slots=True)
class OutputDescription:
    """An output of a bake."""

    file: str  # the file
    kind: str  # what it holds: `usd`, `clip` or `bvh`
    form: str  # of USD: `stage`, `split`, `layer` or `library`; empty for others
    # What would be written; of chunks, what joins them and those that are there.
    files: list[str]
    there: list[str]  # those of them that are there already
    points: bool  # whether meshes are written deformed
    chunk: int | None  # samples a file; None is one file
    systems: list[str]  # names of its systems
    line: int  # of the scene


@dataclass(frozen=True, slots=True)
class SceneDescription:
    """A scene as in its file; the files it names are not read."""

    path: str  # the file
    sources: list[str]  # source files
    rig: str | None  # the rig that it names; None is that of the source
    props: list[PropDescription]  # props
    passes: list[PassDescription]  # passes
    systems: list[SystemDescription]  # what is simulated
    outputs: list[OutputDescription]  # what would be baked
    fps: Fraction | None  # None is that of the source or the rig layer
    frame_range: FrameRange | None  # frames to write; None is those of the source
    variables: list[str]  # names of variables that it uses or gives
    # Always empty: `animtool validate` reports warnings.
    notices: list[Fault] = field(default_factory=list)
    json_keys: ClassVar[str] = (
        "path sources rig props passes systems outputs fps rate "
        "first=frame_range.first last=frame_range.last variables notices"
    )

    @property
    def rate(self) -> str:
        """Frames a second, exact; empty without."""
        return "" if self.fps is None else str(self.fps)


def describe_scene(scene: Scene) -> SceneDescription:
    """Describe a loaded scene."""
    return SceneDescription(
        str(scene.path),
        [str(source.path) for source in scene.sources],
        None if scene.rig is None else str(scene.rig),
        [PropDescription(str(prop.file), prop.prim, prop.path) for prop in scene.props],
        [
            PassDescription(entry.pass_.name, entry.location.line)
            for entry in scene.passes
        ],
        [_system(scene, system) for system in scene.systems],
        [_output(scene, output) for output in scene.outputs],
        scene.bake.fps,
        scene.bake.frame_range,
        sorted(scene.variables),
    )


def _system(scene: Scene, system: SceneSystem) -> SystemDescription:
    setup = system.setup
    facts = setup.facts
    return SystemDescription(
        system.name,
        system.kind,
        facts.counts,
        facts.method,
        facts.step,
        facts.colliders,
        list(dict.fromkeys(name for name, _ in setup.joined)),
        list(dict.fromkeys(setup.around.met)),
        setup.around.tied_bodies,
        [str(path) for path in dict.fromkeys(setup.files) if path != scene.path],
        scene.path in setup.files,
        system.location.line,
    )


def _output(scene: Scene, output: SceneOutput) -> OutputDescription:
    path, bake = output.path or default_output(scene.path), output.bake
    writer = writer_of(path)
    usd = writer is None or writer.stage
    written = [s for s in scene.writing(output).systems if s.written]
    files = output_files(path, bake, simulated=bool(written))
    if writer is not None and not usd:
        files = writer.files(path)
    return OutputDescription(
        str(path),
        "usd" if writer is None else writer.name,
        str(form_of(bake)) if usd else "",
        [str(path) for path in files],
        [str(path) for path in files if path.exists()],
        bake.deform,
        bake.chunk,
        [system.name for system in written] if usd else [],
        output.location.line,
    )
