"""Reading a scene file, ``*.scene.yaml``: a source, passes, an output."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from animtool.config import project_roots
from animtool.documents.check import FileModel, check_version, validated, wrong_values
from animtool.documents.document import Document, Location, read_document
from animtool.documents.names import nearest
from animtool.documents.references import referred, referred_input
from animtool.documents.variables import resolve_variables
from animtool.errors import AnimtoolError, OptionError
from animtool.passes import Pass, find_pass
from animtool.plugins import load_object
from animtool.rates import parse_rate
from animtool.scene.entries import (
    OutputKind,
    Place,
    SceneOutput,
    ScenePass,
    SceneProp,
    SceneSource,
    SceneSystem,
    kind_of,
    place_of_entry,
)
from animtool.scene.options import BakeOptions
from animtool.scene.output_fields import Value, option_keys
from animtool.scene.retime import Preroll
from animtool.scene.scene import Scene
from animtool.scene.schema import (
    OutputModel,
    PropModel,
    SceneModel,
    SourceModel,
    SystemModel,
    model_for,
)
from animtool.scene.sources import SourceOptions, is_usd, takes_option
from animtool.scene.systems.links import check_links, check_names
from animtool.scene.tracks import TrackNames
from animtool.shot import FrameRange, Shot
from animtool.systems.fields import SystemColliderModel
from animtool.systems.kinds import SYSTEM_KINDS

# It reads whole scenes, where they are characters.
COLLIDER_READER = "animtool.scene.systems.entries:EntryReader"


def load_scene(
    path: Path | str,
    variables: Mapping[str, str] | None = None,
    *,
    parts: Collection[str] = (),
) -> Scene:
    """Return the scene of a scene file.

    Args:
        path: The file.
        variables: Values of ``${name}`` in it, which come before those that it gives
            itself; it need not use them all, see `Scene.variables`. Files below an
            absolute path among them may be read, wherever that is.
        parts: Those of them that other files state, such as names of clips. In names
            of files to write they are a part of one name.

    Raises:
        FormatError: With every fault of the file, each with line and column.
    """
    return scene_of_document(read_document(Path(path)), variables, parts=parts)


def scene_of_document(
    document: Document,
    variables: Mapping[str, str] | None = None,
    *,
    parts: Collection[str] = (),
) -> Scene:
    """Return the scene of a document; see `load_scene`."""
    given = variables or {}
    check_version(document, "scene")
    keys = model_for(document.value)
    found = resolve_variables(document, keys, given, parts)
    model = validated(document, keys)
    named = {
        name: Path(text) for name, text in given.items() if Path(text).is_absolute()
    }
    written = [path for name, path in named.items() if name not in parts]
    reader = _SceneReader(document, model, list(named.values()), written)
    scene = replace(
        reader.scene(),
        variables=found.names,
        idle_variables=found.idle,
        effective_variables=found.effective,
        notices=tuple(sorted(document.notices, key=lambda notice: notice.lines)),
    )
    document.check()
    return scene


def stated_rate(path: Path) -> Fraction | None:
    """Return the rate that a scene file states as a number; None where it has none."""
    given = read_document(path).value
    fps = given.get("fps") if isinstance(given, dict) else None
    try:
        return parse_rate(fps) if isinstance(fps, int | float | str) else None
    except ValueError:
        return None


_PRIM_PATH = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)


def _meet(one: str, other: str) -> bool:
    """Return whether a path is another, or below it."""
    return f"{one}/".startswith(f"{other}/") or f"{other}/".startswith(f"{one}/")


class _SceneReader:
    def __init__(
        self,
        document: Document,
        model: SceneModel,
        named: list[Path],
        written: list[Path],
    ) -> None:
        self.document, self.model = document, model
        roots = project_roots(document.path)
        self.roots, self.output_roots = (*roots, *named), (*roots, *written)

    def scene(self) -> Scene:
        model, shot = self.model, self.model.shot
        rig = None if model.rig is None else self.read_file(("rig",), model.rig)
        passes = [
            pass_
            for i, entry in enumerate(model.passes)
            for name, given in entry.items()
            if (pass_ := self._pass(("passes", i, name), name, given or {})) is not None
        ]
        return Scene(
            self.document.path,
            self._sources(rig),
            tuple(passes),
            self._outputs(),
            rig,
            self._renamed_props(),
            None if shot is None or shot.start is None else Fraction(shot.start),
            self._preroll(),
            systems=self._systems(),
        )

    def _systems(self) -> tuple[SceneSystem, ...]:
        """Return what is simulated, alone or beside a source."""
        model = self.model
        if model.source is None and not model.systems:
            hint = "it names the clip, BVH or USD file; what is simulated has systems"
            self.document.add("DOC021", (), "key 'source' is missing", hint)
        if not model.systems:
            return ()
        if model.source is None:
            self._check_simulated()
        read = (self._system(i, entry) for i, entry in enumerate(model.systems))
        systems = tuple(system for system in read if system is not None)
        check_links(self.document, systems, self._names())
        return systems

    def _system(self, i: int, entry: SystemModel) -> SceneSystem | None:
        kind = self._kind(("systems", i), entry)
        if kind is None:
            return None
        at: Location = ("systems", i, kind)
        given = getattr(entry, kind)
        # Loaded by name: systems open scenes themselves.
        read: Any = load_object("animtool.scene.systems.derived:read_spec")
        setup = read(self.document, at, given, self.roots)
        if setup is None:
            return None
        return SceneSystem(given.name, kind, setup, self._place(at, given))

    def _kind(self, at: Location, entry: SystemModel) -> str | None:
        """Return the kind that an entry names."""
        kinds = sorted(entry.model_fields_set)
        known = ", ".join(SYSTEM_KINDS)
        if len(kinds) == 1:
            return kinds[0]
        if kinds:
            message = f"a system is of one kind, and this of {' and '.join(kinds)}"
            hint = "give each an entry of its own, beginning with a dash"
            self.document.add("SCN065", at, message, hint)
        elif not self._written_systems()[at[1]]:
            self.document.add("SCN065", at, "it names no kind", f"they are {known}")
        return None

    def _written_systems(self) -> Any:
        """Return the systems as written, under a misspelt key too."""
        written = self.document.spellings.get(("systems",), "systems")
        return self.document.value[written]

    def _check_simulated(self) -> None:
        """Refuse what there is only with a source, and outputs of other kinds."""
        model = self.model
        for key in sorted({"rig", "passes", "shot", "props"} & model.model_fields_set):
            message = f"{key} is for scenes with a source"
            self.document.add("SCN060", (key,), message, "leave it out")
        if model.range is None:
            message = "what is simulated has no end of its own"
            hint = "say which frames to write: range: [1, 120]"
            self.document.add("SCN061", (), message, hint)
        given = model.output
        entries = given if isinstance(given, list) else [given]
        for i, entry in enumerate(entries):
            at: Location = ("output", i) if isinstance(given, list) else ("output",)
            if entry.file and kind_of(Path(entry.file)) is not OutputKind.USD:
                message = f"{entry.file!r} is no USD file, as what is simulated is"
                self.document.add("SCN060", (*at, "file"), message)

    def _renamed_props(self) -> tuple[SceneProp, ...]:
        props = [
            self._prop(("props", i), entry) for i, entry in enumerate(self.model.props)
        ]
        for i, prop in enumerate(props):
            for other in props[:i]:
                if _meet(prop.path, other.path):
                    message = f"{prop.path!r} meets {other.path!r} of "
                    message += other.place.where
                    hint = "each has a path of its own, none below another's"
                    self.document.add("SCN046", ("props", i, "path"), message, hint)
        return tuple(props)

    def _prop(self, at: Location, model: PropModel) -> SceneProp:
        file = self.read_file((*at, "from"), model.file)
        if not is_usd(file):
            message = f"{model.file!r} is no USD file"
            self.document.add("SCN048", (*at, "from"), message)
        path = model.path or model.prim.rpartition("/")[2]
        if not _PRIM_PATH.fullmatch(path):
            message = f"{path!r} is no path such as Props/box or /World/box"
            self.document.add("SCN048", (*at, "path"), message)
        shown: Path | None = None
        if isinstance(model.reference, str):
            shown = self.read_file((*at, "reference"), model.reference)
        elif model.reference:
            shown = file
        return SceneProp(
            file,
            model.prim,
            path,
            tuple(model.attributes),
            shown,
            frame=None if model.frame is None else Fraction(repr(model.frame)),
            retimed=model.retimed,
            place=self._place(at),
        )

    def _preroll(self) -> Preroll | None:
        shot = self.model.shot
        if shot is None or not shot.preroll:
            return None
        own_shot = self._shot()
        assert own_shot is not None
        return Preroll(
            None if shot.start is None else Fraction(shot.start),
            own_shot.start - shot.preroll,
            self._rate(("fps",), self.model.fps),
        )

    def _shot(self) -> Shot | None:
        """Return the shot's frames; its rate is that of the output."""
        shot = self.model.shot
        if shot is None:
            return None
        return Shot(shot.cut[0], shot.cut[1], shot.handles, shot.handles)

    def _outputs(self) -> tuple[SceneOutput, ...]:
        given = self.model.output
        fps = self._rate(("fps",), self.model.fps)
        frames = self._frames()
        if isinstance(given, OutputModel):
            return (self._output(("output",), given, fps, frames),)
        for i, entry in enumerate(given):
            at = ("output", i)
            if entry.file is None:
                hint = "each of several outputs names its file"
                self.document.add("DOC021", at, "key 'file' is missing", hint)
        outputs = tuple(
            self._output(("output", i), entry, fps, frames)
            for i, entry in enumerate(given)
        )
        for i, output in enumerate(outputs):
            if output.bake.chunk is not None:
                message = "chunks are for a scene of one output"
                self.document.add("SCN039", ("output", i, "chunk"), message)
        return outputs

    def _output(
        self,
        at: Location,
        model: OutputModel,
        fps: Fraction | None,
        frames: FrameRange | None,
    ) -> SceneOutput:
        path = None if model.file is None else self._file((*at, "file"), model.file)
        if path is not None and kind_of(path) is not OutputKind.USD:
            self._check_kind(at, model, kind_of(path))
        keys = option_keys(BakeOptions, model, "scene", at, self)
        if "take" in keys and keys.get("form") != "library":
            message = "take is for a take of a library"
            self.document.add("SCN039", (*at, "take"), message, "write as: library")
        shot = self.model.shot
        if "start" not in keys and shot is not None and shot.start is not None:
            keys["start"] = Fraction(shot.start)
        bake = BakeOptions(fps=fps, frame_range=frames, shot=self._shot(), **keys)
        systems = None if model.systems is None else tuple(model.systems)
        if systems is not None:
            check_names(self.document, (*at, "systems"), systems, self._names())
        if not systems and systems is not None and self.model.source is None:
            message = "nothing would be written: it takes no system"
            hint = "leave systems out to write all"
            self.document.add("SCN081", (*at, "systems"), message, hint)
        return SceneOutput(path, bake, self._place(at), systems)

    def _names(self) -> list[str]:
        """Return the names of all systems, of those that are faulty too."""
        entries = self.model.systems
        given = [getattr(e, key) for e in entries for key in e.model_fields_set]
        return [entry.name for entry in given]

    def _check_kind(self, at: Location, model: OutputModel, kind: OutputKind) -> None:
        """Refuse what only other kinds of files have."""
        allowed = {"file", "start"}
        if kind is OutputKind.CLIP:
            allowed |= {"reduce", "reduce_at"}
        for name in sorted(model.model_fields_set - allowed):
            message = f"{name} is not for a {kind} file"
            hint = f"it has {', '.join(sorted(allowed))}"
            self.document.add("SCN039", (*at, name), message, hint)

    def _frames(self) -> FrameRange | None:
        """Return the frames to write: a range, or the cut with its handles."""
        shot, found = self.model.shot, self._shot()
        at: Location = ("range",) if shot is None else ("shot", "cut")
        ends = self.model.range if shot is None else shot.cut
        if shot is not None and self.model.range is not None:
            message = "the cut of the shot says which frames to write"
            self.document.add("SCN041", ("range",), message, "leave range or shot out")
        if ends is None:
            return None
        first, last = ends
        if first > last:
            message = f"the {at[-1]} from {first} to {last} is reversed"
            self.document.add("SCN003", at, message, f"write [{last}, {first}]")
        if found is not None:
            return FrameRange(found.start, found.end)
        return FrameRange(first, last)

    def _sources(self, rig: Path | None) -> tuple[SceneSource, ...]:
        given = self.model.source
        if given is None:
            return ()
        if isinstance(given, SourceModel):
            for key in ("tracks", "timecode", "timecode_fps"):
                if getattr(given, key) is not None:
                    message = f"{key} is for one of several sources"
                    hint = "write a list: source: [{file: …}, {file: …}]"
                    self.document.add("SCN038", ("source", key), message, hint)
            return (self._source(("source",), given, rig),)
        if given and given[0].tracks is not None:
            message = "the first source brings all that it has"
            hint = "tracks: says what each of the others puts in its place"
            self.document.add("SCN038", ("source", 0, "tracks"), message, hint)
        # Others than clips are brought onto the rig of the first as they are joined.
        return tuple(
            self._source(
                ("source", i),
                entry,
                rig if i == 0 or takes_option(Path(entry.file), "rig") else None,
            )
            for i, entry in enumerate(given)
        )

    def _source(
        self, at: Location, model: SourceModel, rig: Path | None
    ) -> SceneSource:
        path = self.read_file((*at, "file"), model.file)
        keys = option_keys(SourceOptions, model, "scene", at, self)
        tracks = None
        if model.tracks is not None:
            tracks = TrackNames(**{name: tuple(of) for name, of in model.tracks})
        return SceneSource(
            path,
            SourceOptions(rig=rig, **keys),
            self._place(at),
            tracks,
            model.timecode,
            self._rate((*at, "timecode_fps"), model.timecode_fps),
        )

    def _place(self, at: Location, model: FileModel | None = None) -> Place:
        """Return a place, with those of the keys that its model was given."""
        return place_of_entry(self.document, at, model)

    def _file(self, at: Location, name: str) -> Path:
        """Return a file to write."""
        roots = self.output_roots
        path = referred(self.document, at, name, roots, written=True)
        return Path(name) if path is None else path

    def read_file(self, at: Location, name: str) -> Path:
        """Return a file to read, which must be there."""
        path = referred_input(self.document, at, name, self.roots)
        return Path(name) if path is None else path

    def _rate(self, at: Location, rate: float | str | None) -> Fraction | None:
        return None if rate is None else self.parsed(at, rate, parse_rate)

    def parsed(
        self, at: Location, value: Any, parse: Callable[[Any], Value]
    ) -> Value | None:
        """Return a value; None, and a fault, where it is none."""
        try:
            return parse(value)
        except ValueError as error:
            self.document.add(getattr(error, "code", "SCN003"), at, str(error))
            return None

    def _pass(
        self, at: Location, name: str, values: dict[str, Any]
    ) -> ScenePass | None:
        try:
            pass_ = find_pass(name)
        except AnimtoolError as error:
            fault = error.faults[0]
            self.document.add(fault.code, at, fault.message, fault.hint)
            return None
        names = [field.name for field in fields(pass_.options)]
        unknown = [key for key in values if key not in names]
        for key in unknown:
            message = f"unknown option {key!r} of {name}"
            self.document.add("SCN001", (*at, key), message, nearest(key, names))
        known = {key: value for key, value in values.items() if key in names}
        try:
            options = TypeAdapter(pass_.options).validate_python(known)
        except ValidationError as error:
            for place, message in wrong_values(known, error):
                self.document.add("SCN002", (*at, *place), message)
            return None
        options, files = self._with_colliders(at, options)
        self._check(at, pass_, options)
        if unknown:
            return None
        return ScenePass(pass_, options, self._place(at), files)

    def _with_colliders(
        self, at: Location, options: Any
    ) -> tuple[Any, tuple[Path, ...]]:
        """Return options with what they run into, and the files that this goes with."""
        entries = {
            field.name: value
            for field in fields(options)
            if isinstance(value := getattr(options, field.name), list)
            and any(isinstance(one, SystemColliderModel) for one in value)
        }
        if not entries:
            return options, ()
        kind: Any = load_object(COLLIDER_READER)
        reader = kind(self.document, self.roots)
        read = {
            name: tuple(reader.colliders((*at, name), models))
            for name, models in entries.items()
        }
        return replace(options, **read), tuple(reader.files)

    def _check(self, at: Location, pass_: Pass, options: Any) -> None:
        """Note what is wrong with options whatever the take is."""
        for option, check in pass_.checks(options).items():
            try:
                check()
            except OptionError as error:
                for fault in error.faults:
                    place = (*at, option)
                    self.document.add(fault.code, place, fault.message, fault.hint)
        for field in fields(pass_.options):
            value = getattr(options, field.name)
            if isinstance(value, Path):
                self.read_file((*at, field.name), str(value))
        for name in getattr(options, "writes", ()):
            self._file(at, str(name))
