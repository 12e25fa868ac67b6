"""Figures of irregular takes on other rigs: maps, motions, scores and notices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from retarget.test_balls import with_toes
from support.figures import check_figures
from support.people import named, person

from animtool import Channel, Motion, Rig, Take, open_source
from animtool.core.units import UpAxis, up_from_up
from animtool.maths import so3
from animtool.motion.passes import PassContext, apply_pass, find_pass
from animtool.motion.take import TakeStream
from animtool.retarget import map_joints, map_text, retarget_take
from animtool.retarget.anatomy import find_anatomy
from animtool.retarget.facts import measure_capture
from animtool.retarget.fingers import _digits_by_position
from animtool.retarget.options import RetargetOptions
from animtool.retarget.report import fit_scores
from animtool.retarget.roled_skeleton import RoledSkeleton
from animtool.retarget.standing import (
    find_standing_axis,
    measure_stance,
    standing_directions,
)
from animtool.retarget.take_pass import retarget_stream
from animtool.rig.kinematics import rest_world
from animtool.rig.skeleton import Joint

ROOT = Path(__file__).parents[2]
BIPED = ROOT / "rigs/biped/biped.rig.yaml"


@cache
def taken(name: str, count: int = 36) -> Take:
    """Return the first frames of a sample."""
    take = open_source(ROOT / f"samples/retarget/takes/{name}.bvh").collect()
    motion = take.motion.select(slice(0, count))
    return replace(take, motion=motion, clock=replace(take.clock, count=motion.frames))


def uneven(take: Take, seed: int = 3) -> Take:
    """Return a take whose joints shake, and that leans, turns and drifts."""
    rng = np.random.default_rng(seed)
    places, turns = take.motion.translations.dense(), take.motion.rotations.dense()
    count = len(places)
    shakes = np.cumsum(rng.normal(0, 0.01, turns[..., :3].shape), axis=0)
    turns = so3.multiply(turns, so3.exp(shakes))
    lean = so3.exp(np.linspace(0, 1, count)[:, None] * [0.05, 0.5, -0.1])
    turns[:, 0] = so3.multiply(lean, turns[:, 0])
    places[:, 0] = so3.rotate(lean, places[:, 0])
    places[:, 0] += np.linspace(0, 1, count)[:, None] * [0.1, 0.01, -0.05]
    made = Channel.from_dense(places), Channel.from_dense(so3.align_signs(turns))
    return replace(take, motion=Motion(*made))


@cache
def odd_biped() -> Rig:
    """Return the biped with longer forearms and shins, one side more than the other."""
    rig = Rig.load(BIPED)
    longer = {"hand_l": 1.2, "hand_r": 1.1, "foot_l": 0.9, "foot_r": 0.93}
    joints = tuple(
        replace(
            joint,
            translation=tuple(
                longer.get(joint.name, 1.0) * x for x in joint.translation
            ),
        )
        for joint in rig.joints
    )
    return replace(rig, joints=joints)


def in_order(joints: Sequence[Joint]) -> tuple[Joint, ...]:
    """Return joints behind their parents, those of each the other way round."""
    order: list[int] = []

    def walk(j: int) -> None:
        order.append(j)
        for child in reversed([k for k, one in enumerate(joints) if one.parent == j]):
            walk(child)

    walk(0)
    place = {j: i for i, j in enumerate(order)}
    return tuple(
        replace(joints[j], parent=place.get(joints[j].parent, -1)) for j in order
    )


def reordered(rig: Rig) -> Rig:
    return replace(rig, joints=in_order(rig.joints))


def without_paths(report: Any) -> dict[str, Any]:
    return {key: value for key, value in asdict(report).items() if key != "notices"}


@pytest.mark.parametrize("name", ["kick", "jump", "lift"])
def test_irregular_takes_on_an_uneven_rig(name: str) -> None:
    take, rig = uneven(taken(name)), odd_biped()
    found = map_joints(take.rig, rig)
    made = retarget_take(take, rig, found, hands=name == "lift")
    scores = fit_scores(made.report)
    check_figures(
        __file__,
        name,
        {
            "motion": list(made.take.motion.dense())[:2],
            "report": without_paths(made.report),
            "scores": [asdict(score) for score in scores.scores],
            "names": dict(scores.names),
        },
    )


def test_what_is_said_of_a_take_frame_by_frame() -> None:
    take = uneven(taken("turn", 40), 7)
    turns = take.motion.rotations.dense()
    shakes = so3.exp(np.random.default_rng(8).normal(0, 0.7, (8, turns.shape[1], 3)))
    turns[12:20] = so3.multiply(turns[12:20], shakes)
    rotations = Channel.from_dense(so3.align_signs(turns))
    take = replace(take, motion=replace(take.motion, rotations=rotations))
    made, _, notices = retarget_stream(
        TakeStream.of(take), odd_biped(), RetargetOptions()
    )
    blocks = list(made.blocks())
    assert sum(block.frames for block in blocks) == 40
    verdict = made.verdict()
    assert any(reason.frames for reason in verdict.reasons)
    found = {
        "verdict": asdict(verdict),
        "report": without_paths(made.report()),
        "notices": notices,
    }
    check_figures(__file__, "verdict", found)


def turned_about(rig: Rig, turn: np.ndarray, **changes: Any) -> Rig:
    """Return a rig that is turned as a whole."""
    first = rig.joints[0]
    root = replace(
        first,
        translation=tuple(so3.rotate(turn, np.array(first.translation)).tolist()),
        rotation=tuple(so3.multiply(turn, np.array(first.rotation)).tolist()),
    )
    return replace(rig, joints=(root, *rig.joints[1:]), **changes)


def mitten(role: str) -> str:
    """Return the name of a joint of who has all fingers in one."""
    digits = ("index", "middle", "ring", "pinky", "thumb")
    kept = role[:-2] in {"index_1", "index_2", "thumb_1"}
    if role.startswith(digits) and not kept:
        return ""
    return role.replace("index_1", "fingers").replace("index_2", "fingers2")


RIGS: dict[str, Rig] = {
    "z up": turned_about(
        person(metacarpals=True)[0],
        np.array(up_from_up(UpAxis.Z, UpAxis.Y)),
        up=UpAxis.Z,
    ),
    "sideways": turned_about(person(fingers=False)[0], so3.exp([0.0, 1.1, 0.0])),
    "mitten": person(mitten)[0],
    "no toes": person(lambda role: "" if role.startswith("toe") else role)[0],
}


@pytest.mark.parametrize(
    ("rig", "name"),
    [("z up", "sneak"), ("sideways", "carry"), ("mitten", "wave"), ("no toes", "sit")],
)
def test_takes_on_rigs_of_other_kinds(rig: str, name: str) -> None:
    take, target = uneven(taken(name, 24), 5), RIGS[rig]
    made = retarget_take(take, target, map_joints(take.rig, target), hands=True)
    back = retarget_take(made.take, take.rig, map_joints(target, take.rig))
    check_figures(
        __file__,
        rig,
        {
            "motion": list(made.take.motion.dense())[:2],
            "report": without_paths(made.report),
            "back": list(back.take.motion.dense())[:2],
        },
    )


@pytest.mark.parametrize(("toes", "bones"), [(0, 1), (2, 3), (3, 1)])
def test_takes_on_feet_of_other_toes(toes: int, bones: int) -> None:
    walk = open_source(ROOT / "samples/walk/walk.bvh").collect()
    motion = walk.motion.select(slice(5, 29))
    take = replace(walk, motion=motion, clock=replace(walk.clock, count=24))
    rig = with_toes(take.rig, toes, bones, shin=1.1, tip=0.6)
    made = retarget_take(take, rig, map_joints(take.rig, rig))
    balls = [made.transfer.target.balls.get(side) for side in "lr"]
    check_figures(
        __file__,
        f"toes {toes}",
        {
            "motion": list(made.take.motion.dense())[:2],
            "report": without_paths(made.report),
            "balls": balls,
        },
    )


def passed(take: Take, name: str, **options: Any) -> dict[str, Any]:
    own, context = find_pass(name), PassContext(open_source, Path())
    stream = apply_pass(TakeStream.of(take), own, own.options(**options), context)
    made = stream.collect()
    codes = [f"{notice.code} {notice.message}" for notice in context.notices]
    codes += [f"{notice.code} {notice.message}" for notice in stream.notices]
    return {
        "motion": list(made.motion.dense())[:2],
        "codes": codes,
        "scores": [[asdict(s) for s in one.scores] for one in context.scores],
    }


@pytest.mark.parametrize(
    ("label", "name", "options"),
    [
        ("rest", "retarget", {"rig": BIPED, "rest": 3, "warn_above": 0.0}),
        ("as rig", "retarget", {"rig": BIPED, "rest": "rig", "free_feet": True}),
        ("feet", "feet", {}),
        ("drift", "root_drift", {"heading": True}),
    ],
)
def test_passes_of_persons(label: str, name: str, options: dict[str, Any]) -> None:
    made = passed(uneven(taken("march")), name, **options)
    check_figures(__file__, label, made)


@pytest.mark.parametrize(
    "preset", ["mixamo", "ue5_manny", "vrm0", "cmu_bvh", "smpl", ""]
)
def test_maps_of_conventions(preset: str) -> None:
    rig, _ = person(named(preset) if preset else str, metacarpals=True)
    rig = reordered(rig)
    target = odd_biped()
    known = find_anatomy(rig)
    found = map_joints(rig, target)
    check_figures(
        __file__,
        f"map {preset}",
        {
            "roles": known.roles,
            "found": known.evidence,
            "confidence": known.confidence,
            "text": map_text(found, rig, target),
            "back": map_text(map_joints(target, rig), target, rig),
        },
    )


def without(*parts: str) -> Rig:
    """Return a person who lacks joints."""
    return person(lambda role: "" if role.startswith(parts) else role)[0]


def hung_elsewhere(joint: str, above: str) -> Rig:
    """Return a person of whom a joint hangs on another one, in its place."""
    rig, _ = person()
    places = rest_world(rig).positions[0]
    j, parent = rig.index(joint), rig.index(above)
    off = tuple((places[j] - places[parent]).tolist())
    joints = list(rig.joints)
    joints[j] = replace(joints[j], parent=parent, translation=off)
    return replace(rig, joints=in_order(joints))


BODIES: dict[str, Rig] = {
    "fingers": person()[0],
    "metacarpals": person(metacarpals=True)[0],
    "four": without("pinky"),
    "two": without("pinky", "ring", "middle"),
    "mitten": person(mitten)[0],
    "no neck": without("neck", "spine_2", "spine_3"),
    "no head": without("head", "toe"),
    "stump": without("hand_l", "thumb_1_l", "index_1_l", "foot_r"),
    "apart": hung_elsewhere("neck", "hips"),
}


@pytest.mark.parametrize("kind", BODIES)
@pytest.mark.parametrize("named_", [True, False])
def test_bodies_of_all_kinds(kind: str, named_: bool) -> None:
    """By their names, and by where joints are."""
    rig = reordered(BODIES[kind])
    if not named_:
        joints = [replace(one, name=f"j{i}") for i, one in enumerate(rig.joints)]
        rig = replace(rig, joints=tuple(joints))
    known = find_anatomy(rig)
    body = RoledSkeleton.of(rig, known.roles)
    facing = body.facing_axes
    shown = {
        "roles": known.roles,
        "found": known.evidence,
        "confidence": known.confidence,
        "notices": known.notices,
        "facing": None if facing is None else np.asarray(facing),
        "size": body.size,
        "legs": [body.leg(side) or () for side in "lr"],
        "balls": [body.balls.get(side) for side in "lr"],
    }
    check_figures(__file__, f"body {kind} {named_}", shown)


def test_digits_of_hands_that_are_shaped_at_random() -> None:
    found = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        count = 1 + seed % 5
        positions, ways = [np.zeros(3)], []
        for _ in range(count):
            at = rng.uniform([0.02, -0.04, -0.01], [0.1, 0.04, 0.01])
            bone, way = rng.uniform([0.0, -0.03, -0.01], [0.03, 0.03, 0.01]), []
            for k in range(int(rng.integers(1, 5))):
                way.append(len(positions))
                positions.append(at + k * bone)
            ways.append(way)
        body: Any = SimpleNamespace(positions=np.array(positions))
        found.append(" ".join(_digits_by_position(body, ways, 0)))
    check_figures(__file__, "digits", found)


def test_nobody_stands_nowhere() -> None:
    none = Rig("none", ())
    empty = Motion(
        Channel.from_dense(np.zeros((3, 0, 3))), Channel.from_dense(np.zeros((3, 0, 4)))
    )
    assert find_standing_axis(none, empty, ()) is None


@pytest.mark.parametrize("name", ["kick", "run"])
def test_facts_of_takes(name: str) -> None:
    take = uneven(taken(name))
    facts = measure_capture(take)
    assert facts is not None
    roles = find_anatomy(take.rig).roles
    positions = take.world().positions
    lying = so3.rotate(np.array(up_from_up(UpAxis.Z, UpAxis.Y)), positions)
    check_figures(
        __file__,
        f"facts {name}",
        {
            "facts": asdict(facts),
            "axes": standing_directions(roles, positions),
            "stands": str(find_standing_axis(take.rig, take.motion, roles)),
            "stance": [
                measure_stance(roles, where, UpAxis.Y, rest)
                for where in (positions, lying, -positions)
                for rest in (None, positions[0], lying[0])
            ],
        },
    )
