"""Adds IK targets to a page, as markers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from animtool.core.array_types import FloatArray, IntArray
from animtool.core.clock import Clock
from animtool.core.units import UpAxis, up_from_up
from animtool.ik.file import load_targets
from animtool.ik.goals import Targets
from animtool.ik.tracks import TargetTracks
from animtool.maths import so3
from animtool.preview.draft import PageDraft, skip_unreadable
from animtool.preview.takes import PageTake
from animtool.rig.kinematics import WorldTransforms, bind_matrices
from animtool.rig.skeleton import Joint, Rig

# Per kind of goal: column of the weights, sRGB color, and marker radius [m].
_GOAL_STYLES = {
    "position": ("positions", 0, (0.70, 0.04, 0.10), 0.024),
    "aim": ("aims", 2, (0.75, 0.30, 0.02), 0.018),
    "pole": ("poles", 3, (0.10, 0.20, 0.62), 0.018),
}


def add_targets(
    draft: PageDraft, tracks: TargetTracks, page_take: PageTake | None, up: UpAxis | str
) -> None:
    """Add goal positions as markers, in the frames in which they are active.

    Args:
        draft: The page.
        tracks: The goals, read without a rig.
        page_take: The take that the goals apply to; None if there is none.
        up: Up axis of that take's file.
    """
    with skip_unreadable(draft, f"targets {tracks.path.name!r}"):
        samples = _covered_samples(draft, tracks)
        if not len(samples):
            draft.add_notice(f"targets {tracks.path.name!r} have other frames")
            return
        up_rotation = up_from_up(UpAxis.Y, UpAxis(up))
        rig, world = _posed_targets(tracks, page_take, samples, up_rotation)
        rig = replace(rig, up=UpAxis(up))
        if page_take is not None:
            tracks = load_targets(tracks.path, rig)
        clock = _targets_clock(draft, tracks, samples)
        targets = tracks.at_clock(clock).sample(rig, clock, world)
        _add_markers(draft, tracks, targets, samples, up_rotation)


def _covered_samples(draft: PageDraft, tracks: TargetTracks) -> IntArray:
    """Return the page samples within the frame range of the targets file ``(A,)``."""
    fps = draft.timeline.fps
    codes = draft.timeline.codes * float((tracks.fps or fps) / fps)
    first = -np.inf if tracks.first is None else float(tracks.first)
    last = np.inf if tracks.last is None else float(tracks.last)
    return np.flatnonzero((codes >= first - 1e-6) & (codes <= last + 1e-6))


def _targets_clock(draft: PageDraft, tracks: TargetTracks, samples: IntArray) -> Clock:
    """Return the clock of the page samples that the targets cover."""
    timeline = draft.timeline
    fps = tracks.fps or timeline.fps
    rate_ratio = fps / timeline.fps
    first = (timeline.first + int(samples[0]) * timeline.step) * rate_ratio
    return Clock(fps, first, timeline.step * rate_ratio, len(samples))


def _posed_targets(
    tracks: TargetTracks,
    page_take: PageTake | None,
    samples: IntArray,
    up_rotation: object,
) -> tuple[Rig, WorldTransforms]:
    """Return the rig that the targets refer to, and its pose in the file's up axis."""
    if page_take is None or not page_take.frames:
        joint_names = dict.fromkeys(goal.goal.joint for goal in tracks.goals)
        rig = Rig(
            Path(tracks.path).stem, tuple(Joint(name, -1) for name in joint_names)
        )
        bind = bind_matrices(rig)[None].repeat(len(samples), axis=0)
        return rig, WorldTransforms(bind[..., :3, 3], bind[..., :3, :3])
    take_frames = np.clip(samples - page_take.first_sample, 0, page_take.frames - 1)
    world = page_take.world(slice(int(take_frames.min()), int(take_frames.max()) + 1))
    take_frames = take_frames - take_frames.min()
    positions, linear = world.positions[take_frames], world.linear[take_frames]
    if up_rotation is not None:
        to_file_axes = so3.to_matrix(np.array(up_rotation)).T
        positions, linear = positions @ to_file_axes.T, to_file_axes @ linear
    return page_take.rig, WorldTransforms(positions, linear)


def _add_markers(
    draft: PageDraft,
    tracks: TargetTracks,
    targets: Targets,
    samples: IntArray,
    up_rotation: object,
) -> None:
    """Add the goals of each kind as markers; inactive goals are NaN."""
    weights = np.asarray(targets.weights)
    for kind, (field_name, weight_column, color, radius) in _GOAL_STYLES.items():
        active_indices = [
            goal_index
            for goal_index, track in enumerate(tracks.goals)
            if track.goal.weights[weight_column] > 0
        ]
        if not active_indices:
            continue
        points: FloatArray = np.asarray(getattr(targets, field_name), np.float64)[
            :, active_indices
        ]
        if up_rotation is not None:
            points = so3.rotate(np.array(up_rotation), points)
        points = np.where(
            weights[:, active_indices, weight_column, None] > 0, points, np.nan
        )
        all_positions = np.full((draft.timeline.count, len(active_indices) * 3), np.nan)
        all_positions[samples] = points.reshape(len(samples), -1)
        if not np.isfinite(all_positions).any():
            continue
        label = "" if kind == "position" else f" {kind}"
        draft.add_points(
            f"{tracks.path.name}{label}",
            draft.add_positions(all_positions),
            radius=radius,
            color=color,
            names=[f"{tracks.goals[i].name}{label}" for i in active_indices],
        )
