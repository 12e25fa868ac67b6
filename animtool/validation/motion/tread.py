"""How far a body travels, against how far its feet tread."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.validation.motion.body import hips_of
from animtool.validation.motion.contacts import Contacts, moves_over
from animtool.validation.motion.subject import MotionSubject

# Velocities are over about this time [s].
SPAN = 0.1
# Slower hips [size/s] show no ratio, nor does a shorter time [s]. Feet that slide less
# in all are not seen to [size].
SLOW, MIN_SECONDS, MIN_SLIDE = 0.1, 0.2, 0.05
# Where the travel is scaled, the foot that stands moves along with the hips or against
# them, at a part of their speed that hardly changes. Over the path, the 15th percentile
# of this ratio is above the first one here, or the median and the 75th below the others
# [1]: a foot that rolls goes along a little.
ALONG, AGAINST, MOSTLY_AGAINST = 0.1, -0.15, -0.05
# From the 15th percentile to the median the ratio changes by less than this, along and
# against [1]: feet that slide on purpose, as in a dance, have no ratio.
EVEN_ALONG, EVEN_AGAINST = 0.12, 0.2


def travel_scale(subject: MotionSubject, contacts: Contacts) -> float | None:
    """Return how many times too far the hips go for their feet, if they do.

    Over 1 feet are dragged along, and below they slip back.
    """
    ratios, weights = _ratios(subject, contacts)
    path = float(weights.sum()) * subject.interval / subject.size
    if len(ratios) * subject.interval < MIN_SECONDS:
        return None
    order = np.argsort(ratios, kind="stable")
    totals = np.cumsum(weights[order]) / weights.sum()
    places = np.searchsorted(totals, (0.15, 0.5, 0.75)).clip(0, len(order) - 1)
    low, middle, high = ratios[order][places].tolist()
    along = low > ALONG and middle - low < EVEN_ALONG and middle < 1.0
    against = middle < AGAINST and high < MOSTLY_AGAINST
    against &= middle - low < EVEN_AGAINST * max(1.0, -middle)
    if path * abs(middle) < MIN_SLIDE or not (along or against):
        return None
    return float(1.0 / (1.0 - middle))


def _ratios(
    subject: MotionSubject, contacts: Contacts
) -> tuple[FloatArray, FloatArray]:
    """Return velocities of the foot that stands, over those of the hips ``(N,)``.

    Along the hips' velocity, and their speeds [m/s]. Of feet near to the ground the
    slowest one counts.
    """
    points = subject.level(np.append(contacts.feet, hips_of(subject)))
    ways, steps = moves_over(subject, points, SPAN)
    velocities = ways / (steps * subject.interval)[:, None, None]
    feet, hips = velocities[:, :-1], velocities[:, -1]
    speeds = np.where(contacts.near, np.linalg.norm(feet, axis=2), np.inf)
    slowest = feet[np.arange(len(feet)), speeds.argmin(axis=1)]
    pace = np.linalg.norm(hips, axis=1)
    known = contacts.near.any(axis=1) & (pace > SLOW * subject.size)
    along = np.einsum("fc,fc->f", slowest, hips)[known]
    return np.asarray(along / pace[known] ** 2), np.asarray(pace[known])
