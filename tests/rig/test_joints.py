from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from animtool.maths import so3
from animtool.rig.joints import (
    DRIVEN_PARTS,
    coordinate_slices,
    local_from_coordinates,
    part_hint,
    project_to_coordinates,
)
from animtool.rig.skeleton import Joint, JointType, Rig

AXIS = (2 / 3, -1 / 3, 2 / 3)
REST = (0.5, -0.5, 0.5, 0.5)


def every_type() -> Rig:
    """Return a chain with one joint of each type, all with a rest rotation."""
    return Rig(
        "all",
        tuple(
            Joint(kind.value, i - 1, kind, (0.1, 0.2, 0.3), REST, AXIS)
            for i, kind in enumerate(JointType)
        ),
    )


def test_widths() -> None:
    assert [s.stop - s.start for s in coordinate_slices(every_type())] == [
        7,
        4,
        1,
        1,
        0,
    ]


@given(st.integers(0, 1000))
def test_round_trip(seed: int) -> None:
    rig, rng = every_type(), np.random.default_rng(seed)
    q = rng.normal(size=(4, 13))
    q[:, 3:7], q[:, 7:11] = so3.normalize(q[:, 3:7]), so3.normalize(q[:, 7:11])
    q[:, 3:7], q[:, 7:11] = so3.align_signs(q[:, 3:7]), so3.align_signs(q[:, 7:11])
    q[:, 11] = rng.uniform(-1.5, 1.5, 4)
    back = project_to_coordinates(rig, local_from_coordinates(rig, q))
    assert_allclose(back, q, atol=1e-13)


def test_zero_coordinates_are_rest() -> None:
    rig = every_type()
    q = np.zeros((1, 13))
    q[:, [6, 10]] = 1
    local = local_from_coordinates(rig, q)
    assert_allclose(local.translations[0], rig.rest_translations, atol=1e-16)
    assert_allclose(local.rotations[0], rig.rest_rotations, atol=1e-16)


def test_pin_turns_about_its_axis_in_the_rest_frame() -> None:
    pin = Rig("pin", (Joint("p", -1, JointType.PIN, rotation=REST, axis=AXIS),))
    local = local_from_coordinates(pin, [[0.7]])
    kept = so3.rotate(local.rotations[0, 0], AXIS)
    assert_allclose(kept, so3.rotate(REST, AXIS), atol=1e-15)
    assert_allclose(so3.angle_between(local.rotations[0, 0], REST), 0.7, atol=1e-15)


def test_prismatic_slides_along_its_axis() -> None:
    slider = Rig("s", (Joint("s", -1, JointType.PRISMATIC, (1, 2, 3), REST, AXIS),))
    local = local_from_coordinates(slider, [[0.5]])
    assert_allclose(
        local.translations[0, 0], np.array([1, 2, 3]) + 0.5 * so3.rotate(REST, AXIS)
    )


def test_pin_angles_run_on_over_whole_turns() -> None:
    pin = Rig("pin", (Joint("p", -1, JointType.PIN, axis=(0, 0, 1)),))
    angles = np.linspace(0, 40, 200)[:, None]
    found = project_to_coordinates(pin, local_from_coordinates(pin, angles))
    assert_allclose(found, angles, atol=1e-12)


def test_what_a_joint_cannot_do_is_left_out() -> None:
    rig = every_type()
    rng = np.random.default_rng(0)
    q = rng.normal(size=(1, 13))
    local = local_from_coordinates(rig, q)
    local.translations[:, 2] += 5.0  # the pin does not slide
    back = local_from_coordinates(rig, project_to_coordinates(rig, local))
    assert_allclose(back.translations[0, 2], rig.rest_translations[2])


def test_shape() -> None:
    with pytest.raises(ValueError, match="coordinates"):
        local_from_coordinates(every_type(), np.zeros((1, 12)))


@pytest.mark.parametrize(
    ("target", "kind", "part"),
    [
        ("knee.rotateX", JointType.PIN, ".angle"),
        ("knee.rotation", JointType.PIN, ".angle"),
        ("piston.tx", JointType.PRISMATIC, ".slide"),
        ("chest.rz", JointType.BALL, ".rotation.z"),
        ("hips.translate_y", JointType.FREE, ".translation.y"),
        ("knee.angel", None, "'.angle'"),
        ("knee", JointType.PIN, ".angle"),
        ("root", JointType.FIXED, "nothing"),
    ],
)
def test_a_part_in_the_words_of_other_tools(
    target: str, kind: JointType | None, part: str
) -> None:
    assert part_hint(target, DRIVEN_PARTS, kind).endswith((part, f"{part}?", "moves"))
