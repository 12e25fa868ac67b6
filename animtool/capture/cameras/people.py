"""Who is who: people that several cameras see, matched by rays and followed in time.

A person that was found in space is looked for where it should be in each image. What
no person takes is matched by how far the rays of two cameras miss each other, and makes
new people.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from animtool import _kernels
from animtool.capture.cameras.camera import Camera, camera_numbers, project, rays
from animtool.core.array_types import FloatArray

MAX_PEOPLE = 100
# How far off keypoints of one person may be, against the diagonal of what is seen [1]:
# between an image and where the person was before, and between two rays.
_NEAR, _AGREE = 0.3, 0.06
# How long a person may be out of sight and be the same [s].
LOST_SECONDS = 0.5
# People that are seen shorter are taken for mistakes of the detector [s].
MIN_SECONDS = 0.25
# Keypoints that two images must share, to be compared.
MIN_SHARED = 3
# The noise of detectors, against the diagonal of a person [1], and the gate.
_NOISE, _GATE, _CONDITION = 0.015, 5.0, 6600.0


@dataclass(slots=True)
class _Track:
    """A person over time."""

    points: FloatArray  # where it was last [m] (M, 3)
    seen: int  # the frame of that
    # By frame and camera, which of the people there it is.
    found: dict[tuple[int, int], int] = field(default_factory=dict)


def follow_people(
    detections: Sequence[Sequence[Sequence[FloatArray]]],
    cameras: Sequence[Camera],
    rate: float,
    keypoints: int,
    most: int | None,
) -> FloatArray:
    """Return x, y and confidence of each person's keypoints ``(F, C, P * M, 3)``.

    Args:
        detections: By frame and camera, people ``(M, 3)`` with NaN for what is not
            seen.
        cameras: Their calibrations.
        rate: Frames a second.
        keypoints: M.
        most: People to keep, those that are seen most; None keeps all.
    """
    tracks: list[_Track] = []
    lost_after = max(1, round(LOST_SECONDS * rate))
    for frame, people in enumerate(detections):
        live = [t for t in tracks if frame - t.seen <= lost_after]
        free = {(c, i) for c, seen in enumerate(people) for i in range(len(seen))}
        groups = _continued(live, people, cameras, free)
        fresh = _grouped(people, cameras, sorted(free))
        for known_as, group in [*groups, *((None, group) for group in fresh)]:
            points = _solved(group, people, cameras, keypoints)
            if points is None:
                continue
            track = known_as or _Track(points, frame)
            if known_as is None:
                tracks.append(track)
            known = np.isfinite(points[:, :1])
            track.points = np.where(known, points, track.points)
            track.seen = frame
            track.found.update({(frame, c): i for c, i in group.items()})
    least = min(len(detections), max(1, round(MIN_SECONDS * rate)))
    kept = [t for t in tracks if len({f for f, _ in t.found}) >= least] or tracks
    order = sorted(range(len(kept)), key=lambda k: (-len(kept[k].found), k))
    order = sorted(order[: most or len(order)])
    return _gathered([kept[k] for k in order], detections, len(cameras), keypoints)


def _gathered(
    tracks: list[_Track],
    detections: Sequence[Sequence[Sequence[FloatArray]]],
    cameras: int,
    keypoints: int,
) -> FloatArray:
    shape = (len(detections), cameras, max(1, len(tracks)), keypoints, 3)
    made = np.full(shape, np.nan)
    made[..., 2] = 0
    for p, track in enumerate(tracks):
        for (frame, camera), i in track.found.items():
            made[frame, camera, p] = detections[frame][camera][i]
    return made.reshape(shape[0], cameras, -1, 3)


def _size(person: FloatArray) -> float:
    """Return the diagonal of what is seen of a person [px]."""
    spread = np.nanmax(person[:, :2], axis=0) - np.nanmin(person[:, :2], axis=0)
    return max(float(np.linalg.norm(spread)), 1.0)


def _continued(
    live: list[_Track],
    people: Sequence[Sequence[FloatArray]],
    cameras: Sequence[Camera],
    free: set[tuple[int, int]],
) -> list[tuple[_Track | None, dict[int, int]]]:
    """Give people in images to those found before, and take them from ``free``."""
    from scipy.optimize import linear_sum_assignment

    groups: list[dict[int, int]] = [{} for _ in live]
    for c, camera in enumerate(cameras):
        if not live or not people[c]:
            continue
        costs = np.full((len(live), len(people[c])), _NEAR)
        for t, track in enumerate(live):
            shown = project(camera, track.points)
            for i, person in enumerate(people[c]):
                off = np.linalg.norm(shown - person[:, :2], axis=-1)
                known = np.isfinite(off)
                if known.sum() >= MIN_SHARED:
                    cost = float(np.median(off[known])) / _size(person)
                    costs[t, i] = min(cost, _NEAR)
        for t, i in zip(*linear_sum_assignment(costs), strict=True):
            if costs[t, i] < _NEAR:
                groups[t][c] = int(i)
                free.discard((c, int(i)))
    return list(zip(live, groups, strict=True))


def _grouped(
    people: Sequence[Sequence[FloatArray]],
    cameras: Sequence[Camera],
    free: Sequence[tuple[int, int]],
) -> list[dict[int, int]]:
    """Return new people: images of one person have rays that meet."""
    pairs = []
    lines = {each: _rays(cameras[each[0]], people[each[0]][each[1]]) for each in free}
    for a, one in enumerate(free):
        for other in free[a + 1 :]:
            if one[0] != other[0]:
                cost = _missed(
                    cameras[one[0]], lines[one], cameras[other[0]], lines[other],
                    _size(people[one[0]][one[1]]), _size(people[other[0]][other[1]]),
                )  # fmt: skip
                if cost < _AGREE:
                    pairs.append((cost, one, other))
    close = {(one, other): cost for cost, one, other in pairs}
    group_of = {each: {each[0]: each[1]} for each in free}
    for _, one, other in sorted(pairs):
        first, second = group_of[one], group_of[other]
        if first is second or set(first) & set(second):
            continue
        # All of both must agree: rays of two people may meet by chance.
        crossing = [
            tuple(sorted([(c, i), (d, j)]))
            for c, i in first.items()
            for d, j in second.items()
        ]
        if all(pair in close for pair in crossing):
            first.update(second)
            for c, i in second.items():
                group_of[c, i] = first
    unique = {id(group): group for group in group_of.values()}
    return [group for group in unique.values() if len(group) > 1]


def _rays(camera: Camera, person: FloatArray) -> FloatArray:
    """Return directions of keypoints in the world ``(M, 3)``."""
    flat = rays(camera, person[:, :2])
    ahead = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
    return np.asarray(ahead @ camera.rotation)


def _missed(
    one: Camera, a: FloatArray, other: Camera, b: FloatArray, size: float, wide: float
) -> float:
    """Return how far rays of two cameras miss, against the size of a person [1].

    The angle between a ray and the plane of the other ray and both cameras, in pixels.
    """
    between = other.position - one.position
    total = 0.0
    for mine, theirs, camera, scale in ((a, b, one, size), (b, a, other, wide)):
        normal = np.cross(between, theirs)
        with np.errstate(invalid="ignore", divide="ignore"):
            sine = np.abs(np.einsum("mi,mi->m", mine, normal))
            sine = sine / np.linalg.norm(normal, axis=1)
        known = np.isfinite(sine)
        if known.sum() < MIN_SHARED:
            return np.inf
        # Lengths are at depth 1 of the camera.
        total = max(total, float(np.median(sine[known])) * camera.focal[0] / scale)
    return total


def _solved(
    group: dict[int, int],
    people: Sequence[Sequence[FloatArray]],
    cameras: Sequence[Camera],
    keypoints: int,
) -> FloatArray | None:
    """Return where a person is [m] ``(M, 3)``; None where two cameras do not agree."""
    if len(group) < 2:
        return None
    chosen = sorted(group)
    seen = np.stack([people[c][group[c]] for c in chosen])
    noise = np.array([_NOISE * _size(person) for person in seen])
    points: FloatArray = _kernels.triangulate_points(
        np.ascontiguousarray(seen[None, :, :, :2]), None,
        camera_numbers([cameras[c] for c in chosen]),
        np.ones((1, len(chosen)), bool), noise, _GATE, _CONDITION,
        detailed=False,
    )[0][0]  # fmt: skip
    found = np.isfinite(points).all(axis=-1)
    return points if found.sum() >= min(MIN_SHARED, keypoints) else None
