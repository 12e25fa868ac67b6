"""Every template of a report, against the record that it is of."""

from __future__ import annotations

import ast
import importlib
import re
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import pytest

import animtool
from animtool.core.plugins import load_object
from animtool.core.values import JsonKey, parse_template
from animtool.report import text
from animtool.report.text import Each, Line, Table, Template, render

ANY = object()  # a type that says nothing of its fields
KEY, NUMBER, LEFT = {"key": str, "value": ANY}, {"number": int}, {"left": int}


@cache
def _modules() -> list[Any]:
    """Return the modules that have templates, or records with keys of their own."""
    root = Path(animtool.__file__).parent
    return [
        importlib.import_module(".".join(path.relative_to(root.parent).parts)[:-3])
        for path in sorted(root.rglob("*.py"))
        if re.search(r"Template\(|json_keys", path.read_text())
    ]


def _templates() -> list[tuple[str, Template]]:
    templates = {}
    for module in _modules():
        for name, value in vars(module).items():
            parts = value.items() if isinstance(value, dict) else [("", value)]
            for key, own in parts:
                if isinstance(own, Template):
                    label = f"{module.__name__}:{name}{key and f'.{key}'}"
                    templates.setdefault(id(own), (label, own))
    return list(templates.values())


def _records() -> list[type]:
    records = {
        value
        for module in _modules()
        for value in vars(module).values()
        if isinstance(value, type)
        and value.__module__.startswith("animtool")
        and isinstance(getattr(value, "json_keys", None), str)
    }
    return sorted(records, key=lambda record: (record.__module__, record.__qualname__))


@cache
def _names(module: str) -> dict[str, Any]:
    """Return the names of a module, those for type checkers alone too."""
    loaded = importlib.import_module(module)
    names = {**vars(typing), **vars(loaded)}
    if not module.startswith("animtool"):
        return names
    for node in ast.parse(Path(str(loaded.__file__)).read_text()).body:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            for line in node.body:
                if isinstance(line, ast.ImportFrom):
                    exec(ast.unparse(line), names)
                    for alias in line.names:
                        known = names[alias.asname or alias.name]
                        if isinstance(known, str):
                            value = _evaluated(known, _names(str(line.module)))
                            names[alias.asname or alias.name] = value
    return names


def _hints(owner: Any) -> dict[str, Any]:
    """Return the types that annotations name."""
    found: dict[str, Any] = {}
    for own in reversed(owner.__mro__) if isinstance(owner, type) else [owner]:
        if own.__module__ != "builtins":
            names = _names(own.__module__)
            known = getattr(own, "__annotations__", {})
            found |= {n: _evaluated(value, names) for n, value in known.items()}
    return found


def _evaluated(kind: Any, names: dict[str, Any]) -> Any:
    while isinstance(kind, str):
        kind = eval(kind, names)
    return kind


@cache
def _fields(record: Any) -> dict[str, Any]:
    """Return the types of fields and properties of a class."""
    types_by_name = dict(_hints(record))
    for base in record.__mro__:
        for name, value in vars(base).items():
            if isinstance(value, property):
                assert value.fget is not None
                types_by_name.setdefault(name, _hints(value.fget)["return"])
            elif isinstance(value, cached_property):
                types_by_name.setdefault(name, _hints(value.func)["return"])
            elif isinstance(value, types.MemberDescriptorType):
                types_by_name.setdefault(name, ANY)
    return types_by_name


def _options(kind: Any) -> list[Any]:
    """Return the types that a value may have, None left out."""
    if typing.get_origin(kind) in {typing.Union, types.UnionType}:
        return [each for own in typing.get_args(kind) for each in _options(own)]
    return [] if kind is type(None) else [kind]


def _field(kind: Any, name: str) -> list[Any]:
    """Return the types of a field of a value.

    Raises:
        AttributeError: Some type that it may have lacks the field.
    """
    found = []
    for own in _options(kind):
        if isinstance(own, dict):
            if name not in own:
                raise AttributeError(name)
            found.append(own[name])
        elif (
            own in {ANY, Any, object}
            or isinstance(own, typing.TypeVar)
            or (isinstance(own, type) and issubclass(own, BaseException))
        ):
            found.append(ANY)
        elif issubclass(typing.get_origin(own) or own, Mapping):
            arguments = typing.get_args(own)
            found.append(arguments[1] if arguments else ANY)
        elif name in (fields := _fields(typing.get_origin(own) or own)):
            found.append(fields[name])
        elif not hasattr(own, name):
            raise AttributeError(f"{getattr(own, '__name__', own)} has no {name!r}")
        else:
            found.append(ANY)
    return found


def _at(kinds: list[Any], path: str) -> list[Any]:
    for name in filter(None, path.split(".")):
        kinds = [found for kind in kinds for found in _field(kind, name)]
    return kinds


def _entries(kind: Any) -> list[Any]:
    """Return the types of the entries of a list or a mapping."""
    found: list[Any] = []
    for own in _options(kind):
        origin, arguments = typing.get_origin(own), typing.get_args(own)
        if origin is not None and issubclass(origin, Mapping):
            found.append({"key": arguments[0], "value": arguments[1]})
        elif origin is not None and issubclass(origin, Sequence) and arguments:
            found.append(arguments[0])
        else:
            found.append(ANY)
    return found


def _result(printer: Callable[..., Any]) -> Any:
    """Return the type of what a printer returns."""
    try:
        return _hints(printer).get("return", ANY)
    except (AttributeError, TypeError):
        return ANY


class _Checker:
    """Looks up the names of a template."""

    def __init__(self, template: Template) -> None:
        self.printers = {**text.DEFAULT_PRINTERS, **template.printers, "names": str}

    def lines(self, scope: tuple[Any, ...], lines: Sequence[Line]) -> None:
        for line in lines:
            if isinstance(line, str):
                self._part(scope, text._parse_template(line))
                continue
            name, _, spec = line.name.partition(":")
            kinds = self._value(scope, name)
            if spec:
                kinds = [_result(self.printers[spec])]
            entries = [one for kind in kinds for one in _entries(kind)] or [ANY]
            for entry in entries:
                inner = (entry, NUMBER, *scope)
                if isinstance(line, Table):
                    self.lines(inner, list(line.columns.values()))
                else:
                    self.lines(inner, line.lines)
                    self.lines((LEFT, *scope), (line.omitted,))

    def _part(self, scope: tuple[Any, ...], nodes: tuple[Any, ...]) -> None:
        for node in nodes:
            if isinstance(node, text._Alternatives):
                for part in node.parts:
                    self._part(scope, part)
            elif isinstance(node, text._Field):
                self._value(scope, node.name)

    def _value(self, scope: tuple[Any, ...], name: str) -> list[Any]:
        first, _, others = name.partition(".")
        if first == "self":
            return _at([scope[0]], others)
        for kind in scope:
            if kind is ANY or kind is Any:
                return [ANY]
            try:
                found = _field(kind, first)
            except AttributeError:
                continue
            return _at(found, others)
        raise AttributeError(f"no record has {name!r}")


TEMPLATES = _templates()
RECORDS = _records()


def test_there_are_templates_and_records() -> None:
    assert len(TEMPLATES) > 15
    assert len(RECORDS) > 30


@pytest.mark.parametrize(("name", "template"), TEMPLATES, ids=[n for n, _ in TEMPLATES])
def test_names_of_a_template_are_fields(name: str, template: Template) -> None:
    record = load_object(template.record)
    assert is_dataclass(record), name
    checker = _Checker(template)
    checker.lines((record,), template.lines)
    checker.lines((record,), template.details)


@pytest.mark.parametrize("record", RECORDS, ids=[r.__qualname__ for r in RECORDS])
def test_keys_of_a_report_are_fields(record: Any) -> None:
    _check_keys([record], parse_template(record.json_keys))


def _check_keys(kinds: list[Any], keys: tuple[JsonKey, ...]) -> None:
    for key in keys:
        found = _at(kinds, key.path)
        if key.keys is None:
            continue
        entries = []
        for kind in (own for each in found for own in _options(each)):
            origin = typing.get_origin(kind)
            many = origin is not None and issubclass(origin, list | tuple | Sequence)
            entries += _entries(kind) if many else [kind]
        _check_keys(entries, key.keys)


class _Part:
    """A record of one field."""

    name: str = "hips"


@pytest.mark.parametrize(
    "line", ["{nmae}", "[{?nmae}x]", "[{name.size}|y]", Each("joints", ("x",))]
)
def test_a_misspelt_name_is_found(line: Line) -> None:
    template = Template("animtool.core.errors:Fault", (line,))
    with pytest.raises(AttributeError):
        _Checker(template).lines((_Part,), template.lines)
    with pytest.raises(AttributeError):
        render(_Part(), [line])


def test_a_misspelt_key_is_found() -> None:
    with pytest.raises(AttributeError):
        _check_keys([_Part], parse_template("name size"))
