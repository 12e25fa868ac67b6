"""The items of a batch: matches inputs, names outputs and checks both."""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from animtool.batch.cut_frames import SHOT_NAMES
from animtool.batch.cuts import Cut
from animtool.batch.inputs import (
    OverriddenVariables,
    cuts_of,
    missing_inputs_error,
    resolve_overrides,
    shared_output_fault,
    with_timeline_as_cuts,
)
from animtool.batch.item import (
    INPUT_NAMES,
    Item,
    ItemTask,
    OutputPattern,
    UnsafeNameError,
    complete_pattern,
    input_values,
    output_root,
    pattern_problems,
)
from animtool.batch.locations import locate_value_faults, variable_fault
from animtool.batch.spec import BatchSpec, Limits
from animtool.batch.variants import file_name_part, name_problems, variant_pattern
from animtool.core.arguments import argument
from animtool.core.errors import (
    AnimtoolError,
    Fault,
    OptionError,
    Severity,
    listed,
    refuse_warnings,
)
from animtool.core.files.output import is_inside
from animtool.core.files.reading import MatchedFile
from animtool.core.names import check_unused_variables, has_kind_suffix, most_similar
from animtool.core.record import dataclass
from animtool.core.writers import take_writer
from animtool.scene.sources.open import source_stem

if TYPE_CHECKING:
    from animtool.documents.variables import SceneValues
    from animtool.scene.bake.reading import Source
    from animtool.scene.scene import Scene


# Folder of the records, in the folder of all outputs.
RECORDS_FOLDER = ".animtool"
MAX_FAULTS = 50


def _first_item(spec: BatchSpec, shot: Cut, overrides: OverriddenVariables) -> Item:
    """Return item 1 of an input, with the first row of the variants."""
    scene_values, file = {**shot.shot_values, **spec.rows[0]}, shot.media
    variables = overrides.values.get(file.path, {})
    return Item(1, file, file.path, scene_values, variables=variables, shot=shot.shot)


def _item_names(spec: BatchSpec) -> set[str]:
    """Return the names that inputs and shots define."""
    return {*INPUT_NAMES, *(() if spec.cuts is None else SHOT_NAMES)}


def check_columns(spec: BatchSpec) -> None:
    """Raise an error if a column of variants has a reserved name."""
    if spec.variants is None:
        return
    reserved_names = {*_item_names(spec), *spec.variables}
    path = spec.variants.path
    path_text, location = (None, ()) if path is None else (str(path), (1,))
    hint = f"names of inputs, shots and {argument('set')} are reserved: "
    hint += listed(sorted(reserved_names))
    faults = [
        Fault("BAT063", message, path_text, location, hint)
        for _, message in name_problems(spec.variants.names, reserved_names)
    ]
    if faults:
        raise OptionError(faults)


def check_effects(
    spec: BatchSpec,
    item_task: ItemTask,
    shots: Sequence[Cut],
    overrides: OverriddenVariables,
) -> None:
    """Raise an error for a scene that uses neither its inputs nor the variants."""
    shots_by_source = {spec.scene or shot.media.path: shot for shot in reversed(shots)}
    column_names = () if spec.variants is None else spec.variants.names
    item_names = _item_names(spec)
    faults = []
    for path, shot in sorted(shots_by_source.items()):
        if not has_kind_suffix(path, "scene"):
            if column_names:
                hint = f"{argument('scene')} names a scene that uses ${{input}} and "
                hint += "the variants"
                fault = Fault("BAT060", "variants need a scene", str(path), (), hint)
                faults.append(fault)
            continue
        if spec.scene is None and not column_names:
            continue
        with locate_value_faults(spec):
            source = item_task.source(_first_item(spec, shot, overrides))
        scene = cast("Scene", source)
        if spec.scene is not None and not scene.effective_variables & item_names:
            faults.append(_unused_inputs_fault(scene, len(shots)))
        if column_names and not scene.effective_variables.intersection(column_names):
            faults.append(_unused_variants_fault(spec, scene))
    if faults:
        raise OptionError(faults[:MAX_FAULTS])


def _unused_variants_fault(spec: BatchSpec, scene: Scene) -> Fault:
    """Return a fault, located in the batch, for a scene that uses no variant."""
    assert spec.variants is not None
    column_names, used_names = spec.variants.names, sorted(scene.effective_variables)
    file_name = Path(str(scene.path)).name
    message = (
        f"{file_name} uses no {' or '.join(f'${{{name}}}' for name in column_names)}"
    )
    if used_names:
        message += f"; it uses {listed([f'${{{name}}}' for name in used_names])}"
    candidates = [name for name in used_names if name not in _item_names(spec)]
    for name in column_names:
        if similar_name := most_similar(name, candidates):
            hint = f"did you mean {similar_name!r}?"
            return variable_fault(spec, name, "BAT060", message, hint)
    hint = f"write ${{{column_names[0]}}} in {file_name} in place of a value"
    return variable_fault(spec, column_names[0], "BAT060", message, hint)


def _unused_inputs_fault(scene: Scene, item_count: int) -> Fault:
    """Return a fault for a scene that does not use its inputs."""
    message = "the scene does not use its input"
    if item_count > 1:
        message += f": all {item_count} items would be the same"
    hint = "write `file: ${input}` in its source"
    if scene.sources:
        return scene.sources[0].location.fault("BAT060", message, hint, Severity.ERROR)
    return Fault("BAT060", message, str(scene.path), (), hint)


@dataclass(frozen=True, slots=True)
class Batch:
    """A batch after its inputs were found: its items and how to build them."""

    name: str  # name of its records
    items: tuple[Item, ...]  # in order
    item_task: ItemTask  # how each item is built
    limits: Limits  # limits of each item
    jobs: int | None  # number of processes; None uses one per processor
    root: Path  # folder of all outputs, absolute; root of the paths in records
    shared_inputs: tuple[Path, ...] = ()  # inputs of all items, such as a scene
    # Source of the first item, if all have the same scene.
    common_source: Source | None = None
    # Warnings about the timeline, the inputs and the overrides.
    notices: tuple[Fault, ...] = ()

    @property
    def records_folder(self) -> Path:
        """Folder of the batch's records."""
        return self.root / RECORDS_FOLDER

    def outputs(self, item: Item) -> list[Path]:
        """Return the files that an item writes, loading its scene if necessary."""
        if item.files:
            return list(item.files)
        source = (
            self.item_task.source(item)
            if self.common_source is None
            else self.common_source
        )
        return self.item_task.outputs(item, source)


def find_batch(spec: BatchSpec) -> Batch:
    """Return a batch with its items, sorted by name or in timeline order."""
    spec = with_timeline_as_cuts(spec)
    if spec.output is not None:
        name = "{parent}/{stem}" if spec.cuts is None else "{shot}"
        pattern = complete_pattern(spec.output, name + variant_pattern(spec.variants))
        spec = replace(spec, output=pattern)
        _check_pattern(spec, pattern)
    spec = _with_scene_input(spec)
    check_columns(spec)
    cuts = cuts_of(spec)
    shots = cuts.shots
    if not shots:
        raise missing_inputs_error(spec)
    files = [shot.media for shot in shots]
    item_task, overrides = _item_task(spec, files), resolve_overrides(spec, files)
    common_source = None
    if spec.scene is not None:
        with locate_value_faults(spec):
            common_source = item_task.source(_first_item(spec, shots[0], overrides))
        if spec.output is not None:
            item_task.refuse_two_outputs(common_source)
    _check_variables(spec, item_task, common_source)
    check_effects(spec, item_task, shots, overrides)
    items = _ItemListBuilder(spec, item_task, shots, common_source, overrides).build()
    _check_roots(spec, items)
    if spec.path is not None and (fault := shared_output_fault(spec, files)):
        raise OptionError(fault)
    options = spec.options
    notices = (*cuts.notices, *overrides.notices)
    refuse_warnings(notices, strict=options.strict)
    table_path = None if spec.variants is None else spec.variants.path
    named_paths = (
        *(spec.scene, options.rig_layer, options.source.rig),
        *(spec.path, spec.cuts, table_path),
    )
    return Batch(
        spec.name,
        items,
        item_task,
        spec.limits,
        spec.jobs,
        Path(spec.folder, output_root(spec.output or "")).absolute(),
        tuple(path for path in named_paths if path is not None),
        common_source,
        notices,
    )


def scene_values(spec: BatchSpec) -> dict[Path, SceneValues]:
    """Return the variables of the first item of each scene of a batch, by path."""
    from animtool.documents.variables import SceneValues

    spec = _with_scene_input(with_timeline_as_cuts(spec))
    shots = cuts_of(spec).shots
    files = [shot.media for shot in shots]
    item_task, overrides = _item_task(spec, files), resolve_overrides(spec, files)
    values_by_scene: dict[Path, SceneValues] = {}
    for shot in shots:
        path = spec.scene or shot.media.path
        if path not in values_by_scene and has_kind_suffix(path, "scene"):
            item = _first_item(spec, shot, overrides)
            variable_values = item_task.variable_values(item)
            values_by_scene[path] = SceneValues(
                variable_values, frozenset(item.scene_values)
            )
    return values_by_scene


def unused_variable_faults(spec: BatchSpec) -> list[Fault]:
    """Return a fault for each variable that the scene of a batch does not use.

    The list is empty if the batch names no scene, or the scene cannot be read.
    """
    try:
        spec = _with_scene_input(with_timeline_as_cuts(spec))
        shots = cuts_of(spec).shots
        if spec.scene is None or not shots:
            return []
        files = [shot.media for shot in shots]
        item_task, overrides = _item_task(spec, files), resolve_overrides(spec, files)
        source = item_task.source(_first_item(spec, shots[0], overrides))
    except AnimtoolError:
        return []
    try:
        _check_variables(spec, item_task, source)
    except OptionError as error:
        return list(error.faults)
    return []


def _with_scene_input(spec: BatchSpec) -> BatchSpec:
    """Return a batch in which the scene of the variants is the only input."""
    if spec.scene is None or spec.variants is None or spec.inputs or spec.cuts:
        return spec
    scene = spec.scene if spec.path is None else spec.scene.absolute()
    return replace(spec, inputs=(os.fspath(scene),), scene=None)


def _check_pattern(spec: BatchSpec, pattern: str) -> None:
    """Raise an error for an output pattern with unknown names or suffix."""
    known_names = {**spec.variables, **spec.rows[0]}
    if spec.cuts is not None:
        known_names |= dict.fromkeys(SHOT_NAMES, "")
    faults = [
        Fault("BAT004", message, spec.path_text, (), hint)
        for message, hint in pattern_problems(pattern, known_names)
    ]
    if faults:
        raise OptionError(faults)
    # Other names at the end may contain a suffix.
    if not pattern.replace("{stem}", "stem").endswith("}"):
        take_writer(Path(pattern), allows_folders=True)


def _item_task(spec: BatchSpec, files: Sequence[MatchedFile]) -> ItemTask:
    """Return the task that builds items: the scene, its variables, and the options."""
    paths = [file.path for file in files]
    path_by_kind = {
        (path.suffix.lower(), has_kind_suffix(path, "scene")): path for path in paths
    }
    return ItemTask(
        spec.scene, dict(spec.variables), spec.options, tuple(path_by_kind.values())
    )


def _check_variables(
    spec: BatchSpec, item_task: ItemTask, common_source: Source | None
) -> None:
    """Raise an error for variables that neither the scene nor the output uses."""
    names = [*spec.variables, *(n for o in spec.overrides for n in o.variables)]
    variables = [*dict.fromkeys(names), *spec.rows[0]]
    used_names = {name for name in variables if f"{{{name}}}" in (spec.output or "")}
    if common_source is not None:
        scene_names = set(getattr(common_source, "variables", ()))
        if spec.scene is not None and scene_names.isdisjoint(spec.rows[0]):
            # `check_effects` reports variants that are all unused.
            variables = [name for name in variables if name not in spec.rows[0]]
        used_names |= scene_names
    elif any(has_kind_suffix(path, "scene") for path in item_task.example_paths):
        # Each holds its faults until the items are built.
        used_names |= set(variables)
    check_unused_variables(
        variables,
        used_names - _item_names(spec),
        spec.path,
        locate=None
        if spec.path is None
        else lambda name, message, hint: variable_fault(
            spec, name, "SCN031", message, hint
        ),
        has_scene=spec.scene is not None,
    )


@dataclass(slots=True)
class _ItemListBuilder:
    """Builds the items of a batch with outputs named by pattern, scene or input."""

    spec: BatchSpec
    item_task: ItemTask
    shots: Sequence[Cut]
    common_source: Source | None
    overrides: OverriddenVariables
    faults: list[Fault] = field(default_factory=list)

    def build(self) -> tuple[Item, ...]:
        """Return an item per input and row of variants; raise all faults together."""
        spec = self.spec
        output_pattern = None
        if spec.output is not None:
            folder_names = frozenset({"parent", *spec.variables})
            output_pattern = OutputPattern(spec.output, spec.folder, folder_names)
        combinations = itertools.product(self.shots, spec.rows)
        items = [
            self._item(number, shot, row, output_pattern)
            for number, (shot, row) in enumerate(combinations, 1)
        ]
        if self.faults:
            raise OptionError(self.faults[:MAX_FAULTS])
        return tuple(items)

    def _item(
        self,
        number: int,
        shot: Cut,
        row: Mapping[str, str],
        output_pattern: OutputPattern | None,
    ) -> Item:
        """Return the item of an input and a row of variants, with its output path."""
        spec, file, scene_values = self.spec, shot.media, {**shot.shot_values, **row}
        variables = self.overrides.values.get(file.path, {})
        file_name_parts = {name: file_name_part(value) for name, value in row.items()}
        suffix = "".join(f"_{part}" for part in file_name_parts.values())
        output_path = file.path.with_name(f"{source_stem(file.path)}{suffix}.usdc")
        if spec.cuts is not None:
            output_path = spec.cuts.with_name(
                f"{shot.shot_values['shot']}{suffix}.usdc"
            )
        if output_pattern is not None:
            value_by_name = {**spec.variables, **variables, **input_values(file)}
            value_by_name |= {**shot.shot_values, **file_name_parts}
            try:
                output_path = output_pattern.path(value_by_name)
            except UnsafeNameError as error:
                self._record_unsafe_output(shot, row, error)
        variant_arguments = ((), row, variables, shot.shot)
        item = Item(number, file, output_path, scene_values, *variant_arguments)
        has_scene = spec.scene is None and has_kind_suffix(file.path, "scene")
        is_output_in_scene = getattr(self.common_source, "output", None) is not None
        if output_pattern is None and (has_scene or is_output_in_scene):
            item = self.item_task.with_scene_outputs(item)
        return item

    def _record_unsafe_output(
        self, shot: Cut, row: Mapping[str, str], error: UnsafeNameError
    ) -> None:
        """Record an output with an unsafe name, located in the file that states it."""
        spec, name = self.spec, error.name
        source: Path | None = shot.media.path
        hint = f"rename the input, or remove the name from {argument('output')}"
        if name in shot.shot_values:
            source = spec.cuts
            hint = "rename it in the edit, or write {shot}, which is always valid"
        elif name in row:
            source = None if spec.variants is None else spec.variants.path or spec.path
            hint = "use another value"
        elif name in spec.variables:
            source, hint = spec.path, "use another value"
        path = None if source is None else str(source)
        fault = Fault("OUT006", f"the output {error}", path, (), hint)
        if fault not in self.faults:
            self.faults.append(fault)


def _check_roots(spec: BatchSpec, items: Sequence[Item]) -> None:
    """Raise an error for outputs outside the folders that a batch may write to."""
    if not spec.roots:
        return
    folders = dict.fromkeys(folder for item in items for folder in item.folders)
    roots_text = listed([str(root) for root in spec.roots])
    hint = f"set {argument('output')}, or add the folder to roots in animtool.toml"
    messages = [
        f"{str(folder)!r} is outside {roots_text}"
        for folder in folders
        if not any(is_inside(folder, root) for root in spec.roots)
    ]
    faults = [Fault("DOC014", text, spec.path_text, (), hint) for text in messages]
    if faults:
        raise OptionError(faults[:MAX_FAULTS])
