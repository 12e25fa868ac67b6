"""Keys of clip channels that are arrays of npz files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from animtool.clip.plain_keys import PlainKeys
from animtool.clip.schema import ClipModel
from animtool.core.config import project_roots
from animtool.core.files.reading import not_a_file_reason
from animtool.documents.arrays import Archives
from animtool.documents.document import Document, Location
from animtool.documents.fields import MAX_NUMBER
from animtool.documents.references import (
    missing_hint,
    resolve_reference,
    split_reference,
)

# Array name of a reference without a name.
DEFAULT_ARRAY = "keys"


def with_array_keys(document: Document, model: ClipModel) -> ClipModel:
    """Return a clip whose references to arrays are replaced by their keys.

    Channels whose array is faulty have no keys (CLIP016, DOC014, DOC015).
    """
    channels = list(model.channels)
    with Archives() as archives:
        for i, channel in enumerate(channels):
            keys: object = channel.keys
            if isinstance(keys, str):
                array_keys = _load_keys(
                    document, ("channels", i, "keys"), keys, archives
                )
                channels[i] = channel.model_copy(update={"keys": array_keys})
    return model.model_copy(update={"channels": channels})


def _load_keys(
    document: Document, location: Location, text: str, archives: Archives
) -> PlainKeys | list[object]:
    """Return the keys of an array reference; an empty list if it is faulty."""
    name, array = split_reference(text, DEFAULT_ARRAY)
    path = (
        None
        if document.is_placeholder(location)
        else _array_file(document, location, name)
    )
    if path is None:
        return []
    try:
        key_rows = archives.load(path, array)
    except ValueError as error:
        document.add("CLIP016", location, str(error))
        return []
    if key_rows.ndim != 2 or not len(key_rows) or key_rows.shape[1] < 2:
        message = f"{text!r} has shape {key_rows.shape}, not (K, 1 + D)"
        hint = "write a row for each key: its time, then its value"
        document.add("CLIP016", location, message, hint)
        return []
    if not (np.abs(key_rows) <= MAX_NUMBER).all():
        document.add(
            "CLIP016", location, f"{text!r} has a number beyond {MAX_NUMBER:.0e}"
        )
        return []
    times, values = (
        np.ascontiguousarray(part) for part in (key_rows[:, 0], key_rows[:, 1:])
    )
    return PlainKeys(times, values, text)


def _array_file(document: Document, location: Location, name: str) -> Path | None:
    """Return the file of an array; None if missing or not allowed."""
    path = resolve_reference(document, location, name, project_roots(document.path))
    reason = None if path is None else not_a_file_reason(path)
    if reason is None:
        return path
    document.add("DOC015", location, f"{name!r} {reason}", missing_hint(document, name))
    return None
