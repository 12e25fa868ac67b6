"""Warnings about times of systems that look like frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from animtool.core.quantities import (
    MIN_SUSPECT_SECONDS,
    MIN_SUSPECT_STEP,
    frames_hint,
    plain_number,
    step_hint,
)
from animtool.core.record import dataclass
from animtool.documents.document import Document, Location

# A whole number of seconds from which a duration may be one of frames [s].
MIN_SUSPICIOUS_SECONDS = 20.0
# No frame of a scene whose length is unknown lasts so long [s].
MAX_FRAME_DURATION = 10.0
# From so many picoseconds a second on, times may be picoseconds [ps/s].
MIN_PICOSECOND_PACE = 2.0
# Lists of rows that begin with a time, and keys of a time at which something begins.
TIMED_ROW_KEYS = {"moves", "turns", "gusts", "bursts", "temperatures"}
START_KEYS = {"start", "release", "opens", "bursts"}
# Rows in frames reach at least this fraction of the scene's frames; fewer may be the
# seconds of a longer scene of which only the beginning is written.
MIN_LAST_FRACTION = 0.3


@dataclass(frozen=True, slots=True)
class SceneTimes:
    """The frame rate and range of a scene, to which times are compared."""

    rate: float  # [frames/s]
    frames: tuple[float, float] | None = None  # first and last; None if unknown

    @property
    def length(self) -> float:
        """Time from the first to the last frame [s]; 0 if unknown."""
        if self.frames is None:
            return 0.0
        return (self.frames[1] - self.frames[0]) / self.rate

    def is_late_frame(self, t: float) -> bool:
        """Return whether a time [s] is after the scene's end and looks like a frame."""
        if self.frames is None or t != round(t) or t < MIN_SUSPECT_SECONDS:
            return False
        first, last = self.frames
        return self.length < t <= max(last, last - first) + 1

    def hint(self, frame: float) -> str:
        """Return a hint with the time of a frame in seconds."""
        first = self.frames[0] if self.frames else 0.0
        seconds = (frame - first if frame >= first else frame) / self.rate
        text = f"times are in seconds from the first frame: frame {frame:g} is "
        return f"{text}{seconds:.3g} s"


def warn_of_times(
    document: Document, location: Location, values: Mapping[str, Any], times: SceneTimes
) -> None:
    """Warn of durations and times that seem to be in frames (SIM109, SIM200).

    ``values`` are the stated keys of the system at a location.
    """
    _warn_of_durations(document, location, values, times)
    _warn_of_step(document, location, values.get("step"), times)
    if times.frames is None:
        return
    if _warn_of_picoseconds(document, location, values, times):
        return
    end_text = f"but the scene ends at {times.length:.3g} s"
    for key_location, key, value in stated_keys(location, values):
        rows = value if isinstance(value, list | tuple) else []
        starts = [row[0] for row in rows if isinstance(row, list | tuple) and row]
        start = min(starts, default=value if isinstance(value, int | float) else 0.0)
        if key in START_KEYS and times.is_late_frame(start):
            row_location = (
                (*key_location, starts.index(start)) if starts else key_location
            )
            message = f"{key} {start:g} is {start:g} s, {end_text}"
            document.warn("SIM200", row_location, message, times.hint(start))
            return
        if key in TIMED_ROW_KEYS and _is_in_frames(starts, times):
            row = starts.index(max(starts))
            message = f"the last row of {key} is at {starts[row]:g} s, {end_text}"
            document.warn(
                "SIM200", (*key_location, row), message, times.hint(starts[row])
            )
            return


def _warn_of_picoseconds(
    document: Document, location: Location, values: Mapping[str, Any], times: SceneTimes
) -> bool:
    """Warn of rows of a thermostat that seem to be in picoseconds (SIM200)."""
    rows = (values.get("thermostat") or {}).get("temperatures") or ()
    last, pace = max((row[0] for row in rows), default=0.0), values.get("pace") or 1.0
    seconds = last / pace
    # At a low pace the rows may be the seconds of a longer scene.
    if pace < MIN_PICOSECOND_PACE or last < pace or not times.length < last:
        return False
    if seconds < MIN_LAST_FRACTION * times.length:
        return False
    message = f"the last row of temperatures is at {last:g} s, but the scene ends at "
    message += f"{times.length:.3g} s"
    hint = f"times are in seconds from the first frame: {last:g} ps is "
    hint += f"{plain_number(seconds)} s at a pace of {pace:g} ps/s"
    row = [row[0] for row in rows].index(last)
    row_location = (*location, "thermostat", "temperatures", row)
    document.warn("SIM200", row_location, message, hint)
    return True


def _warn_of_step(
    document: Document, location: Location, step: object, times: SceneTimes
) -> None:
    """Warn of a step longer than the scene, likely steps per second (SIM109)."""
    scene_text = f"the scene of {plain_number(times.length)} s"
    limit, limit_text = max(times.length, MIN_SUSPECT_STEP), scene_text
    if not times.length:
        limit, limit_text = MAX_FRAME_DURATION, "any frame"
    if isinstance(step, int | float) and step > limit:
        message = f"a step of {plain_number(step)} s is longer than {limit_text}"
        document.warn("SIM109", (*location, "step"), message, step_hint(step))


def stated_keys(
    location: Location, values: Mapping[str, Any]
) -> Iterator[tuple[Location, str, Any]]:
    """Yield the location, name and value of every key, including nested keys."""
    for key, value in values.items():
        yield (*location, key), key, value
        entries = value if isinstance(value, list) else [value]
        for i, entry in enumerate(entries):
            if isinstance(entry, Mapping):
                index = (i,) if isinstance(value, list) else ()
                yield from stated_keys((*location, key, *index), entry)


def _is_in_frames(row_times: list[float], times: SceneTimes) -> bool:
    last = max(row_times, default=0.0)
    assert times.frames is not None
    are_integers = all(t == round(t) for t in row_times)
    min_last = MIN_LAST_FRACTION * (times.frames[1] - times.frames[0])
    return are_integers and last >= min_last and times.is_late_frame(last)


def _warn_of_durations(
    document: Document, location: Location, values: Mapping[str, Any], times: SceneTimes
) -> None:
    durations = [((*location, "preroll"), "preroll", values.get("preroll"))]
    for i, emitter in enumerate(values.get("emitters") or ()):
        key_location = (*location, "emitters", i, "lifetime")
        durations.append((key_location, "lifetime", emitter.get("lifetime")))
    for key_location, key, seconds in durations:
        if not isinstance(seconds, int | float):
            continue
        hint = frames_hint(seconds, times.rate)
        if hint and seconds >= max(MIN_SUSPICIOUS_SECONDS, times.length):
            message = f"{key} {seconds:g} is {seconds:g} s"
            if times.length:
                message += f", and the scene has {times.length:.3g} s"
            document.warn("SIM200", key_location, message, hint)
