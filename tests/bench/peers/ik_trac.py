"""TRAC-IK, by the bindings of pytracik: two solvers beside each other in threads."""

from math import atan2, hypot
from xml.etree import ElementTree as Tree

import numpy as np
import pytracik
from clock import Taken, now, since
from ik_problems import Array, Case, matrices
from ik_serve import Asked, OneByOne, Solver, serve

KINDS = {"pin": "revolute", "prismatic": "prismatic", "fixed": "fixed"}
# It compares each component of the miss.
SHARE = 3**-0.5


def urdf(case: Case) -> str:
    """Return the model; the link ``tip`` is the effector."""
    root = Tree.Element("robot", name="case")
    Tree.SubElement(root, "link", name="base")
    links = ["base"]
    for j, joint in enumerate(case.joints):
        links.append(f"link{j}")
        Tree.SubElement(root, "link", name=links[-1])
        kind = KINDS[joint["type"]]
        limits = joint.get("limits")
        if kind == "revolute" and not limits:
            kind = "continuous"
        made = _joint(root, f"joint{j}", kind, links[joint["parent"] + 1], links[-1])
        turn = matrices(joint["offset_r"])
        Tree.SubElement(
            made, "origin", xyz=_numbers(joint["offset_t"]), rpy=_numbers(_angles(turn))
        )
        if kind != "fixed":
            Tree.SubElement(made, "axis", xyz=_numbers(joint["axis"]))
            low, high = limits or (-np.pi, np.pi)
            Tree.SubElement(
                made,
                "limit",
                lower=repr(low),
                upper=repr(high),
                effort="1",
                velocity="1",
            )
    Tree.SubElement(root, "link", name="tip")
    end = _joint(root, "end", "fixed", links[case.owners[0] + 1], "tip")
    Tree.SubElement(
        end, "origin", xyz=_numbers(case.effectors[0]["offset"]), rpy="0 0 0"
    )
    return Tree.tostring(root, encoding="unicode")


def _joint(
    root: Tree.Element, name: str, kind: str, parent: str, child: str
) -> Tree.Element:
    made = Tree.SubElement(root, "joint", name=name, type=kind)
    Tree.SubElement(made, "parent", link=parent)
    Tree.SubElement(made, "child", link=child)
    return made


def _numbers(values: list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _angles(turn: Array) -> list[float]:
    """Return roll, pitch, yaw; exact where the pitch is a right angle too."""
    yaw = atan2(turn[1, 0], turn[0, 0])
    pitch = atan2(-turn[2, 0], hypot(turn[0, 0], turn[1, 0]))
    c, s, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    before = np.array([[c * cp, -s, c * sp], [s * cp, c, s * sp], [-sp, 0, cp]])
    rest = before.T @ turn
    return [atan2(rest[2, 1], rest[1, 1]), pitch, yaw]


class Trac(OneByOne):
    """One chain of TRAC-IK."""

    def __init__(self, case: Case) -> None:
        self.text = urdf(case)
        self.points, self.turns = case.targets["pos"][:, 0], case.targets["rot"][:, 0]
        self.made: dict[Asked, pytracik.TRAC_IK] = {}

    def places(self, pose: Array) -> tuple[Array, Array]:
        solver = self._solver(Asked(1e-4, 1e-3, 0, 0.02))
        found = np.asarray(pytracik.fk(solver, pose)).reshape(4, 4)
        return found[None, :3, :3], found[None, :3, 3]

    def _solver(self, asked: Asked) -> pytracik.TRAC_IK:
        if asked not in self.made:
            epsilon = min(asked.position, asked.angle) * SHARE
            speed = pytracik.SolveType.Speed
            self.made[asked] = pytracik.TRAC_IK(
                "base", "tip", self.text, asked.seconds, epsilon, speed
            )
        return self.made[asked]

    def one(self, start: Array, frame: int, asked: Asked) -> tuple[Array, Taken]:
        solver = self._solver(asked)
        quaternion = _quaternion(self.turns[frame])
        began = now()
        found = pytracik.ik(solver, start, *self.points[frame], *quaternion)
        taken = since(began)
        reached = found[0] >= 0
        return np.array(found[1 : len(start) + 1]) if reached else start, taken


def _quaternion(turn: Array) -> Array:
    """Return x y z w, by the largest of four."""
    trace = np.trace(turn)
    sizes = [*np.diag(turn), trace]
    largest = int(np.argmax(sizes))
    if largest == 3:
        found = [
            turn[2, 1] - turn[1, 2],
            turn[0, 2] - turn[2, 0],
            turn[1, 0] - turn[0, 1],
            1 + trace,
        ]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        found = [0.0] * 4
        found[i] = 1 + turn[i, i] - turn[j, j] - turn[k, k]
        found[j] = turn[j, i] + turn[i, j]
        found[k] = turn[k, i] + turn[i, k]
        found[3] = turn[k, j] - turn[j, k]
    return np.array(found) / np.linalg.norm(found)


def build(case: Case) -> Solver:
    return Trac(case)


if __name__ == "__main__":
    serve(build)
