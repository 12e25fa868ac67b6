"""How often takes are solved for goals that come and go, and from what these come."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from support.targets import legs, tracks_of, walk_of

from animtool.ik.on_take import count_solves, solve_fade_sources
from animtool.ik.tracks import TargetTracks
from animtool.motion.take import Take

LEFT = "- {effector: leg_l, position: [0.1, 0.3, 0], during: [[4, 9]]}\n"
RIGHT = "- {effector: leg_r, position: [0.1, 0.3, 0], during: [[4, 9]]}\n"
OTHER = "- {effector: tail, orientation: [1, 0, 0, 0], during: [[7, 20]]}\n"
ALWAYS = "- {effector: hips, position: [0, 1, 0]}\n"


@pytest.mark.parametrize(
    ("goals", "solved"),
    [
        (ALWAYS, []),
        (LEFT + RIGHT, []),
        (ALWAYS + LEFT + RIGHT, [{"hips"}]),
        (LEFT + OTHER, [{"tail"}, {"leg_l"}]),
        (ALWAYS + LEFT + OTHER, [{"hips"}, {"hips", "tail"}, {"hips", "leg_l"}]),
    ],
)
def test_goals_come_from_the_take_at_all_others(
    tmp_path: Path, goals: str, solved: list[set[str]]
) -> None:
    take, found = walk_of(legs()), list[set[str]]()
    made: list[Take] = []

    def bring(wanted: TargetTracks, free: tuple[Take, ...]) -> Take:
        assert len(free) == len(wanted.goals)
        found.append({track.name for track in wanted.goals})
        made.append(replace(take))
        return made[-1]

    tracks = tracks_of(tmp_path, goals)
    takes = solve_fade_sources(take, tracks, bring)
    assert found == solved
    assert count_solves(tracks) == 1 + len(solved)
    for track, one in zip(tracks.goals, takes, strict=True):
        if track.during and solved:
            (names,) = (n for n, own in zip(found, made, strict=True) if own is one)
            assert track.name not in names
        else:
            assert one is take
