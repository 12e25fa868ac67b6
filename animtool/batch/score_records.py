"""Scores of passes in the records of a batch."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from animtool.batch.records import (
    RecordError,
    list_in,
    number_in,
    object_of,
    text_in,
    texts_in,
)
from animtool.scores import PassScores, Score, ScoreUnit


def scores_in(record: Mapping[str, Any], key: str) -> tuple[PassScores, ...]:
    """Return the scores that `PassScores.as_dict` wrote; none without the key."""
    if key not in record:
        return ()
    return tuple(_pass_scores(object_of(one)) for one in list_in(record, key))


def _pass_scores(plain: Mapping[str, Any]) -> PassScores:
    names = object_of(plain.get("names"))
    return PassScores(
        tuple(_score(object_of(one)) for one in _some(plain, "scores")),
        {what: tuple(texts_in(names, what)) for what in names},
        text_in(plain, "pass"),
        text_in(plain, "where"),
    )


def _some(plain: Mapping[str, Any], key: str) -> Sequence[Any]:
    entries = list_in(plain, key)
    if not entries:
        raise RecordError(f"{key!r} is empty")
    return entries


def _score(plain: Mapping[str, Any]) -> Score:
    unit = text_in(plain, "unit")
    if unit not in {*ScoreUnit}:
        raise RecordError(f"{unit!r} is no unit of a score")
    value, usual, ideal = (
        number_in(plain, key, -math.inf) for key in ("value", "usual", "ideal")
    )
    if usual <= ideal:
        raise RecordError("'usual' is not above 'ideal'")
    return Score(text_in(plain, "name"), value, ScoreUnit(unit), usual, ideal)
