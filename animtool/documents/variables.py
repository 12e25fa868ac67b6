"""Variables in the text of a document: ``${name}``, with defaults in the file."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import field
from typing import Any

from pydantic import BaseModel

from animtool.core.arguments import argument, clause
from animtool.core.errors import excerpt
from animtool.core.files.output import name_problem
from animtool.core.names import VARIABLE_NAME, is_variable_name, most_similar
from animtool.core.record import dataclass
from animtool.documents.document import Document, Location
from animtool.documents.placeholders import (
    annotation_at,
    placeholder_of,
    replaced,
    takes_no_text,
)
from animtool.documents.yaml_values import plain_scalar

# Key of the variables' default values.
DEFAULTS = "variables"
# Key of a document's output.
OUTPUT = "output"
# First and last key of output paths.
WRITTEN = frozenset({(OUTPUT, "file"), ("passes", "save")})
# Longest text [character]: longer than any path or number.
LONGEST = 10_000
# `$$` is an escaped dollar.
_USE = re.compile(rf"\$(?P<kept>\$)?\{{(?:(?P<name>{VARIABLE_NAME})\}})?")


@dataclass(frozen=True, slots=True)
class SceneValues:
    """Values of a scene's variables that another file sets."""

    # Values by variable name; they override the scene's.
    values: Mapping[str, str] = field(default_factory=dict)
    # Variables that must be a single path component in output names.
    parts: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Variables:
    """The variables of a document."""

    names: frozenset[str] = frozenset()  # variables it uses or defines
    # Variables with a value that no text uses.
    idle: frozenset[str] = frozenset()
    # Variables that affect more than the key ``output``.
    effective: frozenset[str] = frozenset()


def resolve_variables(
    document: Document,
    model: type[BaseModel],
    variables: Mapping[str, str],
    parts: Collection[str] = (),
) -> Variables:
    """Substitute variables in the values of a document; keys are not changed.

    Unquoted text is parsed again after substitution, so it may become a number; so is
    a quoted variable where text is not allowed. A default may use variables defined
    above it and those passed in. A placeholder replaces each faulty value. Faults: an
    unknown name (SCN030), a malformed ``${``, an invalid name (SCN032), or a value that
    is unsafe in an output's name (OUT006).

    Args:
        document: The document, changed in place.
        model: Model of the document.
        variables: Values by name; they override the document's.
        parts: Names of variables that must be a single component of an output path,
            without a slash.
    """
    resolver = _Resolver(document, model, dict(variables), parts=set(parts))
    resolver.defaults()
    for location, text in list(_texts(document.value, ())):
        if location[0] != DEFAULTS:
            resolver.put(location, text)
    with_default = frozenset(resolver.with_default)
    used_names = frozenset().union(*resolver.uses.values())
    return Variables(
        with_default | used_names, with_default - used_names, resolver.effective()
    )


# JSON Schema of a variable: text that becomes another type.
_TEXT = {"type": "string", "pattern": rf"\$\{{{VARIABLE_NAME}\}}"}
# Schema keywords that describe a value's type, not its meaning.
_TYPE_KEYWORDS = frozenset(
    {"type", "enum", "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"}
)


def with_variables(schema: Any) -> Any:
    """Return a JSON Schema that also allows variables in place of values.

    >>> with_variables({"type": "number", "minimum": 0})["anyOf"][0]
    {'type': 'number', 'minimum': 0}
    """
    if isinstance(schema, list):
        return [with_variables(entry) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    extended_schema = {key: _inner_schema(key, value) for key, value in schema.items()}
    if "anyOf" not in schema and _is_other(schema):
        type_keywords = {
            key: extended_schema.pop(key)
            for key in list(extended_schema)
            if key in _TYPE_KEYWORDS
        }
        extended_schema["anyOf"] = [type_keywords, _TEXT]
    return extended_schema


def _inner_schema(key: str, value: Any) -> Any:
    if key in {"properties", "$defs"}:
        return {name: with_variables(entry) for name, entry in value.items()}
    return value if key in {"default", "examples"} else with_variables(value)


def _is_other(schema: dict[str, Any]) -> bool:
    """Return whether a schema excludes text."""
    return "enum" in schema or schema.get("type") in {"number", "integer", "boolean"}


def _texts(node: Any, location: Location) -> Iterator[tuple[Location, str]]:
    """Yield the location and text of each value that may use a variable."""
    if isinstance(node, str):
        if "${" in node:
            yield location, node
    elif isinstance(node, dict):
        for key, value in node.items():
            yield from _texts(value, (*location, key))
    elif isinstance(node, list):
        for i, value in enumerate(node):
            yield from _texts(value, (*location, i))


@dataclass(slots=True)
class _Resolver:
    """Substitutes variables in the texts of a document."""

    document: Document  # changed in place
    model: type[BaseModel]  # expected model
    values: dict[str, str]  # known variables and their values
    # Variables with a value in the document.
    with_default: set[str] = field(default_factory=set)
    # Variables used by texts, by key of the document; inside the values of variables
    # also by the variable's name.
    uses: dict[Location, set[str]] = field(default_factory=dict)
    # Variables with a faulty value.
    faulty: set[str] = field(default_factory=set)
    # Variables whose value another file sets, directly or through other variables.
    parts: set[str] = field(default_factory=set)

    def defaults(self) -> None:
        """Read the document's default values; each may use earlier ones."""
        default_values = self.document.value.get(DEFAULTS)
        for name, value in (
            default_values if isinstance(default_values, dict) else {}
        ).items():
            location = (DEFAULTS, name)
            if not is_variable_name(name):
                message = f"{name!r} is not a valid variable name"
                hint = "use letters, digits and _, and do not start with a digit"
                self.document.add("SCN032", location, message, hint)
                continue
            self.with_default.add(name)
            if name in self.values:
                continue
            written_values = self.document.written(location)
            text = self.resolved(
                location, str(value) if written_values is None else written_values
            )
            if text is None or isinstance(value, dict | list) or value is None:
                self.faulty.add(name)
            else:
                self.values[name] = text
                if self.uses.get(location, set()) & self.parts:
                    self.parts.add(name)

    def effective(self) -> frozenset[str]:
        """Return the variables that affect more than the output's name."""
        output_only = {
            name
            for key, names in self.uses.items()
            if key[0] not in {DEFAULTS, OUTPUT}
            for name in names
        }
        used_names: set[str] = set()
        while output_only:
            name = output_only.pop()
            used_names.add(name)
            output_only |= self.uses.get((DEFAULTS, name), set()) - used_names
        return frozenset(used_names)

    def put(self, location: Location, text: str) -> None:
        """Substitute variables in one text of the document."""
        resolved_text = self.resolved(location, text)
        if resolved_text is not None and (location[0], location[-1]) in WRITTEN:
            resolved_text = self.output_name(location, text, resolved_text)
        value: Any = resolved_text
        if resolved_text is not None and self.is_typed(location, text):
            try:
                value = plain_scalar(resolved_text)
            except OverflowError:
                self.document.add("DOC001", location, "a number with too many digits")
                resolved_text = None
        if resolved_text is None:
            annotation = annotation_at(self.model, self.document.value, location)
            value = placeholder_of(annotation)
            self.document.doubts.add(location)
        replaced(self.document.value, location, value)

    def output_name(self, location: Location, text: str, spelling: str) -> str | None:
        """Return an output's name; None and a fault if it is unsafe."""
        for component in text.split("/"):
            used_names = {
                match["name"] for match in _USE.finditer(component) if match["name"]
            }
            if not used_names & self.parts:
                continue
            name = self.resolved(location, component) or ""
            problem = name_problem(name)
            if problem is not None:
                message = f"{excerpt(component)} is {excerpt(name)}, which {problem}"
                hint = "a value from another file can be part of one file name only"
                self.document.add("OUT006", location, message, hint)
                return None
        return spelling

    def is_typed(self, location: Location, text: str) -> bool:
        """Return whether a text may become a number or boolean.

        It is unquoted, or a single variable where text is not allowed.
        """
        if self.document.written(location) is not None:
            return True
        use = _USE.fullmatch(text)
        if use is None or not use["name"]:
            return False
        kind = annotation_at(self.model, self.document.value, location)
        return kind is not None and takes_no_text(kind)

    def resolved(self, location: Location, text: str) -> str | None:
        """Return a text with its variables substituted; None on a fault."""
        pieces: list[str] = []
        complete, end, length = True, 0, 0
        for use in _USE.finditer(text):
            piece = self._value(location, use)
            length += len(piece or "")
            if length > LONGEST:
                message = f"variables expand to more than {LONGEST} characters"
                self.document.add("DOC025", location, message)
                return None
            complete &= piece is not None
            pieces += [text[end : use.start()], piece or ""]
            end = use.end()
        return "".join([*pieces, text[end:]]) if complete else None

    def _value(self, location: Location, match: re.Match[str]) -> str | None:
        """Return the value of a variable; None and a fault if it is unknown."""
        if match["kept"]:
            return match[0][1:]
        name = match["name"]
        if name is None:
            message = "a ${ is not followed by a name and }"
            hint = "write ${name}, or $${ for the literal characters"
            self.document.add("SCN032", location, message, hint)
            return None
        key = location[:2] if location[0] == DEFAULTS else location[:1]
        self.uses.setdefault(key, set()).add(name)
        if name not in self.values and name not in self.faulty:
            message = f"unknown variable {name!r}"
            hint = f"give it a value under {DEFAULTS}:"
            hint += clause(f", or with {argument('set', f'{name}=VALUE')}")
            similar_names = most_similar(name, sorted(self.values))
            hint = f"did you mean {similar_names!r}?" if similar_names else hint
            self.document.add("SCN030", location, message, hint)
        return self.values.get(name)
