"""The entries of a scene file: sources, things beside them, passes, outputs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animtool.documents.check import FileModel
from animtool.documents.document import Document, Location, spelled
from animtool.errors import Fault, FormatError, OptionError, Severity, ToleranceError
from animtool.passes import Pass
from animtool.scene.options import BakeOptions
from animtool.scene.sources import SourceOptions
from animtool.scene.tracks import TrackNames

if TYPE_CHECKING:
    from animtool.scene.systems.kinds import SystemSetup


@dataclass(frozen=True, slots=True)
class Place:
    """Where in a file something is said.

    Attributes:
        path: The file.
        line: 1-based.
        column: 1-based.
        where: Such as ``passes[1].trim``.
        keys: Line and column of keys that are there below it.
    """

    path: Path
    line: int
    column: int
    where: str
    keys: Mapping[str, tuple[int, int]] = field(default_factory=dict, hash=False)

    def fault(
        self,
        code: str,
        message: str,
        hint: str | None = None,
        severity: Severity = Severity.ERROR,
    ) -> Fault:
        """Return a fault that is here."""
        return self.put(Fault(code, message, hint=hint, severity=severity))

    def put(self, fault: Fault) -> Fault:
        """Return a fault that has no file as one that is here, or at a key of it."""
        if fault.path is not None:
            return fault
        (line, column), where = (self.line, self.column), self.where
        if fault.where is not None and fault.where in self.keys:
            line, column = self.keys[fault.where]
            where = f"{where}.{fault.where}"
        return replace(
            fault, path=str(self.path), lines=(line,), column=column, where=where
        )

    @contextmanager
    def located(self) -> Iterator[None]:
        """Give faults that have no file this place.

        Raises:
            FormatError: What an `OptionError` said.
            ToleranceError: What one said.
        """
        try:
            yield
        except ToleranceError as error:
            raise ToleranceError([self.put(fault) for fault in error.faults]) from error
        except OptionError as error:
            raise FormatError([self.put(fault) for fault in error.faults]) from error


def place_of_entry(
    document: Document, at: Location, model: FileModel | None = None
) -> Place:
    """Return a place in a document, with those of the keys that its model was given."""
    names = () if model is None else sorted(model.model_fields_set)
    keys = {name: document.place((*at, name)) for name in names}
    return Place(document.path, *document.place(at), spelled(at), keys)


@dataclass(frozen=True, slots=True)
class SceneSource:
    """One source of a scene.

    Attributes:
        path: The file.
        options: How to open it.
        place: Of the entry.
        tracks: Of several, what it brings; None is what it moves.
        timecode: SMPTE time code of its first frame; None states none.
        timecode_fps: Frames a second that this counts; None is the source's rate.
    """

    path: Path
    options: SourceOptions
    place: Place
    tracks: TrackNames | None = None
    timecode: str | None = None
    timecode_fps: Fraction | None = None


@dataclass(frozen=True, slots=True)
class SceneProp:
    """A thing beside the character of a scene.

    Attributes:
        file: The USD file that it is read from.
        prim: Path of its prim.
        path: Where it is written: below the character, or from ``/`` on.
        frame: Time code of its file that comes with the first frame; None is the
            number of that frame.
        retimed: Whether passes retime it with the take; else it has the frames of
            what comes out of them.
        attributes: Names of what is read of it beside its place.
        reference: File that shows it; None is nothing.
        place: Of the entry.
    """

    file: Path
    prim: str
    path: str
    frame: Fraction | None
    retimed: bool
    attributes: tuple[str, ...]
    reference: Path | None
    place: Place


@dataclass(frozen=True, slots=True)
class ScenePass:
    """One entry of a scene's passes.

    Attributes:
        pass_: What to do.
        options: Its own record.
        place: Of the entry.
    """

    pass_: Pass
    options: Any
    place: Place


@dataclass(frozen=True, slots=True)
class SceneSystem:
    """One entry of a scene's systems.

    Attributes:
        name: Of its prim.
        kind: Of `SYSTEM_KINDS`.
        setup: What it is made of.
        place: Of the entry.
        written: Whether it goes into the output; else another needs it.
    """

    name: str
    kind: str
    setup: SystemSetup
    place: Place
    written: bool = True


class OutputKind(StrEnum):
    """What a file holds."""

    USD = "usd"
    CLIP = "clip"
    BVH = "bvh"


def kind_of(path: Path) -> OutputKind:
    """Return what a file of a name holds; USD where it is not known.

    >>> kind_of(Path("shot.clip.yaml")).value, kind_of(Path("shot.usdc")).value
    ('clip', 'usd')
    """
    suffix = path.suffix.lower()
    if suffix in {".yaml", ".yml"}:
        return OutputKind.CLIP
    return OutputKind.BVH if suffix == ".bvh" else OutputKind.USD


@dataclass(frozen=True, slots=True)
class SceneOutput:
    """One output of a scene.

    Attributes:
        path: The file to write; None where it names none.
        bake: Options that it sets, those of the whole scene among them.
        place: Of the entry.
        systems: Names of those that go into it; None is all.
    """

    path: Path | None
    bake: BakeOptions
    place: Place
    systems: tuple[str, ...] | None = None
