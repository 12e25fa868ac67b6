"""Keys of clip channels that are arrays of npz files."""

from __future__ import annotations

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
                location = ("channels", i, "keys")
                array_keys = _load_keys(document, location, keys, archives)
                channels[i] = channel.model_copy(update={"keys": array_keys})
    return model.model_copy(update={"channels": channels})


def _load_keys(
    document: Document, location: Location, text: str, archives: Archives
) -> PlainKeys | list[object]:
    """Return the keys of an array reference; an empty list if it is faulty."""
    name, array = split_reference(text, DEFAULT_ARRAY)
    if document.is_placeholder(location):
        return []
    path = resolve_reference(document, location, name, project_roots(document.path))
    reason = None if path is None else not_a_file_reason(path)
    if reason is not None:
        hint = missing_hint(document, name)
        document.add("DOC015", location, f"{name!r} {reason}", hint)
    if path is None or reason is not None:
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
        message = f"{text!r} has a number beyond {MAX_NUMBER:.0e}"
        document.add("CLIP016", location, message)
        return []
    times, values = map(np.ascontiguousarray, (key_rows[:, 0], key_rows[:, 1:]))
    return PlainKeys(times, values, text)
