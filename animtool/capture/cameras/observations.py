"""Observations: pixels of markers in each camera and frame."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from animtool.capture.cameras.camera import MAX_CAMERAS, Camera, Cameras
from animtool.core.arguments import argument, flag
from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, FormatError, OptionError, counted, listed
from animtool.core.files.reading import open_input
from animtool.core.files.signatures import signature_of
from animtool.core.names import most_similar
from animtool.core.rates import FractionLike, rate_from_float, rate_option
from animtool.core.record import dataclass
from animtool.documents.arrays import Archives, open_arrays

# Pixel arrays by key: unit of a stored number [px], and the number that marks invisible
# points.
_PIXEL_ARRAYS = {"uv8": (0.125, 65535), "uv": (1.0, None)}
# Hint for a file that has no observations.
LAYOUT_HINT = (
    "write uv (frames, cameras, markers, 2) in pixels, fs and marker_names with "
    f"numpy.savez, then: animtool mocap triangulate take.npz {flag('cameras')} "
    "stage.cameras.yaml -o markers.npz"
)
_POSITIONS_TEXT = "holds positions of markers"
# Bytes read to identify another file type.
SIGNATURE_BYTES = 4096
# Valid rates of a capture [Hz].
_RATE_RANGE = (0.1, 100_000.0)


@dataclass(frozen=True, slots=True)
class Observations:
    """Pixels at which C cameras see M points over F frames.

    Attributes:
        names: Names of the points.
        clock: Times of the frames.
        stored: Pixels as the file has them ``(F, C, M, 2)``.
        cameras: Names of the cameras; empty where the file names none, and they are in
            the order of the cameras file.
        unit: Size of one stored unit [px].
        missing: The stored number for invisible points; None is NaN.
        confidences: Detector confidence ``(F, C, M)``, 0 if not visible; None if
            all are equal.
        path: File of the observations.
        notices: Warnings and notes about it.
    """

    names: tuple[str, ...]
    clock: Clock
    stored: npt.NDArray[Any]
    cameras: tuple[str, ...] = ()
    unit: float = 1.0
    missing: int | None = None
    confidences: FloatArray | None = None
    path: str = ""
    notices: tuple[Fault, ...] = ()

    def pixels(self, first: int, end: int, step: int = 1) -> FloatArray:
        """Return every ``step``-th frame's pixels ``(F, C, M, 2)``, NaN if hidden."""
        stored = self.stored[first:end:step]
        pixels: FloatArray = np.multiply(stored, self.unit, dtype=np.float64)
        if self.missing is not None:
            pixels[(stored == self.missing).any(axis=-1)] = np.nan
        return pixels

    def confidences_of(self, first: int, end: int, step: int = 1) -> FloatArray | None:
        """Return every ``step``-th frame's confidences ``(F, C, M)``, or None."""
        if self.confidences is None:
            return None
        return np.ascontiguousarray(self.confidences[first:end:step], np.float64)


PIXEL_AXES = "u points right and v down, from the top left"
# Sizes of images, relative to those of proxies or of upscaled pictures [1].
PROXY_FACTORS = (2.0, 4.0, 3.0, 1.5, 0.5, 0.25, 1 / 3, 2 / 3)


def pixels_in_other_conventions(
    observations: Observations, cameras: Sequence[Camera]
) -> Iterator[tuple[str, str, npt.NDArray[Any]]]:
    """Yield name, remedy and stored pixels of each convention that a file may have.

    They are swapped coordinates, pixels of images of another size and, if image sizes
    are known, v from the bottom.
    """
    stored = observations.stored
    yield (
        "[v, u]",
        f"exchange them: {PIXEL_AXES}",
        np.ascontiguousarray(stored[..., ::-1]),
    )
    if observations.missing is None and all(camera.size for camera in cameras):
        heights = np.array([camera.size[1] for camera in cameras if camera.size])
        flipped = np.array(stored, np.float64)
        flipped[..., 1] = heights[:, None] / observations.unit - flipped[..., 1]
        remedy = f"write the height minus v: {PIXEL_AXES}"
        yield "counted from the bottom", remedy, flipped
    for factor in PROXY_FACTORS:
        scaled = factor * np.array(stored, np.float64)
        if observations.missing is not None:
            scaled[stored == observations.missing] = observations.missing
        remedy = f"multiply them by {factor:.3g}, the size of the calibrated images "
        remedy += "over that of these"
        yield f"{factor:.3g} times as large", remedy, scaled


def read_observations(
    path: Path | str, *, fps: FractionLike | None = None
) -> Observations:
    """Read the observations in an npz file.

    It has ``uv`` ``(F, C, M, 2)`` in pixels, NaN where not visible, or ``uv8``, eighths
    of a pixel as uint16, 65535 where not visible; the number ``fs`` (frames a second)
    and the texts ``marker_names``. Optional: the texts ``camera_names`` and
    ``confidence`` ``(F, C, M)``.

    Args:
        path: The file.
        fps: The frame rate, if the file has a wrong one or none.

    Raises:
        FormatError: The file cannot be read, or lacks these arrays (CAM010).
        OptionError: Invalid frame rate (SCN022).
    """
    path = Path(path)
    with open_arrays(path, partial(_npz_error, path)) as archives:
        return _read_arrays(archives, path, fps)


def _solve_hint(path: Path) -> str:
    """Return a hint to solve a file of 3D positions instead of triangulating it."""
    return f"they are triangulated already: animtool mocap solve {path}"


def _npz_error(path: Path, message: str) -> FormatError:
    """Return an error about an invalid array, or about a file that is not npz."""
    message, hint = _explain_npz_fault(path, message)
    return FormatError(Fault("CAM010", message, str(path), hint=hint))


def _explain_npz_fault(path: Path, message: str) -> tuple[str, str | None]:
    """Return the error message and hint for a file that is not npz."""
    with open_input(path, None) as file:
        first_bytes = file.read(SIGNATURE_BYTES)
    if not first_bytes:
        return "the file is empty", "export or copy it again"
    if first_bytes[:2] == b"PK":
        is_damaged = message.startswith("is incomplete")
        hint = _solve_hint(path) if message.startswith(_POSITIONS_TEXT) else LAYOUT_HINT
        return message, None if is_damaged else hint
    signature = signature_of(first_bytes)
    if signature is not None and signature.suffixes[:1] in {(".c3d",), (".trc",)}:
        return f"is {signature.format_name}, not pixels of cameras", _solve_hint(path)
    text = first_bytes.lstrip(b"\xef\xbb\xbf \r\n\t")
    if path.suffix.lower() != ".json" and text[:1] not in {b"{", b"["}:
        return "is not an npz file of pixels", LAYOUT_HINT
    problem = "is a JSON file; observations are an npz file of pixels, or a folder of "
    problem += "OpenPose keypoints"
    if b'"people"' in text:
        hint = "pass the folder that contains one folder of such files per camera: "
        hint += (
            f"animtool mocap triangulate pose/ {flag('cameras', 'calib.toml')} "
            f"{flag('fps', '60')} "
        )
        return problem, hint + "-o people.npz"
    if any(key in text for key in (b'"cameras"', b'"camera_matrix"', b'"K"')):
        problem = "holds cameras, not observations; pass it as "
        problem += f"{argument('cameras', path.name)}"
    return problem, LAYOUT_HINT


def _read_arrays(
    archives: Archives, path: Path, fps: FractionLike | None
) -> Observations:
    """Read and check the arrays of an npz that `read_observations` lists."""
    array_names = archives.names(path)
    key = next((name for name in _PIXEL_ARRAYS if name in array_names), None)
    if key is None:
        arrays = listed(array_names) or "nothing"
        if any(re.match(r"markers(_|$)", name) for name in array_names):
            raise ValueError(f"{_POSITIONS_TEXT}, not pixels; its arrays are {arrays}")
        message = "has no array 'uv' or 'uv8' of pixels; its arrays are "
        raise ValueError(f"{message}{arrays}")
    unit, missing = _PIXEL_ARRAYS[key]
    header = archives.header(path, key)
    if len(header.shape) != 4 or header.shape[3] != 2:
        message = f"{key!r} has shape {header.shape}, not (frames, cameras, markers, 2)"
        raise ValueError(message)
    frame_count, view_count, marker_count, _ = header.shape
    if not (frame_count and view_count and marker_count):
        raise ValueError(f"{key!r} has shape {header.shape}: it is empty")
    if view_count > MAX_CAMERAS:
        raise ValueError(
            f"{key!r} has {view_count} cameras; the limit is {MAX_CAMERAS}"
        )
    if (header.kind == "f") != (key == "uv"):
        dtype_text = "floats" if key == "uv" else "whole numbers"
        raise ValueError(f"{key!r} does not hold {dtype_text}")
    stored = archives.load_stored(path, key)
    if header.kind == "f" and np.isinf(stored).any():
        raise ValueError(f"{key!r} contains an infinity")
    texts = {
        name: tuple(archives.texts(path, name)) if name in array_names else ()
        for name in ("marker_names", "camera_names")
    }
    names = texts["marker_names"] or tuple(f"*{i}" for i in range(marker_count))
    cameras = texts["camera_names"]
    name_counts = (
        ("marker_names", len(names), marker_count),
        ("camera_names", len(cameras), view_count),
    )
    for label, name_count, expected_count in name_counts:
        if name_count not in {expected_count, 0}:
            message = f"{label!r} has {name_count}, but {key!r} has "
            raise ValueError(f"{message}{expected_count}")
    rate = _observation_rate(archives, path, array_names, fps)
    confidences = None
    if "confidence" in array_names:
        confidences = archives.load(path, "confidence")
        if confidences.shape != header.shape[:3]:
            message = f"'confidence' has shape {confidences.shape}"
            raise ValueError(f"{message}, not {header.shape[:3]}")
    clock = Clock(rate, Fraction(1), Fraction(1), frame_count)
    return Observations(
        names, clock, stored, cameras, unit, missing, confidences, str(path)
    )


def _observation_rate(
    archives: Archives, path: Path, array_names: list[str], fps: FractionLike | None
) -> Fraction:
    """Return ``fps``, or else the number ``fs`` of the file [Hz]."""
    if fps is not None:
        return rate_option(fps)
    if "fs" not in array_names:
        message = "has no number 'fs', the frame rate; set it with "
        raise ValueError(f"{message}{argument('fps')}")
    stored_rates = archives.load_stored(path, "fs").ravel()
    min_rate, max_rate = _RATE_RANGE
    if stored_rates.size != 1 or not min_rate <= float(stored_rates[0]) <= max_rate:
        rates = listed(stored_rates.tolist())
        message = f"'fs' is {rates}, which is not a frame rate; set it with "
        raise ValueError(f"{message}{argument('fps')}")
    return rate_from_float(float(stored_rates[0]))


def uncalibrated_error(name: str, cameras: Cameras, advice: str) -> OptionError:
    """Return an error for a camera without calibration, with similar names (CAM011).

    advice: Text after the calibrated names, which are listed if none is similar.
    """
    similar_name = most_similar(name, cameras.names)
    hint = f"the calibration has {listed(cameras.names)}{advice}"
    if similar_name:
        hint = f"did you mean {similar_name!r}?"
    message = f"camera {name!r} has no calibration"
    return OptionError(Fault("CAM011", message, cameras.path or None, (), hint))


def match_cameras(observations: Observations, cameras: Cameras) -> Cameras:
    """Return the calibrations in the order in which the observations list cameras.

    Raises:
        OptionError: A camera is not calibrated or their numbers differ (CAM011), or
            there is only one (CAM012).
    """
    path = cameras.path or None
    camera_count = observations.stored.shape[1]
    if observations.cameras:
        camera_by_name = {camera.name: camera for camera in cameras.cameras}
        missing_names = [
            name for name in observations.cameras if name not in camera_by_name
        ]
        if missing_names:
            advice = ": is it that of this capture?"
            raise uncalibrated_error(missing_names[0], cameras, advice)
        matched_cameras = tuple(camera_by_name[name] for name in observations.cameras)
    else:
        matched_cameras = cameras.cameras
        if len(matched_cameras) != camera_count:
            message = f"holds {counted(len(matched_cameras), 'camera')}, "
            message += f"but the observations have {camera_count}"
            hint = "use the calibration of this capture, or write camera_names in the "
            hint += "observations to tell which cameras they are"
            raise OptionError(Fault("CAM011", message, path, (), hint))
    if camera_count < 2:
        message = "one camera sees no depth: at least two are needed"
        raise OptionError(Fault("CAM012", message, observations.path or path))
    return replace(cameras, cameras=matched_cameras)
