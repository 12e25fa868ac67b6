"""What clips of nested, trimmed and retimed timelines show, against OpenTimelineIO."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.suite import some_quick

from animtool.batch.cut_frames import CutOptions
from animtool.batch.cuts import CutList, read_cuts
from animtool.core.shot import Shot

otio = pytest.importorskip("opentimelineio", reason="no OpenTimelineIO (extra: otio)")

from support.timelines import clip, span, timeline  # noqa: E402

RATES = (24.0, 25.0, 30.0, 30000 / 1001, 24000 / 1001, 120.0)
SEEDS = range(120)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "take.bvh").touch()
    return tmp_path


def shots(path: Path) -> dict[str, Shot]:
    return {cut.shot_values["shot"]: shot for cut, shot in _each(read_cuts(path))}


def _each(cuts: CutList) -> Iterator[tuple[Any, Shot]]:
    for cut in cuts.shots:
        assert cut.shot is not None
        yield cut, cut.shot


class Maker:
    """Makes timelines of clips, gaps, tracks and stacks in each other."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.count = 0

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def range(self, longest: int) -> Any:
        # Whole frames of one rate, as editors write them.
        first, count = self.rng.integers(0, longest), self.rng.integers(1, longest)
        return span(int(first), int(count), float(self.rng.choice(RATES)))

    def item(self, depth: int) -> Any:
        if depth and self.chance(0.3):
            made = self.stack(depth - 1) if self.chance(0.5) else self.track(depth - 1)
        elif self.chance(0.2):
            made = otio.schema.Gap(source_range=self.range(40))
        else:
            self.count += 1
            media = span(int(self.rng.integers(0, 90000)), 400, 24.0)
            made = clip(f"s{self.count}", "take.bvh", self.range(60), media)
        made.enabled = not self.chance(0.08)
        return made

    def track(self, depth: int) -> Any:
        made = otio.schema.Track(f"T{depth}", kind="Video")
        made.extend([self.item(depth) for _ in range(self.rng.integers(1, 5))])
        return self.trimmed(made)

    def stack(self, depth: int) -> Any:
        made = otio.schema.Stack(f"S{depth}")
        made.extend([self.item(depth) for _ in range(self.rng.integers(1, 4))])
        return self.trimmed(made)

    def trimmed(self, made: Any) -> Any:
        if self.chance(0.35):
            rate = float(self.rng.choice(RATES))
            first, count = self.rng.integers(0, 40), self.rng.integers(20, 160)
            made.source_range = span(int(first), int(count), rate)
        return made

    def whole(self, path: Path) -> Any:
        made = otio.schema.Timeline("edit")
        made.global_start_time = otio.opentime.RationalTime(
            0, float(self.rng.choice(RATES))
        )
        made.tracks.extend([self.track(2) for _ in range(self.rng.integers(1, 3))])
        self.trimmed(made.tracks)
        otio.adapters.write_to_file(made, str(path))
        return made


def visible(made: Any, item: Any) -> Any:
    """Return the range of a clip that the timeline shows, by OpenTimelineIO."""
    node, shown = item, item.trimmed_range()
    enabled = item.enabled
    while (parent := node.parent()) is not None:
        shown = node.transformed_time_range(shown, parent)
        if parent.source_range is not None:
            begin = max(shown.start_time, parent.source_range.start_time)
            end = min(
                shown.end_time_exclusive(), parent.source_range.end_time_exclusive()
            )
            if not end - begin > otio.opentime.RationalTime(1e-6, 1):
                return None
            shown = otio.opentime.range_from_start_end_time(begin, end)
        node, enabled = parent, enabled and parent.enabled
    if not enabled:
        return None
    within = item.trimmed_range_in_parent()
    assert within is not None
    back = made.tracks.transformed_time_range(shown, item)
    assert back.duration <= within.duration or back.duration.almost_equal(
        within.duration, 1e-6
    )
    return back


@pytest.mark.parametrize("seed", some_quick(SEEDS, 4))
def test_seconds_are_those_of_opentimelineio(folder: Path, seed: int) -> None:
    maker, path = Maker(seed), folder / "edit.otio"
    made = maker.whole(path)
    expected = {}
    for item in made.find_clips():
        shown = visible(made, item)
        if shown is not None:
            first = item.media_reference.available_range.start_time
            expected[item.name] = (
                (shown.start_time - first).to_seconds(),
                shown.duration.to_seconds(),
            )
    found = shots(path)
    assert found.keys() == expected.keys()
    for name, (begin, seconds) in expected.items():
        shot = found[name]
        assert float(shot.seconds_at(shot.cut_in)) == pytest.approx(begin, abs=1e-6)
        assert shot.fps is not None
        frames = shot.cut_out - shot.cut_in + 1
        assert frames / shot.fps >= seconds - 1e-4 / shot.fps
        assert frames == 1 or (frames - 1) / shot.fps < seconds


def warp(item: Any, *speeds: float) -> Any:
    for speed in speeds:
        item.effects.append(otio.schema.LinearTimeWarp(time_scalar=speed))
    return item


def test_a_trim_inside_a_retimed_clip_is_of_the_timeline(folder: Path) -> None:
    path = timeline(
        folder / "a.otio", warp(clip("a", "take.bvh", (24, 48)), 2.0), rate=24
    )
    made = otio.adapters.read_from_file(str(path))
    made.tracks[0].source_range = span(12, 24)
    otio.adapters.write_to_file(made, str(path))
    shot = shots(path)["a"]
    assert shot.seconds_at(shot.cut_in) == Fraction(24 + 2 * 12, 24)
    assert (shot.cut_out - shot.cut_in + 1, shot.speed) == (24, 2)


def test_a_retimed_stack_retimes_its_clips(folder: Path) -> None:
    inner = otio.schema.Track("inner", kind="Video")
    inner.extend([clip("a", "take.bvh", (10, 24)), clip("b", "take.bvh", (50, 24))])
    stack = warp(otio.schema.Stack("s", [inner], span(12, 12)), 2.0)
    found = shots(timeline(folder / "a.otio", stack, rate=24))
    # Twelve frames at twice the speed are the last half of a and the first of b.
    shown = {
        name: (shot.seconds_at(shot.cut_in) * 24, shot.cut_out - shot.cut_in + 1)
        for name, shot in found.items()
    }
    assert shown == {"a": (22, 6), "b": (50, 6)}
    assert {shot.speed for shot in found.values()} == {2}


@pytest.mark.parametrize("speed", [-1.0, 0.0])
def test_stacks_that_do_not_go_forward_are_left_out(folder: Path, speed: float) -> None:
    inner = otio.schema.Stack("s", [clip("a", "take.bvh", (10, 24))])
    made = warp(inner, speed), clip("b", "take.bvh", (0, 4))
    found = read_cuts(timeline(folder / "a.otio", *made, rate=24))
    assert [cut.shot_values["shot"] for cut in found.shots] == ["b"]
    left = [notice for notice in found.notices if notice.code == "BAT044"]
    assert [notice.severity.value for notice in left] == ["warning"]


def test_backwards_shows_the_frames_of_the_range_in_reverse(folder: Path) -> None:
    path = timeline(
        folder / "a.otio", warp(clip("a", "take.bvh", (24, 48)), -1.0), rate=24
    )
    shot = shots(path)["a"]
    assert shot.seconds_at(shot.cut_in) * 24 == 71
    assert shot.seconds_at(shot.cut_out) * 24 == 24
    made = otio.adapters.read_from_file(str(path))
    made.tracks[0].source_range = span(40, 8)
    otio.adapters.write_to_file(made, str(path))
    shot = shots(path)["a"]
    assert shot.seconds_at(shot.cut_in) * 24 == 31
    assert shot.seconds_at(shot.cut_out) * 24 == 24


def test_a_frame_is_held(folder: Path) -> None:
    still = clip("a", "take.bvh", (24, 48))
    still.effects.append(otio.schema.FreezeFrame())
    shot = shots(timeline(folder / "a.otio", still, rate=24))["a"]
    assert {shot.seconds_at(f) for f in (shot.cut_in, shot.cut_out)} == {1}


def test_effects_that_are_off_do_nothing_and_time_curves_are_named(
    folder: Path,
) -> None:
    off = warp(clip("a", "take.bvh", (24, 48)), 3.0)
    off.effects[0].enabled = False
    curve = clip("b", "take.bvh", (24, 48))
    curve.effects.append(otio.schema.TimeEffect("ease"))
    found = read_cuts(timeline(folder / "a.otio", off, curve, rate=24))
    assert [cut.shot.speed for cut in found.shots if cut.shot] == [1]
    assert [notice.code for notice in found.notices] == ["BAT044"]
    assert "'b'" in found.notices[0].message


@pytest.mark.parametrize(
    ("name", "left_out"),
    [("Time Remap", True), ("Variable Speed", True), ("Blur", False)],
)
def test_effects_of_other_kinds_count_by_their_names(
    folder: Path, name: str, left_out: bool
) -> None:
    made = clip("a", "take.bvh", (24, 48))
    made.effects.append(otio.schema.Effect(effect_name=name))
    path = timeline(folder / "a.otio", made, rate=24)
    assert shots(path).keys() == (set() if left_out else {"a"})
    codes = [notice.code for notice in read_cuts(path).notices]
    assert codes == ["BAT044"] * left_out


def test_what_is_disabled_or_trimmed_away_is_named(folder: Path) -> None:
    gone, kept = clip("gone", "take.bvh", (0, 24)), clip("kept", "take.bvh", (0, 24))
    off = clip("off", "none.bvh", (0, 24))
    off.enabled = False
    path = timeline(folder / "a.otio", gone, off, kept, rate=24)
    made = otio.adapters.read_from_file(str(path))
    made.tracks[0].source_range = span(30, 24)
    otio.adapters.write_to_file(made, str(path))
    found = read_cuts(path, (), CutOptions())
    assert [cut.shot_values["shot"] for cut in found.shots] == ["kept"]
    assert [cut.shot.media_in for cut in found.shots if cut.shot] == [0]
    assert {notice.code for notice in found.notices} == {"BAT043"}
    assert [n.message.split("'")[1] for n in found.notices] == ["gone", "off"]
