"""Rigs and clips of every kind pass without a warning about their numbers."""

from __future__ import annotations

import math
import re
from itertools import pairwise
from pathlib import Path

import pytest

from animtool.validation.run import validate

# Suspicions about units, axes, times and orders.
SUSPICIONS = re.compile(
    "RIG(10[78]|11[0-2]|217)|CLIP(10[6-9]|11[0-2]|201)|TAKE0(09|10)|MOT21[345]"
)

Joints = list[str]
Keys = list[tuple[float, object]]
Channels = list[tuple[str, str, Keys]]


def scaled(joints: Joints, factor: float, turned: bool = False) -> Joints:
    """Return joints in another unit, and from Y up to Z up."""

    def row(match: re.Match[str]) -> str:
        x, y, z = (factor * float(number) for number in match[1].split(","))
        row = (x, -z, y) if turned else (x, y, z)
        return "translate: [" + ", ".join(f"{number:.6g}" for number in row) + "]"

    return [re.sub(r"translate: \[([^\]]*)\]", row, joint) for joint in joints]


def chain(names: list[str], step: str, kind: str) -> Joints:
    """Return joints in a row below a free one."""
    joints = [f"name: {names[0]}, type: free"]
    for above, name in pairwise(names):
        joints.append(f"name: {name}, parent: {above}, {kind}, translate: {step}")
    return joints


def sided(joints: Joints) -> Joints:
    """Return joints for both sides, written with S for the side and X for its sign."""
    sides = (("l", ""), ("r", "-"))
    return [j.replace("_S", f"_{s}").replace("X", x) for s, x in sides for j in joints]


BIPED = [
    "name: hips, type: free, translate: [0, 0.95, 0]",
    "name: spine, parent: hips, type: ball, translate: [0, 0.3, 0]",
    "name: head, parent: spine, type: ball, translate: [0, 0.35, 0]",
    *sided(
        [
            "name: thigh_S, parent: hips, type: ball, translate: [X0.1, -0.05, 0]",
            "name: knee_S, parent: thigh_S, type: pin, axis: [1, 0, 0], "
            "limits: [0, 140], translate: [0, -0.42, 0]",
            "name: foot_S, parent: knee_S, type: ball, translate: [0, -0.42, 0.02]",
            "name: elbow_S, parent: spine, type: pin, axis: [0, 1, 0], "
            "limits: [-145, 0], translate: [X0.5, 0.2, 0]",
        ]
    ),
]
DOG = [
    "name: pelvis, type: free, translate: [0, 60, -30]",
    "name: spine, parent: pelvis, type: ball, translate: [0, 5, 30]",
    "name: head, parent: spine, type: ball, translate: [0, 25, 40]",
    *sided(
        [
            "name: thigh_S, parent: pelvis, type: ball, translate: [X8, -5, 0]",
            "name: knee_S, parent: thigh_S, type: pin, axis: [1, 0, 0], "
            "limits: [0, 120], translate: [0, -25, 0]",
            "name: paw_S, parent: knee_S, type: ball, translate: [0, -28, 4]",
        ]
    ),
]
HAND = ["name: wrist, type: free"] + [
    f"name: {finger}_{k}, parent: {'wrist' if k == 0 else f'{finger}_{k - 1}'}, "
    f"type: ball, translate: [{0.02 * i * (k == 0):g}, 0, {0.08 / (k + 1):.3g}]"
    for i, finger in enumerate(("thumb", "index", "middle", "ring", "pinky"))
    for k in range(4)
]
INSECT = [
    "name: thorax, type: free, translate: [0, 4, 0]",
    "name: head, parent: thorax, type: ball, translate: [0, 0.5, 3]",
    *sided(
        [
            f"name: {part}{i}_S, parent: {above}, type: pin, axis: [0, 0, 1], "
            f"limits: [-80, 80], translate: {step}"
            for i in range(3)
            for part, above, step in (
                ("femur", "thorax", f"[X1.2, 0.6, {i - 1}]"),
                ("tibia", f"femur{i}_S", "[X2, -1, 0]"),
            )
        ]
    ),
]
SNAKE = chain(
    [f"s{i}" for i in range(20)],
    "[0, 0.07, 0]",
    "type: ball, limits: {swing: 25, twist: [-3, 3], twist_axis: [0, 1, 0]}",
)
ROBOT = [
    "name: base, type: fixed",
    *(
        f"name: a{i}, parent: {'base' if i == 1 else f'a{i - 1}'}, type: pin, "
        f"axis: [0, {i % 2}, {1 - i % 2}], limits: [-LIMIT, LIMIT], translate: {step}"
        for i, step in enumerate(
            ("[0, 0, 400]", "[25, 0, 0]", "[0, 0, 455]", "[420, 0, 0]"), 1
        )
    ),
]
CRANE = [
    "name: base, type: free",
    "name: mast, parent: base, type: pin, axis: [0, 1, 0], translate: [0, 2.5, 0]",
    "name: arm, parent: mast, type: pin, axis: [1, 0, 0], limits: [-40, 60], "
    "translate: [0, 0.3, 0]",
    "name: head, parent: arm, type: ball, translate: [0, 0, 12]",
]
WATCH = [
    "name: case, type: fixed",
    "name: hour, parent: case, type: pin, axis: [0, 0, 1], translate: [0, 0, 2]",
    "name: minute, parent: case, type: pin, axis: [0, 0, 1], translate: [0, 0, 3]",
]
JET = [
    "name: body, type: free",
    *sided(
        [
            "name: flap_S, parent: body, type: pin, axis: [1, 0, 0], "
            "limits: [-25, 25], translate: [X4, 0, -2]"
        ]
    ),
]
DEGREES = [joint.replace("LIMIT", "170") for joint in ROBOT]
RADIANS = [joint.replace("LIMIT", "2.967") for joint in ROBOT]
RIGS: dict[str, tuple[str, str, Joints]] = {
    "man": ("length: cm", "Y", scaled(BIPED, 100)),
    "man along Z": ("length: m", "Z", scaled(BIPED, 1, turned=True)),
    "giant": ("length: m", "Y", scaled(BIPED, 8)),
    "doll": ("length: mm", "Y", scaled(BIPED, 170)),
    "dog": ("length: cm", "Y", DOG),
    "cow": ("length: mm", "Z", scaled(DOG, 25, turned=True)),
    "hand": ("length: m", "Y", HAND),
    "hand in inches": ("length: in", "Z", scaled(HAND, 39.37)),
    "ant": ("length: mm", "Y", INSECT),
    "beetle": ("length: cm", "Y", scaled(INSECT, 0.4)),
    "snake": ("length: m", "Z", SNAKE),
    "crane": ("length: m", "Y", CRANE),
    "robot": ("length: mm, angle: rad", "Z", RADIANS),
    "robot in degrees": ("length: mm, angle: deg", "Z", DEGREES),
    "watch": ("length: mm", "Y", WATCH),
    "jet": ("length: m", "Y", JET),
}


def wave(first: float, step: float, *values: object) -> Keys:
    return [(first + step * k, value) for k, value in enumerate(values)]


def swings(*names: str) -> Channels:
    rows = wave(1, 12, [-25, 0, 0], [25, 2, 0], [-25, 0, 0])
    return [(f"joint/{name}.rotation", "euler: XYZ, ", rows) for name in names]


CLIPS: dict[str, tuple[str, Channels]] = {
    "a walk": (
        "man",
        [
            ("joint/hips.translation", "", wave(1, 24, [0, 0, 0], [0, 3, 110])),
            *swings("thigh_l", "thigh_r"),
            ("joint/knee_l.angle", "", wave(1, 8, 5, 60, 10, 5)),
        ],
    ),
    "a jump": (
        "man",
        [
            (
                "joint/hips.translation",
                "",
                wave(1, 8, [0, 0, 0], [0, -30, 0], [0, 95, 40], [0, 0, 90]),
            )
        ],
    ),
    "an idle": (
        "man",
        [
            ("joint/hips.translation", "", wave(1, 48, [0, 0, 0], [0.4, -0.5, 0])),
            (
                "joint/spine.rotation",
                "euler: XYZ, ",
                wave(1, 48, [0, 0, 0], [1.5, 0, 0]),
            ),
            ("joint/elbow_l.angle", "", wave(1, 48, -12, -14)),
        ],
    ),
    "a place": ("man", [("joint/hips.local_translation", "", [(1, [0, 95, 0])])]),
    "a blink": (
        "man",
        [
            (
                "joint/head.rotation",
                "euler: XYZ, ",
                wave(1, 1.5, [0, 0, 0], [4, 0, 0], [0, 0, 0]),
            )
        ],
    ),
    "samples between frames": (
        "man",
        [("joint/knee_l.angle", "", wave(1, 0.25, *(30 + k % 7 for k in range(99))))],
    ),
    "a retimed clip": (
        "man",
        [("joint/knee_l.angle", "", [(0, 0), (3.7, 40), (9.2, 10), (22.4, 0)])],
    ),
    "a fist": ("hand", swings("index_1", "ring_1")),
    "a slither": (
        "snake",
        [
            ("joint/s0.translation", "", wave(1, 47, [0, 0, 0], [0, 1.2, 0])),
            *[
                (
                    f"joint/s{i}.rotation",
                    "euler: XYZ, ",
                    wave(1, 24, [0, 0, 2], [0, 0, -2.5], [0, 0, 2]),
                )
                for i in range(1, 20)
            ],
        ],
    ),
    "a slow pan": (
        "crane",
        [
            ("joint/mast.angle", "", wave(1001, 99, 0, 1.5)),
            ("joint/arm.angle", "", wave(1001, 99, -20, 35)),
        ],
    ),
    "a pick": (
        "robot",
        [
            (f"joint/a{i}.angle", "", wave(1, 30, 0, 0.7 * i / 3, 0))
            for i in range(1, 5)
        ],
    ),
    "a tick": ("watch", [("joint/minute.angle", "", wave(1, 23, 0, -6))]),
    "a flight": (
        "jet",
        [
            ("joint/body.translation", "", wave(1, 95, [0, 0, 0], [0, 40, 900])),
            ("joint/flap_l.angle", "", wave(1, 48, 0, 2.5, 0)),
        ],
    ),
    "many turns": (
        "watch",
        [("joint/minute.angle", "", wave(1, 47, 0, math.tau * 360))],
    ),
}


def write_rig(folder: Path, name: str) -> Path:
    units, up, joints = RIGS[name]
    lines = "".join(f"- {{{joint}}}\n" for joint in joints)
    path = folder / "kind.rig.yaml"
    head = f"rig: animtool/1\nname: kind\nunits: {{{units}}}\nup: {up}\njoints:\n"
    path.write_text(head + lines, "utf-8")
    return path


def suspicions(path: Path) -> list[str]:
    return [str(one) for one in validate(path) if SUSPICIONS.fullmatch(one.code)]


@pytest.mark.parametrize("name", RIGS)
def test_a_rig(name: str, tmp_path: Path) -> None:
    assert suspicions(write_rig(tmp_path, name)) == []


@pytest.mark.parametrize("name", CLIPS)
def test_a_clip(name: str, tmp_path: Path) -> None:
    rig, channels = CLIPS[name]
    write_rig(tmp_path, rig)
    lines = ["clip: animtool/1", "rig: kind.rig.yaml", "fps: 24", "channels:"]
    for target, extra, keys in channels:
        rows = ", ".join(f"{{t: {t:g}, v: {v}}}" for t, v in keys)
        lines.append(f"- {{target: {target}, {extra}keys: [{rows}]}}")
    path = tmp_path / "kind.clip.yaml"
    path.write_text("\n".join(lines) + "\n", "utf-8")
    assert suspicions(path) == []


@pytest.mark.parametrize(
    ("name", "unit"), [("man", "m"), ("robot", "m"), ("hand", "mm"), ("snake", "cm")]
)
def test_a_rig_in_another_unit_is_suspected(
    name: str, unit: str, tmp_path: Path
) -> None:
    path = write_rig(tmp_path, name)
    text = re.sub("length: [a-z]+", f"length: {unit}", path.read_text("utf-8"), count=1)
    path.write_text(text, "utf-8")
    # Numbers of a snake of 1.3 fit centimetres too, of a worm.
    assert any("RIG217" in one for one in suspicions(path)) is (name != "snake")
