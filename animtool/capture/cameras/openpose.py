"""Keypoints of OpenPose: a folder for each camera, a JSON file for each frame.

Other detectors write the same format (AlphaPose, MMPose, RTMLib).

References:
    Cao et al., OpenPose, 2019; its documentation of the output format.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from animtool import _kernels
from animtool.capture.cameras.camera import (
    Camera,
    Cameras,
    camera_parameters,
    pixel_rays,
    project,
)
from animtool.capture.cameras.observations import (
    Observations,
    match_cameras,
    uncalibrated_error,
)
from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, FormatError, OptionError, listed
from animtool.core.files.reading import MAX_TEXT_BYTES, read_input
from animtool.core.json_problems import json_problem
from animtool.core.rates import FractionLike, rate_option
from animtool.core.record import dataclass

# People seen by several cameras are matched by rays and tracked over time.

MAX_PEOPLE = 100
# Largest distance between keypoints of one person, relative to the diagonal of the
# visible ones [1]: from the person's previous position in an image, and between two
# rays.
_MAX_SHIFT, _MAX_RAY_GAP = 0.3, 0.06
# Longest absence of a tracked person [s].
MAX_LOST_SECONDS = 0.5
# People visible for less than this are false detections [s].
MIN_TRACK_SECONDS = 0.25
# Minimum number of shared keypoints for comparing two images.
MIN_SHARED_KEYPOINTS = 3
# Noise of detectors relative to the diagonal of a person [1], its outlier gate and
# largest condition number.
_DETECTOR_NOISE, _OUTLIER_GATE, _MAX_CONDITION = 0.015, 5.0, 6600.0


@dataclass(slots=True)
class _PersonTrack:
    """A person followed over frames: last known keypoints, and detections by camera."""

    points: FloatArray  # last positions [m] (M, 3)
    last_frame: int  # their frame
    # Index of the detection by frame and camera.
    detections: dict[tuple[int, int], int] = field(default_factory=dict)


def track_people(
    detections: Sequence[Sequence[Sequence[FloatArray]]],
    cameras: Sequence[Camera],
    rate: float,
    keypoint_count: int,
    max_people: int | None,
) -> FloatArray:
    """Track P people; return x, y and confidence of keypoints ``(F, C, P * M, 3)``.

    ``detections`` are people by frame and camera ``(M, 3)``, NaN for invisible
    keypoints. The ``max_people`` that are most visible are kept; None keeps all.
    """
    tracks: list[_PersonTrack] = []
    max_lost_frames = max(1, round(MAX_LOST_SECONDS * rate))
    for frame, people in enumerate(detections):
        live_tracks = [t for t in tracks if frame - t.last_frame <= max_lost_frames]
        free_detections = {
            (camera, i)
            for camera, camera_people in enumerate(people)
            for i in range(len(camera_people))
        }
        groups = _continue_tracks(live_tracks, people, cameras, free_detections)
        new_groups = _group_detections(people, cameras, sorted(free_detections))
        for known_track, group in [*groups, *((None, group) for group in new_groups)]:
            points = _solve_person(group, people, cameras, keypoint_count)
            if points is None:
                continue
            track = known_track or _PersonTrack(points, frame)
            if known_track is None:
                tracks.append(track)
            is_triangulated = np.isfinite(points[:, :1])
            track.points = np.where(is_triangulated, points, track.points)
            track.last_frame = frame
            track.detections.update({(frame, camera): i for camera, i in group.items()})
    min_frames = min(len(detections), max(1, round(MIN_TRACK_SECONDS * rate)))
    long_tracks = [
        t for t in tracks if len({f for f, _ in t.detections}) >= min_frames
    ] or tracks
    track_order = sorted(
        range(len(long_tracks)), key=lambda k: (-len(long_tracks[k].detections), k)
    )
    kept_tracks = sorted(track_order[: max_people or len(track_order)])
    shape = (len(detections), len(cameras), max(1, len(kept_tracks)), keypoint_count, 3)
    tracked_keypoints = np.full(shape, np.nan)
    tracked_keypoints[..., 2] = 0
    for p, k in enumerate(kept_tracks):
        for (frame, c), i in long_tracks[k].detections.items():
            tracked_keypoints[frame, c, p] = detections[frame][c][i]
    return tracked_keypoints.reshape(len(detections), len(cameras), -1, 3)


def _person_size(keypoints: FloatArray) -> float:
    """Return the diagonal of a person's visible keypoints [px]."""
    spread = np.nanmax(keypoints[:, :2], axis=0) - np.nanmin(keypoints[:, :2], axis=0)
    return max(float(np.linalg.norm(spread)), 1.0)


def _continue_tracks(
    live_tracks: list[_PersonTrack],
    people: Sequence[Sequence[FloatArray]],
    cameras: Sequence[Camera],
    free_detections: set[tuple[int, int]],
) -> list[tuple[_PersonTrack | None, dict[int, int]]]:
    """Match tracks to detections by reprojection; return each with camera → detection.

    Matched detections are removed from ``free_detections``.
    """
    from scipy.optimize import linear_sum_assignment

    groups: list[dict[int, int]] = [{} for _ in live_tracks]
    for c, camera in enumerate(cameras):
        if not live_tracks or not people[c]:
            continue
        costs = np.full((len(live_tracks), len(people[c])), _MAX_SHIFT)
        for track_index, track in enumerate(live_tracks):
            projected_points = project(camera, track.points)
            for i, keypoints in enumerate(people[c]):
                distances = np.linalg.norm(projected_points - keypoints[:, :2], axis=-1)
                is_visible = np.isfinite(distances)
                if is_visible.sum() >= MIN_SHARED_KEYPOINTS:
                    distance = float(np.median(distances[is_visible]))
                    costs[track_index, i] = min(
                        distance / _person_size(keypoints), _MAX_SHIFT
                    )
        for track_index, i in zip(*linear_sum_assignment(costs), strict=True):
            if costs[track_index, i] < _MAX_SHIFT:
                groups[track_index][c] = int(i)
                free_detections.discard((c, int(i)))
    return list(zip(live_tracks, groups, strict=True))


def _group_detections(
    people: Sequence[Sequence[FloatArray]],
    cameras: Sequence[Camera],
    free_detections: Sequence[tuple[int, int]],
) -> list[dict[int, int]]:
    """Group detections of different cameras whose rays meet; return camera → detection.

    Groups of one camera are omitted.
    """
    rays = {
        (c, i): _keypoint_rays(cameras[c], people[c][i]) for c, i in free_detections
    }
    sizes = {(c, i): _person_size(people[c][i]) for c, i in free_detections}
    pair_costs = {}
    for a, b in itertools.combinations(free_detections, 2):
        if a[0] != b[0]:
            cost = _ray_distance(
                cameras[a[0]], rays[a], cameras[b[0]], rays[b], sizes[a], sizes[b]
            )
            if cost < _MAX_RAY_GAP:
                pair_costs[a, b] = cost
    group_by_detection = {(c, i): {c: i} for c, i in free_detections}
    for _, a, b in sorted((cost, *pair) for pair, cost in pair_costs.items()):
        first_group, second_group = group_by_detection[a], group_by_detection[b]
        if first_group is second_group or set(first_group) & set(second_group):
            continue
        # All keypoints of both must agree: rays of two people may meet by chance.
        cross_pairs = itertools.product(first_group.items(), second_group.items())
        if all((min(pair), max(pair)) in pair_costs for pair in cross_pairs):
            first_group.update(second_group)
            for detection in second_group.items():
                group_by_detection[detection] = first_group
    unique_groups = {id(group): group for group in group_by_detection.values()}
    return [group for group in unique_groups.values() if len(group) > 1]


def _keypoint_rays(camera: Camera, keypoints: FloatArray) -> FloatArray:
    """Return ray directions of keypoints in the world, at depth 1 ``(M, 3)``."""
    image_points = pixel_rays(camera, keypoints[:, :2])
    directions = np.concatenate([image_points, np.ones((len(image_points), 1))], axis=1)
    return np.asarray(directions @ camera.rotation)


def _ray_distance(
    camera_a: Camera,
    rays_a: FloatArray,
    camera_b: Camera,
    rays_b: FloatArray,
    size_a: float,
    size_b: float,
) -> float:
    """Return the distance between rays of two cameras, over a person's size [1].

    The distance is the median epipolar error in pixels: the angle between a ray and the
    plane that contains the other ray and both cameras.
    """
    baseline = camera_b.position - camera_a.position
    largest_distance = 0.0
    for ray_set, opposite_rays, camera, size in (
        (rays_a, rays_b, camera_a, size_a),
        (rays_b, rays_a, camera_b, size_b),
    ):
        normal = np.cross(baseline, opposite_rays)
        with np.errstate(invalid="ignore", divide="ignore"):
            sine = np.abs(np.einsum("mi,mi->m", ray_set, normal))
            sine = sine / np.linalg.norm(normal, axis=1)
        is_finite = np.isfinite(sine)
        if is_finite.sum() < MIN_SHARED_KEYPOINTS:
            return np.inf
        # Lengths are at depth 1 of the camera.
        median = float(np.median(sine[is_finite]))
        largest_distance = max(largest_distance, median * camera.focal[0] / size)
    return largest_distance


def _solve_person(
    group: dict[int, int],
    people: Sequence[Sequence[FloatArray]],
    cameras: Sequence[Camera],
    keypoint_count: int,
) -> FloatArray | None:
    """Triangulate a person's points [m] ``(M, 3)``; None if no two cameras agree."""
    if len(group) < 2:
        return None
    cameras_of_person = sorted(group)
    camera_keypoints = np.stack([people[c][group[c]] for c in cameras_of_person])
    noise = np.array(
        [_DETECTOR_NOISE * _person_size(view) for view in camera_keypoints]
    )
    points: FloatArray = _kernels.triangulate_points(
        np.ascontiguousarray(camera_keypoints[None, :, :, :2]), None,
        camera_parameters([cameras[c] for c in cameras_of_person]),
        np.ones((1, len(cameras_of_person)), bool), noise,
        _OUTLIER_GATE, _MAX_CONDITION, has_details=False,
    )[0][0]  # fmt: skip
    is_triangulated = np.isfinite(points).all(axis=-1)
    return (
        points
        if is_triangulated.sum() >= min(MIN_SHARED_KEYPOINTS, keypoint_count)
        else None
    )


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
_KEYPOINT_NAMES = {25: BODY_25, 18: COCO_18}
# Keypoints of a person; with hands and face there are 137.
MAX_KEYPOINTS = 1000
MAX_FRAMES = 1_000_000
_LAST_NUMBER = re.compile(r"(\d+)(?=\D*$)")


def read_keypoints(
    folder: Path | str,
    cameras: Cameras,
    *,
    fps: FractionLike | None,
    people: int | None = None,
) -> Observations:
    """Read a folder of OpenPose keypoints, with people tracked across cameras.

    Args:
        folder: Contains a folder for each camera, named after its calibration or in the
            order of the cameras. File names end with the frame number, as in
            ``take_000000000012_keypoints.json``.
        cameras: Calibrations of all cameras: people are matched by intersecting rays.
        fps: The frame rate, which the files do not state.
        people: Largest number of people to keep, most visible first; None keeps all.

    Raises:
        FormatError: A file cannot be read, or the folder has no files (CAM010).
        OptionError: fps is missing (CAM010) or invalid (SCN022), or the cameras are
            others (CAM011).
    """
    folder = Path(folder)
    if fps is None:
        message = "OpenPose keypoints state no frame rate"
        hint = f"set it with {argument('source.fps')}"
        raise OptionError(Fault("CAM010", message, str(folder), (), hint))
    rate = rate_option(fps)
    folders = sorted(
        subfolder for subfolder in folder.iterdir() if any(subfolder.glob("*.json"))
    )
    if not folders:
        message = "contains no folder of JSON files for each camera"
        raise FormatError(Fault("CAM010", message, str(folder)))
    names = _camera_names(folders, cameras)
    files_by_frame = [dict(_numbered_files(subfolder)) for subfolder in folders]
    first = min(min(files) for files in files_by_frame)
    last = max(max(files) for files in files_by_frame)
    if last - first >= MAX_FRAMES:
        message = f"frames are numbered {first} to {last}: more than {MAX_FRAMES}"
        raise FormatError(Fault("CAM010", message, str(folder)))
    empty_observations = Observations(
        (), Clock(rate, Fraction(1), Fraction(1), last - first + 1),
        np.zeros((1, len(folders), 0, 2)), names, path=str(folder),
    )  # fmt: skip
    matched_cameras = match_cameras(empty_observations, cameras)
    detections = [
        [_read_people(files[f]) if f in files else [] for files in files_by_frame]
        for f in range(first, last + 1)
    ]
    keypoint_counts = {len(p) for frame in detections for group in frame for p in group}
    if len(keypoint_counts) != 1:
        message = f"people have {listed(sorted(keypoint_counts)) or 'no'} keypoints"
        hint = "all files must use one body model"
        raise FormatError(Fault("CAM010", message, str(folder), (), hint))
    keypoint_count = keypoint_counts.pop()
    tracked_keypoints = track_people(
        detections, matched_cameras.cameras, float(rate), keypoint_count, people
    )
    keypoint_names = _KEYPOINT_NAMES.get(keypoint_count) or tuple(
        f"point{i:02d}" for i in range(keypoint_count)
    )
    person_count = tracked_keypoints.shape[2] // keypoint_count
    point_names = tuple(
        keypoint_name if person_count == 1 else f"person{p + 1}_{keypoint_name}"
        for p in range(person_count)
        for keypoint_name in keypoint_names
    )
    clock = Clock(rate, Fraction(first), Fraction(1), len(detections))
    return Observations(
        point_names, clock, np.ascontiguousarray(tracked_keypoints[..., :2]), names,
        confidences=np.ascontiguousarray(tracked_keypoints[..., 2]), path=str(folder),
    )  # fmt: skip


def _camera_names(folders: list[Path], cameras: Cameras) -> tuple[str, ...]:
    """Return each folder's camera by the folder's name; if none matches, in order."""
    calibrated_names = set(cameras.names)
    suffixes = ("", "_json", "-json")
    names = []
    for folder in folders:
        bare_names = [folder.name.removesuffix(end) for end in suffixes]
        matching_names = (name for name in bare_names if name in calibrated_names)
        names.append(next(matching_names, ""))
    if all(names):
        return tuple(names)
    if any(names):
        unmatched_folder = folders[names.index("")].name
        raise uncalibrated_error(unmatched_folder, cameras, "; name the folder so")
    if len(folders) != len(cameras):
        message = f"{len(folders)} folders, but {len(cameras)} cameras"
        hint = "give each folder the name of its camera in the calibration"
        raise OptionError(Fault("CAM011", message, cameras.path or None, (), hint))
    return cameras.names


def _numbered_files(folder: Path) -> Iterator[tuple[int, Path]]:
    """Yield frame number and path of the JSON files of one camera, sorted by path."""
    file_of_frame: dict[int, Path] = {}
    for path in sorted(folder.glob("*.json")):
        number_match = _LAST_NUMBER.search(path.name.removesuffix("_keypoints.json"))
        if number_match is None or len(number_match[1]) > 15:
            message = "has no frame number in its name"
            raise FormatError(Fault("CAM010", message, str(path)))
        frame = int(number_match[1])
        if frame in file_of_frame:
            message = f"has frame number {frame}, as {file_of_frame[frame].name} has"
            raise FormatError(Fault("CAM010", message, str(path)))
        file_of_frame[frame] = path
        yield frame, path


def _read_people(path: Path) -> list[FloatArray]:
    """Read one frame's people, each x, y and confidence of keypoints ``(M, 3)``."""
    data = read_input(path, MAX_TEXT_BYTES)
    try:
        document: Any = json.loads(data)
        people = document["people"]
        people_arrays = [
            np.array(keypoints["pose_keypoints_2d"], np.float64).reshape(-1, 3)
            for keypoints in people[: MAX_PEOPLE + 1]
        ]
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        message = f"is not a file of keypoints: {_error_reason(error)}"
        raise FormatError(Fault("CAM010", message, str(path))) from error
    if len(people) > MAX_PEOPLE:
        message = f"holds {len(people)} people; the limit is {MAX_PEOPLE}"
        raise FormatError(Fault("CAM010", message, str(path)))
    visible_people = []
    for keypoints in people_arrays:
        if not 0 < len(keypoints) <= MAX_KEYPOINTS:
            message = f"a person has {len(keypoints)} keypoints"
            raise FormatError(Fault("CAM010", message, str(path)))
        is_missing = ~np.isfinite(keypoints).all(axis=1) | (keypoints[:, 2] <= 0)
        keypoints[is_missing] = [np.nan, np.nan, 0]
        if not is_missing.all():
            visible_people.append(keypoints)
    return visible_people


def _error_reason(error: Exception) -> str:
    """Return why a JSON file cannot be used, as text after a colon."""
    if isinstance(error, KeyError):
        return f"it has no {error.args[0]!r}"
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    if isinstance(error, json.JSONDecodeError):
        problem = json_problem(error)
        return f"line {problem.line}, column {problem.column}: {problem.message}"
    return str(error)
