"""Reads batch files, ``*.batch.yaml``, and records every fault with its location."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from animtool.batch.cut_frames import SHOT_NAMES
from animtool.batch.item import INPUT_NAMES, pattern_problems
from animtool.batch.schema import (
    BatchModel,
    OptionsModel,
    OverrideModel,
    RangeModel,
    VariableValue,
)
from animtool.batch.spec import BatchSpec, Limits, Override, parse_bytes
from animtool.batch.variants import (
    MAX_VARIANTS,
    TOO_MANY_TEXT,
    BackwardRangeError,
    Variants,
    name_problems,
    range_values,
    read_variants,
    value_problem,
    values_of_text,
    variants_of_columns,
)
from animtool.core.config import project_roots
from animtool.core.errors import excerpt
from animtool.core.names import is_variable_name
from animtool.core.readers import is_timeline
from animtool.core.timecode import is_timecode
from animtool.documents.check import validate_file
from animtool.documents.document import Document, Location, read_document
from animtool.documents.references import resolve_input
from animtool.scene.bake.options import BakeOptions
from animtool.scene.file.output_fields import KeyReader, option_values
from animtool.scene.sources.open import SourceOptions


def value_text(document: Document, location: Location, value: VariableValue) -> str:
    """Return a value as text, with numbers spelled as in the file."""
    if isinstance(value, str):
        return value
    return document.source_text(location) or str(value).lower()


def read_variables(
    document: Document, location: Location, values: Mapping[str, VariableValue]
) -> dict[str, str]:
    """Return variables as text; record a fault for each invalid name."""
    for name in values:
        if not is_variable_name(name):
            message = f"{name!r} is not a valid variable name"
            hint = "use letters, digits and _, and do not start with a digit"
            document.add("BAT002", (*location, name), message, hint)
    return {
        name: value_text(document, (*location, name), value)
        for name, value in values.items()
    }


def read_overrides(
    document: Document, models: Sequence[OverrideModel], reserved_names: Collection[str]
) -> tuple[Override, ...]:
    """Return the overrides of a batch file; record faults in variable names.

    Overrides cannot set ``reserved_names``, whose values come from elsewhere.
    """
    overrides = []
    for i, model in enumerate(models):
        location = ("overrides", i, "variables")
        values = read_variables(document, location, model.variables)
        for name in sorted(values.keys() & reserved_names):
            message = f"{name!r} already has a value for each item"
            hint = "inputs, shots and variants set it: give the variable another name"
            document.add("BAT063", (*location, name), message, hint)
        overrides.append(Override(tuple(model.inputs), values))
    return tuple(overrides)


VARIANTS_LOCATION = ("variants",)


def read_listed_variants(
    document: Document, variants: Any, reserved_names: Collection[str]
) -> Variants | None:
    """Return the variants that a batch file lists; None if they are faulty."""
    reader = _VariantReader(document, reserved_names)
    fault_count = len(document.faults)
    if isinstance(variants, list):
        table = reader.rows(variants)
    else:
        columns = reader.columns(variants)
        # If values are faulty, the table is incomplete.
        table = None if len(document.faults) > fault_count else reader.combine(columns)
    if len(document.faults) > fault_count or document.is_placeholder(VARIANTS_LOCATION):
        return None
    return table


class _VariantReader:
    """Reads the variants of a batch file and records their faults."""

    def __init__(self, document: Document, reserved_names: Collection[str]) -> None:
        self.document, self.reserved_names = document, reserved_names

    def columns(self, columns: Mapping[str, Any]) -> dict[str, list[str]]:
        """Return the values of each column by its name; record faults in either."""
        self._check_names(VARIANTS_LOCATION, list(columns))
        return {
            name: list(self._values((*VARIANTS_LOCATION, name), entry))
            for name, entry in columns.items()
        }

    def combine(self, columns: Mapping[str, list[str]]) -> Variants | None:
        """Return every combination of the values of columns."""
        try:
            return variants_of_columns(columns)
        except ValueError as error:
            self.document.add("BAT065", VARIANTS_LOCATION, str(error))
            return None

    def rows(self, entries: list[Mapping[str, Any]]) -> Variants | None:
        """Return the variants of a list that has one mapping per row."""
        if len(entries) > MAX_VARIANTS:
            message = f"{len(entries)} variants: {TOO_MANY_TEXT}"
            self.document.add("BAT065", VARIANTS_LOCATION, message)
            return None
        column_names = list(entries[0])
        self._check_names((*VARIANTS_LOCATION, 0), column_names)
        if not column_names:
            self.document.add("BAT061", (*VARIANTS_LOCATION, 0), "a row has no values")
        rows = []
        for i, entry in enumerate(entries):
            location = (*VARIANTS_LOCATION, i)
            if set(entry) != set(column_names):
                message = "the columns differ from those of the first row: "
                message += ", ".join(sorted(set(entry) ^ set(column_names)))
                hint = f"columns: {', '.join(column_names)}"
                self.document.add("BAT062", location, message, hint)
                continue
            rows.append(
                {name: self._value((*location, name), entry) for name in column_names}
            )
        return Variants(tuple(rows))

    def _check_names(self, location: Location, names: list[str]) -> None:
        for i, message in name_problems(names, self.reserved_names):
            self.document.add("BAT063", (*location, names[i]), message)

    def _values(self, location: Location, values: Any) -> Iterator[str]:
        """Yield the values of a column: a list, a range, or a text such as ``1..4``."""
        if isinstance(values, list):
            for i in range(len(values)):
                yield self._value((*location, i), values)
            return
        try:
            if isinstance(values, RangeModel):
                texts = (
                    value_text(self.document, (*location, key), getattr(values, key))
                    for key in ("start", "stop", "step")
                )
                yield from range_values(*texts)
            else:
                yield from values_of_text(values)
        except BackwardRangeError as error:
            hint = error.key_hint if isinstance(values, RangeModel) else error.hint
            self.document.add("BAT064", location, str(error), hint)
        except ValueError as error:
            self.document.add("BAT064", location, str(error))

    def _value(self, location: Location, parent_value: Any) -> str:
        """Return one value of a list or a row as text."""
        text = value_text(self.document, location, parent_value[location[-1]])
        problem = value_problem(text)
        if problem is not None:
            self.document.add("BAT064", location, problem)
        return text


def load_batch(path: Path | str, *, uses_timeline: bool = False) -> BatchSpec:
    """Return the spec of a batch file.

    Args:
        path: The file.
        uses_timeline: Whether the command line names a timeline for it.

    Raises:
        FormatError: With every fault of the file, each with line and column.
        OptionError: The project's settings are malformed.
    """
    return parse_batch(read_document(Path(path), "batch"), uses_timeline=uses_timeline)


def parse_batch(document: Document, *, uses_timeline: bool = False) -> BatchSpec:
    """Return the spec of a parsed batch file; see `load_batch`."""
    model = validate_file(document, "batch", BatchModel)
    spec = _BatchReader(document, model, uses_timeline=uses_timeline).spec()
    document.check()
    return spec


class _BatchReader:
    """Reads the spec of a batch from a validated batch file."""

    def __init__(
        self, document: Document, model: BatchModel, *, uses_timeline: bool
    ) -> None:
        self.document, self.model = document, model
        folder = document.path.parent
        has_timeline = any(is_timeline(folder / text) for text in model.inputs)
        self.uses_timeline = uses_timeline or has_timeline or model.cut is not None
        self.reader = KeyReader(document, project_roots(document.path), "BAT002")

    def spec(self) -> BatchSpec:
        model = self.model
        path = self.document.path
        read_file = self.reader.read_file
        if model.scene is not None and model.options is not None:
            message = "the batch has both a scene and options"
            hint = "move the options into the scene's output"
            self.document.add("BAT001", ("options",), message, hint)
        has_inputs = not self.document.is_placeholder(("inputs",))
        is_scene_alone = model.scene and model.variants
        if has_inputs and not (model.inputs or self.uses_timeline or is_scene_alone):
            location: Location = ()
            message = "key 'inputs' is missing"
            if "inputs" in model.model_fields_set:
                location, message = ("inputs",), "has no entries"
            hint = "files, folders and globs; a scene alone can have variants"
            self.document.add("DOC021", location, message, hint)
        variants = self._variants()
        columns = self._column_names(variants)
        if columns is not None:
            self._check_output_names(columns)
        memory_key = ("limits", "memory")
        memory = self.reader.parse_value(memory_key, model.limits.memory, parse_bytes)
        reserved_names = {*self._reserved_names(), *(columns or ())}
        return BatchSpec(
            tuple(model.inputs),
            path.parent,
            path.name.rpartition(".batch.")[0] or path.stem,
            tuple(model.exclude),
            None if model.scene is None else read_file(("scene",), model.scene),
            read_variables(self.document, ("variables",), model.variables),
            self._options(model.options or OptionsModel()),
            model.output,
            Limits(model.limits.seconds, memory),
            None if model.jobs == "auto" else model.jobs,
            path,
            None if model.cut is None else read_file(("cut",), model.cut),
            model.handles,
            variants,
            self.reader.roots,
            read_overrides(self.document, model.overrides, reserved_names),
            None,
            None if model.cut_start is None else int(model.cut_start),
            self._first_timecode(),
        )

    def _reserved_names(self) -> set[str]:
        """Return the names that inputs and shots define, which variables cannot use."""
        return {*INPUT_NAMES, *(SHOT_NAMES if self.uses_timeline else ())}

    def _first_timecode(self) -> str | None:
        text = self.model.first_timecode
        if text is not None and not is_timecode(text):
            message = f"{excerpt(text)} is not a time code"
            hint = "write 01:00:00:00, or 01:00:00;02 for drop-frame"
            self.document.add("BAT001", ("first_timecode",), message, hint)
        return text

    def _variants(self) -> Variants | None:
        """Return the variants; None if there are none, or after recording faults."""
        variants = self.model.variants
        if not variants:
            if "variants" in self.model.model_fields_set:
                hint = "write {k: [1, 2]}, a list of rows, or the name of a CSV file"
                self.document.add("BAT061", ("variants",), "has no values", hint)
            return None
        if isinstance(variants, str):
            location = ("variants",)
            path = resolve_input(self.document, location, variants, self.reader.roots)
            return None if path is None else read_variants(path)
        reserved_names = {*self._reserved_names(), *self.model.variables}
        return read_listed_variants(self.document, variants, reserved_names)

    def _column_names(self, variants: Variants | None) -> Sequence[str] | None:
        """Return the names of columns, even with faulty values; None if unknown."""
        entry = self.model.variants
        if variants is not None:
            return variants.names
        if isinstance(entry, str):
            return None
        first_row = entry[0] if isinstance(entry, list) and entry else entry
        return tuple(first_row) if isinstance(first_row, dict) else ()

    def _check_output_names(self, columns: Sequence[str]) -> None:
        """Record a fault for each unknown name in braces in the output."""
        model = self.model
        known_names = dict.fromkeys([*model.variables, *columns], "")
        if self.uses_timeline:
            known_names |= dict.fromkeys(SHOT_NAMES, "")
        for message, hint in pattern_problems(model.output or "", known_names):
            self.document.add("BAT004", ("output",), message, hint)

    def _options(self, model: OptionsModel) -> BakeOptions:
        location: Location = ("options",)
        source = option_values(SourceOptions, model, "batch", location, self.reader)
        bake = option_values(BakeOptions, model, "batch", location, self.reader)
        return BakeOptions(source=SourceOptions(**source), **bake)
