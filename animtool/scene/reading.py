"""The sources of a bake: which files they are, and all of them opened."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from animtool.documents.names import is_named
from animtool.errors import AnimtoolError, Fault, Severity
from animtool.motion import Channel, Motion
from animtool.scene.options import BakeOptions, merged
from animtool.scene.progress import Progress, share_of
from animtool.scene.scene import Scene
from animtool.scene.sources import (
    Opener,
    fitting_options,
    open_source,
)
from animtool.take import TakeStream

Source: TypeAlias = "Path | str | Scene"


def source_file(source: Source) -> Path:
    """Return the file that a source is read from."""
    return Path(source) if isinstance(source, Path | str) else source.path


@dataclass(frozen=True, slots=True)
class Reading:
    """What is to be read."""

    files: list[Path]  # of the sources, in order
    scenes: dict[Path, Scene]  # what those say that are scenes

    @property
    def inputs(self) -> list[Path]:
        """Every file that is named to be read."""
        named = [path for scene in self.scenes.values() for path in scene.inputs]
        return [*self.files, *named]

    def options(self, given: BakeOptions) -> tuple[BakeOptions, list[Fault]]:
        """Return options with those of the one scene, and warnings of scenes.

        The given ones come first.
        """
        notices = [notice for s in self.scenes.values() for notice in s.notices]
        if len(self.files) == 1:
            scenes = list(self.scenes.values())
            return (merged(given, scenes[0].bake) if scenes else given), notices
        return given, notices + _unused(self.scenes)

    def open(
        self,
        options: BakeOptions,
        progress: Progress = None,
        opener: Opener = open_source,
    ) -> list[TakeStream]:
        """Return every source, opened; what is wrong with them is said at once.

        Args:
            options: Of the bake.
            progress: Called with the share done, 0 to 1.
            opener: Called as `open_source` for each source that is no scene.
        """
        streams: list[TakeStream] = []
        errors: list[AnimtoolError] = []
        for i, path in enumerate(self.files):
            try:
                shown = share_of(progress, i, len(self.files))
                if path in self.scenes:
                    scene = self.scenes[path].forced(force_fit=options.force_fit)
                    streams.append(scene.open(progress=shown))
                    continue
                own = fitting_options(options.source, path, self.files)
                shot = options.shot or own.shot
                own = replace(own, force_fit=options.force_fit, shot=shot)
                streams.append(opener(path, own, progress=shown))
            except AnimtoolError as error:
                errors.append(error)
        if len(errors) == 1:
            raise errors[0]
        if errors:
            raise type(errors[0])([fault for e in errors for fault in e.faults])
        return streams


def found_sources(given: Sequence[Source]) -> Reading:
    """Return the files of sources, those loaded that are scenes."""
    files: list[Path] = []
    scenes: dict[Path, Scene] = {}
    for source in given:
        path = source_file(source)
        files.append(path)
        if isinstance(source, Scene):
            scenes[path] = source
        elif is_named(path, "scene"):
            from animtool.scene.file import load_scene

            scenes[path] = load_scene(path)
    return Reading(files, scenes)


def _unused(scenes: dict[Path, Scene]) -> list[Fault]:
    """Say so where a take of a library is a scene that states how to bake it."""
    message = "the scene's fps, range and output are for it alone, and not used here"
    hint = "the options of the command are for the whole library"
    return [
        Fault("CLI103", message, str(path), (), hint, Severity.WARNING)
        for path, scene in scenes.items()
        if scene.bake != BakeOptions()
    ]


def shared(stream: TakeStream, count: int) -> list[TakeStream]:
    """Return streams of one take for several readers.

    It is gathered once, when the first is read; one reader has the stream itself.
    """
    if count == 1:
        return [stream]
    held: list[Motion] = []

    def blocks() -> Iterator[Motion]:
        if not held:
            whole = Motion.concatenate(list(stream.blocks))
            held.append(whole.map(Channel.compact))
        yield held[0]

    return [replace(stream, blocks=blocks()) for _ in range(count)]
