"""Typed access to a glTF's JSON, with JSON pointers for messages."""

from __future__ import annotations

import math
from typing import Any, NoReturn

from animtool.core.errors import value_excerpt
from animtool.core.record import dataclass
from animtool.formats import FLOAT32_MAX
from animtool.formats.file_diagnostics import FileDiagnostics


def escape_pointer(key: str) -> str:
    """Return a key escaped for a JSON pointer.

    >>> escape_pointer("a/b~c")
    'a~1b~0c'
    """
    return key.replace("~", "~0").replace("/", "~1")


def animtool_extras(item: JsonItem) -> dict[str, Any]:
    """Return animtool's entry in an object's extras; empty if it has none."""
    extras = item.values.get("extras")
    animtool_values = extras.get("animtool") if isinstance(extras, dict) else None
    return animtool_values if isinstance(animtool_values, dict) else {}


def is_number(value: Any) -> bool:
    """Return whether a JSON value is a number; booleans are not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_integer(value: Any) -> bool:
    """Return whether a JSON value is an integer, also if written as 1.0."""
    return is_number(value) and math.isfinite(value) and value == int(value)


@dataclass(frozen=True, slots=True)
class JsonItem:
    """An object in the JSON of a glTF, with its JSON pointer."""

    values: dict[str, Any]
    pointer: str  # empty for the document root
    diagnostics: FileDiagnostics

    def pointer_to(self, key: str) -> str:
        """Return the pointer of a property."""
        return f"{self.pointer}/{escape_pointer(key)}"

    def fail(
        self, key: str, message: str, code: str = "GLT005", hint: str | None = None
    ) -> NoReturn:
        """Raise a `FormatError` about a property."""
        self.diagnostics.fail(code, self.pointer_to(key), message, hint)

    def fail_missing(self, key: str) -> NoReturn:
        """Raise a `FormatError` about a missing property."""
        message = f"the required property {key!r} is missing"
        self.diagnostics.fail("GLT005", self.pointer or "/", message)

    def integer(self, key: str) -> int | None:
        """Return an integer property, also if written as 1.0; None if missing."""
        if key not in self.values:
            return None
        value = self.values[key]
        if _is_integer(value):
            return int(value)
        kind = ""
        hint: str | None = None
        if isinstance(value, str):
            kind = "the text "
            hint = "write it without quotes" if value.strip("-").isdecimal() else None
        message = f"{key} must be an integer, not {kind}{value_excerpt(value)}"
        return self.fail(key, message, hint=hint)

    def size(self, key: str, default: int | None = None, minimum: int = 0) -> int:
        """Return an integer property; raise if it is missing or below a minimum."""
        value = self.integer(key)
        if value is None:
            if default is None:
                self.fail_missing(key)
            return default
        if value < minimum:
            self.fail(key, f"{key} is {value}, but must be at least {minimum}")
        return value

    def index(self, key: str, count: int, noun: str) -> int:
        """Return an index into a list of ``count`` entries; -1 if missing."""
        value = self.integer(key)
        if value is None:
            return -1
        if not 0 <= value < count:
            range_text = f"0 to {count - 1}" if count else "none"
            message = f"{noun} {value} does not exist; the file has {range_text}"
            self.fail(key, message, "GLT006")
        return value

    def required_index(self, key: str, count: int, noun: str) -> int:
        """Return an index into a list of ``count`` entries; raise if missing."""
        index = self.index(key, count, noun)
        return index if index >= 0 else self.fail_missing(key)

    def indices(self, key: str, count: int, noun: str) -> list[int]:
        """Return indices into a list of ``count`` entries; empty if missing."""
        values = self.read_list(key)
        for i, value in enumerate(values):
            if not _is_integer(value):
                self.fail(key, f"entry {i} is {value_excerpt(value)}, not an integer")
            if not 0 <= value < count:
                message = f"{noun} {int(value)} does not exist"
                self.diagnostics.fail("GLT006", f"{self.pointer_to(key)}/{i}", message)
        return [int(value) for value in values]

    def floats(self, key: str, length: int | None) -> list[float] | None:
        """Return a list of numbers of a required length; None if missing."""
        if key not in self.values:
            return None
        values = self.read_list(key)
        if length is not None and len(values) != length:
            self.fail(key, f"{key} must have {length} numbers, not {len(values)}")
        for i, value in enumerate(values):
            if not is_number(value):
                self.fail(key, f"{value_excerpt(value)} is not a number")
            if not abs(value) <= FLOAT32_MAX:
                message = f"{value} is outside the range of a float32"
                self.diagnostics.fail("GLT010", f"{self.pointer_to(key)}/{i}", message)
        return [float(value) for value in values]

    def text(self, key: str) -> str | None:
        """Return a string property; None if missing."""
        value = self.values.get(key)
        if value is None and key == "name" and key in self.values:
            self.diagnostics.warn(
                "GLT106", self.pointer_to(key), "a name of null is ignored"
            )
        elif not isinstance(value, str) and key in self.values:
            self.fail(key, f"{key} must be text, not {value_excerpt(value)}")
        return value

    def flag(self, key: str) -> bool:
        """Return a boolean property; False if missing."""
        value = self.values.get(key, False)
        if not isinstance(value, bool):
            self.fail(key, f"{key} must be true or false, not {value_excerpt(value)}")
        return value

    def read_list(self, key: str) -> list[Any]:
        """Return a list property, empty if missing; warn about an empty list."""
        if key not in self.values:
            return []
        value = self.values[key]
        if not isinstance(value, list):
            self.fail(key, f"{key} must be a list, not {value_excerpt(value)}")
        if not value:
            self.diagnostics.warn(
                "GLT106", self.pointer_to(key), "an empty list is ignored"
            )
        return value

    def child(self, key: str) -> JsonItem | None:
        """Return a child object; None if missing."""
        if key not in self.values:
            return None
        value = self.values[key]
        if not isinstance(value, dict):
            self.fail(key, f"{key} must be an object, not {value_excerpt(value)}")
        return JsonItem(value, self.pointer_to(key), self.diagnostics)

    def required_child(self, key: str) -> JsonItem:
        """Return a child object; raise if missing."""
        return self.child(key) or self.fail_missing(key)

    def children(self, key: str) -> list[JsonItem]:
        """Return a list of objects; empty if missing."""
        items = []
        for i, value in enumerate(self.read_list(key)):
            pointer = f"{self.pointer_to(key)}/{i}"
            if not isinstance(value, dict):
                message = f"must be an object, not {value_excerpt(value)}"
                self.diagnostics.fail("GLT005", pointer, message)
            items.append(JsonItem(value, pointer, self.diagnostics))
        return items

    def extension(self, name: str) -> JsonItem | None:
        """Return an extension of the object; None if missing."""
        extensions = self.values.get("extensions")
        extension = extensions.get(name) if isinstance(extensions, dict) else None
        if not isinstance(extension, dict):
            return None
        pointer = f"{self.pointer}/extensions/{escape_pointer(name)}"
        return JsonItem(extension, pointer, self.diagnostics)
