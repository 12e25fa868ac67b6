"""The entries of a scene file: sources, props, passes, systems and outputs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from animtool.core.errors import (
    Fault,
    FormatError,
    OptionError,
    Severity,
    ToleranceError,
)
from animtool.core.record import dataclass
from animtool.core.units import LengthUnit
from animtool.documents.check import FileModel
from animtool.documents.document import (
    Document,
    Location,
    location_text,
    parse_location,
)
from animtool.motion.passes import Pass
from animtool.motion.transforms import PropRequest
from animtool.scene.bake.options import BakeOptions
from animtool.scene.file.tracks import TrackNames
from animtool.scene.sources.open import SourceOptions
from animtool.systems.framework.spec import EntryRecord, SystemSpec


@dataclass(frozen=True, slots=True)
class EntryLocation:
    """Location of an entry in a scene file, to which faults are attached."""

    path: Path  # the file
    line: int  # 1-based
    column: int  # 1-based
    where: str  # such as ``passes[1].trim``
    # Line and column of the keys present below it.
    positions: Mapping[str, tuple[int, int]] = field(default_factory=dict, hash=False)

    def fault(
        self,
        code: str,
        message: str,
        hint: str | None = None,
        severity: Severity = Severity.ERROR,
    ) -> Fault:
        """Return a fault at this location."""
        return self.locate(Fault(code, message, hint=hint, severity=severity))

    def nearest_key(self, fault: Fault) -> str | None:
        """Return the nearest key with a known location that contains a fault's key.

        >>> keys = {"bodies[1]": (4, 7)}
        >>> at = EntryLocation(Path("a.yaml"), 1, 1, "systems[0]", keys)
        >>> at.nearest_key(Fault("SIM061", "two bodies", where="bodies[1].name"))
        'bodies[1]'
        """
        key = fault.where or ""
        while key and key not in self.positions:
            key = key[: max(key.rfind("."), key.rfind("["), 0)]
        return key or None

    def locate(self, fault: Fault) -> Fault:
        """Return a fault located at this entry or one of its keys.

        A fault that names a file is returned unchanged.
        """
        if fault.path is not None:
            return fault
        (line, column), key_path = (self.line, self.column), self.where
        key = self.nearest_key(fault)
        if key is not None:
            line, column = self.positions[key]
            key_path = f"{key_path}.{fault.where}"
        return replace(
            fault, path=str(self.path), lines=(line,), column=column, where=key_path
        )

    @contextmanager
    def located(self) -> Iterator[None]:
        """Attach this location to faults without a file that a block raises."""
        try:
            yield
        except ToleranceError as error:
            raise ToleranceError(list(map(self.locate, error.faults))) from error
        except (OptionError, FormatError) as error:
            raise FormatError(list(map(self.locate, error.faults))) from error


def entry_location(
    document: Document, location: Location, model: FileModel | None = None
) -> EntryLocation:
    """Return the location of an entry and of the keys that are set in its model."""
    positions = {}
    for steps in () if model is None else _key_steps(model):
        positions[location_text(steps)] = document.position((*location, *steps))
    line, column = document.position(location)
    return EntryLocation(
        document.path, line, column, location_text(location), positions
    )


def _key_steps(model: FileModel) -> Iterator[Location]:
    """Yield the location of each key set in a model, or in a model inside it."""
    for name in sorted(model.model_fields_set):
        yield (name,)
        value = getattr(model, name)
        indexed_values = (
            enumerate(value) if isinstance(value, list) else [(None, value)]
        )
        for index, inner_value in indexed_values:
            if isinstance(inner_value, FileModel):
                steps = (name,) if index is None else (name, index)
                yield steps
                yield from ((*steps, *inner) for inner in _key_steps(inner_value))


@dataclass(frozen=True, slots=True)
class SceneSource:
    """A clip, capture or USD file that a scene takes motion from."""

    path: Path  # the file
    options: SourceOptions  # how to open it
    location: EntryLocation  # of the entry
    # For several sources: its tracks; None uses all moving ones.
    tracks: TrackNames | None = None
    # SMPTE time code of its first frame; None if not stated.
    timecode: str | None = None
    # Frames a second that the time code counts; None is the source's rate.
    timecode_fps: Fraction | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneProp(PropRequest):
    """A prop of a scene: a camera, an object or attributes."""

    # Time code of its file at the first frame; None is the number of that frame.
    frame: Fraction | None
    # Whether passes retime it with the take; otherwise it is sampled at the output's
    # frames.
    is_retimed: bool
    location: EntryLocation  # of the entry


@dataclass(frozen=True, slots=True)
class ScenePass:
    """A pass that a scene applies to its motion, with its options."""

    pass_: Pass
    options: Any  # its options record
    location: EntryLocation
    files: tuple[Path, ...] = ()  # files that its colliders follow


STEPS_METHOD = "steps"  # method name of kinds without methods


@dataclass(frozen=True, slots=True)
class SystemSetup:
    """The setup of a system: its spec, its colliders and its parsed entries."""

    spec: SystemSpec
    surroundings: Any  # its colliders, as `Surroundings`
    # Parsed entries of keys that are neither plain values nor colliders, by key.
    entries: Mapping[str, Any] = field(default_factory=dict)
    record: EntryRecord | None = None  # record that the spec builds from the parts
    location: Location = ()  # location of the entry
    carriers: tuple[Path, ...] = ()  # files of its carriers
    resume: Path | None = None  # file of the state to resume

    @property
    def _description_source(self) -> SystemSpec | EntryRecord:
        """The record that provides title, counts and inputs of the system."""
        return self.spec if self.record is None else self.record

    @property
    def joined_systems(self) -> tuple[tuple[str, Location], ...]:
        """Names of the systems joined to it, and the location of each name."""
        joined_names = () if self.record is None else self.record.joined_systems
        return tuple(
            (n, (*self.location, *parse_location(key))) for n, key in joined_names
        )

    @property
    def writes(self) -> tuple[str, ...]:
        """Files that the system writes in addition to the output."""
        return () if self.spec.save is None else (self.spec.save,)

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that the system reads in addition to the scene file."""
        characters = (
            Path(character.file) for character in self.surroundings.characters
        )
        resume = [self.resume] if self.resume else []
        return (*characters, *self.carriers, *self.surroundings.followed_files, *resume)

    @property
    def reads(self) -> tuple[str, ...]:
        """Descriptions of what acts on the system, for reports and plans."""
        return (*self._description_source.reads, *self.surroundings.reads)

    @property
    def summary(self) -> str:
        """Title of the system with its method and step, for plans."""
        method_text = "" if self.method == STEPS_METHOD else f" by {self.method}"
        steps = "" if self.spec.step is None else f" in steps of {self.spec.step:g} s"
        return f"{self._description_source.title},{method_text}{steps}"

    @property
    def method(self) -> str:
        """Name of the integration method; ``steps`` for a kind without methods."""
        return str(getattr(self.spec, self.spec.method_key, STEPS_METHOD))

    @property
    def counts(self) -> dict[str, int]:
        """Number of elements of the system by kind, before it is simulated."""
        return self._description_source.counts


@dataclass(frozen=True, slots=True)
class SceneSystem:
    """A simulated system of a scene, with its setup."""

    name: str  # name of its prim
    kind: str  # key of `SYSTEM_KINDS`
    setup: SystemSetup
    location: EntryLocation
    is_written: bool = True  # whether it is written; otherwise another system needs it
    # Unit of lengths that the scene states for its entry; None if not stated.
    unit: LengthUnit | None = None


@dataclass(frozen=True, slots=True)
class SceneOutput:
    """A file that a scene writes, with its bake options."""

    path: Path | None  # file to write; None if not named
    bake: BakeOptions  # its options, merged with those of the scene
    location: EntryLocation  # of the entry
    # Names of its systems; None is all.
    systems: tuple[str, ...] | None = None
