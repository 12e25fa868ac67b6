"""Variables in the text of a document, ``${name}``, with defaults in the file."""

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
    excludes_text,
    placeholder_of,
    set_value_at,
)
from animtool.documents.yaml_values import plain_scalar

# Key of the variables' default values.
DEFAULTS_KEY = "variables"
# Key of a document's output.
OUTPUT_KEY = "output"
# First and last key of output paths.
OUTPUT_PATH_KEYS = frozenset({(OUTPUT_KEY, "file"), ("passes", "save")})
# Longest text [character]: longer than any path or number.
MAX_TEXT_LENGTH = 10_000
# `$$` is an escaped dollar.
_VARIABLE_USE = re.compile(rf"\$(?P<escape>\$)?\{{(?:(?P<name>{VARIABLE_NAME})\}})?")


@dataclass(frozen=True, slots=True)
class SceneValues:
    """Values that another file sets for the variables of a scene."""

    # Values by variable name; they override the scene's.
    values: Mapping[str, str] = field(default_factory=dict)
    # Variables that must be a single path component in output names.
    component_names: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Variables:
    """The names of a document's variables, and which of them have an effect."""

    names: frozenset[str] = frozenset()  # variables it uses or defines
    # Variables with a value that no text uses.
    unused_names: frozenset[str] = frozenset()
    # Variables that affect more than the key ``output``.
    effective_names: frozenset[str] = frozenset()


def resolve_variables(
    document: Document,
    model: type[BaseModel],
    variables: Mapping[str, str],
    component_names: Collection[str] = (),
) -> Variables:
    """Substitute the variables in all values of a document; keys stay unchanged.

    Unquoted text is parsed again after substitution, so it may become a number; so may
    a quoted variable where text is not allowed. A default may use variables defined
    above it and those passed in. A placeholder replaces each faulty value. Faults are
    unknown names (SCN030), a malformed ``${`` or invalid name (SCN032), and values that
    are unsafe in an output's name (OUT006).

    Args:
        document: The document, changed in place.
        model: Model of the document.
        variables: Values by name; they override the document's.
        component_names: Names of variables that must be a single component of an output
            path, without a slash.
    """
    resolver = _Resolver(
        document,
        model,
        dict(variables),
        component_names=set(component_names),
        outside_names=frozenset(variables),
    )
    resolver.read_defaults()
    for location, text in list(_variable_texts(document.value, ())):
        if location[0] != DEFAULTS_KEY:
            resolver.substitute_at(location, text)
    defined_names = frozenset(resolver.defined_names)
    used_names = frozenset().union(*resolver.uses.values())
    names, unused_names = defined_names | used_names, defined_names - used_names
    return Variables(names, unused_names, resolver.effective_names())


# JSON Schema of a variable: text that becomes another type.
_VARIABLE_TEXT = {"type": "string", "pattern": rf"\$\{{{VARIABLE_NAME}\}}"}
# Schema keywords that describe a value's type, not its meaning.
_TYPE_KEYWORDS = frozenset(
    {"type", "enum", "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"}
)


def with_variables(schema: Any) -> Any:
    """Return a JSON Schema that accepts a variable wherever it accepts a value.

    >>> with_variables({"type": "number", "minimum": 0})["anyOf"][0]
    {'type': 'number', 'minimum': 0}
    """
    if isinstance(schema, list):
        return [with_variables(entry) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    extended_schema = {key: _inner_schema(key, value) for key, value in schema.items()}
    if "anyOf" not in schema and _excludes_text(schema):
        type_keys = [key for key in extended_schema if key in _TYPE_KEYWORDS]
        type_keywords = {key: extended_schema.pop(key) for key in type_keys}
        extended_schema["anyOf"] = [type_keywords, _VARIABLE_TEXT]
    return extended_schema


def _inner_schema(key: str, value: Any) -> Any:
    if key in {"properties", "$defs"}:
        return {name: with_variables(entry) for name, entry in value.items()}
    return value if key in {"default", "examples"} else with_variables(value)


def _excludes_text(schema: dict[str, Any]) -> bool:
    """Return whether a schema allows only numbers, booleans or fixed values."""
    return "enum" in schema or schema.get("type") in {"number", "integer", "boolean"}


def _variable_texts(node: Any, location: Location) -> Iterator[tuple[Location, str]]:
    """Yield each text of a document that may use a variable, with its location."""
    if isinstance(node, str):
        if "${" in node:
            yield location, node
    elif isinstance(node, dict):
        for key, value in node.items():
            yield from _variable_texts(value, (*location, key))
    elif isinstance(node, list):
        for i, value in enumerate(node):
            yield from _variable_texts(value, (*location, i))


@dataclass(slots=True)
class _Resolver:
    """Substitutes variables in the texts of a document."""

    document: Document  # changed in place
    model: type[BaseModel]  # expected model
    values: dict[str, str]  # known variables and their values
    # Variables with a value in the document.
    defined_names: set[str] = field(default_factory=set)
    # Variables used by texts, by key of the document; inside the values of variables
    # also by the variable's name.
    uses: dict[Location, set[str]] = field(default_factory=dict)
    # Variables with a faulty value.
    faulty_names: set[str] = field(default_factory=set)
    # Variables whose value another file sets, directly or through other variables.
    component_names: set[str] = field(default_factory=set)
    # Variables whose value is set from outside the document.
    outside_names: frozenset[str] = frozenset()

    def read_defaults(self) -> None:
        """Read the default values of variables; each may use the ones before it."""
        default_values = self.document.value.get(DEFAULTS_KEY)
        if not isinstance(default_values, dict):
            return
        for name, value in default_values.items():
            location = (DEFAULTS_KEY, name)
            if not is_variable_name(name):
                message = f"{name!r} is not a valid variable name"
                hint = "use letters, digits and _, and do not start with a digit"
                self.document.add("SCN032", location, message, hint)
                continue
            self.defined_names.add(name)
            if name in self.values:
                continue
            source_text = self.document.source_text(location)
            default_text = str(value) if source_text is None else source_text
            text = self.expand_text(location, default_text)
            if text is None or isinstance(value, dict | list) or value is None:
                self.faulty_names.add(name)
            else:
                self.values[name] = text
                if self.uses.get(location, set()) & self.component_names:
                    self.component_names.add(name)

    def effective_names(self) -> frozenset[str]:
        """Return the variables that affect more than the name of the output."""
        pending_names = {
            name
            for key, names in self.uses.items()
            if key[0] not in {DEFAULTS_KEY, OUTPUT_KEY}
            for name in names
        }
        used_names: set[str] = set()
        while pending_names:
            name = pending_names.pop()
            used_names.add(name)
            pending_names |= self.uses.get((DEFAULTS_KEY, name), set()) - used_names
        return frozenset(used_names)

    def substitute_at(self, location: Location, text: str) -> None:
        """Substitute variables in the text at a location, and parse the result."""
        resolved_text = self.expand_text(location, text)
        is_output_path = (location[0], location[-1]) in OUTPUT_PATH_KEYS
        if resolved_text is not None and is_output_path:
            resolved_text = self.safe_output_name(location, text, resolved_text)
        value: Any = resolved_text
        if resolved_text is not None and self.may_be_typed(location, text):
            try:
                value = plain_scalar(resolved_text)
            except OverflowError:
                self.document.add("DOC001", location, "a number with too many digits")
                resolved_text = None
        if resolved_text is None:
            annotation = annotation_at(self.model, self.document.value, location)
            value = placeholder_of(annotation)
            self.document.placeholders.add(location)
        set_value_at(self.document.value, location, value)
        names = {use["name"] for use in _VARIABLE_USE.finditer(text)}
        outside_names = sorted(names & self.outside_names)
        if outside_names:
            self.document.outside_values[location] = {
                name: self.values[name] for name in outside_names
            }

    def safe_output_name(
        self, location: Location, text: str, resolved_text: str
    ) -> str | None:
        """Return an output path, or None after recording that it is unsafe."""
        for component in text.split("/"):
            used_names = {match["name"] for match in _VARIABLE_USE.finditer(component)}
            if not used_names & self.component_names:
                continue
            name = self.expand_text(location, component) or ""
            problem = name_problem(name)
            if problem is not None:
                message = f"{excerpt(component)} is {excerpt(name)}, which {problem}"
                hint = "a value from another file can be part of one file name only"
                self.document.add("OUT006", location, message, hint)
                return None
        return resolved_text

    def may_be_typed(self, location: Location, text: str) -> bool:
        """Return whether a text may become a number or boolean.

        It is unquoted, or a single variable where text is not allowed.
        """
        if self.document.source_text(location) is not None:
            return True
        use = _VARIABLE_USE.fullmatch(text)
        if use is None or not use["name"]:
            return False
        annotation = annotation_at(self.model, self.document.value, location)
        return annotation is not None and excludes_text(annotation)

    def expand_text(self, location: Location, text: str) -> str | None:
        """Substitute the variables of a text; return None after recording a fault."""
        text_pieces: list[str] = []
        is_complete, use_end, length = True, 0, 0
        for use in _VARIABLE_USE.finditer(text):
            value_text = self._variable_value(location, use)
            length += len(value_text or "")
            if length > MAX_TEXT_LENGTH:
                message = f"variables expand to more than {MAX_TEXT_LENGTH} characters"
                self.document.add("DOC025", location, message)
                return None
            is_complete &= value_text is not None
            text_pieces += [text[use_end : use.start()], value_text or ""]
            use_end = use.end()
        return "".join([*text_pieces, text[use_end:]]) if is_complete else None

    def _variable_value(self, location: Location, use: re.Match[str]) -> str | None:
        """Return the text that replaces a use; None after recording an unknown one."""
        if use["escape"]:
            return use[0][1:]
        name = use["name"]
        if name is None:
            message = "a ${ is not followed by a name and }"
            hint = "write ${name}, or $${ for the literal characters"
            self.document.add("SCN032", location, message, hint)
            return None
        key = location[:2] if location[0] == DEFAULTS_KEY else location[:1]
        self.uses.setdefault(key, set()).add(name)
        if name not in self.values and name not in self.faulty_names:
            message = f"unknown variable {name!r}"
            hint = f"give it a value under {DEFAULTS_KEY}:"
            hint += clause(f", or with {argument('set', f'{name}=VALUE')}")
            similar_name = most_similar(name, sorted(self.values))
            hint = f"did you mean {similar_name!r}?" if similar_name else hint
            self.document.add("SCN030", location, message, hint)
        return self.values.get(name)
