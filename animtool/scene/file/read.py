"""Reading scene files, ``*.scene.yaml``: sources, passes, systems, outputs."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from animtool.core.config import project_roots
from animtool.core.errors import AnimtoolError, OptionError
from animtool.core.plugins import load_object
from animtool.core.rates import FractionLike, RateError, parse_rate, rate_warning
from animtool.core.record import dataclass
from animtool.core.writers import writes_stage
from animtool.documents.check import (
    FileModel,
    check_version,
    record_from_options,
    rename_options,
    validate_document,
)
from animtool.documents.document import Document, Location, read_document
from animtool.documents.references import resolve_reference
from animtool.documents.variables import resolve_variables
from animtool.motion.passes import Pass, find_pass
from animtool.scene.file.entries import (
    ScenePass,
    SceneProp,
    SceneSource,
    SceneSystem,
    entry_location,
)
from animtool.scene.file.output_fields import KeyReader, OutputReader, option_values
from animtool.scene.file.schema import (
    PropModel,
    SceneModel,
    SourceModel,
    SystemModel,
    model_for,
)
from animtool.scene.file.tracks import TrackNames
from animtool.scene.scene import DEFAULT_FPS, Scene
from animtool.scene.sources.open import SourceOptions, is_usd, supports_option
from animtool.scene.systems.links import check_colliders, check_links
from animtool.scene.systems.suspicions import warn_of_rotations, warn_of_suspect_units
from animtool.scene.systems.suspicious_forces import warn_of_forces
from animtool.scene.systems.suspicious_times import SceneTimes, warn_of_times
from animtool.systems.framework.conversion import SceneUnits
from animtool.systems.framework.fields import COLLISION_KEYS
from animtool.systems.framework.kinds import SYSTEM_KINDS

# Reads whole scenes as characters, so it is loaded by name.
COLLIDER_READER_NAME = "animtool.scene.systems.entries:EntryReader"


def load_scene(
    path: Path | str,
    variables: Mapping[str, str] | None = None,
    *,
    parts: Collection[str] = (),
) -> Scene:
    """Return the scene of a scene file.

    Args:
        path: The file.
        variables: Values of ``${name}`` that override those of the file. Unused ones
            are allowed, see `Scene.variables`. Files below a value that is an absolute
            path may be read.
        parts: Variables whose values come from other files, such as names of clips. A
            slash in them does not create a folder in names of output files.

    Raises:
        FormatError: With every fault of the file, each with line and column.
    """
    return parse_scene(read_document(Path(path), "scene"), variables, parts=parts)


def parse_scene(
    document: Document,
    variables: Mapping[str, str] | None = None,
    *,
    parts: Collection[str] = (),
) -> Scene:
    """Return the scene that a parsed file describes; see `load_scene`."""
    variable_values = variables or {}
    check_version(document, "scene")
    _expand_short_forms(document)
    model_type = model_for(document.value)
    resolved_variables = resolve_variables(document, model_type, variable_values, parts)
    model = validate_document(document, model_type)
    folders = {
        n: Path(text) for n, text in variable_values.items() if Path(text).is_absolute()
    }
    output_folders = [path for name, path in folders.items() if name not in parts]
    reader = _SceneReader(document, model, list(folders.values()), output_folders)
    scene = replace(
        reader.read_scene(),
        variables=resolved_variables.names,
        unused_variables=resolved_variables.unused_names,
        effective_variables=resolved_variables.effective_names,
        notices=tuple(sorted(document.notices, key=lambda notice: notice.lines)),
    )
    if document.faults and scene.systems:
        # Loaded by name, since systems open scenes themselves.
        name = "animtool.scene.systems.simulation:build_faults"
        build_faults: Any = load_object(name)
        document.faults += build_faults(document, scene.systems)
    document.check()
    return scene


def check_scene_values(document: Document) -> None:
    """Record the faults of keys and values of a scene, without opening its files."""
    _expand_short_forms(document)
    model_type = model_for(document.value)
    resolve_variables(document, model_type, {}, ())
    validate_document(document, model_type)


def _expand_short_forms(document: Document) -> None:
    """Expand ``source: walk.bvh``, ``output: a.usdc`` and ``range: 1-24``."""
    value = document.value
    expanded_values: dict[str, Any] = {}
    for key in ("source", "output"):
        if isinstance(value.get(key), str):
            expanded_values[key] = {"file": value[key]}
    range_value = value.get("range")
    match = isinstance(range_value, str) and re.fullmatch(
        r"\s*(-?\d+)\s*-\s*(-?\d+)\s*", range_value
    )
    if match:
        expanded_values["range"] = [int(match[1]), int(match[2])]
    if expanded_values:
        # Locations of values are as in the file.
        document.position(())
        value.update(expanded_values)


def stated_rate(path: Path) -> Fraction | None:
    """Return the rate that a scene file states as a number; None if it states none."""
    document = read_document(path).value
    fps = document.get("fps") if isinstance(document, dict) else None
    try:
        return parse_rate(fps) if isinstance(fps, int | float | str) else None
    except ValueError:
        return None


_PRIM_PATH = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)


def _paths_overlap(path: str, other_path: str) -> bool:
    """Return whether two paths are equal or one is an ancestor of the other."""
    path, other_path = f"{path}/", f"{other_path}/"
    return path.startswith(other_path) or other_path.startswith(path)


class _SceneReader:
    """Reads the scene of a validated scene file; records faults of its values."""

    def __init__(
        self,
        document: Document,
        model: SceneModel,
        variable_folders: list[Path],
        output_folders: list[Path],
    ) -> None:
        self.document, self.model = document, model
        roots = project_roots(document.path)
        self.reader = KeyReader(document, (*roots, *variable_folders), "SCN003")
        self.output_roots = (*roots, *output_folders)
        self.units = SceneUnits.from_names(model.units.length, model.units.angle)

    def read_scene(self) -> Scene:
        model = self.model
        rig = None if model.rig is None else self.reader.read_file(("rig",), model.rig)
        pass_reader = _PassReader(self.reader, self.output_roots, self.units)
        passes = tuple(pass_reader.passes(model.passes))
        systems = self._systems()
        check_colliders(self.document, passes, systems, model.system_names)
        outputs = OutputReader(self.reader, model, self.output_roots)
        return Scene(
            self.document.path,
            self._sources(rig),
            passes,
            outputs.outputs(),
            rig,
            self._props(),
            outputs.start,
            outputs.preroll(),
            systems=systems,
        )

    def _systems(self) -> tuple[SceneSystem, ...]:
        """Return the systems of the scene; record faults of links between them."""
        model = self.model
        is_empty = model.source is None and not model.systems
        if is_empty and not self.document.is_placeholder(("systems",)):
            hint = "it names the clip, BVH or USD file; a simulation has systems "
            hint += "instead"
            self.document.add("DOC021", (), "key 'source' is missing", hint)
        if not model.systems:
            return ()
        if model.source is None:
            self._check_simulated()
        read_systems = (self._system(i, entry) for i, entry in enumerate(model.systems))
        systems = tuple(system for system in read_systems if system is not None)
        check_links(self.document, systems, model.system_names)
        # Loaded by name, since systems open scenes themselves.
        name = "animtool.scene.systems.suspicious_layout:warn_of_layout"
        warn_of_layout: Any = load_object(name)
        warn_of_layout(self.document, systems, self._times().length)
        return systems

    def _system(self, i: int, entry: SystemModel) -> SceneSystem | None:
        kind = self._system_kind(("systems", i), entry)
        if kind is None:
            return None
        entry_path: Location = ("systems", i, kind)
        spec = getattr(entry, kind)
        # Loaded by name, since systems open scenes themselves.
        read_spec: Any = load_object("animtool.scene.systems.derived:read_spec")
        setup = read_spec(
            self.document, entry_path, spec, self.reader.roots, self.units
        )
        if setup is None:
            return None
        stated_values = spec.model_dump(exclude_unset=True, by_alias=True)
        warn_of_times(self.document, entry_path, stated_values, self._times())
        location, unit = entry_location(self.document, entry_path, spec), self.units
        return SceneSystem(spec.name, kind, setup, location, unit=unit.scene_length)

    def _times(self) -> SceneTimes:
        """Return the frame rate of the scene and the frames of its range."""
        try:
            rate = float(parse_rate(self.model.fps or DEFAULT_FPS))
        except ValueError:
            return SceneTimes(float(DEFAULT_FPS))
        frames = self.model.range
        return SceneTimes(rate, None if frames is None else (frames[0], frames[1]))

    def _system_kind(self, location: Location, entry: SystemModel) -> str | None:
        """Return the system kind that an entry names."""
        kinds = sorted(entry.model_fields_set)
        if len(kinds) == 1:
            return kinds[0]
        if kinds:
            message = f"a system has one kind, but this one has {' and '.join(kinds)}"
            hint = "write each as its own entry, starting with a dash"
            self.document.add("SCN065", location, message, hint)
            return None
        # The unparsed entries, which may have an old key.
        old_key = self.document.old_keys.get(("systems",), "systems")
        if not self.document.value[old_key][location[1]]:
            hint = f"the kinds are {', '.join(SYSTEM_KINDS)}"
            self.document.add("SCN065", location, "its kind is missing", hint)
        return None

    def _check_simulated(self) -> None:
        """Refuse keys that need a source and outputs that are not USD."""
        model = self.model
        for key in sorted({"rig", "passes", "shot", "props"} & model.model_fields_set):
            message = f"{key} needs a scene with a source"
            self.document.add("SCN060", (key,), message, "remove it")
        if model.range is None:
            message = "a simulation has no natural end"
            hint = "set the frames to write: range: [1, 120]"
            self.document.add("SCN061", (), message, hint)
        output = model.output
        entries = output if isinstance(output, list) else [output]
        for i, entry in enumerate(entries):
            if entry.file and not writes_stage(Path(entry.file)):
                output_index = (i,) if isinstance(output, list) else ()
                message = f"{entry.file!r} is not a USD file, which simulations need"
                self.document.add("SCN060", ("output", *output_index, "file"), message)

    def _props(self) -> tuple[SceneProp, ...]:
        """Return the props of the scene; record props whose paths overlap."""
        entries = enumerate(self.model.props)
        props = [self._prop(("props", i), entry) for i, entry in entries]
        for i, prop in enumerate(props):
            for other_prop in props[:i]:
                if _paths_overlap(prop.path, other_prop.path):
                    message = f"{prop.path!r} overlaps {other_prop.path!r} of "
                    message += other_prop.location.where
                    hint = "each needs its own path, not below another's"
                    self.document.add("SCN046", ("props", i, "path"), message, hint)
        return tuple(props)

    def _prop(self, location: Location, model: PropModel) -> SceneProp:
        file = self.reader.read_file((*location, "from"), model.file)
        if not is_usd(file):
            message = f"{model.file!r} is not a USD file"
            self.document.add("SCN048", (*location, "from"), message)
        path = model.path or model.prim.rpartition("/")[2]
        if not _PRIM_PATH.fullmatch(path):
            message = f"{path!r} is not a path such as Props/box or /World/box"
            self.document.add("SCN048", (*location, "path"), message)
        reference: Path | None = None
        if isinstance(model.reference, str):
            reference = self.reader.read_file((*location, "reference"), model.reference)
        elif model.reference:
            reference = file
        return SceneProp(
            file,
            model.prim,
            path,
            tuple(model.attributes),
            reference,
            frame=None if model.frame is None else Fraction(repr(model.frame)),
            is_retimed=model.retimed,
            location=entry_location(self.document, location),
        )

    def _sources(self, rig: Path | None) -> tuple[SceneSource, ...]:
        source = self.model.source
        if source is None:
            return ()
        if isinstance(source, SourceModel):
            for key in ("tracks", "timecode", "timecode_fps"):
                if getattr(source, key) is not None:
                    message = f"{key} applies to one of several sources"
                    hint = "write a list: source: [{file: …}, {file: …}]"
                    self.document.add("SCN038", ("source", key), message, hint)
            return (self._source(("source",), source, rig),)
        if source and source[0].tracks is not None:
            message = "the first source always provides everything it has"
            hint = "list under tracks: what each of the others replaces"
            self.document.add("SCN038", ("source", 0, "tracks"), message, hint)
        # Sources other than clips are mapped to the rig of the first when joined.
        return tuple(
            self._source(
                ("source", i),
                entry,
                rig if i == 0 or supports_option(Path(entry.file), "rig") else None,
            )
            for i, entry in enumerate(source)
        )

    def _source(
        self, location: Location, model: SourceModel, rig: Path | None
    ) -> SceneSource:
        path = self.reader.read_file((*location, "file"), model.file)
        keys = option_values(SourceOptions, model, "scene", location, self.reader)
        self._warn_of_rate(location, keys.get("fps"))
        tracks = None
        if model.tracks is not None:
            patterns = {name: tuple(texts) for name, texts in model.tracks}
            tracks = TrackNames(**patterns)
        rate_key, rate = (*location, "timecode_fps"), model.timecode_fps
        return SceneSource(
            path,
            SourceOptions(rig=rig, **keys),
            entry_location(self.document, location),
            tracks,
            model.timecode,
            self.reader.parse_value(rate_key, rate, parse_rate),
        )

    def _warn_of_rate(self, location: Location, fps: FractionLike | None) -> None:
        """Warn of an implausible rate of a source (TAKE009)."""
        try:
            warnings = [] if fps is None else rate_warning(parse_rate(fps), None)
        except RateError:
            return
        key = (*location, "fps")
        for fault in warnings:
            self.document.warn(fault.code, key, fault.message, fault.hint)


@dataclass(frozen=True, slots=True)
class _PassReader:
    """Reads passes; ``output_roots`` are the folders they may write to."""

    reader: KeyReader
    output_roots: Sequence[Path]
    units: SceneUnits

    def passes(self, entries: Sequence[Mapping[str, Any]]) -> Iterator[ScenePass]:
        """Yield the passes of a scene's entries, without those with faults."""
        for i, entry in enumerate(entries):
            for name, values in entry.items():
                pass_ = self._pass(("passes", i, name), name, values or {})
                if pass_ is not None:
                    yield pass_

    def _pass(
        self, location: Location, name: str, values: dict[str, Any]
    ) -> ScenePass | None:
        document = self.reader.document
        try:
            pass_ = find_pass(name)
        except AnimtoolError as error:
            fault = error.faults[0]
            document.add(fault.code, location, fault.message, fault.hint)
            return None
        values = rename_options(document, location, values, "scene")
        converted_values = self.units.convert_pass_options(name, values)
        options, faults = record_from_options(pass_.options, converted_values, name)
        for key, fault in faults:
            key_location, is_at_key = (*location, *key), fault.code == "SCN001"
            document.add(
                fault.code, key_location, fault.message, fault.hint, is_at_key=is_at_key
            )
        if options is None:
            return None
        options, files = self._with_colliders(location, options)
        _check_pass(self.reader, location, pass_, options)
        for output in map(str, getattr(options, "writes", ())):
            roots = self.output_roots
            resolve_reference(document, location, output, roots, is_output=True)
        if faults:
            return None
        if name in {"simulate", "ragdoll"}:
            warn_of_suspect_units(document, location, converted_values)
            warn_of_forces(document, location, converted_values)
            warn_of_rotations(document, location, converted_values)
        return ScenePass(pass_, options, entry_location(document, location), files)

    def _with_colliders(
        self, location: Location, options: Any
    ) -> tuple[Any, tuple[Path, ...]]:
        """Return options with their colliders, and the colliders' files."""
        entries = {
            name: models
            for name in COLLISION_KEYS
            if (models := getattr(options, name, ()))
            and isinstance(models[0], FileModel)
        }
        if not entries:
            return options, ()
        reader_class: Any = load_object(COLLIDER_READER_NAME)
        reader = reader_class(self.reader.document, self.reader.roots, self.units)
        colliders = {
            name: reader.collision_entries(location, name, models)
            for name, models in entries.items()
        }
        characters = colliders.get("characters", ())
        files = (*reader.files, *(Path(character.file) for character in characters))
        return replace(options, **colliders), files


def _check_pass(
    reader: KeyReader, location: Location, pass_: Pass, options: Any
) -> None:
    """Record faults in options that can be found without the take."""
    for option, check in pass_.checks(options).items():
        try:
            check()
        except OptionError as error:
            key_location = (*location, option)
            for fault in error.faults:
                reader.document.add(fault.code, key_location, fault.message, fault.hint)
    for field in fields(pass_.options):
        value = getattr(options, field.name)
        if isinstance(value, Path):
            reader.read_file((*location, field.name), str(value))
