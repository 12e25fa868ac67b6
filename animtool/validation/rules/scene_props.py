"""What a scene carries beside its character."""

from __future__ import annotations

from collections.abc import Iterator

from animtool.errors import Fault
from animtool.validation.subjects.scene import SceneSubject


def out_of_time(subject: SceneSubject) -> Iterator[Fault]:
    """Yield things whose files have no frame of the take (SCN213)."""
    take = subject.take
    if take.motion.track_times is None:
        return
    times = take.motion.track_times.dense()[..., 0]
    indices = {prop.path: i for i, prop in enumerate(subject.scene.props)}
    for column, track in enumerate(take.tracks):
        held = track.at(times[:, column]).held
        if held is None or not held.all():
            continue
        first, last = times[[0, -1], column]
        message = (
            f"its file has no frame of the take, which asks for {first:g} to {last:g}"
        )
        hint = "frame: says which of its frames comes with the first"
        at = ("props", indices[track.path])
        yield subject.fault("SCN213", at, message, hint)
