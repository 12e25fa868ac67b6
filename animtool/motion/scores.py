"""Quality scores of a pass, each with the largest value of a good result."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import field, replace
from enum import StrEnum
from typing import ClassVar

from animtool.core.errors import percent_text
from animtool.core.quantities import angle_text, length_text, plain_number
from animtool.core.record import dataclass

# Fraction of a good result's value below which a score is shown as 0.
NEGLIGIBLE_FRACTION = 1e-4


class ScoreUnit(StrEnum):
    """Unit of a score."""

    LENGTH = "m"
    ANGLE = "rad"
    FRACTION = "share"
    RATIO = "ratio"


@dataclass(frozen=True, slots=True)
class Score:
    """A quality score of a pass; larger values are worse."""

    name: str  # name in reports
    value: float  # the number, in the unit; NaN where there was nothing to score
    unit: ScoreUnit  # metres, radians, a fraction, or a ratio
    usual: float  # largest value of a good result, above ``ideal``
    ideal: float = 0.0  # value of a perfect result

    @property
    def excess(self) -> float:
        """Badness: 0 for a perfect result or NaN, 1 at the limit of good results.

        >>> Score("drift", 0.003, ScoreUnit.LENGTH, 0.001).excess
        3.0
        """
        if math.isnan(self.value):
            return 0.0
        return max(0.0, (self.value - self.ideal) / (self.usual - self.ideal))

    @property
    def text(self) -> str:
        """The value with its unit; 0 if negligible, "none" if NaN.

        >>> Score("drift", 0.003, ScoreUnit.LENGTH, 0.001).text
        '3 mm'
        >>> Score("drift", math.nan, ScoreUnit.LENGTH, 0.001).text
        'none'
        """
        if math.isnan(self.value):
            return "none"
        is_negligible = not self.ideal and self.excess < NEGLIGIBLE_FRACTION
        value = 0.0 if is_negligible else self.value
        if self.unit is ScoreUnit.LENGTH:
            return length_text(value)
        if self.unit is ScoreUnit.ANGLE:
            return angle_text(math.degrees(value))
        if self.unit is ScoreUnit.FRACTION:
            return percent_text(value)
        return plain_number(value)


@dataclass(frozen=True, slots=True)
class PassScores:
    """The scores of a pass on one take."""

    scores: tuple[Score, ...]  # scores in the order of reports
    # Names of affected joints or parts of the take, by description.
    names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    pass_name: str = ""  # name of the pass; empty until a scene sets it
    where: str = ""  # entry of the pass in the scene; empty until a scene sets it
    json_keys: ClassVar[str] = "pass=pass_name where scores names"

    def with_pass(self, name: str, where: str) -> PassScores:
        """Return the scores with a pass name and its entry in a scene."""
        return replace(self, pass_name=name, where=where)

    @property
    def exceeded_scores(self) -> list[Score]:
        """The scores beyond the limit of a good result, the worst first."""
        worse_scores = [score for score in self.scores if score.excess > 1.0]
        return sorted(worse_scores, key=lambda score: -score.excess)


def sort_key_of_scores(scores: Iterable[PassScores]) -> list[float]:
    """Return a sort key of takes by their scores, the worst score first.

    >>> score = Score("drift", 0.003, ScoreUnit.LENGTH, 0.001)
    >>> sort_key_of_scores([PassScores((score,))])
    [3.0]
    """
    excesses = [score.excess for pass_scores in scores for score in pass_scores.scores]
    return sorted(excesses, reverse=True)
