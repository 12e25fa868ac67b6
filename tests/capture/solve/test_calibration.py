"""Bones and offsets of a subject who is not the template's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.clouds import cloud, template
from support.marked import FIGURE, TEMPLATE, Captured, captured, moving
from support.mocap_skeleton import rig_of, template_of

from animtool.capture.solve import calibrate, solve_markers
from animtool.capture.solve.calibration import with_bones, without_limits
from animtool.capture.solve.model import marker_model
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
    return with_bones(FIGURE, SCALES), replace(TEMPLATE, markers=markers)


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


def test_pins_have_no_limits_where_markers_tell_their_angle() -> None:
    generic = template("body41")
    rig, markers = rig_of(generic, "generic"), template_of(generic)
    model = marker_model(rig, markers, np.arange(len(markers.markers)))
    free = without_limits(model)
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
    found = with_bones(body, SCALES)
    assert found.bind["chest"].translation == FIGURE.joints[1].translation
    assert "hips" not in found.bind


def test_too_few_frames_are_refused() -> None:
    _, motion = takes()
    points = np.full_like(motion.markers.positions, np.nan)
    points[:5] = motion.markers.positions[:5]
    with pytest.raises(OptionError) as caught:
        calibrate(replace(motion.markers, positions=points), FIGURE, TEMPLATE)
    assert caught.value.code == "SOL006"
