"""What each check holds on, and what it does not hold on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from support.reported.made import made_c3d
from support.reported.results import (
    BOUNDS,
    FALL,
    GONE,
    LAID,
    RIDE,
    TURNS,
    UNSEEN,
    WALK,
    Make,
    agents,
    bodies,
    cloth,
    cradle,
    dust,
    falls,
    info,
    nothing,
    npz,
    pendulum_rope,
    person,
    pinned,
    rope,
    says,
    skeleton,
    somersault,
    told,
    trc,
    turned_taken,
    walk_bvh,
    writes,
)


@dataclass(frozen=True)
class Case:
    """A check, what is right, and what is wrong with it.

    Attributes:
        what: The check.
        make: Of a right result.
        right: What the table says.
        wrong: What it might say instead, each of which does not hold.
        bad: Of other results, in which what is right does not hold.
    """

    what: str
    make: Make
    right: dict[str, Any]
    wrong: tuple[dict[str, Any], ...] = ()
    bad: tuple[Make, ...] = ()


DROP = np.linspace(0.95, 0.15, 25)
EDGE = np.zeros((2, 3)).tolist()
MARKER = {"marker": 0, "seconds": 1 / 30, "value": [0.012, 0, 0], "tolerance": 1e-4}
PLACE = {"joint": "Head", "time": 5, "value": [4 / 24, 1.6, 0], "tolerance": 1e-4}
CURVE = {"joint": "Hips", "axis": "x", "times": [1, 9], "values": [0, 1 / 3]}
NEAR = {
    "joint": "Hips",
    "targets": (RIDE[:, 0] + [0, 0, 0.1]).tolist(),
    "best": [0.1] * 9,
    "tolerance": 1e-3,
}
PIN = {"on_first": [0.15, 0, 0], "on_second": [-0.3, 0, 0], "max": 1e-4}
ROD = {"half": 0.25, "at": [0, 0.5, 0], "moves": [[0, 0, 0], [0.2, 0, 0.4]]}
SHOT = {"shot": "sh010", "frames": 9, "fps": 24, "first_s": 0, "last_s": 1 / 3}
PIVOT = {"body": 2, "pivot": [0.4, 2, 0], "value": 40, "tolerance": 1}
WALL = {"body": 0, "axis": "x", "side": "above", "value": 0.34}
SPEED_RIDE = RIDE[:, :1]
FAR_NPZ = {"array": "markers_m", "max": 2.0}

CASES = [
    Case(
        "message_contains",
        says("Frame 5 is there twice", "and No more"),
        {"any": ["frame 7", "FRAME 5"]},
        ({"any": ["frame 7"]}, {"all": ["twice", "thrice"]}, {}),
        (says("in.file: fine"), nothing),
    ),
    Case("message_contains", says("a b"), {"all": ["a", "B"]}, ({"all": ["c"]},)),
    Case(
        "message_lacks",
        says("all is well"),
        {"any": ["--up Z"]},
        ({"any": ["ALL IS"]}, {"any": []}),
    ),
    Case(
        "codes",
        says("x: warning: MOT202 a: b", '"code": "CLIP202"'),
        {"any": ["CLIP2"], "all": ["MOT202"], "none": ["BVH"], "new": ["MOT202"]},
        (
            {"any": ["BVH"]},
            {"all": ["MOT202", "BVH"]},
            {"none": ["MOT"]},
            {"new": ["MOT202", "CLIP2"]},
            {},
        ),
        # No code has such a page.
        (says("marker ABC123 is gone"), nothing),
    ),
    Case(
        "count_of",
        says("SIM061 a\nSIM061 b"),
        {"text": "SIM061", "min": 2},
        ({"text": "SIM061", "min": 3}, {"text": "", "min": 1}),
    ),
    Case(
        "says_number",
        says("USD251: 7.35 cm at frame 4\n1,250 rows, SIM122"),
        {"value": [73.0, 7.3], "tolerance": 0.02, "code": "USD251"},
        (
            {"value": 7.3, "tolerance": 0.001},
            {"value": 122, "tolerance": 0.001},
            {"value": 1250, "tolerance": 0.001, "code": "USD251"},
            {"value": [], "tolerance": 1},
        ),
    ),
    Case(
        "says_number",
        says("the pin is 58.41 m off\n  346 kB written in 59 ms"),
        {"value": [58.41], "tolerance": 0.001},
        ({"value": [59.0], "tolerance": 0.001},),
    ),
    Case(
        "files",
        writes("p.svg", "<svg/>"),
        {"names": ["p.svg"]},
        ({"names": []}, {"names": ["p.svg", "q.svg"]}),
    ),
    Case("memory_mb", says("", peak=80), {"max": 100}, ({"max": 70},)),
    Case(
        "frames", trc(WALK), {"value": 3}, ({"value": 2},), (trc(np.zeros((0, 2, 3))),)
    ),
    Case("frames", skeleton(RIDE), {"value": 9}, ({"value": 8},)),
    Case("frames", writes("o.bvh", walk_bvh(2)), {"value": 24}, ({"value": 23},)),
    Case(
        "frames", info(frames=66048), {"value": 66048}, ({"value": 65535},), (info(),)
    ),
    Case("fps", trc(WALK, rate=29.97), {"value": 30000 / 1001}, ({"value": 30},)),
    Case("fps", skeleton(RIDE), {"value": 24}, ({"value": 25},)),
    Case(
        "duration_s",
        trc(WALK, seconds=[0, 0.1, 0.4]),
        {"value": 0.4, "tolerance": 0.001},
        ({"value": 0.033, "tolerance": 0.001},),
    ),
    Case(
        "markers", trc(WALK), {"value": 2}, ({"value": 3},), (trc(WALK, names=["A"]),)
    ),
    Case("unlabelled", info(unlabelled=2), {"value": 2}, ({"value": 0},), (info(),)),
    Case("unlabelled", trc(WALK, names=["A", ""]), {"value": 1}, ({"value": 0},)),
    Case(
        "bounds_m",
        trc(WALK),
        {"value": BOUNDS, "tolerance": 1e-4},
        ({"value": EDGE, "tolerance": 1e-4},),
        (trc(UNSEEN),),
    ),
    Case(
        "height_m",
        info(up="-Z", units="cm", bounds=[[0, 0, 100], [9, 9, 160]]),
        {"value": [-1.6, -1.0], "tolerance": 1e-3},
        ({"value": [1.0, 1.6], "tolerance": 1e-3},),
        (info(up=None, bounds=[[0, 0, 100], [9, 9, 160]]),),
    ),
    Case(
        "height_m",
        skeleton(LAID, up="Z"),
        {"value": [1.0, 1.6], "tolerance": 1e-3},
        ({"value": [0.0, 1.6], "tolerance": 1e-3},),
        (skeleton(LAID), skeleton(RIDE, unit=0.01)),
    ),
    Case(
        "max_step_m",
        trc(WALK),
        {"max": 0.0061},
        ({"max": 0.0059},),
        (trc(UNSEEN), trc(WALK[:1])),
    ),
    Case(
        "marker_at",
        trc(WALK),
        MARKER,
        (
            {**MARKER, "value": [0.006, 0, 0]},
            {**MARKER, "marker": "XYZ"},
            {**MARKER, "marker": 2},
            {**MARKER, "seconds": 0.1},
        ),
        (trc(UNSEEN), trc(WALK, seconds=[0, 1, 2])),
    ),
    Case("marker_at", trc(WALK), {**MARKER, "marker": "LASI"}),
    Case(
        "marker_at",
        writes("o.c3d", made_c3d(WALK, a_frame=0, analog_rate=0)),
        {
            **MARKER,
            "seconds": 2 / 120,
        },
        ({**MARKER, "seconds": 2 / 120, "value": [12, 0, 0]},),
    ),
    Case(
        "trc_rows_end",
        trc(GONE),
        {},
        (),
        (trc(GONE, closed=False), trc(np.zeros((0, 2, 3)))),
    ),
    Case("trc_rows_end", trc(WALK, closed=False), {}),
    Case(
        "c3d_analog_rate",
        writes("o.c3d", made_c3d(WALK, a_frame=10, analog_rate=1200)),
        {},
        (),
        (
            writes("o.c3d", made_c3d(WALK, a_frame=0, analog_rate=120)),
            writes("o.c3d", made_c3d(WALK, a_frame=1, analog_rate=1200)),
        ),
    ),
    Case(
        "c3d_finite",
        writes("o.c3d", made_c3d(WALK, a_frame=0, analog_rate=0)),
        {},
        (),
        (
            writes(
                "o.c3d",
                made_c3d(WALK, a_frame=0, analog_rate=0).replace(
                    np.float32(1000).tobytes(), np.float32(np.inf).tobytes()
                ),
            ),
            writes("o.c3d", made_c3d(WALK[:0], a_frame=0, analog_rate=0)),
        ),
    ),
    Case(
        "npz_within_m",
        npz(1.9, np.nan, -2),
        FAR_NPZ,
        ({**FAR_NPZ, "max": 1.0}, {**FAR_NPZ, "array": "points"}),
        (npz(np.nan), npz(), npz(np.inf)),
    ),
    Case(
        "joint_world",
        skeleton(RIDE),
        PLACE,
        (
            {**PLACE, "value": [0, 1.6, 0]},
            {**PLACE, "time": 10},
            {**PLACE, "joint": "Tail"},
            {"joint": "Head", "value": [0, 1, 0], "tolerance": 9},
        ),
        (skeleton(RIDE, unit=0.01), skeleton(RIDE, up="Z")),
    ),
    Case(
        "joint_world",
        skeleton(100 * LAID * [1, -1, 1], up="Z", unit=0.01),
        {**{k: v for k, v in PLACE.items() if k != "time"}, "frame": 4},
        ({**PLACE, "time": None, "frame": 9},),
    ),
    Case(
        "joint_curve",
        skeleton(RIDE),
        {**CURVE, "tolerance": 1e-4},
        (
            {**CURVE, "axis": "y", "tolerance": 1e-4},
            {**CURVE, "times": [1, 10], "tolerance": 1e-4},
            {**CURVE, "times": [], "values": [], "tolerance": 1e-4},
        ),
    ),
    Case("whole_samples", skeleton(RIDE), {}, (), (skeleton(RIDE, begin=1.5),)),
    Case(
        "upright",
        skeleton(RIDE),
        {"high": "Head", "low": "Hips", "min": 0.59},
        (
            {"high": "Head", "low": "Hips", "min": 0.61},
            {"high": "Hips", "low": "Head", "min": 0.1},
            {"high": "Head", "low": "Hips", "min": 0.1, "axis": "z"},
        ),
        (somersault(FALL),),
    ),
    Case(
        "upright",
        somersault(FALL),
        {
            "high": "Head",
            "low": "Hips",
            "min": 0.59,
            "first": True,
        },
    ),
    Case(
        "upright",
        writes("o.bvh", walk_bvh(2)),
        {"high": "Hips", "low": "LeftFoot", "min": 0.79},
        (
            {"high": "Hips", "low": "LeftFoot", "min": 0.81},
            {"high": "Hips", "low": "LeftFoot", "min": 0.1, "axis": "z"},
            {"high": "Hips", "low": "Tail", "min": 0.1},
        ),
    ),
    Case(
        "max_step_deg",
        turned_taken(4),
        {"max": 10.1},
        ({"max": 9.9},),
        (turned_taken(5), turned_taken(1), skeleton(np.zeros((3, 0, 3)), names=[])),
    ),
    Case("max_step_deg", writes("o.bvh", walk_bvh(2)), {"max": 1}),
    Case(
        "jumps_named",
        told(turned_taken(9), {"jumps": [{"frame": 5.0, "joint": "Head"}]}),
        {"min": 30},
        ({"min": 9},),
        (
            told(turned_taken(9), {"jumps": []}),
            told(turned_taken(9), {"jumps": [{"frame": 4.0, "joint": "Head"}]}),
            told(turned_taken(1), {"jumps": [{"frame": 5.0, "joint": "Head"}]}),
            told(turned_taken(9), {}),
            turned_taken(9),
        ),
    ),
    Case("jumps_named", told(turned_taken(4), {"jumps": []}), {"min": 30}),
    Case(
        "nearest",
        skeleton(RIDE),
        NEAR,
        ({**NEAR, "best": [0.09] * 9}, {**NEAR, "best": [0.11] * 9}),
        (skeleton(RIDE[:8]),),
    ),
    Case(
        "retarget_scores",
        writes("o.bvh", walk_bvh(2.1, leg=40)),
        {"source": "source.bvh", "dip_ratio": 1.2, "acceleration_ratio": 1.1},
        (
            {"source": "source.bvh", "dip_ratio": 1.01, "acceleration_ratio": 1.1},
            {"source": "source.bvh", "dip_ratio": 1.2, "acceleration_ratio": 1.01},
            {"source": "none.bvh", "dip_ratio": 9, "acceleration_ratio": 9},
        ),
        (writes("o.bvh", walk_bvh(3)), writes("o.bvh", walk_bvh(0))),
    ),
    Case(
        "mesh_bounds_m",
        skeleton(RIDE, mesh=True),
        {
            "mesh": "body",
            "time": 9,
            "value": [[1 / 3, 1.6, 0], [4 / 3, 2.6, 0]],
            "tolerance": 1e-3,
        },
        (
            {"mesh": "body", "time": 1, "value": EDGE, "tolerance": 1},
            {"mesh": "hat", "time": 9, "value": EDGE, "tolerance": 9},
            {"mesh": "body", "time": 10, "value": EDGE, "tolerance": 9},
        ),
        (skeleton(RIDE),),
    ),
    Case(
        "extents_hold",
        skeleton(RIDE, mesh=True, extent=[[0, 1.6, 0], [4 / 3, 2.6, 0]]),
        {"max": 1e-4},
        (),
        (
            skeleton(RIDE, mesh=True, extent=[[0, 1.6, 0], [1.2, 2.6, 0]]),
            skeleton(RIDE, mesh=True),
            skeleton(RIDE, extent=[[0, 1.6, 0], [4 / 3, 2.6, 0]]),
        ),
    ),
    Case(
        "body_at",
        bodies(RIDE),
        {"body": 0, "seconds": 4 / 24, "value": [1 / 6, 1, 0], "tolerance": 1e-4},
        (
            {"body": 1, "seconds": 4 / 24, "value": [1 / 6, 1, 0], "tolerance": 1e-4},
            {"body": 2, "seconds": 0, "value": [0, 1, 0], "tolerance": 9},
            {"body": 0, "seconds": 0.4, "value": [0, 1, 0], "tolerance": 9},
            {
                "body": 0,
                "seconds": 0,
                "value": [0, 1, 0],
                "tolerance": 9,
                "system": "x",
            },
        ),
    ),
    Case(
        "turned_deg",
        bodies(RIDE, turns=TURNS),
        {"body": 1, "seconds": 4 / 24, "value": 70, "tolerance": 0.1},
        (
            {"body": 0, "seconds": 4 / 24, "value": 70, "tolerance": 0.1},
            {"body": 1, "seconds": 3 / 24, "value": 70, "tolerance": 0.1},
        ),
        (dust(RIDE),),
    ),
    Case(
        "never_beyond",
        dust(RIDE),
        WALL,
        ({**WALL, "value": 0.3}, {**WALL, "side": "below"}, {**WALL, "side": "left"}),
        (dust(np.full((3, 1, 3), np.inf)),),
    ),
    Case(
        "rise_m",
        bodies(falls(0.5)[::-1]),
        {"body": 0, "value": 1.0, "tolerance": 0.1},
        (
            {"body": 0, "value": 0.5, "tolerance": 0.1},
            {"body": 0, "max": 0.5},
            {"body": 0},
        ),
        (bodies(falls(0.5)),),
    ),
    Case(
        "max_turn_deg",
        bodies(RIDE, turns=0.004 * TURNS),
        {"max": 0.5},
        ({"max": 0.4}, {"max": 9, "body": 2}),
        (bodies(RIDE, turns=TURNS), dust(RIDE), bodies(np.zeros((3, 0, 3)))),
    ),
    Case(
        "first_rise_m",
        bodies(np.concatenate([falls(0.5), falls(0.0)], axis=1)),
        {"values": [0.25, 0], "rest": [0.1, 0.1], "tolerance": 0.003},
        (
            {"values": [0.2, 0], "rest": [0.1, 0.1], "tolerance": 0.003},
            {"values": [0.25, 0.04], "rest": [0.1, 0.1], "tolerance": 0.003},
            {"values": [0.25], "rest": [0.1], "tolerance": 0.003},
        ),
        (
            # One that falls on and on, and one that stays in the air.
            bodies(
                np.concatenate([falls(0.5, frames=30), falls(0, frames=30)], axis=1)
            ),
            bodies(np.ones((90, 2, 3))),
        ),
    ),
    Case(
        "max_angle_deg",
        bodies(cradle(1.0)),
        {**PIVOT, "until_s": 1.5},
        ({**PIVOT, "body": 1}, {**PIVOT, "until_s": 0.4}),
        (bodies(cradle(0.9)),),
    ),
    Case(
        "energy_kept",
        bodies(cradle(1.0)),
        {"zero": [1, 1, 1], "min": 0.98, "max": 1.01},
        ({"zero": [1, 1, 1]}, {"zero": [1, 1], "min": 0.98}),
        (
            bodies(cradle(0.95)),
            bodies(cradle(1.05)),
            bodies(0 * cradle(1.0) + 1),
            bodies(cradle(1.0)[:6]),
        ),
    ),
    Case(
        "pin_apart_m",
        pinned(),
        PIN,
        ({**PIN, "on_first": [0.14, 0, 0]},),
        (pinned(apart=0.001), pinned(out_of_plane=0.001)),
    ),
    Case(
        "rope_stretch_m",
        rope(1.0025, 1.0024),
        {"length": 1, "value": 0.0025, "tolerance": 0.0002},
        ({"length": 1, "value": 0.0, "tolerance": 0.0002},),
        (rope(1.0025, 1.015, 1.0025),),
    ),
    Case(
        "swing_kept",
        pendulum_rope(1.0),
        {"window": 96, "min": 0.95},
        ({"window": 96, "min": 1.05}, {"window": 300, "min": 0.5}),
        (pendulum_rope(0.9), pendulum_rope(0.0), rope(*[1.0] * 200)),
    ),
    Case(
        "rim_moves_m",
        cloth(1, 1),
        {"count": 16, "max": 1e-6},
        ({"count": 15, "max": 1e-6},),
        (cloth(1, 1, lift=1e-4), cloth(1, 0.9)),
    ),
    Case(
        "rod_pierces",
        cloth(*[1] * 9),
        ROD,
        (
            {**ROD, "moves": [[0, 0, 0], [0.2, 0, 0.6]]},
            {**ROD, "at": [3, 0.5, 0]},
            {**ROD, "axis": [0, 1, 0], "half": 0.6},
        ),
        (cloth(*[1] * 9, tilt=-2.0), cloth(*[1] * 8, 0.8)),
    ),
    Case(
        "rms_speed_m_s",
        dust(SPEED_RIDE),
        {"from_s": 0.1, "max": 1.01},
        (
            {"from_s": 0.1, "max": 0.99},
            {"from_s": 8 / 24, "max": 2},
            {"from_s": 2, "max": 2},
        ),
    ),
    Case(
        "mean_height_m",
        dust(RIDE),
        {"value": 0.8, "tolerance": 0.01},
        ({"value": 0.9, "tolerance": 0.01},),
        (dust(np.zeros((3, 0, 3))),),
    ),
    Case(
        "shot_list",
        skeleton(RIDE, file="sh010.usda"),
        {"shots": [SHOT]},
        (
            {"shots": []},
            {"shots": [SHOT, {**SHOT, "shot": "sh020"}]},
            {"shots": [{**SHOT, "frames": 8}]},
            {"shots": [{**SHOT, "fps": 25}]},
            {"shots": [{**SHOT, "first_s": 1}]},
            {"shots": [{**SHOT, "shown": 1}]},
        ),
        (skeleton(RIDE, file="sh020.usda"),),
    ),
    Case(
        "crowd_through",
        agents(10, -10),
        {"seconds": 1, "first": 1, "beyond": 9, "min": 2},
        (
            {"seconds": 0.5, "first": 1, "beyond": 9, "min": 2},
            {"seconds": 1, "first": 3, "beyond": 9, "min": 0},
            {"seconds": 2, "first": 1, "beyond": 9, "min": 0},
        ),
        (agents(10, 8), agents(-10, 10)),
    ),
    Case(
        "crowd_hips",
        person(DROP, np.linspace(0, 90, 25)),
        {"above": 0.7, "step": 0.1},
        ({"above": 0.7, "step": 0.03},),
        (person(DROP, np.zeros(25)), person([0.95, 0.7, 0.95], np.zeros(3))),
    ),
]
