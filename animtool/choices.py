"""Options of which there are a few, by the words that scenes write for them."""

from __future__ import annotations

from enum import StrEnum
from typing import TypeVar

from animtool.errors import Fault, OptionError, excerpt
from animtool.similar import similar

Choice = TypeVar("Choice", bound=StrEnum)


def chosen(choices: type[Choice], given: str, option: str) -> Choice:
    """Return a choice by its word, or as it is.

    Raises:
        OptionError: There is none of that word (SCN025).

    >>> class Side(StrEnum):
    ...     LEFT = "left"
    >>> chosen(Side, "left", "side")
    <Side.LEFT: 'left'>
    """
    try:
        return choices(given)
    except ValueError as error:
        words = [str(choice) for choice in choices]
        message = f"{option} is {excerpt(str(given))}; it is one of {', '.join(words)}"
        near = similar(str(given), words)
        hint = f"did you mean {near}?" if near else None
        raise OptionError(Fault("SCN025", message, hint=hint)) from error
