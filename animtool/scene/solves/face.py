"""Face solves between files: landmarks, a rig, and the report."""

from __future__ import annotations

import time
from dataclasses import field, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from animtool.capture.face.capture import FaceCapture, order_landmarks, read_capture
from animtool.capture.face.file import face_model, load_landmarks
from animtool.capture.face.fit import FaceFit
from animtool.capture.face.model import FaceModel
from animtool.capture.face.solve import fit_face
from animtool.capture.options import FaceOptions
from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import (
    Fault,
    OptionError,
    Severity,
    faults_in,
    listed,
    warning,
)
from animtool.core.quantities import length_text, pixels_text
from animtool.core.record import dataclass
from animtool.core.units import UpAxis
from animtool.maths.so3 import multiply, rotate
from animtool.motion.driving import drive_take
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take, TakeStream
from animtool.rig.head import HEAD, head_joints, local_rotations
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.remap import ShapeLinks, link_shapes, load_remap
from animtool.rig.sides import pair_sides
from animtool.rig.skeleton import JointType, Rig
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.progress import Progress
from animtool.scene.solves.writing import SolvedOutput
from animtool.scene.sources.onto_rig import open_rig
from animtool.scene.sources.open import SourceOptions

if TYPE_CHECKING:
    from animtool.capture.cameras.camera import Camera
    from animtool.scene.bake.bake import OutputReport

# Rotation from a world with Z up to one with Y up.
_Y_UP_FROM_Z_UP = np.array([-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
# A neutral frame adds its own noise to all others, which is up to 1.4 times that of the
# landmarks; a fit that is so much worse has another cause [1].
MAX_NEUTRAL_RATIO = 2.0
# Frames that are fitted without it for comparison.
MAX_COMPARED_FRAMES = 24
# Shapes of a face that is not neutral, as named in a message.
MAX_NAMED_SHAPES, MIN_EXPRESSION = 3, 0.1
# Landmarks that are mirrored miss the face by more than this fraction of its size, and
# by less than this fraction of that as the mirror image.
MIN_MIRRORED_RMS, MAX_MIRRORED_RATIO = 0.01, 0.5
# A larger mean head rotation indicates that axes differ from the rig's.
MAX_MEAN_ROTATION = np.radians(75)


@dataclass(frozen=True, slots=True)
class FaceJob:
    """Arguments of `animtool mocap face`."""

    capture: Path  # npz with landmarks, or a file of markers
    rig: Path  # rig file or USD file
    output: Path | None = None  # USD file or ``.clip.yaml``; None writes nothing
    # Landmarks file of the rig; None uses the face that the capture contains.
    landmarks: Path | None = None
    remap: Path | None = None  # remap file from the capture's shapes to the rig's
    camera: Path | None = None  # camera file, for landmarks in pixels
    camera_name: str | None = None  # name of the camera, if the file has several
    options: FaceOptions = field(default_factory=FaceOptions)
    # Properties of the capture.
    source_options: SourceOptions = field(default_factory=SourceOptions)
    # Its `overwrite` and `strict` apply to all outputs.
    bake: BakeOptions = field(default_factory=BakeOptions)

    @property
    def solved_output(self) -> SolvedOutput:
        """Where to write the solved take; empty if there is no output."""
        return SolvedOutput.of(self.output, self.capture, self.bake, self.rig)


@dataclass(slots=True)
class FaceResult:
    """Report of a face solve: the fit, the linked shapes and the take."""

    job: FaceJob
    fit: FaceFit
    shape_links: ShapeLinks
    take: Take
    is_in_pixels: bool  # whether residuals are in pixels
    notices: list[Fault]
    seconds: dict[str, float]  # wall time by stage
    # Pixels a metre at the face, for landmarks in pixels.
    pixels_per_meter: float | None = None
    written: OutputReport | None = None
    json_keys: ClassVar[str] = (
        "'mocap face' source=job.capture rig=job.rig outputs frames residual_unit "
        "pixels_per_meter rms=fit.rms noise=fit.noise rounds=fit.rounds "
        "change=fit.change landmarks=fit.landmarks shapes=fit.peaks status=fit.status "
        "lost=shape_links.unlinked seconds notices"
    )

    @property
    def outputs(self) -> list[Path]:
        """Written files; empty if the solve had no output."""
        return [] if self.written is None else self.written.files

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.fit.weights)

    @property
    def residual_unit(self) -> str:
        """Unit of residuals: ``px`` for landmarks in pixels, else ``m``."""
        return "px" if self.is_in_pixels else "m"

    @property
    def moving_shape_count(self) -> int:
        """Number of shapes that move."""
        return sum(shape.max > 0 for shape in self.fit.peaks)

    @property
    def rate(self) -> float:
        """Solved frames a second."""
        return self.frames / max(self.seconds["solve"], 1e-9)


def run_face(job: FaceJob, *, progress: Progress = None) -> FaceResult:
    """Fit a face to its landmarks and write the take."""
    solved_output = job.solved_output
    solved_output.check((job.capture, job.rig, job.landmarks, job.remap, job.camera))
    result = solve_face(job, progress=progress)
    solved_output.write(TakeStream.of(result.take), result, "landmarks")
    return result


def solve_face(job: FaceJob, *, progress: Progress = None) -> FaceResult:
    """Return a face fitted to its landmarks, without writing it."""
    start_time = time.perf_counter()
    source_options = job.source_options
    capture = read_capture(
        job.capture,
        unit=source_options.unit,
        up=source_options.up,
        fps=source_options.fps,
    )
    rig, notices = open_rig(job.rig)
    remap = None if job.remap is None else load_remap(job.remap)
    model = _load_model(job, capture, rig)
    points, point_notices = order_landmarks(capture, model)
    camera, points = _undistort(job, capture, points)
    read_end_time = time.perf_counter()
    with faults_in(job.capture):
        rig_face = model
        model = _with_neutral_proportions(
            job.options, model, points, capture.is_in_pixels
        )
        fit = fit_face(
            model,
            points,
            float(capture.clock.rate),
            smooth=job.options.smooth,
            camera=camera,
            progress=progress,
        )
        up = np.array(rig.up.vector, np.float64)
        mirror_warnings = _mirror_warnings(
            job.options, rig_face, fit, points, camera, up
        )
        neutral_warnings = []
        if not mirror_warnings:
            neutral_warnings = _neutral_warnings(job.options, rig_face, fit, points)
    if mirror_warnings:
        # All landmarks are misplaced, and the head is rotated to make up for it.
        other_notices = [n for n in fit.notices if n.code not in {"FAC104", "FAC105"}]
        fit = replace(fit, notices=(*other_notices, *mirror_warnings))
    if neutral_warnings:
        # Landmarks of a face with other proportions do not match it.
        other_notices = [notice for notice in fit.notices if notice.code != "FAC105"]
        fit = replace(fit, notices=(*other_notices, *neutral_warnings))
    shape_links = link_shapes(model.shapes, [shape.name for shape in rig.shapes], remap)
    if not shape_links.links:
        message = f"{rig.name!r} has no face shape"
        hint = f"pair them with {argument('source_options.remap')}"
        raise OptionError(Fault("FAC009", message, str(job.rig), (), hint))
    head_motion = job.options.head or ("rotation" if camera is None else "none")
    if capture.up is UpAxis.Z and camera is None and job.landmarks is None:
        fit = replace(
            fit,
            rotations=multiply(_Y_UP_FROM_Z_UP, fit.rotations),
            translations=rotate(_Y_UP_FROM_Z_UP, fit.translations),
        )
    motion, head_notices = face_motion(fit, shape_links, rig, head_motion)
    if mirror_warnings:
        head_notices = [n for n in head_notices if n.code != "FAC110"]
    capture_notices = [*capture.notices, *point_notices, *fit.notices, *head_notices]
    notices += [notice.in_file(job.capture) for notice in capture_notices]
    take = drive_take(Take(rig, capture.clock, motion, tuple(notices)))
    solve_seconds = time.perf_counter() - read_end_time
    seconds = {"read": read_end_time - start_time, "solve": solve_seconds}
    pixels_per_meter = None
    if camera is not None:
        pixels_per_meter = float(camera[0] / np.median(fit.translations[:, 2]))
    return FaceResult(
        job,
        fit,
        shape_links,
        take,
        capture.is_in_pixels,
        notices,
        seconds,
        pixels_per_meter,
    )


def _load_model(job: FaceJob, capture: FaceCapture, rig: Rig) -> FaceModel:
    if job.landmarks is not None:
        return face_model(load_landmarks(job.landmarks, rig), rig)
    if capture.model is None:
        message = "does not say where its landmarks are on the rig"
        hint = f"name a landmarks file with {argument('landmarks', 'FILE')}, or store "
        hint += "the face in an npz: neutral_mm, delta_mm, shape_names"
        raise OptionError(Fault("FAC003", message, str(job.capture), (), hint))
    return capture.model


def _undistort(
    job: FaceJob, capture: FaceCapture, points: FloatArray
) -> tuple[FloatArray | None, FloatArray]:
    """Return camera intrinsics (None for positions) and undistorted landmarks."""
    if not capture.is_in_pixels:
        if job.camera is not None:
            message = f"{argument('camera')} is for landmarks in pixels, but these are "
            raise OptionError(Fault("CLI004", f"{message}positions", str(job.capture)))
        return None, points
    if job.camera is None:
        message = "landmarks are in pixels, but there is no camera"
        hint = f"set the lens of the camera with {argument('camera')} FILE"
        raise OptionError(Fault("FAC010", message, str(job.capture), (), hint))
    from animtool.capture.cameras.camera import pixel_rays
    from animtool.capture.cameras.file import load_cameras

    camera = _selected_camera(job, load_cameras(job.camera).cameras)
    intrinsics = np.array([*camera.focal, *camera.centre])
    rays = pixel_rays(camera, points)[..., :2]
    return intrinsics, rays * intrinsics[:2] + intrinsics[2:]


def _selected_camera(job: FaceJob, cameras: tuple[Camera, ...]) -> Camera:
    names = [camera.name for camera in cameras]
    if job.camera_name is None and len(cameras) == 1:
        return cameras[0]
    if job.camera_name not in names:
        message = f"unknown camera {job.camera_name!r}"
        hint = f"choose one of {', '.join(names)}"
        if job.camera_name is None:
            message = f"has {len(names)} cameras"
            example = argument("camera_name", names[0])
            hint = f"choose that of the helmet with {example}; all are "
            hint += ", ".join(names)
        raise OptionError(Fault("FAC010", message, str(job.camera), (), hint))
    return cameras[names.index(job.camera_name)]


def _with_neutral_proportions(
    options: FaceOptions, model: FaceModel, points: FloatArray, is_in_pixels: bool
) -> FaceModel:
    if options.neutral is None:
        return model
    if is_in_pixels:
        message = f"{argument('neutral')} needs landmarks in three dimensions"
        raise OptionError(Fault("CLI004", message))
    reason = ""
    if options.neutral >= len(points):
        reason = f"the capture has {len(points)} frames"
    elif np.isfinite(points[options.neutral]).all(axis=-1).sum() < 4:
        reason = "fewer than 4 landmarks in that frame"
    if reason:
        frame_text = argument("neutral", options.neutral)
        raise OptionError(Fault("FAC011", f"{frame_text}: {reason}"))
    return model.with_proportions(points[options.neutral])


def _neutral_warnings(
    options: FaceOptions, rig_face: FaceModel, fit: FaceFit, points: FloatArray
) -> list[Fault]:
    """Return a warning if landmarks fit much worse with a neutral frame (FAC111).

    ``rig_face`` has the rig's own proportions, ``fit`` used those of the neutral frame.
    ``points`` are landmarks ``(F, N, 3)`` [m].
    """
    if options.neutral is None:
        return []
    frame_indices = np.linspace(0, len(points) - 1, MAX_COMPARED_FRAMES).astype(int)
    frame_indices = np.unique([*frame_indices, options.neutral])
    rig_fit = fit_face(rig_face, points[frame_indices], 1.0, smooth=0.0)
    if fit.rms < MAX_NEUTRAL_RATIO * rig_fit.rms:
        return []
    weights = rig_fit.weights[int(np.searchsorted(frame_indices, options.neutral))]
    largest_indices = np.argsort(-weights, kind="stable")[:MAX_NAMED_SHAPES]
    shapes = [
        f"{rig_face.shapes[i]} {weights[i]:.2g}"
        for i in largest_indices.tolist()
        if weights[i] > MIN_EXPRESSION
    ]
    message = f"with {argument('neutral', options.neutral)} landmarks fit within "
    message += f"{length_text(fit.rms)}, without it within {length_text(rig_fit.rms)}: "
    message += "that frame is not neutral"
    message += f" ({listed(shapes)})" if shapes else ""
    hint = "choose a frame with a relaxed, closed face, or leave it out"
    return [warning("FAC111", message, hint)]


def _mirror_warnings(
    options: FaceOptions,
    rig_face: FaceModel,
    fit: FaceFit,
    points: FloatArray,
    camera: FloatArray | None,
    up: FloatArray,
) -> list[Fault]:
    """Return a warning if landmarks fit much better mirrored (FAC112).

    ``points`` are landmarks ``(F, N, 3)`` [m], or pixels ``(F, N, 2)`` of a camera;
    ``up`` ``(3,)`` is the up axis of the face at rest.
    """
    is_close = fit.rms < MIN_MIRRORED_RMS * rig_face.size
    if camera is None and options.neutral is None and is_close:
        return []
    frame_indices = np.linspace(0, len(points) - 1, MAX_COMPARED_FRAMES).astype(int)
    sampled_points = points[np.unique(frame_indices)]
    mirrored_points = sampled_points.copy()
    mirrored_points[..., 0] *= -1.0
    if camera is not None:
        mirrored_points[..., 0] += 2 * camera[2]
    errors = []
    for landmarks in (sampled_points, mirrored_points):
        try:
            errors.append(
                fit_face(rig_face, landmarks, 1.0, smooth=0.0, camera=camera).rms
            )
        except OptionError:  # no sampled frame has enough landmarks
            return []
    error, mirrored_error = errors
    if mirrored_error > MAX_MIRRORED_RATIO * error:
        return []
    format_distance = pixels_text if camera is not None else length_text
    message = (
        f"the landmarks fit the face within {format_distance(error)}, but within "
        f"{format_distance(mirrored_error)} when mirrored"
    )
    hint = "negate x of the landmarks"
    if camera is not None:
        hint = "replace each u with the width of the image minus u"
        if _is_upside_down(rig_face, points, up):
            message += "; the face is upside down in the image"
            hint = "replace each v with the height of the image minus v, as v counts "
            hint += "from the upper edge"
            return [warning("FAC112", message, hint)]
    if pair_sides(rig_face.names).left:
        hint += ", or swap the names of left and right landmarks"
    return [warning("FAC112", message, hint)]


def face_motion(
    fit: FaceFit, shape_links: ShapeLinks, rig: Rig, head_mode: str
) -> tuple[Motion, list[Fault]]:
    """Return shape weights and head pose as motion of a rig, and warnings.

    Args:
        fit: The face over frames.
        shape_links: Mapping from the shapes of the face to those of the rig.
        rig: The rig.
        head_mode: ``rotation``, ``pose`` or ``none``.
    """
    frame_count = len(fit.weights)
    weights = shape_links.apply(fit.weights, len(rig.shapes))
    rotations = Channel.static(rig.rest_rotations, frame_count)
    translations = Channel.static(rig.rest_translations, frame_count)
    notices: list[Fault] = []
    joint = head_joints(rig).get(HEAD)
    if head_mode != "none" and joint is None:
        message = "the rig has no joint called head: head motion is ignored"
        notices.append(Fault("FAC109", message, severity=Severity.NOTE))
    elif head_mode != "none" and joint is not None:
        mean_rotation = np.abs(fit.rotations[:, 3]).mean()
        if 2 * np.arccos(min(float(mean_rotation), 1.0)) > MAX_MEAN_ROTATION:
            message = "the head faces far away from the rig's in most frames"
            hint = f"set the up axis with {argument('source.up')}; "
            hint += f"{argument('head', 'none')} ignores head motion"
            notices.append(warning("FAC110", message, hint))
        head_rotations = local_rotations(rig, joint, fit.rotations)
        rotations = rotations.put(np.array([joint]), head_rotations[:, None])
        if head_mode == "pose":
            translations, translation_notices = _head_translations(
                fit, rig, joint, translations
            )
            notices += translation_notices
    motion = Motion(
        translations.compact(),
        rotations.compact(),
        weights=Channel.from_dense(weights[..., None]),
    )
    return motion, notices


def _head_translations(
    fit: FaceFit, rig: Rig, joint: int, translations: Channel
) -> tuple[Channel, list[Fault]]:
    """Return root translations that move the head to its fitted position."""
    root_index = rig.upwards(joint)[-1]
    if rig.joints[root_index].type is not JointType.FREE:
        message = f"the root {rig.joints[root_index].name!r} is not a free joint: "
        message += "the head motion is ignored"
        return translations, [Fault("FAC109", message, severity=Severity.NOTE)]
    rest_pose = forward_kinematics(
        rig, rig.rest_translations[None], rig.rest_rotations[None]
    )
    joint_position = rest_pose.positions[0, joint]
    # The head rotates about its joint, so only the joint is moved.
    joint_positions = np.broadcast_to(joint_position, fit.translations.shape)
    head_offsets = rotate(fit.rotations, joint_positions)
    shift = head_offsets + fit.translations - joint_position
    root_translations = rig.rest_translations[root_index] + shift
    return translations.put(np.array([root_index]), root_translations[:, None]), []


def _is_upside_down(rig_face: FaceModel, pixels: FloatArray, up: FloatArray) -> bool:
    """Return whether the upper landmarks of a face are the lower ones in images.

    ``pixels`` are ``(F, N, 2)``, with v from the upper edge.
    """
    rows = pixels[..., 1]
    is_visible = np.isfinite(rows).all(axis=1)
    if not is_visible.any():
        return False
    rows, heights = rows[is_visible].mean(axis=0), rig_face.neutral @ up
    return float((rows - rows.mean()) @ (heights - heights.mean())) > 0.0
