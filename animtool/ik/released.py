"""What a take does without those of its goals that come and go."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from animtool.ik.tracks import GoalTrack, TargetTracks
from animtool.take import Take

# From tracks, and the take without each of them, to the take at its targets.
Bring = Callable[[TargetTracks, tuple[Take, ...]], Take]


def rounds(tracks: TargetTracks) -> int:
    """Return how often a take is solved: more than once if goals come and go.

    Goals of the same spans come and go together, and need one more round for all, if
    there are others. With other spans beside them, each of these needs one, with the
    others there.
    """
    spans = len(_spans(tracks.goals))
    bare = spans > 0 and any(not track.during for track in tracks.goals)
    return 1 + bare + (spans if spans > 1 else 0)


def takes_released(take: Take, tracks: TargetTracks, bring: Bring) -> tuple[Take, ...]:
    """Return by goal the take from which it comes, and to which it lets go.

    That is the take brought to all goals but those that come and go with it. Where two
    spans begin or end in each other's ease, it is so but for the other's ease.

    Args:
        take: Without goals.
        tracks: The goals.
        bring: Brings the take to some of them.
    """
    spans = _spans(tracks.goals)
    found: dict[object, Take] = {_NEVER: take}
    if spans:
        always = [track for track in tracks.goals if not track.during]
        bare = _solve_take(take, tracks, always, take, bring)
        found |= dict.fromkeys(spans, bare)
    if len(spans) > 1:
        for span in spans:
            others = [track for track in tracks.goals if _span(track) != span]
            found[span] = _solve_take(take, tracks, others, bare, bring)
    return tuple(found[_span(track)] for track in tracks.goals)


_NEVER: object = ()


def _span(track: GoalTrack) -> object:
    return (track.during, track.ease) if track.during else _NEVER


def _spans(goals: Sequence[GoalTrack]) -> list[object]:
    """Return what goals that come and go together have in common, each once."""
    return list(dict.fromkeys(_span(track) for track in goals if track.during))


def _solve_take(
    take: Take,
    tracks: TargetTracks,
    goals: Sequence[GoalTrack],
    bare: Take,
    bring: Bring,
) -> Take:
    """Return the take at some goals, those that come and go from a bare one."""
    if not goals:
        return take
    free = tuple(bare if track.during else take for track in goals)
    return bring(replace(tracks, goals=tuple(goals)), free)
