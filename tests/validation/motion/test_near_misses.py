"""Motion that is nearly a fault, at other sizes and rates, and other forms of USD."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf
from support.cli import animtool
from support.planted_takes import at_frames, eased, edited, held, scaled, step, turned

from animtool.core.array_types import FloatArray
from animtool.core.clock import Clock
from animtool.core.errors import Fault, Severity
from animtool.core.rules import builtin_rules, find_rule, replaced_codes
from animtool.core.units import UpAxis
from animtool.edit.resample import resampled
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.scene.sources.open import open_source
from animtool.validation.motion.sampling import frozen_frames, repeated_frames
from animtool.validation.motion.sides import joints_without_influence
from animtool.validation.motion.size import mismatched_up_axis
from animtool.validation.motion.subject import MotionSubject
from animtool.validation.options import ValidateOptions
from animtool.validation.run import findings_in, validate
from animtool.validation.subjects.open import open_file

RULES = [rule for rule in builtin_rules().values() if rule.takes]


@pytest.fixture(scope="module")
def walking(walk: Path) -> Take:
    return open_source(walk).collect()


def subject(take: Take, codes: FloatArray | None = None) -> MotionSubject:
    def fault_at(
        code: str, joint: str, frame: float | None, message: str, hint: str
    ) -> Fault:
        return Fault(code, message, hint=hint, where=f"{joint} {frame}")

    return MotionSubject(take, fault_at, codes)


def codes(take: Take, times: FloatArray | None = None) -> list[str]:
    seen = subject(take, times)
    return [fault.code for rule in RULES for fault in rule.load()(seen)]


@pytest.mark.parametrize("kind", [JointType.FREE, JointType.PRISMATIC])
def test_what_slides_is_no_bone_that_stretches(walking: Take, kind: JointType) -> None:
    places = walking.motion.translations.dense().copy()
    j = walking.rig.index("LeftFoot")
    places[:, j] *= np.linspace(1.0, 2.0, len(places))[:, None]
    joints = list(walking.rig.joints)
    joints[j] = replace(joints[j], type=kind)
    take = replace(
        walking,
        rig=replace(walking.rig, joints=tuple(joints)),
        motion=replace(walking.motion, translations=Channel.from_dense(places)),
    )
    assert ("MOT212" in codes(take)) is (kind is JointType.FREE)


def kicked(take: Take, frames: int, degrees: float) -> Take:
    """Swing a knee up and back, fastest at the middle, over some frames."""
    turns = take.motion.rotations.dense()
    swing = np.zeros(len(turns))
    t = np.linspace(0.0, 1.0, frames)
    swing[30 : 30 + frames] = np.radians(degrees) * np.sin(np.pi * t) ** 2
    j = take.rig.index("LeftLeg")
    turn = so3.exp(np.outer(swing, [1.0, 0.0, 0.0]))
    turns[:, j] = so3.multiply(turn, turns[:, j])
    return edited(take, rotations=turns)


def test_a_fast_kick_is_no_jump(walking: Take) -> None:
    kick = kicked(walking, 12, 110.0)
    j = kick.motion.rotations.animated.tolist().index(kick.rig.index("LeftLeg"))
    steps = np.linalg.norm(subject(kick).rotation_steps[:, j], axis=1)
    assert np.degrees(steps.max()) > 20.0
    assert "MOT202" not in codes(kick)
    assert "MOT202" in codes(turned("LeftLeg", 20, slice(35, 36))(walking))


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_size_does_not_matter(walking: Take, factor: float) -> None:
    small = scaled(factor)(walking)
    assert codes(small) == []
    assert codes(step(0.08, 0)(small)) == ["MOT203"]
    assert codes(eased(-0.1, 1, 0.3, 0.6)(small)) == ["MOT209"]


@pytest.mark.parametrize("rate", [24, 60, 120])
def test_the_rate_does_not_matter(walking: Take, rate: int) -> None:
    other = resampled(walking, rate)
    assert codes(other) == []
    half = other.motion.frames // 2
    assert codes(turned("LeftArm", 20, slice(half, half + 1))(other)) == ["MOT202"]
    assert "MOT203" in codes(step(0.08, 0)(other))


def test_an_eased_hold_is_not_frozen(walking: Take) -> None:
    moves, turns, _ = walking.motion.dense()
    t = np.linspace(0.0, 1.0, 200)
    # Stops in the middle for a while, and gets going again.
    warped = np.interp(t, [0, 0.4, 0.6, 1], [0.0, 0.5, 0.5, 1.0])
    smooth = np.convolve(np.pad(warped, 10, mode="edge"), np.ones(21) / 21, "valid")
    frames = smooth * (len(turns) - 1)
    low = np.floor(frames).astype(int).clip(0, len(turns) - 2)
    share = frames - low
    between = so3.slerp(turns[low], turns[low + 1], share[:, None])
    way = moves[low] + (moves[low + 1] - moves[low]) * share[:, None, None]
    stopped = edited(walking, way, between)
    assert subject(stopped).speeds.min() < 1e-9
    assert not {"MOT205", "MOT206", "MOT207"} & set(codes(stopped))


@pytest.mark.parametrize(
    ("starts", "said"),
    [((20,), "24; "), ((20, 40), "24, and 1 more time; ")],
)
def test_a_freeze_is_said_with_how_many_there_are(
    walking: Take, starts: tuple[int, ...], said: str
) -> None:
    take = walking
    for start in starts:
        take = held(start, 4)(take)
    (fault,) = frozen_frames(subject(take))
    assert said in fault.message


@pytest.mark.parametrize(("share", "found"), [(0.03, []), (0.05, ["MOT209"])])
def test_feet_are_sunk_from_four_percent_of_the_size(
    walking: Take, share: float, found: list[str]
) -> None:
    assert codes(eased(-share, 1, 0.3, 0.6)(walking)) == found


@pytest.mark.parametrize("higher", [1.0, 1.6])
@pytest.mark.parametrize("factor", [0.01, 0.001])
def test_a_root_in_a_smaller_unit_is_found_by_where_feet_stand(
    walking: Take, factor: float, higher: float
) -> None:
    # Of a rig that rests so much higher the motion crouches.
    joints = list(walking.rig.joints)
    x, y, z = joints[0].translation
    joints[0] = replace(joints[0], translation=(x, higher * y, z))
    rig = replace(walking.rig, joints=tuple(joints))
    places = walking.motion.translations.dense().copy()
    take = replace(edited(walking, places), rig=rig)
    assert "MOT213" not in codes(take)
    places[:, 0] *= factor
    assert "MOT213" in codes(replace(edited(walking, places), rig=rig))


def lost_at(take: Take, names: tuple[str, ...], frame: int) -> Take:
    """Let some joints go twice as far in one step, and on from there."""
    turns = take.motion.rotations.dense().copy()
    for j in (take.rig.index(name) for name in names):
        turns[frame:-1, j] = turns[frame + 1 :, j]
    return edited(take, rotations=turns)


@pytest.mark.slow(0.5)
def test_a_limb_that_skips_a_frame_is_no_lost_frame(walking: Take) -> None:
    every = tuple(walking.rig.names)
    whole = [f for f in range(20, 40) if "MOT205" in codes(lost_at(walking, every, f))]
    hand = ("LeftArm", "LeftForeArm")
    limb = [f for f in range(20, 40) if "MOT205" in codes(lost_at(walking, hand, f))]
    assert (len(whole) >= 14, limb) == (True, [])


def test_a_jump_does_not_float(walking: Take) -> None:
    assert codes(eased(0.15, 1, 0.3, 0.7)(walking)) == []


def test_samples_for_motion_blur_are_no_fault(walking: Take) -> None:
    blurred = np.sort(np.concatenate([np.arange(1, 65) + o for o in (-0.25, 0, 0.25)]))
    thrice = at_frames(walking, np.repeat(np.arange(64), 3))
    found = codes(thrice, blurred)
    assert not {"MOT205", "MOT216"} & set(found)


def test_a_fault_names_joint_frame_and_remedy(walking: Take) -> None:
    seen = subject(turned("LeftLeg", 20, slice(35, 36))(walking))
    (fault,) = (f for rule in RULES for f in rule.load()(seen))
    assert "'LeftLeg' jumps by 24° from frame 35 to 36" in fault.message
    assert fault.where == "LeftLeg 35.0"
    assert "correct the frames" in (fault.hint or "")


def test_takes_that_are_too_short_for_most_rules(walking: Take) -> None:
    for count in (1, 2, 3, 5):
        assert codes(at_frames(walking, np.arange(count))) == []


def test_slower_clocks_keep_their_frames(walking: Take) -> None:
    slow = replace(walking, clock=replace(walking.clock, start=Fraction(1001)))
    seen = subject(step(0.08, 0)(slow))
    (fault,) = (f for rule in RULES for f in rule.load()(seen))
    assert "from frame 1032 to 1033" in fault.message


@pytest.fixture(scope="module")
def forms(walk: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a layer over its rig, and a library of two takes."""
    folder = tmp_path_factory.mktemp("forms")
    assert animtool("bake", walk, "-o", folder / "split.usda", "--split").code == 0
    rig = folder / "split.rig.usda"
    layer = folder / "layer.usda"
    assert animtool("bake", walk, "-o", layer, "--rig-layer", rig).code == 0
    second = folder / "second.usda"
    assert animtool("bake", walk, "-o", second).code == 0
    library = folder / "library.usda"
    assert animtool("bake", walk, second, "-o", library).code == 0
    return folder


def popped(path: Path, output: Path) -> Path:
    """Turn one joint of each animation of a file half round in one sample."""
    layer = Sdf.Layer.CreateNew(str(output))
    layer.TransferContent(Sdf.Layer.FindOrOpen(str(path)))

    def edit(place: Sdf.Path) -> None:
        if place.name == "rotations":
            rows = list(layer.QueryTimeSample(place, 30.0))
            rows[4] = rows[4] * Gf.Quatf(0.0, 1.0, 0.0, 0.0)
            layer.SetTimeSample(place, 30.0, rows)

    layer.Traverse("/", edit)
    layer.Save()
    return output


@pytest.mark.parametrize(("name", "takes"), [("layer", 1), ("library", 2)])
def test_layers_alone_and_every_take_of_a_library(
    forms: Path, name: str, takes: int
) -> None:
    clean = open_file(forms / f"{name}.usda")
    assert len(clean.takes) == takes
    assert [take.has_rest for take in clean.takes] == [name == "library"] * takes
    assert findings_in(clean) == []
    wrong = open_file(popped(forms / f"{name}.usda", forms / f"{name}_popped.usda"))
    found = [fault for fault in findings_in(wrong) if fault.code == "MOT202"]
    assert len(found) == takes
    assert len({fault.where for fault in found}) == takes


def test_codes_of_earlier_versions_are_accepted(walk: Path, tmp_path: Path) -> None:
    lines = walk.read_text("utf-8").splitlines()
    first = lines.index(next(line for line in lines if line.startswith("Frame Time")))
    row = lines[first + 30].split()
    lines[first + 30] = " ".join([*row[:20], str(float(row[20]) + 90.0), *row[21:]])
    path = tmp_path / "take.bvh"
    path.write_text("\n".join(lines) + "\n", "utf-8")
    (fault,) = validate(path)
    assert fault.code == "MOT202"
    # A BVH has no keys with an interpolation.
    assert "interp" not in str(fault.hint)
    assert validate(path, ValidateOptions(ignore=("BVH203",))) == []
    assert [f.code for f in validate(path, ValidateOptions(select=("BVH204",)))] == [
        "MOT202"
    ]
    options = ValidateOptions(severity={"CLIP203": Severity.ERROR})
    assert validate(path, options)[0].severity is Severity.ERROR
    for old, new in replaced_codes().items():
        assert find_rule(old.lower()).code == new[0]


def test_an_entry_of_ignore_may_have_an_earlier_code(tmp_path: Path) -> None:
    rig = "rig: animtool/1\nname: r\njoints: [{name: hips, type: free}]\n"
    (tmp_path / "r.rig.yaml").write_text(rig, "utf-8")
    clip = (
        "clip: animtool/1\nrig: r.rig.yaml\nfps: 24\n"
        "ignore: [{code: CLIP203, why: a cut}]\n"
        "channels: [{target: joint/hips.rotation, euler: XYZ, interp: linear, keys: "
        "[{t: 1, v: [0, 0, 0]}, {t: 9, v: [0, 0, 2]}, {t: 10, v: [80, 0, 2]}, "
        "{t: 20, v: [80, 0, 4]}]}]\n"
    )
    path = tmp_path / "c.clip.yaml"
    path.write_text(clip, "utf-8")
    assert validate(path) == []
    path.write_text(clip.replace("CLIP203", "CLIP204"), "utf-8")
    assert {fault.code for fault in validate(path)} == {"MOT203", "VAL001"}
    path.write_text(clip.replace("CLIP203", "MOT203"), "utf-8")
    assert validate(path) == []


def test_a_take_without_joints_is_looked_at_by_every_rule() -> None:
    rig = Rig("face", (), shapes=(Shape("smile"),))
    weights = np.linspace(0.0, 1.0, 30)[:, None, None]
    for values in (weights, 0.0 * weights):
        motion = Motion(
            Channel.from_dense(np.zeros((30, 0, 3))),
            Channel.from_dense(np.zeros((30, 0, 4))),
            weights=Channel.from_dense(values),
        )
        take = Take(rig, Clock(Fraction(24), Fraction(1), Fraction(1), 30), motion)
        still = values is not weights
        assert codes(take) == (["MOT201"] if still else [])


def test_repeated_frames_of_a_long_take_are_found_in_one_look(
    walking: Take, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = walking.motion.frames
    twice = at_frames(walking, list(np.repeat(np.arange(count), 2)))
    calls = []
    median = np.median
    monkeypatch.setattr(
        np, "median", lambda values, axis=None: calls.append(1) or median(values, axis)
    )
    assert "MOT207" in [f.code for f in repeated_frames(subject(twice))]
    assert len(calls) < 10


@pytest.mark.parametrize(
    ("file_format", "hint"),
    [
        ("USD", 'set upAxis = "Y"'),
        ("clip", "write up: Y in the rig"),
        ("", "read the file with up="),
    ],
)
def test_hints_on_the_up_axis_name_what_the_format_has(
    walking: Take, file_format: str, hint: str
) -> None:
    rig = replace(walking.rig, up=UpAxis.Z)
    seen = replace(subject(replace(walking, rig=rig)), file_format=file_format)
    (fault,) = mismatched_up_axis(seen)
    assert fault.code == "MOT214"
    assert str(fault.hint).startswith(hint)


def test_eyes_and_ends_need_no_weights(walking: Take) -> None:
    """An arm does, and so does a finger."""
    idle = ("eye_l", "Jaw", "LeftToeEnd", "head_end", "prop_r")
    for names, found in ((idle, 0), ((*idle, "forearm_l", "index_3_l"), 2)):
        joints = [replace(walking.rig.joints[0], name="hips")]
        joints += [Joint(name, 0) for name in names]
        rig = Rig("body", tuple(joints))
        shape = (2, len(joints))
        motion = Motion(
            Channel.from_dense(np.zeros((*shape, 3))),
            Channel.from_dense(np.broadcast_to([0.0, 0, 0, 1], (*shape, 4))),
        )
        clock = Clock(Fraction(24), Fraction(1), Fraction(1), 2)
        seen = subject(Take(rig, clock, motion))
        bound = replace(seen, influencing_joints=frozenset({"hips"}))
        faults = list(joints_without_influence(bound))
        assert len(faults) == bool(found)
        assert all(f"{found} of " in fault.message for fault in faults)
