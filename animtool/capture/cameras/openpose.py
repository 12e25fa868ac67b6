"""Keypoints of OpenPose: a folder for each camera, a JSON file for each frame.

Other detectors write the same (AlphaPose, MMPose, RTMLib).

References:
    Cao et al., OpenPose, 2019; its documentation of the output format.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from animtool.capture.cameras.camera import Cameras
from animtool.capture.cameras.observations import Observations, matched
from animtool.capture.cameras.people import MAX_PEOPLE, follow_people
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, FormatError, OptionError, listed
from animtool.core.files.reading import MAX_TEXT_BYTES, read_input
from animtool.core.rates import FractionLike, rate_option
from animtool.core.similar import similar

BODY_25 = (
    "Nose", "Neck", "RShoulder", "RElbow", "RWrist", "LShoulder", "LElbow", "LWrist",
    "MidHip", "RHip", "RKnee", "RAnkle", "LHip", "LKnee", "LAnkle", "REye", "LEye",
    "REar", "LEar", "LBigToe", "LSmallToe", "LHeel", "RBigToe", "RSmallToe", "RHeel",
)  # fmt: skip
COCO_18 = (
    "Nose", "Neck", "RShoulder", "RElbow", "RWrist", "LShoulder", "LElbow", "LWrist",
    "RHip", "RKnee", "RAnkle", "LHip", "LKnee", "LAnkle", "REye", "LEye", "REar",
    "LEar",
)  # fmt: skip
_NAMES = {25: BODY_25, 18: COCO_18}
# Keypoints of a person; with hands and face there are 137.
MAX_KEYPOINTS = 1000
MAX_FRAMES = 1_000_000
_NUMBER = re.compile(r"(\d+)(?=\D*$)")


def read_keypoints(
    folder: Path | str,
    cameras: Cameras,
    *,
    fps: FractionLike | None,
    people: int | None = None,
) -> Observations:
    """Return the keypoints of a folder, with people followed through the cameras.

    Args:
        folder: Holds a folder for each camera, called as its calibration is, or in the
            order of the cameras. Names of files end with the frame's number, as in
            ``take_000000000012_keypoints.json``.
        cameras: Calibrations of all cameras: who is who is found by where rays meet.
        fps: The frame rate, which the files do not state.
        people: Keep the people that are seen most; None keeps all.

    Raises:
        FormatError: A file cannot be read, or there are none (CAM010).
        OptionError: fps is not given (CAM010) or no rate (SCN022), or the cameras are
            others (CAM011).
    """
    folder = Path(folder)
    if fps is None:
        message = "keypoints of OpenPose state no frame rate"
        hint = "--source-fps gives it"
        raise OptionError(Fault("CAM010", message, str(folder), (), hint))
    rate = rate_option(fps)
    folders = sorted(each for each in folder.iterdir() if any(each.glob("*.json")))
    if not folders:
        message = "holds no folder of JSON files for each camera"
        raise FormatError(Fault("CAM010", message, str(folder)))
    names = _camera_names(folders, cameras)
    frames = [dict(_frames(each)) for each in folders]
    first = min(min(found) for found in frames)
    last = max(max(found) for found in frames)
    if last - first >= MAX_FRAMES:
        message = f"frames are numbered {first} to {last}: more than {MAX_FRAMES}"
        raise FormatError(Fault("CAM010", message, str(folder)))
    shown = Observations(
        (), Clock(rate, Fraction(1), Fraction(1), last - first + 1),
        np.zeros((1, len(folders), 0, 2)), names, path=str(folder),
    )  # fmt: skip
    chosen = matched(shown, cameras)
    detections = [
        [_people(found[f]) if f in found else [] for found in frames]
        for f in range(first, last + 1)
    ]
    counts = {len(p) for frame in detections for seen in frame for p in seen}
    if len(counts) != 1:
        message = f"people have {listed(sorted(counts)) or 'no'} keypoints"
        hint = "all files must be of one model of the body"
        raise FormatError(Fault("CAM010", message, str(folder), (), hint))
    keypoints = counts.pop()
    followed = follow_people(detections, chosen.cameras, float(rate), keypoints, people)
    labels = _NAMES.get(keypoints) or tuple(f"point{i:02d}" for i in range(keypoints))
    persons = followed.shape[2] // keypoints
    points = tuple(
        label if persons == 1 else f"person{p + 1}_{label}"
        for p in range(persons)
        for label in labels
    )
    clock = Clock(rate, Fraction(first), Fraction(1), len(detections))
    return Observations(
        points, clock, np.ascontiguousarray(followed[..., :2]), names,
        confidences=np.ascontiguousarray(followed[..., 2]), path=str(folder),
    )  # fmt: skip


def _camera_names(folders: list[Path], cameras: Cameras) -> tuple[str, ...]:
    """Return the camera of each folder: by its name, else in order."""
    known = set(cameras.names)
    suffixes = ("", "_json", "-json")
    found = []
    for folder in folders:
        bare = [folder.name.removesuffix(end) for end in suffixes]
        found.append(next((name for name in bare if name in known), ""))
    if all(found):
        return tuple(found)
    if any(found):
        missing = folders[found.index("")].name
        near = similar(missing, cameras.names)
        message = f"there is no calibration of camera {missing!r}"
        hint = f"did you mean {near!r}?" if near else f"it has {listed(cameras.names)}"
        raise OptionError(Fault("CAM011", message, cameras.path or None, (), hint))
    if len(folders) != len(cameras):
        message = f"{len(folders)} folders and {len(cameras)} cameras"
        hint = "call each folder as the calibration calls its camera"
        raise OptionError(Fault("CAM011", message, cameras.path or None, (), hint))
    return cameras.names


def _frames(folder: Path) -> Iterator[tuple[int, Path]]:
    """Yield the files of a camera by the number of their frame."""
    taken: dict[int, Path] = {}
    for path in sorted(folder.glob("*.json")):
        number = _NUMBER.search(path.name.removesuffix("_keypoints.json"))
        if number is None or len(number[1]) > 15:
            message = "has no number of a frame in its name"
            raise FormatError(Fault("CAM010", message, str(path)))
        frame = int(number[1])
        if frame in taken:
            message = f"is frame {frame}, as {taken[frame].name} is"
            raise FormatError(Fault("CAM010", message, str(path)))
        taken[frame] = path
        yield frame, path


def _people(path: Path) -> list[FloatArray]:
    """Return the people of a file: x, y and confidence of keypoints ``(M, 3)``."""
    data = read_input(path, MAX_TEXT_BYTES)
    try:
        value: Any = json.loads(data)
        people = value["people"]
        found = [
            np.array(person["pose_keypoints_2d"], np.float64).reshape(-1, 3)
            for person in people[: MAX_PEOPLE + 1]
        ]
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        message = f"is no file of keypoints: {_reason(error)}"
        raise FormatError(Fault("CAM010", message, str(path))) from error
    if len(people) > MAX_PEOPLE:
        message = f"holds {len(people)} people; at most {MAX_PEOPLE} are followed"
        raise FormatError(Fault("CAM010", message, str(path)))
    kept = []
    for person in found:
        if not 0 < len(person) <= MAX_KEYPOINTS:
            message = f"a person has {len(person)} keypoints"
            raise FormatError(Fault("CAM010", message, str(path)))
        missing = ~np.isfinite(person).all(axis=1) | (person[:, 2] <= 0)
        person[missing] = [np.nan, np.nan, 0]
        if not missing.all():
            kept.append(person)
    return kept


def _reason(error: Exception) -> str:
    if isinstance(error, KeyError):
        return f"it has no {error.args[0]!r}"
    if isinstance(error, RecursionError):
        return "it is nested too deep"
    return str(error).split(" (char")[0]
