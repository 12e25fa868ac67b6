"""What the calls take that a script, a viewer or a large scene makes.

IK a pose a call, with a session and without; rotations and numbers between keys; takes
to where their joints are; clips of many keys. All in this process, in turn.
"""

from __future__ import annotations

import ctypes
import json
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from figures import Bound, Clock, Row, ratio_rows, time_rows
from measuring import (
    FLOOR,
    ROOT,
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

from animtool import Channel, Motion, Take, ik
from animtool import Clock as TakeClock
from animtool.clip.file import load_clip_of
from animtool.edit import loop, resampled, time_warp
from animtool.maths import so3
from animtool.maths.curves import Curves, Extrapolation, SegmentKind, evaluate
from animtool.maths.rotation_curves import RotationKind, evaluate_rotations
from animtool.rig.joints import local_from_coordinates
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.skeleton import Joint, JointType, Rig

JOINTS, FRAMES = 60, 10_000
# Calls of a run that take microseconds.
CALLS = 300
ARM = ("clavicle_l", "shoulder_l", "elbow_l", "forearm_l", "wrist_l")
SLERP, FORWARD = "so3.slerp", "forward"
PINS = "six pins, a pose a call"


@dataclass(frozen=True)
class Route:
    """Something that is timed.

    Attributes:
        section: Of the table.
        name: A line of it.
        work: What is called.
        calls: How often in a run.
        most: Microseconds of CPU time wanted at most for a call.
        base: Name of a route of the section that it is compared with.
        times: As many times that one's CPU time wanted at most.
    """

    section: str
    name: str
    work: Callable[[], object]
    calls: int = 1
    most: float | None = None
    base: str = ""
    times: float | None = None

    def run(self) -> None:
        """Call it as often as a run does."""
        for _ in range(self.calls):
            self.work()


def six_pins() -> Rig:
    """Return an arm with three parallel axes, of the lengths of a UR5."""
    out, across = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
    places = [
        *((out, (0.0, 0.0, 0.0892)), (across, (0.0, 0.1358, 0.0))),
        *((across, (0.0, -0.1197, 0.425)), (across, (0.0, 0.0, 0.3922))),
        *((out, (0.0, 0.093, 0.0)), (across, (0.0, 0.0, 0.0947))),
    ]
    pins = [
        Joint(f"j{i}", i - 1, JointType.PIN, translation=at, axis=axis)
        for i, (axis, at) in enumerate(places)
    ]
    hand = Joint("hand", 5, JointType.FIXED, translation=(0.0, 0.0823, 0.0))
    return Rig("six pins", (*pins, hand))


def ik_routes() -> list[Route]:
    """Return IK, a pose a call."""
    rig = Rig.load(ROOT / "rigs/biped/biped.rig.yaml")
    problem = ik.build(rig, [ik.Goal("wrist_l")], joints=ARM)
    session = rig.ik("wrist_l", joints=ARM)
    place = np.array([0.3, 1.2, 0.4])
    targets = ik.Targets(positions=[[place]])
    start = session.solve(wrist_l=place).coordinates[0]
    many = np.repeat(start[None], 1000, axis=0)
    arm, (pose, goal) = six_pins(), _six_goal()
    own, whole = arm.ik("hand"), ik.build(arm, [ik.Goal("hand", orientation=1.0)])
    given = ik.Targets([[goal[0]]], [[goal[1]]])

    def step() -> None:
        result = ik.solve(problem, start, targets)
        posed = local_from_coordinates(rig, result.coordinates)
        forward_kinematics(rig, posed.translations, posed.rotations)

    def tick() -> None:
        session.solve(wrist_l=place, start=start).world()

    biped = "biped, a pose a call"
    return [
        Route(biped, "session, with all joints", tick, CALLS, 100.0),
        Route(biped, "ik.solve, coordinates, forward", step, CALLS),
        Route(
            *(biped, "coordinates", lambda: local_from_coordinates(rig, many[:1])),
            *(CALLS, 30.0),
        ),
        Route(
            *(biped, "coordinates of 1,000", lambda: local_from_coordinates(rig, many)),
            *(5, 3000.0),
        ),
        Route(PINS, "session", lambda: own.solve(hand=goal, start=pose), CALLS, 15.0),
        Route(PINS, "all branches", lambda: own.branches(hand=goal), CALLS),
        Route(PINS, "ik.solve", lambda: ik.solve(whole, pose, given), CALLS),
    ]


def peer_rows(python: str, runs: int) -> list[Row]:
    """Return what EAIK and roboticstoolbox take for a pose of the six pins."""
    arm, pose, (place, turn) = six_pins(), *_six_goal()
    target = np.eye(4)
    target[:3, :3], target[:3, 3] = so3.to_matrix(turn), place
    told = {
        "axes": [joint.axis for joint in arm.joints[:6]],
        "offsets": [joint.translation for joint in arm.joints],
        "target": target.tolist(),
        "start": (pose + 0.3).tolist(),
    }
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.json"
        path.write_text(json.dumps(told))
        found = run_peer(python, "ik_one_pose.py", path, runs, CALLS)
    for name, one in found.items():
        taken = taken_of(one)
        rows += time_rows(PINS, name, taken, unit="us", per=CALLS)
        least = [min(run.cpu for run in taken) * 1e6 / CALLS]
        rows.append(Row(PINS, name, "least CPU [us]", least, None, Clock.CPU))
        rows.append(Row(PINS, name, "largest error [1]", [one["error"]]))
    return rows


def _six_goal() -> tuple[Any, tuple[Any, Any]]:
    """Return a pose of the six pins, and where its hand is."""
    arm, pose = six_pins(), np.array([0.3, -0.9, 1.2, 0.4, 0.8, -0.5])
    local = local_from_coordinates(arm, pose[None])
    world = forward_kinematics(arm, local.translations, local.rotations)
    return pose, (world.positions[0, 6], so3.from_matrix(world.linear[0, 6]))


def curve_routes(
    rng: np.random.Generator, libraries: Mapping[str, ctypes.CDLL]
) -> list[Route]:
    """Return rotations and numbers between keys."""
    ends = so3.normalize(rng.normal(size=(2, FRAMES, JOINTS, 4)))
    share = rng.uniform(size=(FRAMES, 1))
    section = f"rotations of {JOINTS} joints, {FRAMES} frames"
    routes = [Route(section, SLERP, lambda: so3.slerp(ends[0], ends[1], share))]
    for count in (50, FRAMES):
        keys = so3.normalize(np.cumsum(rng.normal(size=(count, JOINTS, 4)), 0) * 0.2)
        times, at = np.arange(count) * 1.0, np.linspace(0.25, count - 1.25, FRAMES)
        for kind, most in (
            (RotationKind.SLERP, 1.3),
            (RotationKind.SQUAD, 3.0),
            (RotationKind.SPLINE, 3.0),
        ):
            work = _curve(times, keys, kind, at)
            name = f"{kind.name.lower()}, {count} keys"
            routes.append(Route(section, name, work, base=SLERP, times=most))
    for count, most in ((50, 1.5), (1000, 2.0), (FRAMES, 4.0)):
        curves, at = _lines(rng, count), np.arange(FRAMES) + 0.3
        section = f"{7 * JOINTS} linear curves of {count} keys, {FRAMES} times"
        routes.append(
            Route(section, "Curves.sample", _samples(curves, at), 5, None, FLOOR, most)
        )
        for name, library in libraries.items():
            work = _lerp(library, curves, count, at)
            error = float(np.abs(work() - evaluate(curves, at)).max())
            assert error < 1e-12, error
            routes.append(Route(section, name, work, 5))
    return routes


def _lerp(
    library: ctypes.CDLL, curves: Curves, count: int, at: Any
) -> Callable[[], Any]:
    """Return a plain loop over straight curves, seven with keys at one time."""
    sizes = JOINTS, 7, count
    frames = len(at)

    def work() -> Any:
        # Into an array of its own, as `Curves.sample` gives one.
        out = np.empty((7 * JOINTS, frames))
        keys = curves.times, curves.values
        floor_work(library, "lerp", *keys, *sizes, at, frames, out)()
        return out

    return work


def _curve(times: Any, keys: Any, kind: RotationKind, at: Any) -> Callable[[], object]:
    return lambda: evaluate_rotations(times, keys, kind, at)


def _samples(curves: Curves, at: Any) -> Callable[[], object]:
    return lambda: evaluate(curves, at)


def _lines(rng: np.random.Generator, count: int) -> Curves:
    """Return straight curves whose keys are spread over the frames."""
    curves = 7 * JOINTS
    total, held = curves * count, (Extrapolation.HOLD,) * curves
    return Curves(
        np.arange(curves + 1) * count,
        np.tile(np.linspace(0, FRAMES, count), curves),
        rng.normal(size=total),
        np.full(total, int(SegmentKind.LINEAR), np.int64),
        *(np.zeros((total, 2)), np.zeros((total, 2)), held, held),
    )


def take_routes(rng: np.random.Generator) -> list[Route]:
    """Return what is done to a take of all its frames."""
    rig = Rig(
        "tree",
        tuple(
            Joint(f"j{i}", i - 1, JointType.BALL, translation=(0.0, 0.1, 0.0))
            for i in range(JOINTS)
        ),
    )
    walk = np.cumsum(rng.normal(size=(FRAMES, JOINTS, 4)), 0) * 0.01
    turns = so3.align_signs(so3.normalize(walk + so3.IDENTITY))
    places = np.repeat(rig.rest_translations[None], FRAMES, axis=0)
    places[:, 0] += np.cumsum(rng.normal(size=(FRAMES, 3)), 0) * 1e-3
    clock = TakeClock(Fraction(30), Fraction(1), Fraction(1), FRAMES)
    motion = Motion(Channel.from_dense(places), Channel.from_dense(turns))
    take = Take(rig, clock, motion)
    section = f"a take of {JOINTS} joints, {FRAMES} frames"
    bends = [(1, 1), (FRAMES // 2, 4000), (FRAMES, FRAMES)]
    return [
        Route(section, FORWARD, lambda: forward_kinematics(rig, places, turns)),
        Route(section, "take.world()", take.world, base=FORWARD, times=1.2),
        Route(section, "resampled, 60 fps", lambda: resampled(take, Fraction(60))),
        Route(section, "time_warp", lambda: time_warp(take, bends)),
        Route(section, "loop", lambda: loop(take, repeats=1)),
    ]


def clip_routes(rng: np.random.Generator, folder: Path) -> list[Route]:
    """Return clips of 100,000 keys of times and values."""
    rig, count = six_pins(), 100_000 // 6
    times = np.arange(1.0, count + 1.0).tolist()
    channels = [
        {
            "target": f"joint/j{i}.angle",
            "interp": "linear",
            "keys": [
                {"t": t, "v": v}
                for t, v in zip(times, rng.normal(size=count).tolist(), strict=True)
            ],
        }
        for i in range(6)
    ]
    clip = {"clip": "animtool/1", "fps": 24, "channels": channels}
    quick, slow = folder / "some.clip.json", folder / "some.clip.yaml"
    quick.write_text(json.dumps(clip))
    slow.write_text(json.dumps(clip))
    section = "a clip of 100,000 keys"
    return [
        Route(section, "JSON", lambda: load_clip_of(quick, rig), most=1e6),
        Route(section, "YAML", lambda: load_clip_of(slow, rig), most=4e6),
    ]


def rows_of(routes: list[Route], runs: int) -> list[Row]:
    """Time routes in turn, and return their figures."""
    taken = in_turn({f"{r.section}: {r.name}": in_process(r.run) for r in routes}, runs)
    rows = []
    for route in routes:
        own = taken[f"{route.section}: {route.name}"]
        rows += time_rows(route.section, route.name, own, unit="us", per=route.calls)
        least = [min(one.cpu for one in own) * 1e6 / route.calls]
        most = None if route.most is None else Bound(at_least=False, bound=route.most)
        rows.append(
            Row(route.section, route.name, "least CPU [us]", least, most, Clock.CPU)
        )
        if f"{route.section}: {route.base}" in taken:
            base = taken[f"{route.section}: {route.base}"]
            bound = Bound(at_least=False, bound=route.times or 0.0)
            rows += ratio_rows(
                route.section, route.name, own, base, name=route.base, wanted=bound
            )
    return rows


def main() -> None:
    """Measure, print the table, write the CSV."""
    made = parser(__doc__, "calls.csv", runs=9)
    made.add_argument("--compiler", default="c++", help="of the plain loops")
    made.add_argument("--peer-python", help="interpreter with EAIK and roboticstoolbox")
    options = made.parse_args()
    on_one_thread()
    session = begin(
        options,
        (sys.executable, ["animtool", "numpy"]),
        (options.peer_python, ["EAIK", "roboticstoolbox-python", "numpy"]),
    )
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory(prefix="animtool-bench-") as folder:
        libraries = floors(options.compiler, Path(folder))
        routes = [*ik_routes(), *curve_routes(rng, libraries), *take_routes(rng)]
        rows = rows_of([*routes, *clip_routes(rng, Path(folder))], options.runs)
    if options.peer_python:
        rows += peer_rows(options.peer_python, options.runs)
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
