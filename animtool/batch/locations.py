"""Locations in a batch of values that its scene refuses or does not use."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from animtool.batch.spec import BatchSpec
from animtool.batch.variants import translate_range
from animtool.core.arguments import argument
from animtool.core.errors import Fault, FormatError
from animtool.documents.document import Document, parse_location, read_document


def variable_fault(
    spec: BatchSpec, name: str, code: str, message: str, hint: str | None = None
) -> Fault:
    """Return a fault located where a batch gives a variable its value.

    This is a key of the batch file, a column of a table, or an argument.
    """
    is_variant = spec.variants is not None and name in spec.variants.names
    key = "variants" if is_variant else "variables"
    table_path = None if spec.variants is None or not is_variant else spec.variants.path
    if table_path is not None:
        return Fault(code, message, str(table_path), (1,), hint, where=name)
    if spec.path is None:
        argument_text = argument("vary" if is_variant else "variables")
        return Fault(code, f"{argument_text}: {message}", hint=hint)
    document = read_document(spec.path)
    values = document.value.get(key)
    has_rows = isinstance(values, list)
    if not has_rows and name not in (values or {}):
        overrides = document.value.get("overrides")
        for i, entry in enumerate(overrides if isinstance(overrides, list) else ()):
            if name in (entry.get("variables") or ()):
                location = ("overrides", i, "variables", name)
                return document.fault(code, location, message, hint)
        # A value that the command line adds to those of the batch.
        return Fault(code, f"{name}: {message}", str(spec.path), hint=hint)
    return document.fault(code, (key, *([0] if has_rows else []), name), message, hint)


@contextmanager
def locate_value_faults(spec: BatchSpec) -> Iterator[None]:
    """Relocate faults raised in a block to the batch that sets the faulty values."""
    try:
        yield
    except FormatError as error:
        raise FormatError(_locate_faults(spec, error.faults)) from error


def _locate_faults(spec: BatchSpec, faults: Sequence[Fault]) -> list[Fault]:
    """Return the faults of a scene, located in the batch for values from there."""
    from animtool.documents.placeholders import value_at  # loads pydantic

    batch_values = {**spec.variables, **spec.rows[0]}
    documents: dict[str, Document] = {}
    located_faults = []
    for fault in faults:
        name = None
        if fault.path and fault.where and batch_values:
            path = fault.path
            if path not in documents:
                documents[path] = read_document(Path(path))
            text = None
            with suppress(KeyError, IndexError, TypeError):
                text = value_at(documents[path].value, parse_location(fault.where))
            name = next((n for n in batch_values if text == f"${{{n}}}"), None)
        if name is None:
            located_faults.append(fault)
            continue
        message = f"{fault.message}, for {fault.where} of {Path(str(fault.path)).name}"
        hint = fault.hint
        suggested_range = translate_range(batch_values[name])
        if suggested_range is not None:
            numbers = suggested_range.replace("..", " to ", 1)
            hint = f"for the numbers {numbers} write {suggested_range}"
        located_faults.append(variable_fault(spec, name, fault.code, message, hint))
    return located_faults
