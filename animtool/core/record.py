"""A record decorator like `dataclasses.dataclass`, without generated code.

The one of the standard library writes the methods of each class as text and compiles
it, about 0.4 ms a class; a command loads some hundred. These methods are closures over
the names of the fields. All else is the same: `fields`, `replace`, `asdict`, pickles,
`match`, and a subclass may be decorated by either.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, Field, FrozenInstanceError, field
from operator import attrgetter
from types import FunctionType, MemberDescriptorType, SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar, get_origin

if TYPE_CHECKING:
    # Type checkers know the effect of that decorator; this one has the same.
    from dataclasses import dataclass as dataclass  # noqa: PLC0414  # exports it
else:

    def dataclass(
        cls=None, /, *, frozen=False, slots=False, eq=True, repr=True, kw_only=False
    ):
        """Return a class as a record of its annotated fields, or the decorator.

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
        flags = SimpleNamespace(
            init=True, repr=repr, eq=eq, order=False, unsafe_hash=False,
            frozen=frozen, match_args=True, kw_only=kw_only, slots=slots,
            weakref_slot=False,
        )  # fmt: skip
        if cls is None:
            return lambda decorated: _record(decorated, flags)
        return _record(cls, flags)


def _record(cls: type[Any], flags: Any) -> type[Any]:
    """Return a class with the methods of a record."""
    declared: dict[str, Field[Any]] = {}
    for base in cls.__mro__[-1:0:-1]:
        declared.update(getattr(base, "__dataclass_fields__", {}))
    for name, type_ in inspect.get_annotations(cls).items():
        if not _is_class_variable(type_):
            declared[name] = _declared_field(cls, name, type_, flags.kw_only)
    methods = _methods(declared, flags, hasattr(cls, "__post_init__"))
    attributes = vars(cls)
    if flags.eq and "__hash__" not in attributes:
        methods["__hash__"] = methods["__hash__"] if flags.frozen else None
    elif (
        not flags.eq or attributes["__hash__"] is not None or "__eq__" not in attributes
    ):
        methods.pop("__hash__", None)
    added = {name: each for name, each in methods.items() if name not in attributes}
    if "__hash__" in methods:
        added["__hash__"] = methods["__hash__"]
    for name, each in added.items():
        if isinstance(each, FunctionType):
            each.__qualname__ = f"{cls.__qualname__}.{name}"
            each.__module__ = cls.__module__
    added["__dataclass_fields__"] = declared
    added["__dataclass_params__"] = flags
    if flags.slots:
        return _slotted(cls, declared, added)
    for name, each in added.items():
        setattr(cls, name, each)
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
        kind = type(entry.default)
        raise ValueError(f"mutable default {kind} of {name}: use default_factory")
    entry.name, entry.type = name, type_
    entry._field_type = _FIELD  # as `fields` and `replace` ask for it
    if entry.kw_only is MISSING:
        entry.kw_only = kw_only
    return entry


def _mark_of_fields() -> Any:
    """Return the marker of `dataclasses` for instance fields."""
    import dataclasses

    return vars(dataclasses)["_FIELD"]


_FIELD = _mark_of_fields()


def _methods(
    declared: Mapping[str, Field[Any]], flags: Any, finished: bool
) -> dict[str, Any]:
    """Return the methods of a record.

    finished: Whether it has a ``__post_init__``.
    """
    initialized = [each for each in declared.values() if each.init]
    placed = tuple(each.name for each in initialized if not each.kw_only)
    compared = [each for each in declared.values() if each.compare]
    hashed = [e for e in declared.values() if (e.compare if e.hash is None else e.hash)]
    methods: dict[str, Any] = {
        "__init__": _initializer(declared.values(), placed, flags.frozen, finished),
        "__signature__": _Signature(),
        "__match_args__": placed,
    }
    if flags.repr:
        methods["__repr__"] = _shower([e.name for e in declared.values() if e.repr])
    if flags.eq:
        methods["__eq__"] = _comparer([each.name for each in compared])
        methods["__hash__"] = _hasher([each.name for each in hashed])
    if flags.frozen:
        methods["__setattr__"], methods["__delattr__"] = _locks(frozenset(declared))
    if flags.frozen and flags.slots:
        methods["__getstate__"], methods["__setstate__"] = _pickled(tuple(declared))
    return methods


def _initializer(
    declared: Iterable[Field[Any]],
    placed: tuple[str, ...],
    frozen: bool,
    finished: bool,
) -> Callable[..., None]:
    """Return the ``__init__`` of fields, ``placed`` ones by position too."""
    declared = list(declared)
    defaults = {e.name: e.default for e in declared if e.default is not MISSING}
    factories = [
        (each.name, each.default_factory)
        for each in declared
        if each.default_factory is not MISSING
    ]
    valued = {each.name for each in declared if each.init or each.name in defaults}
    valued.update(name for name, _ in factories)
    never = [each.name for each in declared if not each.init]
    most = len(placed) if valued == set(placed) else -1  # where they can be all
    put: Callable[[Any, str, Any], None] = object.__setattr__ if frozen else setattr

    def __init__(self: Any, /, *positional: Any, **named: Any) -> None:  # noqa: N807
        if len(positional) == most and not named:
            for name, value in zip(placed, positional, strict=True):
                put(self, name, value)
        else:
            values = defaults | dict(zip(placed, positional, strict=False)) | named
            for name, make in factories:
                if name not in values:
                    values[name] = make()
            if (
                len(positional) > len(placed)
                or values.keys() != valued
                or (
                    (positional or never)
                    and _taken(named, placed[: len(positional)], never)
                )
            ):
                _refuse(self, positional, named)
            for name, value in values.items():
                put(self, name, value)
        if finished:
            self.__post_init__()

    return __init__


def _taken(named: Mapping[str, Any], *others: Iterable[str]) -> bool:
    """Return whether an argument is repeated or unknown."""
    return any(name in named for names in others for name in names)


def _refuse(record: Any, positional: tuple[Any, ...], named: Mapping[str, Any]) -> None:
    """Raise Python's error of arguments that do not fit."""
    kind = type(record)
    try:
        _signature(kind).bind(*positional, **named)
    except TypeError as error:
        raise TypeError(f"{kind.__qualname__}.__init__(): {error}") from None


def _signature(kind: type[Any]) -> inspect.Signature:
    parameters = []
    for each in kind.__dataclass_fields__.values():
        if each.init:
            default: Any = inspect.Parameter.empty
            if each.default is not MISSING:
                default = each.default
            elif each.default_factory is not MISSING:
                default = _FactoryDefault()
            parameter = inspect.Parameter(
                each.name,
                inspect.Parameter.KEYWORD_ONLY
                if each.kw_only
                else inspect.Parameter.POSITIONAL_OR_KEYWORD,
                default=default,
                annotation=each.type,
            )
            parameters.append(parameter)
    parameters.sort(key=lambda parameter: parameter.kind)
    return inspect.Signature(parameters, return_annotation=None)


class _FactoryDefault:
    """Shown default of a field with a factory."""

    def __repr__(self) -> str:
        return "<factory>"


class _Signature:
    """The signature of a record, built on access."""

    def __get__(self, instance: object, owner: type[Any]) -> inspect.Signature:
        if instance is not None:
            raise AttributeError("__signature__")
        return _signature(owner)


def _getter(names: list[str]) -> Callable[[Any], Any]:
    """Return a function that returns field values as a comparable value."""
    if names:
        return attrgetter(*names)
    return lambda _: ()


def _comparer(names: list[str]) -> Callable[[Any, Any], Any]:
    values = _getter(names)

    def __eq__(self: Any, other: object) -> Any:  # noqa: N807
        if other.__class__ is not self.__class__:
            return NotImplemented
        # In a tuple an identical object is equal, as a NaN is to itself.
        return (values(self),) == (values(other),)

    return __eq__


def _hasher(names: list[str]) -> Callable[[Any], int]:
    values = _getter(names)

    def __hash__(self: Any) -> int:  # noqa: N807
        return hash(values(self) if len(names) > 1 else (values(self),))

    return __hash__


def _shower(names: list[str]) -> Callable[[Any], str]:
    def __repr__(self: Any) -> str:  # noqa: N807
        kind = type(self)
        # A record that is in itself, by way of a list, would have no end.
        if id(self) in _SHOWN:
            return "..."
        _SHOWN.add(id(self))
        try:
            shown = ", ".join(f"{name}={getattr(self, name)!r}" for name in names)
        finally:
            _SHOWN.discard(id(self))
        return f"{kind.__qualname__}({shown})"

    return __repr__


_SHOWN: set[int] = set()


def _locks(
    names: frozenset[str],
) -> tuple[Callable[[Any, str, Any], None], Callable[[Any, str], None]]:
    """Return methods that refuse to set and delete fields; subclasses may add some."""

    def __setattr__(self: Any, name: str, value: Any) -> None:  # noqa: N807
        if name in names or not hasattr(self, "__dict__"):
            raise FrozenInstanceError(f"cannot assign to field {name!r}")
        object.__setattr__(self, name, value)

    def __delattr__(self: Any, name: str) -> None:  # noqa: N807
        if name in names or not hasattr(self, "__dict__"):
            raise FrozenInstanceError(f"cannot delete field {name!r}")
        object.__delattr__(self, name)

    return __setattr__, __delattr__


def _pickled(
    names: tuple[str, ...],
) -> tuple[Callable[[Any], list[Any]], Callable[[Any, list[Any]], None]]:
    """Return the pickle methods of a frozen record with slots."""

    def __getstate__(self: Any) -> list[Any]:  # noqa: N807
        return [getattr(self, name) for name in names]

    def __setstate__(self: Any, state: list[Any]) -> None:  # noqa: N807
        for name, value in zip(names, state, strict=True):
            object.__setattr__(self, name, value)

    return __getstate__, __setstate__


def _slotted(
    cls: type[Any], declared: Iterable[str], added: Mapping[str, Any]
) -> type[Any]:
    """Return a class with slots for fields that its bases have no slots for."""
    inherited = {
        name for base in cls.__mro__[1:-1] for name in vars(base).get("__slots__", ())
    }
    body = {**vars(cls), **added}
    for name in (*declared, "__dict__", "__weakref__"):
        body.pop(name, None)
    body["__slots__"] = tuple(name for name in declared if name not in inherited)
    metaclass: Any = type(cls)
    rebuilt: type[Any] = metaclass(cls.__name__, cls.__bases__, body)
    rebuilt.__qualname__ = cls.__qualname__
    return rebuilt
