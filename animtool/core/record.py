"""A record decorator like `dataclasses.dataclass`, without generated code.

The decorator of the standard library generates the source of each class's methods and
compiles it, about 0.4 ms per class; a command loads some hundred. These methods are
closures over the field names. Everything else is the same: `fields`, `replace`,
`asdict`, pickling, `match`, and subclasses decorated by either.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import MISSING, Field, FrozenInstanceError, field
from operator import attrgetter
from types import FunctionType, MemberDescriptorType, SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar, get_origin

if TYPE_CHECKING:
    # For type checkers, this is the decorator of the standard library.
    from dataclasses import dataclass as dataclass  # noqa: PLC0414  # exports it
else:

    def dataclass(
        cls=None, /, *, frozen=False, slots=False, eq=True, repr=True, kw_only=False
    ):
        """Return a class as a record of its annotated fields, or a decorator for that.

        Args:
            cls: The class, when used without arguments.
            frozen: Whether instances are read-only; then they have a hash, if equal.
            slots: Whether they have no ``__dict__``.
            eq: Whether two with equal fields are equal.
            repr: Whether their text lists the fields.
            kw_only: Whether fields are given by name only.

        >>> from dataclasses import replace
        >>> @dataclass(frozen=True, slots=True)
        ... class Span:
        ...     first: int
        ...     last: int = 9
        >>> replace(Span(2), first=3)
        Span(first=3, last=9)
        """
        params = SimpleNamespace(
            init=True, repr=repr, eq=eq, order=False, unsafe_hash=False,
            frozen=frozen, match_args=True, kw_only=kw_only, slots=slots,
            weakref_slot=False,
        )  # fmt: skip
        if cls is None:
            return lambda decorated_class: _record(decorated_class, params)
        return _record(cls, params)


def _record(cls: type[Any], params: Any) -> type[Any]:
    """Add the methods of a record to a class; with slots, to a copy of it."""
    declared_fields: dict[str, Field[Any]] = {}
    for base in cls.__mro__[-1:0:-1]:
        declared_fields.update(getattr(base, "__dataclass_fields__", {}))
    for name, type_ in inspect.get_annotations(cls).items():
        if not _is_class_variable(type_):
            declared_fields[name] = _declared_field(cls, name, type_, params.kw_only)
    # Fields of a frozen record without slots are filled in at once.
    stores_in_dict = params.frozen and not params.slots and not _inherited_slots(cls)
    methods = _record_methods(
        declared_fields, params, hasattr(cls, "__post_init__"), stores_in_dict
    )
    attributes = vars(cls)
    if params.eq and "__hash__" not in attributes:
        methods["__hash__"] = methods["__hash__"] if params.frozen else None
    elif (
        not params.eq
        or attributes["__hash__"] is not None
        or "__eq__" not in attributes
    ):
        methods.pop("__hash__", None)
    methods_to_add = {
        name: method
        for name, method in methods.items()
        if name not in attributes or name == "__hash__"
    }
    for name, method in methods_to_add.items():
        if isinstance(method, FunctionType):
            method.__qualname__ = f"{cls.__qualname__}.{name}"
            method.__module__ = cls.__module__
    methods_to_add["__dataclass_fields__"] = declared_fields
    methods_to_add["__dataclass_params__"] = params
    if params.slots:
        return _class_with_slots(cls, declared_fields, methods_to_add)
    for name, method in methods_to_add.items():
        setattr(cls, name, method)
    return cls


def _is_class_variable(type_: Any) -> bool:
    if isinstance(type_, str):
        return type_.startswith(("ClassVar", "typing.ClassVar"))
    return type_ is ClassVar or get_origin(type_) is ClassVar


def _declared_field(cls: type[Any], name: str, type_: Any, kw_only: bool) -> Any:
    """Return the field of an annotation; a default stays on the class."""
    default = getattr(cls, name, MISSING)
    if isinstance(default, Field):
        entry: Any = default
        if entry.default is MISSING:
            delattr(cls, name)
        else:
            setattr(cls, name, entry.default)
    elif isinstance(default, MemberDescriptorType):
        entry = field()
    else:
        entry = field(default=default)
    if type(entry.default).__hash__ is None:
        default_type = type(entry.default)
        message = f"mutable default {default_type} of {name}: use default_factory"
        raise ValueError(message)
    entry.name, entry.type = name, type_
    entry._field_type = _FIELD  # as required by `fields` and `replace`
    if entry.kw_only is MISSING:
        entry.kw_only = kw_only
    return entry


# Marker of `dataclasses` for instance fields.
_FIELD: Any = vars(dataclasses)["_FIELD"]


def _record_methods(
    declared_fields: Mapping[str, Field[Any]],
    params: Any,
    has_post_init: bool,
    stores_in_dict: bool,
) -> dict[str, Any]:
    """Return the methods for the fields and parameters of a record, by name.

    has_post_init: Whether it has a ``__post_init__``.
    stores_in_dict: Whether all fields are in the ``__dict__``.
    """
    record_fields = declared_fields.values()
    positional_names = tuple(e.name for e in record_fields if e.init and not e.kw_only)
    methods: dict[str, Any] = {
        "__init__": _initializer(
            record_fields,
            positional_names,
            params.frozen,
            has_post_init,
            stores_in_dict,
        ),
        "__signature__": _Signature(),
        "__match_args__": positional_names,
    }
    if params.repr:
        methods["__repr__"] = _repr_method([e.name for e in record_fields if e.repr])
    if params.eq:
        hash_fields = [
            e for e in record_fields if (e.compare if e.hash is None else e.hash)
        ]
        methods["__eq__"] = _eq_method([e.name for e in record_fields if e.compare])
        methods["__hash__"] = _hash_method([e.name for e in hash_fields])
    if params.frozen:
        methods["__setattr__"], methods["__delattr__"] = _frozen_methods(
            frozenset(declared_fields)
        )
    if params.frozen and params.slots:
        methods["__getstate__"], methods["__setstate__"] = _pickle_methods(
            tuple(declared_fields)
        )
    return methods


def _initializer(
    record_fields: Collection[Field[Any]],
    positional_names: tuple[str, ...],
    frozen: bool,
    has_post_init: bool,
    stores_in_dict: bool,
) -> Callable[..., None]:
    """Return the ``__init__`` that sets fields from arguments, else from defaults."""
    defaults = {e.name: e.default for e in record_fields if e.default is not MISSING}
    factories = [
        (e.name, e.default_factory)
        for e in record_fields
        if e.default_factory is not MISSING
    ]
    settable_names = {e.name for e in record_fields if e.init or e.name in defaults}
    settable_names.update(name for name, _ in factories)
    unset_names = [e.name for e in record_fields if not e.init]
    # If all fields may be positional: the minimum number, and defaults of the others.
    trailing_defaults = tuple(defaults[n] for n in positional_names if n in defaults)
    all_positional = settable_names == set(positional_names)
    max_positional = len(positional_names) if all_positional else -1
    min_positional = max_positional - (0 if factories else len(trailing_defaults))
    set_field: Callable[[Any, str, Any], None] = (
        object.__setattr__ if frozen else setattr
    )

    def __init__(self: Any, /, *positional: Any, **keywords: Any) -> None:  # noqa: N807
        positional_count = len(positional)
        if min_positional <= positional_count <= max_positional and not keywords:
            if positional_count < max_positional:
                positional += trailing_defaults[positional_count - min_positional :]
            if stores_in_dict:
                self.__dict__.update(zip(positional_names, positional))  # noqa: B905
            else:
                for name, value in zip(positional_names, positional):  # noqa: B905
                    set_field(self, name, value)
        else:
            values = (
                defaults
                | dict(zip(positional_names, positional, strict=False))
                | keywords
            )
            for name, factory in factories:
                if name not in values:
                    values[name] = factory()
            if (
                len(positional) > len(positional_names)
                or values.keys() != settable_names
                or not keywords.keys().isdisjoint(unset_names)
                or not keywords.keys().isdisjoint(positional_names[:positional_count])
            ):
                _raise_argument_error(self, positional, keywords)
            for name, value in values.items():
                set_field(self, name, value)
        if has_post_init:
            self.__post_init__()

    return __init__


def _raise_argument_error(
    record: Any, positional: tuple[Any, ...], keyword_arguments: Mapping[str, Any]
) -> None:
    """Raise the error that Python raises for arguments that do not fit."""
    record_type = type(record)
    try:
        _signature(record_type).bind(*positional, **keyword_arguments)
    except TypeError as error:
        message = f"{record_type.__qualname__}.__init__(): {error}"
        hint = _field_name_hint(record_type, keyword_arguments)
        raise TypeError(f"{message}{hint}") from None


# Fields by the names that other tools use for them.
_OTHER_NAMES = {
    "frame_rate": "fps",
    "framerate": "fps",
    "rate": "fps",
    "frames": "frame_range",
    "range": "frame_range",
    "force": "overwrite",
    "units": "unit",
}


def _field_name_hint(record_type: type[Any], names: Collection[str]) -> str:
    """Return a hint with the field that an unknown argument means; "" if unclear."""
    from difflib import get_close_matches  # every command imports this module

    known_names = _signature(record_type).parameters
    unknown_name = next((name for name in names if name not in known_names), None)
    if unknown_name is None:
        return ""
    intended_name: str | None = _OTHER_NAMES.get(unknown_name)
    if intended_name not in known_names:
        intended_name = next(
            iter(get_close_matches(unknown_name, known_names, 1)), None
        )
    return f"; did you mean {intended_name!r}?" if intended_name else ""


def _signature(record_type: type[Any]) -> inspect.Signature:
    parameters = []
    for entry in record_type.__dataclass_fields__.values():
        if entry.init:
            default: Any = inspect.Parameter.empty
            if entry.default is not MISSING:
                default = entry.default
            elif entry.default_factory is not MISSING:
                default = _FactoryDefault()
            parameter_kind: Any = inspect.Parameter.POSITIONAL_OR_KEYWORD
            if entry.kw_only:
                parameter_kind = inspect.Parameter.KEYWORD_ONLY
            parameter = inspect.Parameter(
                entry.name, parameter_kind, default=default, annotation=entry.type
            )
            parameters.append(parameter)
    parameters.sort(key=lambda parameter: parameter.kind)
    return inspect.Signature(parameters, return_annotation=None)


class _FactoryDefault:
    """Displayed default of a field that has a default factory."""

    def __repr__(self) -> str:
        return "<factory>"


class _Signature:
    """Descriptor of the signature of a record, which is built when accessed."""

    def __get__(self, instance: object, owner: type[Any]) -> inspect.Signature:
        if instance is not None:
            raise AttributeError("__signature__")
        return _signature(owner)


def _value_getter(names: list[str]) -> Callable[[Any], Any]:
    """Return a function that gets field values of a record as a comparable value."""
    if names:
        return attrgetter(*names)
    return lambda _: ()


def _eq_method(names: list[str]) -> Callable[[Any, Any], Any]:
    values = _value_getter(names)

    def __eq__(self: Any, other: object) -> Any:  # noqa: N807
        if other.__class__ is not self.__class__:
            return NotImplemented
        # In a tuple, identical objects are equal, such as a NaN and itself.
        return (values(self),) == (values(other),)

    return __eq__


def _hash_method(names: list[str]) -> Callable[[Any], int]:
    values = _value_getter(names)

    def __hash__(self: Any) -> int:  # noqa: N807
        return hash(values(self) if len(names) > 1 else (values(self),))

    return __hash__


def _repr_method(names: list[str]) -> Callable[[Any], str]:
    def __repr__(self: Any) -> str:  # noqa: N807
        record_type = type(self)
        # A record that contains itself through a list would recurse forever.
        if id(self) in _RECORDS_IN_REPR:
            return "..."
        _RECORDS_IN_REPR.add(id(self))
        try:
            fields_text = ", ".join(f"{name}={getattr(self, name)!r}" for name in names)
        finally:
            _RECORDS_IN_REPR.discard(id(self))
        return f"{record_type.__qualname__}({fields_text})"

    return __repr__


_RECORDS_IN_REPR: set[int] = set()


def _frozen_methods(
    names: frozenset[str],
) -> tuple[Callable[[Any, str, Any], None], Callable[[Any, str], None]]:
    """Return the ``__setattr__`` and ``__delattr__`` of a frozen record."""

    def __setattr__(self: Any, name: str, value: Any) -> None:  # noqa: N807
        if name in names or not hasattr(self, "__dict__"):
            raise FrozenInstanceError(f"cannot assign to field {name!r}")
        object.__setattr__(self, name, value)

    def __delattr__(self: Any, name: str) -> None:  # noqa: N807
        if name in names or not hasattr(self, "__dict__"):
            raise FrozenInstanceError(f"cannot delete field {name!r}")
        object.__delattr__(self, name)

    return __setattr__, __delattr__


def _pickle_methods(
    names: tuple[str, ...],
) -> tuple[Callable[[Any], list[Any]], Callable[[Any, list[Any]], None]]:
    """Return the pickling methods of a frozen record with slots."""

    def __getstate__(self: Any) -> list[Any]:  # noqa: N807
        return [getattr(self, name) for name in names]

    def __setstate__(self: Any, state: list[Any]) -> None:  # noqa: N807
        for name, value in zip(names, state, strict=True):
            object.__setattr__(self, name, value)

    return __getstate__, __setstate__


def _inherited_slots(cls: type[Any]) -> set[str]:
    """Return the names of the slots that a class inherits."""
    return {
        name for base in cls.__mro__[1:-1] for name in vars(base).get("__slots__", ())
    }


def _class_with_slots(
    cls: type[Any], declared_fields: Iterable[str], methods_to_add: Mapping[str, Any]
) -> type[Any]:
    """Return a copy of a class with slots for its fields that no base has slots for."""
    inherited_names = _inherited_slots(cls)
    namespace = {**vars(cls), **methods_to_add}
    for name in (*declared_fields, "__dict__", "__weakref__"):
        namespace.pop(name, None)
    namespace["__slots__"] = tuple(
        name for name in declared_fields if name not in inherited_names
    )
    metaclass: Any = type(cls)
    slotted_class: type[Any] = metaclass(cls.__name__, cls.__bases__, namespace)
    slotted_class.__qualname__ = cls.__qualname__
    return slotted_class
