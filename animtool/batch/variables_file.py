"""Variables in batch files: those of all inputs, and overrides for some."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from animtool.batch.overrides import Override
from animtool.documents.check import FileModel
from animtool.documents.document import Document, Location
from animtool.documents.fields import Name, Real, key
from animtool.documents.names import is_variable_name

Value = str | Real | bool


def value_text(document: Document, at: Location, value: Value) -> str:
    """Return a value as the file has it; numbers keep the digits written."""
    if isinstance(value, str):
        return value
    written = document.written(at)
    return written or str(value).lower()


def variables_of_document(
    document: Document, at: Location, own: Mapping[str, Value]
) -> dict[str, str]:
    """Return the values of variables as text; names that are none are faults."""
    for name in own:
        if not is_variable_name(name):
            message = f"{name!r} is no name of a variable"
            hint = "letters, digits and _ make one, and no digit begins it"
            document.add("BAT002", (*at, name), message, hint)
    return {name: value_text(document, (*at, name), v) for name, v in own.items()}


class OverrideModel(FileModel):
    """Variables of some inputs."""

    inputs: list[Name] = key(
        "The inputs that it is for: files, folders and globs.", ["takes/mixamo/**"]
    )
    variables: dict[str, Value] = key(
        "Their values, in place of those of the batch or of an override above.",
        {"map": "mixamo.map.yaml"},
    )


def overrides_of_document(
    document: Document, models: Sequence[OverrideModel], taken: Collection[str]
) -> tuple[Override, ...]:
    """Return the overrides of a batch file, faults of their names noted.

    Args:
        document: The batch file.
        models: Its entries.
        taken: Names that have values of another source.
    """
    overrides = []
    for i, model in enumerate(models):
        at = ("overrides", i, "variables")
        values = variables_of_document(document, at, model.variables)
        for name in sorted(values.keys() & taken):
            message = f"{name!r} already has a value for each item"
            hint = "inputs, shots and variants give it: name the variable otherwise"
            document.add("BAT063", (*at, name), message, hint)
        overrides.append(Override(tuple(model.inputs), values))
    return tuple(overrides)
