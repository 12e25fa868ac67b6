"""How fast animtool's forward kinematics is, beside Pinocchio, UsdSkel and loops.

Every route gets the same skeleton and rotations, and runs on one thread, in turn; see
README.md beside this file.
"""

from __future__ import annotations

import argparse
import ctypes
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mpmath
import numpy as np
import numpy.typing as npt
from clock import Taken
from figures import Accuracy, Bound, Row, ratio_rows, time_rows
from measuring import (
    begin,
    floor_work,
    floors,
    in_process,
    in_turn,
    on_one_thread,
    parser,
    run_peer,
    taken_of,
)
from pxr import Sdf, Usd, UsdSkel, Vt

from animtool.maths import so3
from animtool.rig.kinematics import WorldTransforms, forward_kinematics
from animtool.rig.skeleton import Joint, Rig

Array = npt.NDArray[np.float64]

SEED = 11
DIGITS = 50
ERROR = "largest error [m]"
# What a ratio needs: float32 is as near.
NEAR_ENOUGH = Bound(at_least=False, bound=1e-5)
OWN, INTO, ONE = "animtool", "animtool, out=", "animtool, a call a frame"
PINOCCHIO = "Pinocchio, forwardKinematics"
CONCAT = "UsdSkel, ConcatJointTransforms"
QUERY = "UsdSkel, ComputeJointSkelTransforms"
# A joint hangs from one of so many before it: chains of about 25 in 60.
NEAR = 4


@dataclass(frozen=True)
class Motion:
    """A skeleton that turns, its root that moves too.

    Attributes:
        rig: J joints.
        translations: Local ``(F, J, 3)`` [m].
        rotations: Local ``(F, J, 4)``.
        sample: Frames that are compared with many digits ``(N,)``.
    """

    rig: Rig
    translations: Array
    rotations: Array
    sample: npt.NDArray[np.int64]

    @staticmethod
    def random(joints: int, frames: int, samples: int) -> Motion:
        """Return one whose joints turn by some 30 degrees."""
        rng = np.random.default_rng(SEED)
        made = [
            Joint(
                f"j{j}",
                int(rng.integers(max(0, j - NEAR), j)) if j else -1,
                translation=tuple(rng.normal(0, 0.1, 3).tolist()),
            )
            for j in range(joints)
        ]
        rig = Rig("tree", tuple(made))
        translations = np.repeat(rig.rest_translations[None], frames, 0)
        translations[:, 0] += np.cumsum(rng.normal(0, 0.01, (frames, 3)), axis=0)
        rotations = so3.exp(rng.normal(0, 0.3, (frames, joints, 3)))
        sample = np.sort(rng.choice(frames, samples, replace=False))
        return Motion(rig, translations, rotations, sample)

    def truth(self) -> Array:
        """Return world positions ``(N, J, 3)`` of the sample, from 50 digits."""
        with mpmath.workdps(DIGITS):
            return np.array([self._frame(frame) for frame in self.sample.tolist()])

    def _frame(self, frame: int) -> list[list[float]]:
        linear: list[mpmath.matrix] = []
        places: list[mpmath.matrix] = []
        for j, parent in enumerate(self.rig.parents.tolist()):
            turn = _turn(self.rotations[frame, j].tolist())
            place = mpmath.matrix(self.translations[frame, j].tolist())
            if parent >= 0:
                place = places[parent] + linear[parent] * place
                turn = linear[parent] * turn
            linear.append(turn)
            places.append(place)
        return [[float(number) for number in place] for place in places]


def _turn(quaternion: list[float]) -> mpmath.matrix:
    x, y, z, w = map(mpmath.mpf, quaternion)
    s = 2 / (x * x + y * y + z * z + w * w)
    return mpmath.matrix(
        [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
    )


@dataclass(frozen=True)
class Route:
    """A way to the world: ``work`` is timed, ``places`` gives the sample's.

    Attributes:
        work: Does every frame.
        places: Returns world positions ``(N, J, 3)`` of the sample [m].
    """

    work: Callable[[], object]
    places: Callable[[], Array]


def animtool_route(motion: Motion, out: WorldTransforms | None = None) -> Route:
    """Return animtool's own, into new arrays or into those of before."""
    rig, t, r = motion.rig, motion.translations, motion.rotations

    def work() -> WorldTransforms:
        return forward_kinematics(rig, t, r, out=out)

    return Route(work, lambda: work().positions[motion.sample])


def numpy_route(motion: Motion) -> Route:
    """Return quaternions joint by joint, over all frames, components first."""
    turns = np.ascontiguousarray(motion.rotations.transpose(1, 2, 0))
    offsets = np.ascontiguousarray(motion.translations.transpose(1, 2, 0))
    parents = motion.rig.parents.tolist()

    def work() -> Array:
        world, places = turns.copy(), offsets.copy()
        for j, parent in enumerate(parents):
            if parent < 0:
                continue
            x, y, z, w = world[parent]
            a, b, c, d = turns[j]
            world[j, 0] = w * a + x * d + y * c - z * b
            world[j, 1] = w * b - x * c + y * d + z * a
            world[j, 2] = w * c + x * b - y * a + z * d
            world[j, 3] = w * d - x * a - y * b - z * c
            p, q, r = offsets[j]
            i, k, m = 2 * (y * r - z * q), 2 * (z * p - x * r), 2 * (x * q - y * p)
            places[j, 0] = places[parent, 0] + p + w * i + y * m - z * k
            places[j, 1] = places[parent, 1] + q + w * k + z * i - x * m
            places[j, 2] = places[parent, 2] + r + w * m + x * k - y * i
        return places

    return Route(work, lambda: work().transpose(2, 0, 1)[motion.sample])


def local_matrices(motion: Motion) -> Array:
    """Return local transforms ``(F, J, 4, 4)`` for row vectors, as USD has them."""
    made = np.zeros((*motion.rotations.shape[:2], 4, 4))
    made[..., :3, :3] = so3.to_matrix(motion.rotations).swapaxes(-1, -2)
    made[..., 3, :3] = motion.translations
    made[..., 3, 3] = 1
    return made


def concat_route(motion: Motion) -> Route:
    """Return UsdSkel's chain of matrices, which are made beforehand."""
    topology = UsdSkel.Topology(motion.rig.paths())
    local = [Vt.Matrix4dArray.FromNumpy(frame) for frame in local_matrices(motion)]

    def work() -> None:
        for frame in local:
            UsdSkel.ConcatJointTransforms(topology, frame)

    def places() -> Array:
        chosen = [local[frame] for frame in motion.sample.tolist()]
        found = [UsdSkel.ConcatJointTransforms(topology, frame) for frame in chosen]
        return np.array(found)[:, :, 3, :3]

    return Route(work, places)


def query_route(motion: Motion) -> Route:
    """Return UsdSkel's own evaluation of an animation in memory."""
    stage = in_memory(motion)
    root = UsdSkel.Root(stage.GetPrimAtPath("/model"))
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/model/Skel"))
    query = cache.GetSkelQuery(skeleton)
    codes = [Usd.TimeCode(float(f)) for f in range(len(motion.rotations))]

    def work() -> object:
        for code in codes:
            query.ComputeJointSkelTransforms(code)
        return stage

    def places() -> Array:
        chosen = [codes[frame] for frame in motion.sample.tolist()]
        found = [query.ComputeJointSkelTransforms(code) for code in chosen]
        return np.array(found)[:, :, 3, :3]

    return Route(work, places)


def in_memory(motion: Motion) -> Usd.Stage:
    """Return a stage with a skeleton and its animation, in float32 as UsdSkel wants."""
    stage = Usd.Stage.CreateInMemory()
    UsdSkel.Root.Define(stage, "/model")
    skeleton = UsdSkel.Skeleton.Define(stage, "/model/Skel")
    paths, count = motion.rig.paths(), len(motion.rig.joints)
    rest = Vt.Matrix4dArray.FromNumpy(local_matrices(motion)[0])
    skeleton.CreateJointsAttr(paths)
    skeleton.CreateRestTransformsAttr(rest)
    skeleton.CreateBindTransformsAttr(rest)
    animation = UsdSkel.Animation.Define(stage, "/model/Anim")
    animation.CreateJointsAttr(paths)
    animation.CreateScalesAttr(Vt.Vec3hArray(count, (1, 1, 1)))
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    turns = animation.CreateRotationsAttr().GetPath()
    moves = animation.CreateTranslationsAttr().GetPath()
    put = stage.GetRootLayer().SetTimeSample
    rotations = motion.rotations.astype(np.float32)
    translations = motion.translations.astype(np.float32)
    with Sdf.ChangeBlock():
        for f in range(len(rotations)):
            put(turns, f, Vt.QuatfArray.FromNumpy(rotations[f]))
            put(moves, f, Vt.Vec3fArray.FromNumpy(translations[f]))
    return stage


def floor_route(motion: Motion, library: ctypes.CDLL) -> Route:
    """Return the plain loop, which writes into arrays that it has already."""
    frames, joints = motion.rotations.shape[:2]
    positions, linear = np.ones((frames, joints, 3)), np.ones((frames, joints, 3, 3))
    parents = motion.rig.parents.astype(np.int64)
    given = (parents, joints, frames, motion.translations, motion.rotations)
    work = floor_work(library, "forward", *given, positions, linear)

    def places() -> Array:
        work()
        return positions[motion.sample]

    return Route(work, places)


def single_route(motion: Motion) -> Route:
    """Return animtool's own with a call for each frame, into one frame's arrays."""
    rig = motion.rig
    frames = [
        (motion.translations[f : f + 1], motion.rotations[f : f + 1])
        for f in range(len(motion.rotations))
    ]
    kept = forward_kinematics(rig, *frames[0])

    def work() -> None:
        for t, r in frames:
            forward_kinematics(rig, t, r, out=kept)

    def places() -> Array:
        chosen = [frames[f] for f in motion.sample.tolist()]
        return np.array([forward_kinematics(rig, t, r).positions[0] for t, r in chosen])

    return Route(work, places)


class Pinocchio:
    """Pinocchio in its own interpreter, which times itself."""

    def __init__(self, python: str, motion: Motion, folder: Path) -> None:
        self.python = python
        self.source, self.output = folder / "motion.npz", folder / "places.npy"
        np.savez(
            self.source,
            parents=motion.rig.parents,
            offsets=motion.rig.rest_translations,
            roots=motion.translations[:, 0],
            rotations=motion.rotations,
            sample=motion.sample,
        )

    def once(self) -> Taken:
        """Return what one run behind a warm-up took."""
        files = self.source, "1", self.output
        return taken_of(run_peer(self.python, "pinocchio_forward.py", *files))[0]

    def places(self) -> Array:
        """Return world positions ``(N, J, 3)`` of the sample [m]."""
        return np.asarray(np.load(self.output), np.float64)


def measure(options: argparse.Namespace, folder: Path) -> list[Row]:
    """Time every route in turn, and compare the sample with 50 digits."""
    motion = Motion.random(options.joints, options.frames, options.samples)
    truth = motion.truth()
    kept = forward_kinematics(motion.rig, motion.translations, motion.rotations)
    batch = {OWN: animtool_route(motion), INTO: animtool_route(motion, kept)}
    libraries = floors(options.compiler, folder)
    batch |= {name: floor_route(motion, one) for name, one in libraries.items()}
    batch["numpy, quaternions"] = numpy_route(motion)
    single = {
        ONE: single_route(motion),
        CONCAT: concat_route(motion),
        QUERY: query_route(motion),
    }
    peer = None
    if options.pin_python:
        peer = Pinocchio(options.pin_python, motion, folder)
    timed_routes = {
        name: in_process(route.work) for name, route in (batch | single).items()
    }
    if peer is not None:
        timed_routes[PINOCCHIO] = peer.once
    taken = in_turn(timed_routes, options.runs)
    found = {name: route.places() for name, route in (batch | single).items()}
    if peer is not None:
        found[PINOCCHIO] = peer.places()
    errors = {
        name: float(np.linalg.norm(places - truth, axis=-1).max())
        for name, places in found.items()
    }
    title = f"{options.joints} joints, {options.frames} frames"
    peers = [CONCAT, QUERY, *([PINOCCHIO] if peer else [])]
    ahead = Bound(at_least=True, bound=1.0)
    # None of these takes many frames, so a loop of its calls is all there is.
    bounds = {INTO: None, "numpy, quaternions": ahead} | dict.fromkeys(peers, ahead)
    rows = rows_of(f"{title}, one call", [*batch, *peers], OWN, bounds, taken, errors)
    for name in libraries:
        bound = Bound(at_least=False, bound=2.0)
        section = f"{title}, one call"
        rows += ratio_rows(
            section, INTO, taken[INTO], taken[name], name=name, wanted=bound
        )
    bounds = dict.fromkeys(peers, ahead)
    section = f"{title}, a call a frame"
    return rows + rows_of(section, [ONE, *peers], ONE, bounds, taken, errors)


def rows_of(
    section: str,
    names: list[str],
    own: str,
    bounds: dict[str, Bound | None],
    taken: dict[str, list[Taken]],
    errors: dict[str, float],
) -> list[Row]:
    """Return the figures of some routes beside one of animtool's."""
    rows = []
    for name in names:
        near = Accuracy(ERROR, errors[name], NEAR_ENOUGH)
        rows += time_rows(section, name, taken[name])
        rows.append(Row(section, name, ERROR, [errors[name]]))
        if name != own:
            bound = bounds.get(name)
            rows += ratio_rows(
                section, name, taken[name], taken[own], wanted=bound, accuracy=[near]
            )
    return rows


def main() -> None:
    """Measure, print the table, write the CSV."""
    made = parser(__doc__, "kinematics.csv", runs=9)
    add = made.add_argument
    add("--joints", type=int, default=60)
    add("--frames", type=int, default=10_000)
    add("--samples", type=int, default=20, help="frames compared with 50 digits")
    add("--compiler", default="c++", help="of the plain loops; '' skips them")
    add("--pin-python", help="interpreter with pin; without it Pinocchio is skipped")
    options = made.parse_args()
    on_one_thread()
    session = begin(
        options,
        (sys.executable, ["animtool", "usd-core", "numpy"]),
        (options.pin_python, ["pin", "numpy"]),
    )
    with tempfile.TemporaryDirectory(prefix="animtool-bench-") as folder:
        rows = measure(options, Path(folder))
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
