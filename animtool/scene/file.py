"""Reading a scene file, ``*.scene.yaml``: a source, passes, an output."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from animtool.config import project_roots
from animtool.documents.arrays import referred
from animtool.documents.check import check_version, nearest, validated, wrong_values
from animtool.documents.document import Document, Location, read_document, spelled
from animtool.documents.variables import resolve_variables
from animtool.edit.resample import FrameRange
from animtool.errors import AnimtoolError, FormatError, OptionError
from animtool.passes import Pass, PassContext, apply_pass, find_pass
from animtool.rates import parse_rate
from animtool.scene.options import BakeOptions
from animtool.scene.schema import SceneModel
from animtool.scene.sources import SourceOptions, open_source, takes_option
from animtool.take import Motion, Take, TakeStream
from animtool.units import LengthUnit, UpAxis, parse_length

__all__ = ["Scene", "ScenePass", "load_scene", "scene_of_document"]


@dataclass(frozen=True, slots=True)
class ScenePass:
    """One entry of a scene's passes.

    Attributes:
        pass_: What to do.
        options: Its own record.
        place: 1-based line and column of the entry.
        where: The entry in the file, such as ``passes[1].trim``.
    """

    pass_: Pass
    options: Any
    place: tuple[int, int]
    where: str


@dataclass(frozen=True, slots=True)
class Scene:
    """What a scene file says.

    Attributes:
        path: The file.
        source: The source's file.
        options: How to open it.
        passes: What to do to it, in order.
        output: The file to write; None where it names none.
        bake: Options of the bake that it sets.
        variables: Names of the variables that it uses or gives a value.
    """

    path: Path
    source: Path
    options: SourceOptions
    passes: tuple[ScenePass, ...]
    output: Path | None
    bake: BakeOptions
    variables: frozenset[str] = frozenset()

    @property
    def inputs(self) -> list[Path]:
        """The files that it names to be read: of its source, rig and passes."""
        folder = self.path.resolve().parent
        named = [
            folder / value
            for entry in self.passes
            for field in fields(entry.options)
            if isinstance(value := getattr(entry.options, field.name), Path)
        ]
        rig = [] if self.options.rig is None else [self.options.rig]
        return [self.source, *rig, *named]

    def open(self) -> TakeStream:
        """Return the source with every pass applied.

        Raises:
            FormatError: The source is malformed, or a pass cannot be applied to it,
                with the pass's place; the blocks may raise it too.
            OptionError: An option does not apply to the source.
        """
        stream = open_source(self.source, self.options)
        context = self._context()
        for entry in self.passes:
            stream = self._passed(stream, entry, context)
        stream.notices += context.notices
        return stream

    def steps(self) -> Iterator[tuple[Take, TakeStream]]:
        """Yield the source and what it is after each pass, as takes and as streams.

        Raises:
            FormatError: As `open`, at the step that raises it.
            OptionError: Likewise.
        """
        take, stream = _gathered(open_source(self.source, self.options))
        yield take, stream
        context = self._context()
        for entry in self.passes:
            take, stream = _gathered(self._passed(stream, entry, context))
            stream.notices += context.notices
            context.notices.clear()
            yield take, stream

    def _context(self) -> PassContext:
        return PassContext(self._take, self.path.resolve().parent)

    def _passed(
        self, stream: TakeStream, entry: ScenePass, context: PassContext
    ) -> TakeStream:
        notices, details = stream.notices, stream.details
        with self._placed(entry):
            stream = apply_pass(stream, entry.pass_, entry.options, context)
        blocks = self._read(entry, stream.blocks)
        return replace(stream, notices=notices, details=details, blocks=blocks)

    def _read(self, entry: ScenePass, blocks: Iterator[Motion]) -> Iterator[Motion]:
        with self._placed(entry):
            yield from blocks

    @contextmanager
    def _placed(self, entry: ScenePass) -> Iterator[None]:
        """Give faults that have no file those of the pass that found them."""
        try:
            yield
        except OptionError as error:
            line, column = entry.place
            faults = [
                replace(
                    fault,
                    path=str(self.path),
                    lines=(line,),
                    column=column,
                    where=entry.where,
                )
                if fault.path is None
                else fault
                for fault in error.faults
            ]
            raise FormatError(faults) from error

    def _take(self, path: Path) -> Take:
        options = (
            SourceOptions(rig=self.options.rig) if takes_option(path, "rig") else None
        )
        return open_source(path, options).collect()


def _gathered(stream: TakeStream) -> tuple[Take, TakeStream]:
    """Return a take, and its stream in one block."""
    take = stream.collect()
    return take, replace(stream, blocks=iter([take.motion]))


def load_scene(path: Path | str, variables: Mapping[str, str] | None = None) -> Scene:
    """Return the scene of a scene file.

    Args:
        path: The file.
        variables: Values of ``${name}`` in it, which come before those that it gives
            itself; it need not use them all, see `Scene.variables`. Files below an
            absolute path among them may be read, wherever that is.

    Raises:
        FormatError: With every fault of the file, each with line and column.
    """
    return scene_of_document(read_document(Path(path)), variables)


def scene_of_document(
    document: Document, variables: Mapping[str, str] | None = None
) -> Scene:
    """Return the scene of a document; see `load_scene`."""
    given = variables or {}
    check_version(document, "scene")
    used = resolve_variables(document, SceneModel, given)
    model = validated(document, SceneModel)
    named = [Path(text) for text in given.values() if Path(text).is_absolute()]
    reader = _SceneReader(document, model, named)
    scene = replace(reader.scene(), variables=used)
    document.check()
    return scene


class _SceneReader:
    def __init__(
        self, document: Document, model: SceneModel, named: list[Path]
    ) -> None:
        self.document, self.model = document, model
        self.roots = (*project_roots(document.path), *named)

    def scene(self) -> Scene:
        model, output = self.model, self.model.output
        source = self._input(("source", "file"), model.source.file)
        rig = None if model.rig is None else self._input(("rig",), model.rig)
        fps = self._rate(("fps",), model.fps)
        options = SourceOptions(
            None if model.source.units is None else LengthUnit(model.source.units),
            None if model.source.up is None else UpAxis(model.source.up),
            self._rate(("source", "fps"), model.source.fps),
            model.source.prim,
            rig if takes_option(source, "rig") else None,
            model.source.clamp,
            model.source.take,
        )
        frames = None
        if model.range is not None:
            first, last = model.range
            if first > last:
                message = f"the range from {first} to {last} is reversed"
                hint = f"write [{last}, {first}]"
                self.document.add("SCN003", ("range",), message, hint)
            frames = FrameRange(first, last)
        layer = output.rig_layer
        bake = BakeOptions(
            form=output.form,
            rig_layer=None
            if layer is None
            else self._input(("output", "rig_layer"), layer),
            prim_path=output.prim_path,
            fps=fps,
            frame_range=frames,
            start=None if output.start is None else Fraction(output.start),
            sparse=output.sparse,
            bones=output.bones,
            keep_curves=output.keep_curves,
            reduce=self._length(("output", "reduce"), output.reduce),
            reduce_at=tuple(
                (name, length)
                for name, text in output.reduce_at.items()
                if (length := self._length(("output", "reduce_at", name), text))
            ),
            deform=output.deform,
            velocities=output.velocities,
            normals=output.normals,
            chunk=output.chunk,
        )
        passes = [
            made
            for i, entry in enumerate(model.passes)
            for name, given in entry.items()
            if (made := self._pass(("passes", i, name), name, given or {})) is not None
        ]
        target = None
        if output.file is not None:
            target = self._file(("output", "file"), output.file)
        return Scene(self.document.path, source, options, tuple(passes), target, bake)

    def _file(self, at: Location, name: str) -> Path:
        found = referred(self.document, at, name, self.roots, "SCN004")
        return Path(name) if found is None else found

    def _input(self, at: Location, name: str) -> Path:
        """Return a file to read, which must be there."""
        found = referred(self.document, at, name, self.roots, "SCN004")
        if found is not None and not found.exists():
            self.document.add("SCN005", at, f"{name!r} does not exist")
        return Path(name) if found is None else found

    def _rate(self, at: Location, given: float | str | None) -> Fraction | None:
        if given is None:
            return None
        try:
            return parse_rate(given)
        except ValueError as error:
            self.document.add("SCN003", at, str(error))
            return None

    def _length(self, at: Location, given: str | None) -> float | None:
        if given is None:
            return None
        try:
            return parse_length(given)
        except ValueError as error:
            self.document.add("SCN003", at, str(error))
            return None

    def _pass(self, at: Location, name: str, given: dict[str, Any]) -> ScenePass | None:
        try:
            found = find_pass(name)
        except AnimtoolError as error:
            fault = error.faults[0]
            self.document.add(fault.code, at, fault.message, fault.hint)
            return None
        names = [field.name for field in fields(found.options)]
        unknown = [key for key in given if key not in names]
        for key in unknown:
            message = f"unknown option {key!r} of {name}"
            self.document.add("SCN001", (*at, key), message, nearest(key, names))
        known = {key: value for key, value in given.items() if key in names}
        try:
            options = TypeAdapter(found.options).validate_python(known)
        except ValidationError as error:
            for place, message in wrong_values(known, error):
                self.document.add("SCN002", (*at, *place), message)
            return None
        self._check(at, found, options)
        if unknown:
            return None
        line, column = self.document.place(at)
        return ScenePass(found, options, (line, column), spelled(at))

    def _check(self, at: Location, found: Pass, options: Any) -> None:
        """Note what is wrong with options whatever the take is."""
        for option, check in found.checks(options).items():
            try:
                check()
            except OptionError as error:
                for fault in error.faults:
                    place = (*at, option)
                    self.document.add(fault.code, place, fault.message, fault.hint)
        for field in fields(found.options):
            value = getattr(options, field.name)
            if isinstance(value, Path):
                self._input((*at, field.name), str(value))
