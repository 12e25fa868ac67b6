"""People of images of several cameras, who is who over time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from support.stage import ring

from animtool.capture.cameras.camera import project
from animtool.capture.cameras.openpose import _read_people, track_people

CAMERAS = ring(3).cameras
POINTS, FRAMES, RATE = 15, 30, 30.0


def places(person: int, frame: int) -> np.ndarray:
    """Return the keypoints of one who walks, a metre from the other one ``(M, 3)``."""
    rng = np.random.default_rng(person)
    body = rng.uniform([-0.25, 0.1, -0.25], [0.25, 1.8, 0.25], (POINTS, 3))
    return body + np.array([1.2 * person - 0.6, 0.0, 0.01 * frame])


def images(
    order: tuple[int, ...], hidden: dict[tuple[int, int], set[int]]
) -> list[list[list[np.ndarray]]]:
    """Return what is seen: people in an order that each other frame turns round.

    hidden: By frame and camera, who is not seen.
    """
    rows = []
    for frame in range(FRAMES):
        seen = []
        for c, camera in enumerate(CAMERAS):
            people = []
            for person in order[:: -1 if frame % 2 else 1]:
                if person in hidden.get((frame, c), set()):
                    continue
                pixels = project(camera, places(person, frame))
                people.append(np.concatenate([pixels, np.ones((POINTS, 1))], axis=1))
            seen.append(people)
        rows.append(seen)
    return rows


def people_of(found: np.ndarray) -> np.ndarray:
    """Return who is in each place, -1 for nobody ``(F, C, P)``."""
    rows = found.reshape(FRAMES, len(CAMERAS), -1, POINTS, 3)
    who = np.full(rows.shape[:3], -1)
    for frame, c, p in np.ndindex(*who.shape):
        for person in (0, 1):
            wanted = project(CAMERAS[c], places(person, frame))
            if np.allclose(rows[frame, c, p, :, :2], wanted):
                who[frame, c, p] = person
    return who


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_people_keep_their_place_in_whatever_order_they_are_listed(
    order: tuple[int, ...],
) -> None:
    who = people_of(track_people(images(order, {}), CAMERAS, RATE, POINTS, None))
    first = who[0, 0]
    assert sorted(first.tolist()) == [0, 1]
    assert (who == first).all()


def test_who_one_camera_sees_is_left_out_of_that_frame_and_others_are_not() -> None:
    """In frames 10 to 12 the first is in one image alone, and the second in all."""
    whole = people_of(track_people(images((0, 1), {}), CAMERAS, RATE, POINTS, None))
    for lost in (0, 1):
        hidden = {(frame, c): {lost} for frame in (10, 11, 12) for c in (0, 2)}
        found = track_people(images((0, 1), hidden), CAMERAS, RATE, POINTS, None)
        who = people_of(found)
        expected = whole.copy()
        gone = expected[10:13]
        gone[gone == lost] = -1
        assert (who == expected).all()
        # Who is not there has no confidence.
        parts = found.reshape(FRAMES, len(CAMERAS), -1, POINTS, 3)
        assert not parts[..., 2][who == -1].any()
        assert np.isnan(parts[..., 0][who == -1]).all()


def test_those_who_are_seen_most_are_kept() -> None:
    hidden = {(frame, c): {0} for frame in range(3) for c in range(3)}
    found = track_people(images((0, 1), hidden), CAMERAS, RATE, POINTS, 1)
    who = people_of(found)
    assert who.shape[2] == 1
    assert (who == 1).all()


def test_keypoints_without_confidence_or_number_are_missing(tmp_path: Path) -> None:
    """Nobody has none but such."""
    rows = [[1, 2, 0.5], [3, 4, 0], [5, float("nan"), 0.7], [6, 7, -1], [8, 9, 1]]
    people = [np.ravel(one).tolist() for one in (rows, rows[1:3], rows[4:])]
    path = tmp_path / "image_01_keypoints.json"
    path.write_text(
        json.dumps({"people": [{"pose_keypoints_2d": one} for one in people]})
    )
    first, last = _read_people(path)
    missing = [np.nan, np.nan, 0]
    assert_array_equal(first, [[1, 2, 0.5], missing, missing, missing, [8, 9, 1]])
    assert_array_equal(last, [[8, 9, 1]])
