"""Tests of the decorator of records against the one of the standard library."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
from dataclasses import FrozenInstanceError, asdict, field, fields, replace
from typing import Any, ClassVar, Generic, TypeVar

import pytest

from animtool.core.record import dataclass

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Span(Generic[T]):
    """A range."""

    first: T
    last: int = 9
    kind: ClassVar[str] = "span"
    names: list[str] = field(default_factory=list, compare=False)
    length: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "length", self.last - 1)


@dataclass(frozen=True, slots=True)
class Named(Span[int]):
    """A range with a name, which is said by name."""

    name: str = field(kw_only=True)


@dataclass
class Count:
    """What counts."""

    many: int = 0
    each: dict[str, int] = field(default_factory=dict, repr=False)


@dataclasses.dataclass(frozen=True)
class Under(Named):
    """A record under one of the other kind."""

    more: float = 0.5


def test_fields_have_their_defaults_and_are_equal() -> None:
    one = Span(1)
    assert (one.first, one.last, one.names, one.length) == (1, 9, [], 8)
    assert Span.kind == "span"
    assert one == Span(first=1, names=["a"])
    assert one != Span(2)
    assert hash(one) == hash(Span(1, 9, ["b"]))
    assert Span(1).names is not Span(1).names
    assert one.__eq__(3) is NotImplemented


@dataclass(frozen=True)
class Plain:
    """A record without slots."""

    first: int
    second: int = 2
    third: int = 3


@dataclass(frozen=True)
class Above(Span[int]):
    """A record without slots, below one with slots."""

    more: int = 4


def test_defaults_follow_what_is_given_in_order() -> None:
    given = [Plain(1), Plain(1, 5), Plain(1, 5, 6), Plain(1, third=6)]
    assert [asdict(one) for one in given] == [
        {"first": 1, "second": 2, "third": 3},
        {"first": 1, "second": 5, "third": 3},
        {"first": 1, "second": 5, "third": 6},
        {"first": 1, "second": 2, "third": 6},
    ]
    for positional in ((), (1, 2, 3, 4)):
        with pytest.raises(TypeError, match="Plain"):
            Plain(*positional)
    above = Above(1, 2, [], 7)
    assert (above.first, above.last, above.more) == (1, 2, 7)


def test_what_is_the_same_is_equal() -> None:
    nan = float("nan")
    assert Count(nan) == Count(nan)  # type: ignore[arg-type]


def test_the_library_takes_it_for_a_dataclass() -> None:
    named = Named(1, name="a")
    assert dataclasses.is_dataclass(named)
    assert [f.name for f in fields(named)] == [
        *("first", "last", "names", "length", "name"),
    ]
    assert replace(named, last=4) == Named(1, 4, name="a")
    assert asdict(named) == {
        **{"first": 1, "last": 9, "names": [], "length": 8, "name": "a"},
    }
    assert Named.__match_args__ == ("first", "last", "names")
    assert pickle.loads(pickle.dumps(named)) == named
    assert copy.deepcopy(named) == named
    assert repr(named) == ("Named(first=1, last=9, names=[], length=8, name='a')")
    assert not hasattr(named, "__dict__")


def test_either_kind_stands_under_the_other() -> None:
    under = Under(1, name="b")
    assert replace(under, more=2.0).more == 2.0
    assert [f.name for f in fields(under)][-1] == "more"


def test_a_frozen_one_is_read_only() -> None:
    one = Span(1)
    with pytest.raises(FrozenInstanceError):
        one.first = 2  # type: ignore[misc]
    with pytest.raises(FrozenInstanceError):
        del one.first
    with pytest.raises(FrozenInstanceError):
        one.other = 2  # type: ignore[attr-defined]


def test_another_is_not_and_has_no_hash() -> None:
    count = Count()
    count.many = 3
    assert repr(count) == "Count(many=3)"
    assert count == Count(3)
    with pytest.raises(TypeError):
        hash(count)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ((), {}),
        ((1, 2, [], 3), {}),
        ((1,), {"first": 2}),
        ((1,), {"length": 2}),
        ((1,), {"other": 2}),
        ((), {"last": 2, "other": 2}),
    ],
)
def test_arguments_that_do_not_fit(given: tuple[Any, ...], named: Any) -> None:
    with pytest.raises(TypeError, match="Span"):
        Span(*given, **named)


def test_its_signature_is_that_of_the_standard_library() -> None:
    def own(_: type[Any]) -> type[Any]:
        class Pair:
            a: int
            b: int = 2
            c: str = field(kw_only=True, default="")

        return Pair

    ours, theirs = dataclass(own(Span)), dataclasses.dataclass(own(Span))
    assert inspect.signature(ours) == inspect.signature(theirs)


def test_a_mutable_default_is_refused() -> None:
    with pytest.raises(ValueError, match="default_factory"):

        @dataclass
        class Bad:
            names: list[str] = []  # noqa: RUF012


@pytest.mark.parametrize(("name", "field"), [("lst", "last"), ("colour", None)])
def test_a_misspelled_argument_names_the_field(name: str, field: str | None) -> None:
    hint = f"did you mean '{field}'" if field else f"'{name}'$"
    with pytest.raises(TypeError, match=hint):
        Named(1, name="a", **{name: 2})  # type: ignore[arg-type]
