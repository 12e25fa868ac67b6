"""How well a pass did its work: numbers, each with the most that a good result has."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import field, replace
from enum import StrEnum
from typing import ClassVar

from animtool.core.errors import percent
from animtool.core.quantities import angle_text, length_text, plain
from animtool.core.record import dataclass

# Of what a good result has: a table is not to show what rounding leaves.
NEGLIGIBLE = 1e-4


class ScoreUnit(StrEnum):
    """What the number of a score counts."""

    LENGTH = "m"
    ANGLE = "rad"
    SHARE = "share"
    RATIO = "ratio"


@dataclass(frozen=True, slots=True)
class Score:
    """One number of a pass: the larger, the worse.

    Attributes:
        name: What reports call it.
        value: The number, in the unit; NaN where there was nothing to score.
        unit: Metres, radians, a share of 1, or a ratio.
        usual: The most that a good result has, above ``ideal``.
        ideal: That of a perfect result.
    """

    name: str
    value: float
    unit: ScoreUnit
    usual: float
    ideal: float = 0.0

    @property
    def excess(self) -> float:
        """How bad it is: 0 is perfect, or nothing; 1 the most that a good result has.

        >>> Score("drift", 0.003, ScoreUnit.LENGTH, 0.001).excess
        3.0
        """
        if math.isnan(self.value):
            return 0.0
        return max(0.0, (self.value - self.ideal) / (self.usual - self.ideal))

    @property
    def text(self) -> str:
        """The value with its unit; 0 where it is too small to matter, or none.

        >>> Score("drift", 0.003, ScoreUnit.LENGTH, 0.001).text
        '3 mm'
        >>> Score("drift", math.nan, ScoreUnit.LENGTH, 0.001).text
        'none'
        """
        if math.isnan(self.value):
            return "none"
        small = not self.ideal and self.excess < NEGLIGIBLE
        value = 0.0 if small else self.value
        if self.unit is ScoreUnit.LENGTH:
            return length_text(value)
        if self.unit is ScoreUnit.ANGLE:
            return angle_text(math.degrees(value))
        return percent(value) if self.unit is ScoreUnit.SHARE else plain(value)


@dataclass(frozen=True, slots=True)
class PassScores:
    """The scores of a pass on one take.

    Attributes:
        scores: In the order of reports.
        names: What of the take or the rig they concern, by what is said of it.
        pass_name: Of the pass; empty until a scene fills it in.
        where: Its entry in the scene; likewise.
    """

    scores: tuple[Score, ...]
    names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    pass_name: str = ""
    where: str = ""
    json_keys: ClassVar[str] = "pass=pass_name where scores names"

    def of_pass(self, name: str, where: str) -> PassScores:
        """Return them as those of a pass at its entry in a scene."""
        return replace(self, pass_name=name, where=where)

    @property
    def worse(self) -> list[Score]:
        """The scores above what a good result has, the worst first."""
        worse = [score for score in self.scores if score.excess > 1.0]
        return sorted(worse, key=lambda score: -score.excess)


def badness(scores: Iterable[PassScores]) -> list[float]:
    """Return a key that sorts takes by their scores: the worst score decides first.

    >>> score = Score("drift", 0.003, ScoreUnit.LENGTH, 0.001)
    >>> badness([PassScores((score,))])
    [3.0]
    """
    excesses = [score.excess for one in scores for score in one.scores]
    return sorted(excesses, reverse=True)
