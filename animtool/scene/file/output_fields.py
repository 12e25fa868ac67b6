"""Reading of scene and batch keys that set options."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

from animtool.core.options import FileKind, OptionKind, keys_of, options_of
from animtool.core.rates import parse_rate
from animtool.core.record import dataclass
from animtool.core.shot import FrameRange, Shot
from animtool.core.units import LengthUnit, UpAxis, parse_length
from animtool.core.writers import Writer, writer_of
from animtool.documents.check import FileModel
from animtool.documents.document import Document, Location
from animtool.documents.references import resolve_input, resolve_reference
from animtool.scene.bake.options import BakeOptions
from animtool.scene.file.entries import SceneOutput, entry_location
from animtool.scene.file.option_text import parse_offsets
from animtool.scene.file.schema import OutputModel, SceneModel
from animtool.scene.sources.retime import Preroll
from animtool.scene.systems.links import check_names

ParsedT = TypeVar("ParsedT")


@dataclass(frozen=True, slots=True)
class KeyReader:
    """Reads the values of keys and records the faults in them."""

    document: Document
    roots: tuple[Path, ...]  # folders that may contain files
    rule_code: str  # code for an invalid value

    def parse_value(
        self, location: Location, value: Any, parse: Callable[[Any], ParsedT]
    ) -> ParsedT | None:
        """Parse a value and record its fault; return None if it is None or invalid."""
        if value is None:
            return None
        try:
            return parse(value)
        except ValueError as error:
            self.document.add(
                getattr(error, "code", self.rule_code), location, str(error)
            )
            return None

    def read_file(self, location: Location, name: str) -> Path:
        """Return an existing file to read; record a fault if it is missing."""
        return resolve_input(self.document, location, name, self.roots) or Path(name)


def option_values(
    record: type[Any],
    model: FileModel,
    file_kind: FileKind,
    location: Location,
    reader: KeyReader,
) -> dict[str, Any]:
    """Return the values of options that keys of a model set, by option name.

    ``model`` has the fields of the record by `with_fields`, at a location in its file.
    """
    values, options = {}, options_of(record)
    for name, key in keys_of(record, file_kind).items():
        alias = key.alias or name
        value = getattr(model, alias)
        if value is not None:
            value = _read_option(options[name].kind, value, (*location, alias), reader)
        if value is not None:
            values[name] = value
    return values


def _read_option(
    kind: OptionKind, value: Any, location: Location, reader: KeyReader
) -> Any:
    """Parse the value of a key; return None, with a fault, if it is invalid."""
    if kind == "file":
        return reader.read_file(location, value)
    if kind == "lengths":
        lengths = {
            name: reader.parse_value((*location, name), text, parse_length)
            for name, text in value.items()
        }
        return tuple(
            (name, length) for name, length in lengths.items() if length is not None
        )
    parse = _PARSERS.get(kind)
    return value if parse is None else reader.parse_value(location, value, parse)


def _parse_range(first_and_last: list[int]) -> FrameRange:
    first, last = first_and_last
    if first > last:
        raise ValueError(f"the range from {first} to {last} is reversed")
    return FrameRange(first, last)


_PARSERS: dict[OptionKind, Callable[[Any], Any]] = {
    "unit": LengthUnit,
    "axis": UpAxis,
    "rate": parse_rate,
    "range": _parse_range,
    "frame": Fraction,
    "offsets": lambda ns: parse_offsets(",".join(map(repr, ns))) if ns else (),
    "length": parse_length,
}


class OutputReader:
    """Reads the outputs of a scene, its shot and its pre-roll.

    Attributes:
        start: Time code of the first frame; None if not stated.
    """

    def __init__(
        self, reader: KeyReader, model: SceneModel, output_roots: Sequence[Path]
    ) -> None:
        self._reader, self._model, self._roots = reader, model, output_roots
        start = None if model.shot is None else model.shot.start
        self.start = None if start is None else Fraction(start)

    @property
    def _document(self) -> Document:
        return self._reader.document

    def _fps(self) -> Fraction | None:
        return self._reader.parse_value(("fps",), self._model.fps, parse_rate)

    def preroll(self) -> Preroll | None:
        """Return the pre-roll of the shot; None if the scene states none."""
        shot, frames = self._model.shot, self._shot()
        if shot is None or frames is None or not shot.preroll:
            return None
        return Preroll(self.start, frames.start - shot.preroll, self._fps())

    def _shot(self) -> Shot | None:
        """Return the shot's frames, at the rate of the output."""
        shot = self._model.shot
        if shot is None:
            return None
        return Shot(shot.cut[0], shot.cut[1], shot.handles, shot.handles)

    def outputs(self) -> tuple[SceneOutput, ...]:
        """Return the outputs of the scene, at least one."""
        entries, fps, frames = self._model.output, self._fps(), self._frames()
        if isinstance(entries, OutputModel):
            return (self._output(("output",), entries, fps, frames),)
        for i, entry in enumerate(entries):
            if entry.file is None:
                message = "key 'file' is missing"
                hint = "each of several outputs needs a file"
                self._document.add("DOC021", ("output", i), message, hint)
        outputs = tuple(
            self._output(("output", i), entry, fps, frames)
            for i, entry in enumerate(entries)
        )
        for i, output in enumerate(outputs):
            if output.bake.chunk is not None:
                message = "chunks need a scene with one output"
                self._document.add("SCN039", ("output", i, "chunk"), message)
        return outputs

    def _output(
        self,
        entry_path: Location,
        model: OutputModel,
        fps: Fraction | None,
        frames: FrameRange | None,
    ) -> SceneOutput:
        path = None
        if model.file is not None:
            path = self._file((*entry_path, "file"), model.file)
        writer = None if path is None else writer_of(path)
        if writer is not None and not writer.stage:
            self._check_keys(entry_path, model, writer)
        options = option_values(BakeOptions, model, "scene", entry_path, self._reader)
        if "take" in options and options.get("form") != "library":
            message, hint = "take applies to a take of a library", "write as: library"
            self._document.add("SCN039", (*entry_path, "take"), message, hint)
        if "start" not in options and self.start is not None:
            options["start"] = self.start
        bake = BakeOptions(fps=fps, frame_range=frames, shot=self._shot(), **options)
        systems = None if model.systems is None else tuple(model.systems)
        key_path = (*entry_path, "systems")
        if systems is not None:
            check_names(self._document, key_path, systems, self._model.system_names)
        if systems == () and self._model.source is None:
            message = "nothing would be written: it includes no system"
            self._document.add(
                "SCN081", key_path, message, "remove systems to write all"
            )
        location = entry_location(self._document, entry_path, model)
        return SceneOutput(path, bake, location, systems)

    def _file(self, location: Location, name: str) -> Path:
        """Return the path of a file to write; record a fault outside the roots."""
        reference = (self._document, location, name, self._roots)
        return resolve_reference(*reference, is_output=True) or Path(name)

    def _check_keys(
        self, location: Location, model: OutputModel, writer: Writer
    ) -> None:
        """Record a fault for each key that does not apply to the file's format."""
        allowed_keys = {"file", "start", *writer.options}
        for name in sorted(model.model_fields_set - allowed_keys):
            message = f"{name} does not apply to a {writer.name} file"
            hint = f"its keys are {', '.join(sorted(allowed_keys))}"
            self._document.add("SCN039", (*location, name), message, hint)

    def _frames(self) -> FrameRange | None:
        """Return the frames to write: a range, or the cut and its handles."""
        shot, shot_with_handles = self._model.shot, self._shot()
        location: Location = ("range",) if shot is None else ("shot", "cut")
        first_and_last = self._model.range if shot is None else shot.cut
        if shot is not None and self._model.range is not None:
            message = "the cut of the shot already sets the frames to write"
            hint = "remove range or shot"
            self._document.add("SCN041", ("range",), message, hint)
        if first_and_last is None:
            return None
        first, last = first_and_last
        if first > last:
            message = f"the {location[-1]} from {first} to {last} is reversed"
            self._document.add("SCN003", location, message, f"write [{last}, {first}]")
        if shot_with_handles is not None:
            return FrameRange(shot_with_handles.start, shot_with_handles.end)
        return FrameRange(first, last)
