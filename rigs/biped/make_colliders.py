"""Make the colliders of the biped: capsules that fill its body, carried by its joints.

They begin along the bones and are fitted to the skin all together: each of its points
is to be on the surface of the capsule that it is deepest in or nearest to. The left
half is fitted and mirrored; capsules of the trunk lie across it. Fingers have none.

Usage: ``python make_colliders.py [RIG]``: writes the last section of ``RIG`` anew, the
file ``biped.rig.yaml`` beside this one unless given.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from make_body import Segments, body_field, hand_field, read_joints
from solids import Array, length

HEADING = "colliders:   # made by make_colliders.py\n"
ROUNDS = 60
# A point this far off counts half of what it would [m].
ROBUST = 0.01
# What is this deep in another surface is not seen [m].
HIDDEN = 0.003
# How firmly numbers stay where they are in a round, and near where they began [1].
STEADY, HOLD = 0.1, 0.02
FINGERS = ("thumb", "index", "middle", "ring", "pinky")

# What may vary of capsules anywhere, across the trunk, and in the middle.
FREE = np.eye(6)
ACROSS = np.array([[-1, 0, 0, 1, 0, 0], [0, 1, 0, 0, 1, 0], [0, 0, 1, 0, 0, 1.0]]).T
MIDDLE = np.eye(6)[:, [1, 2, 4, 5]]

Point = tuple[float, float, float]
Pair = tuple[float, float]


@dataclass(frozen=True)
class Part:
    """A capsule at rest.

    Attributes:
        joint: What carries it.
        ends: Of its axis ``(2, 3)`` [m].
        radius: [m]
        ways: What may be fitted of both ends, ``(6, P)``.
    """

    joint: str
    ends: Array
    radius: float
    ways: Array


def limb(joint: str, start: Point, end: Point, radius: float) -> Part:
    """Return a capsule of the left side, both ends of which may go anywhere."""
    return Part(joint, np.array([start, end]), radius, FREE)


def across(joint: str, y: float, z: float, half: float, radius: float) -> Part:
    """Return a capsule across the trunk: half its length, y and z may vary."""
    return Part(joint, np.array([[-half, y, z], [half, y, z]]), radius, ACROSS)


def upright(joint: str, low: Pair, high: Pair, radius: float) -> Part:
    """Return a capsule in the middle: y and z of both ends may vary."""
    return Part(joint, np.array([[0.0, *low], [0.0, *high]]), radius, MIDDLE)


PARTS = (
    across("hips", 0.88, -0.04, 0.08, 0.09),
    across("hips", 0.97, 0.00, 0.05, 0.10),
    across("spine_1", 1.06, 0.00, 0.04, 0.10),
    across("spine_2", 1.15, 0.00, 0.04, 0.10),
    across("spine_3", 1.25, 0.00, 0.05, 0.11),
    across("spine_4", 1.34, 0.01, 0.08, 0.09),
    across("spine_4", 1.42, -0.02, 0.06, 0.060),
    limb("clavicle_l", (0.09, 1.42, -0.02), (0.16, 1.42, -0.020), 0.060),
    upright("neck_1", (1.48, -0.020), (1.55, 0.000), 0.055),
    upright("head", (1.58, 0.035), (1.64, 0.030), 0.060),
    upright("head", (1.66, -0.020), (1.67, 0.010), 0.075),
    limb("hip_l", (0.095, 0.87, 0.00), (0.093, 0.70, 0.005), 0.080),
    limb("hip_l", (0.093, 0.70, 0.00), (0.092, 0.50, 0.012), 0.063),
    limb("knee_l", (0.092, 0.47, 0.00), (0.091, 0.28, -0.010), 0.055),
    limb("knee_l", (0.091, 0.28, 0.00), (0.090, 0.10, -0.012), 0.046),
    limb("ankle_l", (0.092, 0.05, -0.03), (0.097, 0.04, 0.080), 0.042),
    limb("toe_l", (0.097, 0.04, 0.09), (0.098, 0.035, 0.150), 0.036),
    limb("shoulder_l", (0.19, 1.43, -0.02), (0.44, 1.43, -0.02), 0.050),
    limb("elbow_l", (0.47, 1.43, -0.02), (0.57, 1.43, -0.02), 0.044),
    limb("forearm_l", (0.58, 1.43, -0.02), (0.68, 1.43, -0.02), 0.038),
    limb("wrist_l", (0.70, 1.43, -0.010), (0.78, 1.43, 0.000), 0.018),
    limb("wrist_l", (0.70, 1.43, -0.030), (0.78, 1.43, -0.040), 0.018),
)


def outside(points: Array, part: Part) -> tuple[Array, Array, Array]:
    """Return how far points are outside a capsule, the way out, and where on its axis.

    Args:
        points: ``(V, 3)`` [m].
        part: The capsule.

    Returns:
        Distances ``(V,)`` [m], directions ``(V, 3)`` and shares ``(V,)`` [1].
    """
    start, axis = part.ends[0], part.ends[1] - part.ends[0]
    square = max(float(axis @ axis), 1e-12)
    share = np.clip((points - start) @ axis / square, 0.0, 1.0)
    apart = points - start - share[:, None] * axis
    far = length(apart)
    return far - part.radius, apart / np.maximum(far, 1e-12)[:, None], share


def nearer(part: Part, points: Array, begun: Part) -> Part:
    """Return a capsule brought nearer to points ``(V, 3)``, by one step of Newton's."""
    off, way, share = outside(points, part)
    slopes = np.concatenate(
        [
            -np.hstack([(1 - share)[:, None] * way, share[:, None] * way]) @ part.ways,
            -np.ones((len(points), 1)),
        ],
        axis=1,
    )
    weights = 1 / (1 + (off / ROBUST) ** 2)
    gone = np.append(
        np.linalg.lstsq(part.ways, (begun.ends - part.ends).ravel(), rcond=None)[0],
        begun.radius - part.radius,
    )
    count = len(points)
    matrix = slopes.T @ (weights[:, None] * slopes)
    matrix += (STEADY + HOLD) * count * np.eye(len(matrix))
    step = np.linalg.solve(matrix, HOLD * count * gone - slopes.T @ (weights * off))
    ends = part.ends + (part.ways @ step[:-1]).reshape(2, 3)
    return replace(part, ends=ends, radius=part.radius + step[-1])


def fitted(points: Array) -> list[Part]:
    """Return the capsules, fitted to points of the skin ``(V, 3)`` [m]."""
    parts = list(PARTS)
    for _ in range(ROUNDS):
        off = np.stack([outside(points, part)[0] for part in parts])
        nearest = off.argmin(axis=0)
        parts = [
            nearer(part, points[nearest == k], PARTS[k]) for k, part in enumerate(parts)
        ]
    return parts


def skin(places: dict[str, Array], bones: Segments) -> Array:
    """Return the points of the left half of body and palm ``(V, 3)`` [m].

    Those that hide where hand and sleeve overlap are left out.
    """
    with np.load(Path(__file__).with_name("body.npz")) as body:
        points = body["points"].astype(np.float64)
        most = body["weights"].argmax(axis=1)
        carriers = body["indices"][np.arange(len(points)), most]
    finger = np.array([name.startswith(FINGERS) for name in places])[carriers]
    points = points[(points[:, 0] >= 0) & ~finger]
    deep = np.minimum(body_field(points), hand_field(points, places, bones))
    return np.asarray(points[deep > -HIDDEN])


def mirrored(part: Part) -> Part:
    """Return the capsule of the right side."""
    flip = np.array([-1.0, 1.0, 1.0])
    return replace(part, joint=part.joint[:-2] + "_r", ends=part.ends * flip)


def entry(part: Part, place: Array) -> str:
    """Return a line of the rig file: a capsule in the frame of a joint [m]."""
    axis = part.ends[1] - part.ends[0]
    far = float(length(axis))
    written = {
        "radius": number(part.radius),
        "length": number(far),
        "axis": numbers(axis / far),
        "offset": numbers(part.ends.mean(axis=0) - place),
    }
    inner = ", ".join(f"{name}: {text}" for name, text in written.items())
    return f"- {{joint: {part.joint}, capsule: {{{inner}}}}}\n"


def number(value: float) -> str:
    """Return a number to the tenth of a millimetre."""
    return f"{round(value, 4) + 0.0:.4f}".rstrip("0").rstrip(".")


def numbers(vector: Array) -> str:
    """Return a list of numbers."""
    return "[" + ", ".join(number(value) for value in vector.tolist()) + "]"


def section(rig: Path) -> str:
    """Return the section of the rig file."""
    _, places, bones = read_joints(rig)
    left = fitted(skin(places, bones))
    every = [
        each
        for part in left
        for each in ([part, mirrored(part)] if part.joint.endswith("_l") else [part])
    ]
    return HEADING + "".join(entry(part, places[part.joint]) for part in every)


def main() -> None:
    """Write the section into the file named on the command line."""
    parser = argparse.ArgumentParser(description="Make the colliders of the biped.")
    props = Path(__file__).with_name("biped.rig.yaml")
    parser.add_argument("rig", nargs="?", type=Path, default=props)
    rig: Path = parser.parse_args().rig
    kept, _, _ = rig.read_text("utf-8").partition("colliders:")
    rig.write_text(kept + section(props), "utf-8")


if __name__ == "__main__":
    main()
