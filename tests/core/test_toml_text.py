"""TOML of others: bounds of depth and time."""

from __future__ import annotations

import pytest

from animtool.core.config import MAX_TOML_DEPTH, parse_toml


def test_it_is_read() -> None:
    text = "[a.'b c'.\"d\"]\nx = [1.5, {y = [2]}] # e.f\n"
    assert parse_toml(text) == {"a": {"b c": {"d": {"x": [1.5, {"y": [2]}]}}}}


def test_as_deep_as_is_allowed() -> None:
    assert parse_toml(f"{'.'.join('a' * (MAX_TOML_DEPTH - 1))} = 1")
    with pytest.raises(ValueError, match="nested deeper"):
        parse_toml(f"{'.'.join('a' * MAX_TOML_DEPTH)} = 1")


@pytest.mark.parametrize(
    "text",
    [
        "[" + ".".join("a" * 100_000) + "]",
        " . ".join(["'a b'", '"c\\"d"'] * 50_000) + " = 1",
        "x = " + "[" * 100_000,
        "x = " + "{a = " * 100_000,
        # Shallow keys in shallow tables, deep together.
        "x = " + f"{{{'.'.join('a' * 40)} = " * 5 + "1" + "}" * 5,
    ],
)
def test_deep_ones_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"nested deeper than 50"):
        parse_toml(text)


@pytest.mark.parametrize("text", ["a" * 300_000, "'" * 300_001, '"\\' * 150_000])
def test_long_ones_take_time_with_their_length(text: str) -> None:
    with pytest.raises(ValueError, match="at "):
        parse_toml(text)
