"""Bones and offsets of a subject who is not the template's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.clouds import cloud, template
from support.figures import check_figures
from support.marked import FIGURE, TEMPLATE, Captured, captured, moving
from support.mocap_skeleton import rig_of, template_of

from animtool.capture.options import SolveOptions
from animtool.capture.solve import calibrate, solve_markers
from animtool.capture.solve.calibration import (
    BONE_DEVIATION,
    OFFSET_DEVIATION,
    OVERALL_DEVIATION,
    SIDE_DEVIATION,
    _CalibrationState,
    rig_without_limits,
    scale_rig_bones,
)
from animtool.capture.solve.model import build_marker_problem
from animtool.capture.templates import MarkerTemplate
from animtool.core.errors import OptionError
from animtool.rig.parts import Mesh
from animtool.rig.skeleton import Rig

FPS = 100.0
SCALES = np.array([1.0, 1.1, 0.93, 1.08, 0.93, 1.08])
# Where the hips are along the only bone that begins there, the template alone says.
TOLERANCES = np.array([0.0, 0.03, 0.005, 0.005, 0.005, 0.005])


def subject() -> tuple[Rig, MarkerTemplate]:
    """Return a rig and a template that are somebody's."""
    rng = np.random.default_rng(3)
    markers = tuple(
        replace(m, offset=tuple(np.add(m.offset, rng.normal(scale=0.008, size=3))))
        for m in TEMPLATE.markers
    )
    return scale_rig_bones(FIGURE, SCALES), replace(TEMPLATE, markers=markers)


def takes() -> tuple[Captured, Captured]:
    """Return a static take and one that moves, of the subject."""
    rig, template = subject()
    still = captured(moving(20, FPS, 1, 0.01), FPS, rig=rig, template=template)
    motion = captured(moving(600, FPS, 2, 1.2), FPS, rig=rig, template=template)
    return still, motion


def test_bones_are_those_of_the_subject() -> None:
    still, motion = takes()
    found = calibrate(motion.markers, FIGURE, TEMPLATE, static=still.markers)
    assert found.converged
    assert (np.abs(found.scales - SCALES) <= TOLERANCES).all()
    take = solve_markers(motion.markers, found.rig, found.template).take()
    away = np.linalg.norm(take.world().positions - motion.positions, axis=2)
    assert np.sqrt((away[:, 1:] ** 2).mean()) < 0.002
    assert found.noise.max() < 0.001
    assert 0.005 < np.median(found.shifts) < 0.05
    check_figures(
        __file__,
        "subject",
        {
            "scales": found.scales,
            "shifts": found.shifts,
            "noise": found.noise,
            "offsets": [marker.offset for marker in found.template.markers],
            "rest": found.rig.rest_translations,
            "notices": [notice.message for notice in found.notices],
            "bones": found.bones,
            "moved": found.marker_shifts,
            "rounds": found.rounds,
        },
    )


def test_gaps_spikes_and_skin_do_not_matter_much() -> None:
    still, motion = takes()
    rng = np.random.default_rng(8)
    points = motion.markers.positions.copy()
    points[rng.random(points.shape[:2]) < 0.1] = np.nan
    spikes = rng.random(points.shape[:2]) < 0.02
    points[spikes] += 0.1
    t = np.arange(len(points))[:, None, None] / FPS
    points[:, 6:7] += 0.004 * np.sin(9 * t + [0, 1, 2])
    markers = replace(motion.markers, positions=points)
    found = calibrate(markers, FIGURE, TEMPLATE, static=still.markers)
    assert (np.abs(found.scales - SCALES) <= 2 * TOLERANCES).all()


@pytest.mark.slow
def test_markers_at_an_end_go_with_the_bone_that_leads_there() -> None:
    """Of a person whose head hardly moves on the neck, in a walk."""
    made = cloud(1008)
    found = calibrate(
        made.markers(),
        rig_of(made.template, "generic"),
        template_of(made.template),
        static=made.markers("static_mm"),
    )
    assert found.converged
    take = solve_markers(made.markers(), found.rig, found.template).take()
    off = 1000 * take.world().positions - made.truth["joint_pos_mm"]
    assert np.sqrt((off**2).sum(axis=2).mean()) <= 5.0


def unsettled(**fixed: bool) -> _CalibrationState:
    """Return bones and offsets before any step."""
    _, motion = takes()
    markers = tuple(
        replace(m, fixed=fixed.get(m.name, False)) for m in TEMPLATE.markers
    )
    template = replace(TEMPLATE, markers=markers)
    return _CalibrationState(motion.markers, FIGURE, template, None, SolveOptions())


def test_bones_are_likely_about_a_size_of_their_own_and_sides_alike() -> None:
    """Covariance of bones without sides: 0.07^2, and 0.25^2 that all of them share."""
    work = unsettled(LWRA=True)
    bones, size = len(work.bone_joints), len(work.bone_joints) + work.offsets.size
    assert (bones, work._side_pairs()) == (5, [(1, 3), (2, 4)])
    work.scales = np.array([1.1, 0.9, 1.2, 1.0, 1.2])
    work.offsets = 1.05 * work.initial_offsets
    matrix, drawn = work._prior_equations()
    own = np.linalg.inv(BONE_DEVIATION**2 * np.eye(bones) + OVERALL_DEVIATION**2)
    sides = np.zeros((bones, bones))
    for a, b in ((1, 3), (2, 4)):
        row = np.eye(bones)[a] - np.eye(bones)[b]
        sides += np.outer(row, row) / SIDE_DEVIATION**2
    # Each marker but the held one about its place, as large as the bones it is on.
    of_bones = work._bone_weights()[:, None, :] * work.initial_offsets[:, :, None]
    names = [m.name for m in work.model.template.markers]
    of_bones[names.index("LWRA")] = 0.0
    of_bones = of_bones.reshape(-1, bones)
    left = np.concatenate([-of_bones, np.eye(work.offsets.size)], axis=1)
    wanted = left.T @ left / OFFSET_DEVIATION**2
    wanted[:bones, :bones] += own + sides
    np.testing.assert_allclose(matrix, wanted, rtol=1e-9, atol=1e-6)
    off = work.offsets.ravel() - of_bones @ work.scales
    off.reshape(-1, 3)[names.index("LWRA")] = 0.0
    pull = -left.T @ off / OFFSET_DEVIATION**2
    pull[:bones] -= own @ (work.scales - 1) + sides @ work.scales
    np.testing.assert_allclose(drawn, pull, rtol=1e-9, atol=1e-6)
    assert size == len(drawn)


def test_markers_are_as_large_as_the_bones_that_begin_at_their_joint() -> None:
    """Of the hips the chest's bone, of the chest both arms', of a wrist its own."""
    work = unsettled()
    joints = [FIGURE.joints[j].name for j in work.model.joints.tolist()]
    rows = dict(zip(joints, work._bone_weights().tolist(), strict=True))
    assert rows["hips"] == [1, 0, 0, 0, 0]
    assert rows["chest"] == [0, 0.5, 0, 0.5, 0]
    assert rows["arm_l"] == [0, 0, 1, 0, 0]
    assert rows["elbow_r"] == [0, 0, 0, 0, 1]


def test_what_noise_hides_of_bones_is_not_sure() -> None:
    work = unsettled()
    poses = work.model.start_poses(work.positions)
    work._solve_step(poses)
    assert ((work.scale_certainty > 0.9) & (work.scale_certainty < 1)).all()
    work.noise = np.full_like(work.noise, 100.0)
    work._solve_step(poses)
    assert ((work.scale_certainty > 0) & (work.scale_certainty < 0.1)).all()


def test_pins_have_no_limits_where_markers_tell_their_angle() -> None:
    generic = template("body41")
    rig, markers = rig_of(generic, "generic"), template_of(generic)
    model = build_marker_problem(rig, markers, np.arange(len(markers.markers)))
    free = rig_without_limits(model)
    freed = {
        given.name
        for given, joint in zip(model.rig.joints, free.joints, strict=True)
        if given.limits is not None and joint.limits is None
    }
    assert freed == {"LeftForeArm", "RightForeArm", "LeftLeg", "RightLeg"}


def test_a_marker_on_a_landmark_stays() -> None:
    _, motion = takes()
    markers = tuple(replace(m, fixed=m.name == "LWRA") for m in TEMPLATE.markers)
    found = calibrate(motion.markers, FIGURE, replace(TEMPLATE, markers=markers))
    kept = next(m for m in found.template.markers if m.name == "LWRA")
    place = next(m for m in TEMPLATE.markers if m.name == "LWRA")
    np.testing.assert_allclose(kept.offset, place.offset, atol=1e-12)


def test_surfaces_stay_bound_as_they_were() -> None:
    body = replace(FIGURE, meshes=(Mesh("body", None, None),))  # type: ignore[arg-type]
    found = scale_rig_bones(body, SCALES)
    assert found.bind["chest"].translation == FIGURE.joints[1].translation
    assert "hips" not in found.bind


def test_too_few_frames_are_refused() -> None:
    _, motion = takes()
    points = np.full_like(motion.markers.positions, np.nan)
    points[:5] = motion.markers.positions[:5]
    with pytest.raises(OptionError) as caught:
        calibrate(replace(motion.markers, positions=points), FIGURE, TEMPLATE)
    assert caught.value.code == "SOL006"
