"""How far a body travels for what its feet tread, where the numbers are known."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.planted_takes import drift, travel

from animtool.core.errors import Fault
from animtool.motion.take import Take
from animtool.scene.sources.open import open_source
from animtool.validation.motion.contacts import find_contacts
from animtool.validation.motion.feet import foot_slide, travel_scale
from animtool.validation.motion.subject import MotionSubject


def subject(take: Take) -> MotionSubject:
    def fault_at(
        code: str, joint: str, frame: float | None, message: str, hint: str
    ) -> Fault:
        del joint, frame
        return Fault(code, message, hint=hint)

    return MotionSubject(take, fault_at)


@pytest.fixture(scope="module")
def walking(walk: Path) -> Take:
    return open_source(walk).collect()


def scale_of(take: Take) -> float | None:
    seen = subject(take)
    contacts = find_contacts(seen)
    assert contacts is not None
    return travel_scale(seen, contacts)


@pytest.mark.parametrize("factor", [0.5, 0.7, 1.3, 1.6])
def test_a_travel_that_is_scaled_has_its_factor(walking: Take, factor: float) -> None:
    scale = scale_of(travel(factor)(walking))
    assert scale == pytest.approx(factor, rel=0.15)
    assert [f.code for f in foot_slide(subject(travel(factor)(walking)))] == ["MOT208"]


def test_a_travel_that_feet_tread_has_none(walking: Take) -> None:
    assert scale_of(walking) is None
    assert scale_of(travel(1.02)(walking)) is None
    assert list(foot_slide(subject(walking))) == []


def test_a_body_moved_sideways_slides(walking: Take) -> None:
    slides = [bool(list(foot_slide(subject(drift(v, 0)(walking))))) for v in (0.0, 0.4)]
    assert slides == [False, True]
