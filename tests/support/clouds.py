"""Clouds of markers of made people, with what is wrong in them known.

`cloud` is a person of other bone lengths, with markers put on by hand, who walks, tries
out all joints or moves fast; the arrays are those of ``cloud_*.npz``. Nothing is read:
the generic skeleton is a table here. The same seed, motion and markers are the same
bytes.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray, IntArray
from animtool.core.clock import Clock
from animtool.maths import so3
from animtool.motion.markers import Markers

FS = 120
# Name, parent, offset [m], limits [deg] of a ball, or axis and range [deg] of a pin.
_SPINE = (
    ("Hips", "", (0, 0.95, 0), None),
    ("Spine", "Hips", (0, 0.1, 0), (40, 30, 30)),
    ("Chest", "Spine", (0, 0.2, 0), (35, 30, 30)),
    ("Neck", "Chest", (0, 0.25, 0), (40, 50, 35)),
    ("Head", "Neck", (0, 0.1, 0), (35, 40, 25)),
)
_ARM = (
    ("Shoulder", "Chest", (0.03, 0.2, 0), (0, 15, 20)),
    ("Arm", "Shoulder", (0.15, 0, 0), (60, 70, 85)),
    ("ForeArm", "Arm", (0.29, 0, 0), ((0, -1, 0), 0, 140)),
    ("Hand", "ForeArm", (0.26, 0, 0), (50, 30, 60)),
)
_LEG = (
    ("UpLeg", "Hips", (0.09, -0.05, 0), (100, 40, 40)),
    ("Leg", "UpLeg", (0, -0.43, 0), ((1, 0, 0), 0, 150)),
    ("Foot", "Leg", (0, -0.42, 0), (45, 20, 20)),
    ("Toe", "Foot", (0, -0.06, 0.13), ((1, 0, 0), -45, 30)),
)
# Joint and offset [m] of markers in the middle; those of the left side, and the x or y
# of the right one where it is put elsewhere so that sides differ.
_MIDDLE = {
    "body41": {
        "C7": ("Chest", (0, 0.24, -0.08)),
        "CLAV": ("Chest", (0, 0.19, 0.1)),
        "STRN": ("Chest", (0, 0.02, 0.12)),
        "T10": ("Chest", (0.01, 0.05, -0.13)),
        "LUMB": ("Spine", (0, 0.05, -0.12)),
    },
    "body37": {
        "TOP": ("Head", (0.02, 0.21, 0.01)),
        "JUG": ("Chest", (0, 0.2, 0.09)),
        "XIP": ("Chest", (0.01, 0.01, 0.13)),
        "T4": ("Chest", (-0.01, 0.17, -0.11)),
        "T12": ("Chest", (0.02, 0.0, -0.12)),
        "L4": ("Spine", (-0.01, 0.03, -0.12)),
        "SAC": ("Hips", (0, 0.05, -0.12)),
    },
}
_SIDES = {
    "body41": {
        "FHD": ("Head", (0.07, 0.12, 0.09), {}),
        "BHD": ("Head", (0.07, 0.13, -0.09), {}),
        "ASI": ("Hips", (0.12, 0.04, 0.1), {}),
        "PSI": ("Hips", (0.05, 0.06, -0.11), {}),
        "SHO": ("Shoulder", (0.13, 0.06, 0), {}),
        "UPA": ("Arm", (0.12, 0.02, -0.06), {0: 0.17}),
        "ELB": ("Arm", (0.29, 0, -0.05), {}),
        "WRA": ("ForeArm", (0.25, 0, 0.04), {}),
        "WRB": ("ForeArm", (0.25, 0, -0.04), {}),
        "FIN": ("Hand", (0.09, 0.02, 0.02), {}),
        "HNP": ("Hand", (0.07, 0.02, -0.04), {}),
        "THI": ("UpLeg", (0.09, -0.2, 0.03), {1: -0.26}),
        "KNE": ("UpLeg", (0.055, -0.43, 0), {}),
        "TIB": ("Leg", (0.06, -0.18, 0.02), {1: -0.24}),
        "ANK": ("Leg", (0.045, -0.42, 0), {}),
        "HEE": ("Foot", (0, -0.04, -0.06), {}),
        "MT5": ("Foot", (0.05, -0.05, 0.1), {}),
        "TOE": ("Toe", (-0.01, 0.02, 0.03), {}),
    },
    "body37": {
        "TEM": ("Head", (0.08, 0.1, 0.04), {}),
        "ILC": ("Hips", (0.14, 0.08, 0.03), {1: 0.06}),
        "ACR": ("Shoulder", (0.14, 0.05, 0.01), {}),
        "UPA": ("Arm", (0.14, 0.04, -0.03), {0: 0.19}),
        "LEP": ("Arm", (0.28, 0.02, -0.04), {}),
        "RAD": ("ForeArm", (0.24, 0.01, 0.04), {}),
        "ULN": ("ForeArm", (0.25, 0, -0.04), {}),
        "MC3": ("Hand", (0.08, 0.025, 0), {}),
        "THI": ("UpLeg", (0.08, -0.22, 0.04), {1: -0.28}),
        "LCO": ("UpLeg", (0.06, -0.42, 0.01), {}),
        "MCO": ("UpLeg", (-0.05, -0.42, 0.0), {}),
        "TIB": ("Leg", (0.03, -0.2, 0.05), {1: -0.25}),
        "MAL": ("Leg", (0.045, -0.41, -0.01), {}),
        "CAL": ("Foot", (0.01, -0.03, -0.07), {}),
        "MT1": ("Toe", (-0.03, 0.02, 0.01), {}),
    },
}
MARKER_SETS = tuple(_MIDDLE)
_SOFT = ("THI", "TIB", "UPA")
# Markers a labeller takes for each other, by what their joints and names have alike.
_SWAPPED = {
    "body41": (("LWRA", "LWRB"), ("RFHD", "LFHD"), ("LHEE", "RHEE"), ("LTHI", "LKNE"),
               ("RMT5", "RTOE")),
    "body37": (("LRAD", "LULN"), ("RTEM", "LTEM"), ("LCAL", "RCAL"), ("LTHI", "LLCO"),
               ("RMAL", "RCAL")),
}  # fmt: skip
# Steps a second, length of a pair of steps [m], turning [rad/s], bend of the knees [m],
# arm swing [rad], bend of the elbows [rad], how far arms hang and reach forward [rad],
# lift of the feet [m], lean [rad]; least and most of each.
_WALKS: dict[str, tuple[tuple[float, float], ...]] = {
    "walk": ((1.5, 1.9), (1.1, 1.5), (0.0, 0.12), (0.02, 0.05), (0.2, 0.45),
             (0.2, 0.7), (1.1, 1.35), (0.0, 0.1), (0.06, 0.12), (0.02, 0.1)),
    "walk_slow": ((0.9, 1.3), (0.6, 1.0), (0.0, 0.3), (0.02, 0.06), (0.05, 0.25),
                  (0.1, 0.5), (1.15, 1.4), (0.0, 0.1), (0.05, 0.1), (0.0, 0.15)),
    "walk_fast": ((2.1, 2.7), (1.5, 1.9), (0.0, 0.1), (0.03, 0.08), (0.4, 0.8),
                  (0.6, 1.5), (1.0, 1.3), (0.0, 0.2), (0.08, 0.2), (0.05, 0.2)),
    "walk_turn": ((1.3, 1.9), (0.8, 1.3), (0.5, 1.1), (0.02, 0.06), (0.2, 0.5),
                  (0.2, 0.8), (1.0, 1.35), (0.0, 0.2), (0.06, 0.12), (0.0, 0.15)),
    "walk_sneak": ((0.9, 1.4), (0.6, 1.0), (0.0, 0.4), (0.06, 0.15), (0.05, 0.3),
                   (0.8, 1.6), (0.6, 1.1), (0.3, 0.9), (0.1, 0.25), (0.2, 0.5)),
    "walk_carry": ((1.3, 1.8), (0.9, 1.3), (0.0, 0.3), (0.02, 0.08), (0.0, 0.06),
                   (1.0, 1.6), (1.0, 1.3), (0.3, 0.7), (0.06, 0.12), (0.0, 0.1)),
}  # fmt: skip
MOTIONS = (*_WALKS, "rom", "fast")
_FRAMES = {"rom": 840, "fast": 600}


@dataclass(frozen=True)
class Cloud:
    """A made cloud: arrays by name as in the files, and what is true.

    Attributes:
        arrays: ``fs``, ``marker_names``, ``markers_mm`` ``(F, M, 3)``, ``static_mm``
            and ``unlabelled_mm`` ``(F, M + 4, 3)``.
        truth: ``markers_mm``, ``joint_pos_mm``, ``root_m``, ``local_quat_wxyz``,
            ``joint_names``, ``perm`` and ``contacts``.
        known: ``skeleton``, ``gaps``, ``spikes`` and ``swaps``.
        template: The generic skeleton that the person is made of.
    """

    arrays: dict[str, Any]
    truth: dict[str, Any]
    known: dict[str, Any]
    template: dict[str, Any]

    def markers(self, name: str = "markers_mm") -> Markers:
        """Return an array as markers [m]."""
        positions = self.arrays[name].astype(np.float64) / 1000.0
        names = [str(name) for name in self.arrays["marker_names"]]
        if positions.shape[1] > len(names):
            names = [f"*{i}" for i in range(positions.shape[1])]
        clock = Clock(Fraction(FS), Fraction(1), Fraction(1), len(positions))
        return Markers(tuple(names), clock, positions)

    def write(self, folder: Path, stem: str) -> Path:
        """Write the files of a cloud and return the path of its arrays."""
        path = folder / f"cloud_{stem}.npz"
        np.savez_compressed(path, **self.arrays)
        np.savez_compressed(folder / f"cloud_{stem}.truth.npz", **self.truth)
        (folder / f"cloud_{stem}.truth.json").write_text(json.dumps(self.known))
        (folder / "template_skeleton.json").write_text(json.dumps(self.template))
        return path


def cloud(
    seed: int,
    motion: str | None = None,
    markers: str | None = None,
    frames: int | None = None,
) -> Cloud:
    """Return a cloud of a made person.

    Args:
        seed: Of everything.
        motion: One of `MOTIONS`; None takes them in turn by the seed.
        markers: One of `MARKER_SETS`; None is each of them for some seeds.
        frames: How many at 120 Hz; None as long as captures of such motions are.
    """
    motion = motion or MOTIONS[seed % len(MOTIONS)]
    markers = markers or MARKER_SETS[seed // len(MOTIONS) % len(MARKER_SETS)]
    frames = frames or _FRAMES.get(motion, 720)
    rng = np.random.default_rng([seed, MOTIONS.index(motion), _code(markers)])
    generic = template(markers)
    skeleton = _subject(generic, rng)
    names = [entry["name"] for entry in skeleton["markers"]]
    if motion in _WALKS:
        root, local, contacts = _walk(skeleton, _WALKS[motion], frames, rng)
    else:
        root, local = _free(skeleton, motion, frames, rng)
        contacts = np.zeros((0, 2), bool)
    joints, true = _forward(skeleton, root, local)
    seen = true + rng.normal(0.0, 0.3, true.shape)
    for i, name in enumerate(names):
        if name.endswith(_SOFT):
            seen[:, i] += _smooth(frames, 0.12, rng) * 1.2
    gaps = _gaps(skeleton, frames, rng)
    hidden = np.zeros(seen.shape[:2], bool)
    for gap in gaps:
        hidden[gap["start"] : gap["end"], names.index(gap["marker"])] = True
    bare = np.where(hidden[..., None], np.nan, seen)
    shuffled, perm = _shuffled(bare, rng)
    spikes, swaps = _planted(bare, names, _SWAPPED[markers], rng)
    arrays = {
        "fs": np.array(FS),
        "marker_names": np.array(names),
        "markers_mm": _stored(bare),
        "static_mm": _stored(_static(skeleton, rng)),
        "unlabelled_mm": _stored(shuffled),
    }
    truth = {
        "markers_mm": _stored(true),
        "joint_pos_mm": _stored(joints),
        "root_m": root.astype(np.float32),
        "local_quat_wxyz": np.roll(local, 1, axis=-1).astype(np.float32),
        "joint_names": np.array([entry["name"] for entry in skeleton["joints"]]),
        "perm": perm,
        "contacts": contacts,
    }
    known = {"skeleton": skeleton, "gaps": gaps, "spikes": spikes, "swaps": swaps}
    return Cloud(arrays, truth, known, generic)


def _code(markers: str) -> int:
    return MARKER_SETS.index(markers)


def _stored(values: FloatArray) -> Any:
    """Return positions as files hold them: to 1/32 mm."""
    return (np.round(values * 32.0) / 32.0).astype(np.float32)


def template(markers: str) -> dict[str, Any]:
    """Return the generic skeleton with a set of markers, as the data state one."""
    rows: list[tuple[str, str, Any, Any]] = [*_SPINE]
    for side, sign in (("Left", 1), ("Right", -1)):
        for name, parent, (x, y, z), limits in _ARM + _LEG:
            above = parent if parent in ("Chest", "Hips") else side + parent
            if isinstance(limits, tuple) and isinstance(limits[0], tuple):
                (a, b, c), low, high = limits
                mirrored: Any = ((a, sign * b, c), low, high)
            else:
                mirrored = limits
            rows.append((side + name, above, (sign * x, y, z), mirrored))
    index = {row[0]: i for i, row in enumerate(rows)}
    joints = [_joint(*row, index=index) for row in rows]
    sides = _SIDES[markers]
    listed = [
        {"name": name, "joint": joint, "offset": [float(v) for v in offset]}
        for name, (joint, offset) in _MIDDLE[markers].items()
    ]
    for side, letter, sign in (("Left", "L", 1), ("Right", "R", -1)):
        for name, (joint, offset, other) in sides.items():
            at = [float(v) for v in offset]
            for axis, value in other.items() if sign < 0 else ():
                at[axis] = value
            at[0] *= sign
            on = joint if joint in ("Head", "Hips") else side + joint
            listed.append({"name": letter + name, "joint": on, "offset": at})
    ends = {
        "Head": [0, 0.2, 0], "LeftHand": [0.17, 0, 0], "RightHand": [-0.17, 0, 0],
        "LeftToe": [0, 0, 0.07], "RightToe": [0, 0, 0.07],
    }  # fmt: skip
    return {"units": "m", "up": "Y", "joints": joints, "ends": ends, "markers": listed}


def _joint(
    name: str, parent: str, offset: Any, limits: Any, index: dict[str, int]
) -> dict[str, Any]:
    kind, pin = "ball" if parent else "free", None
    if limits is not None and isinstance(limits[0], tuple):
        kind = "pin"
        axis, low, high = limits
        pin, limits = {"axis": list(axis), "lo_deg": low, "hi_deg": high}, None
    return {
        "name": name,
        "parent": index.get(parent, -1),
        "offset": [float(v) for v in offset],
        "type": kind,
        "limits_deg": list(limits) if limits else None,
        "pin": pin,
    }


def _subject(generic: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """Return a person: bones of other lengths, sides alike, markers put on by hand."""
    skeleton: dict[str, Any] = json.loads(json.dumps(generic))
    scales: dict[str, float] = {}
    for entry in skeleton["joints"]:
        bone = entry["name"].removeprefix("Left").removeprefix("Right")
        scale = scales.setdefault(bone, float(rng.uniform(0.88, 1.12)))
        entry["offset"] = [value * scale for value in entry["offset"]]
    # A marker goes along with the bone that it is on, as far as it is along it.
    grown = {e["name"]: e for e in skeleton["joints"]}
    below = {"Chest": "Neck", "Spine": "Chest", "Hips": "Spine"}
    for arm, child in zip(_ARM + _LEG, _ARM[1:] + _LEG[1:], strict=False):
        if child[1] == arm[0]:
            below |= {s + arm[0]: s + child[0] for s in ("Left", "Right")}
    for entry in skeleton["markers"]:
        child_name = below.get(entry["joint"])
        scale = scales[_bare(child_name)] if child_name in grown else 1.0
        offset = np.array(entry["offset"]) * scale + rng.normal(0.0, 0.008, 3)
        entry["offset"] = [float(value) for value in offset]
    return skeleton


def _bare(name: str | None) -> str:
    return (name or "").removeprefix("Left").removeprefix("Right")


def _forward(
    skeleton: dict[str, Any], root: FloatArray, local: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return positions of joints ``(F, J, 3)`` and markers ``(F, M, 3)`` [mm]."""
    turns: list[FloatArray] = []
    places: list[FloatArray] = []
    for i, entry in enumerate(skeleton["joints"]):
        above = entry["parent"]
        if above < 0:
            turns.append(local[:, i])
            places.append(root)
            continue
        turns.append(so3.multiply(turns[above], local[:, i]))
        places.append(places[above] + so3.rotate(turns[above], entry["offset"]))
    index = {entry["name"]: i for i, entry in enumerate(skeleton["joints"])}
    on = [(index[e["joint"]], e["offset"]) for e in skeleton["markers"]]
    markers = [places[i] + so3.rotate(turns[i], offset) for i, offset in on]
    return np.stack(places, 1) * 1000.0, np.stack(markers, 1) * 1000.0


def _smooth(frames: int, seconds: float, rng: np.random.Generator) -> FloatArray:
    """Return three curves of noise that is smooth over a time, of unit variance."""
    reach = np.arange(-int(3 * seconds * FS), int(3 * seconds * FS) + 1)
    kernel = np.exp(-0.5 * (reach / (seconds * FS / 2.0)) ** 2)
    kernel /= np.sqrt((kernel**2).sum())
    white = rng.normal(size=(frames + len(reach) - 1, 3))
    return np.stack([np.convolve(white[:, k], kernel, "valid") for k in range(3)], 1)


def _static(skeleton: dict[str, Any], rng: np.random.Generator) -> FloatArray:
    """Return a second of standing with the arms out, not quite as the rest pose."""
    count, joints = FS, skeleton["joints"]
    local = np.zeros((count, len(joints), 4))
    local[..., 3] = 1.0
    for i, entry in enumerate(joints):
        if entry["type"] != "pin":
            local[:, i] = so3.exp(rng.normal(0.0, np.radians(3.0), 3))
        else:
            low = max(entry["pin"]["lo_deg"], 0)
            angle = np.radians(low + abs(rng.normal(0.0, 4.0)))
            local[:, i] = so3.exp(np.array(entry["pin"]["axis"], float) * angle)
    root = np.tile(np.array(joints[0]["offset"]), (count, 1))
    _, markers = _forward(skeleton, root, local)
    return markers + rng.normal(0.0, 0.3, markers.shape)


def _free(
    skeleton: dict[str, Any], motion: str, frames: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return root and joints that wander about all that they can do."""
    slow, quick, wide = (0.1, 0.9, 0.9) if motion == "rom" else (0.3, 2.6, 0.65)
    time = np.arange(frames) / FS

    def wander(amount: float, most: float = quick) -> FloatArray:
        rate = rng.uniform(slow, most, 3)
        phase = rng.uniform(0.0, 2.0 * np.pi, 3)
        share = rng.dirichlet(np.ones(3))
        curves = np.sin(2.0 * np.pi * rate * time[:, None] + phase) @ share
        return np.asarray(amount * curves)

    joints = skeleton["joints"]
    local = np.zeros((frames, len(joints), 4))
    for i, entry in enumerate(joints):
        if entry["type"] == "pin":
            low, high = entry["pin"]["lo_deg"], entry["pin"]["hi_deg"]
            angle = 0.5 * (low + high) + wander(0.5 * wide * (high - low))
            axis = np.array(entry["pin"]["axis"], float)
            local[:, i] = so3.exp(np.radians(angle)[:, None] * axis)
            continue
        limits = entry["limits_deg"] or (12, 50, 12)
        about = np.stack([wander(wide * limit) for limit in limits], 1)
        local[:, i] = so3.exp(np.radians(about))
    root = np.stack([wander(amount, 0.6) for amount in (0.4, 0.08, 0.4)], 1)
    return root + joints[0]["offset"], local


def _walk(
    skeleton: dict[str, Any],
    style: tuple[tuple[float, float], ...],
    frames: int,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return root, joints and contacts of a walk whose feet stay where they stand."""
    pace, stride, turn, bend, swing, elbow, hang, reach, lift, lean = (
        float(rng.uniform(low, high)) for low, high in style
    )
    joints = skeleton["joints"]
    index = {entry["name"]: i for i, entry in enumerate(joints)}
    offset = {entry["name"]: np.array(entry["offset"]) for entry in joints}
    thigh, shin = (abs(offset[name][1]) for name in ("LeftLeg", "LeftFoot"))
    long = thigh + shin
    stride *= long / 0.85
    time = np.arange(frames) / FS
    cycle = 0.5 * pace * time + rng.uniform()  # [1] cycles of two steps
    turn *= rng.choice((-1.0, 1.0))
    wobble = rng.uniform(0.05, 0.2) * np.sin(rng.uniform(0.3, 0.8) * time)

    def heading(at: FloatArray) -> FloatArray:
        return np.asarray(turn * at / (0.5 * pace) + np.interp(at, cycle, wobble))

    dense = np.linspace(cycle[0] - 2.0, cycle[-1] + 2.0, 8 * frames)
    way = stride * np.stack([np.sin(heading(dense)), np.cos(heading(dense))], 1)
    path = np.cumsum(way * (dense[1] - dense[0]), axis=0)

    def ground(at: FloatArray) -> FloatArray:
        x, z = (np.interp(at, dense, path[:, k]) for k in range(2))
        return np.stack([x, np.zeros_like(x), z], -1)

    stance = float(rng.uniform(0.58, 0.64))
    tall = np.sqrt(long**2 - (0.5 * stance * stride) ** 2)
    bob = 0.02 * np.cos(4.0 * np.pi * cycle)
    root = ground(cycle)
    root[:, 1] = 0.08 + tall - bend + bob + abs(offset["LeftUpLeg"][1])
    yaw = heading(cycle)
    y_axis, x_axis, z_axis = np.eye(3)[[1, 0, 2]]
    facing = so3.exp(yaw[:, None] * y_axis)
    sway = 0.08 * np.sin(2.0 * np.pi * cycle)
    local = np.zeros((frames, len(joints), 4))
    local[..., 3] = 1.0
    local[:, 0] = so3.multiply(facing, so3.exp(sway[:, None] * y_axis))
    local[:, index["Spine"]] = so3.exp(
        np.stack([np.full(frames, lean), -sway, 0.3 * sway], 1)
    )
    look = 0.3 * np.sin(2.0 * np.pi * 0.23 * time + rng.uniform(0.0, 6.0))
    local[:, index["Neck"]] = so3.exp(
        np.stack([0 * look - 0.7 * lean, look, 0 * look], 1)
    )
    contacts = np.zeros((frames, 2), bool)
    wide = abs(offset["LeftUpLeg"][0])
    pins = {side: (0, -1 if side == "Left" else 1, 0) for side in ("Left", "Right")}
    for k, (side, sign, phase) in enumerate((("Left", 1, 0.0), ("Right", -1, 0.5))):
        own = cycle + phase
        step, part = np.floor(own), own - np.floor(own)
        across = sign * wide

        def foot(at: FloatArray, apart: float = across) -> FloatArray:
            turned = so3.rotate(so3.exp(heading(at)[:, None] * y_axis), apart * x_axis)
            return np.asarray(ground(at) + turned)

        middle = step + 0.5 * stance - phase
        go = np.clip((part - stance) / (1.0 - stance), 0.0, 1.0)
        ease = go * go * (3.0 - 2.0 * go)
        ankle = (1.0 - ease)[:, None] * foot(middle) + ease[:, None] * foot(
            middle + 1.0
        )
        rise = lift * np.sin(np.pi * go) ** 2
        # The heel goes up before the toe leaves.
        late = np.clip((part - 0.6 * stance) / (0.4 * stance), 0.0, 1.0)
        late = late * late * (3.0 - 2.0 * late) * (1.0 - ease)
        ankle[:, 1] = 0.1 + rise + 0.03 * late
        contacts[:, k] = part < stance
        hip = root + so3.rotate(local[:, 0], offset[f"{side}UpLeg"])
        towards = so3.rotate(so3.conjugate(local[:, 0]), ankle - hip)
        far = np.minimum(np.linalg.norm(towards, axis=1), 0.998 * long)
        cosine = (far**2 - thigh**2 - shin**2) / (2.0 * thigh * shin)
        knee = np.arccos(np.clip(cosine, -1.0, 1.0))
        back = np.arctan2(shin * np.sin(knee), thigh + shin * np.cos(knee))
        aim = towards / np.linalg.norm(towards, axis=1, keepdims=True)
        axis = np.cross(-y_axis, aim)
        point = so3.normalize(np.concatenate([axis, 1.0 - aim[:, 1:2]], axis=1))
        up_leg = so3.multiply(point, so3.exp(-back[:, None] * x_axis))
        leg = so3.exp(knee[:, None] * x_axis)
        above = so3.multiply(so3.multiply(local[:, 0], up_leg), leg)
        toes = heading(middle) * (1.0 - ease) + heading(middle + 1.0) * ease
        pitch = 0.35 * late - 0.2 * np.sin(np.pi * go * go * (2.0 - go)) ** 2
        flat = so3.multiply(
            so3.exp((toes + 0.1 * sign)[:, None] * y_axis),
            so3.exp(pitch[:, None] * x_axis),
        )
        local[:, index[f"{side}UpLeg"]] = up_leg
        local[:, index[f"{side}Leg"]] = leg
        local[:, index[f"{side}Foot"]] = so3.multiply(so3.conjugate(above), flat)
        local[:, index[f"{side}Toe"]] = so3.exp(-0.4 * late[:, None] * x_axis)
        beat = np.sin(2.0 * np.pi * own)
        down = so3.exp(np.full((frames, 1), -sign * hang) * z_axis)
        ahead = so3.exp((-reach - swing * beat)[:, None] * x_axis)
        local[:, index[f"{side}Arm"]] = so3.multiply(ahead, down)
        bent = elbow + 0.3 * swing * (1.0 + beat)
        local[:, index[f"{side}ForeArm"]] = so3.exp(
            bent[:, None] * np.array(pins[side])
        )
        hand = np.array([0.1, 0.15, 0.1]) * np.sin(
            2.0 * np.pi * own[:, None] + rng.uniform(0.0, 6.0, 3)
        )
        local[:, index[f"{side}Hand"]] = so3.exp(hand)
    return root, local, contacts


def _gaps(
    skeleton: dict[str, Any], frames: int, rng: np.random.Generator
) -> list[dict[str, Any]]:
    """Return gaps of all kinds, none in the first and last half second."""
    names = [entry["name"] for entry in skeleton["markers"]]
    on: dict[str, list[str]] = {}
    for entry in skeleton["markers"]:
        on.setdefault(entry["joint"], []).append(entry["name"])
    half, seconds = FS // 2, frames / FS
    found: list[dict[str, Any]] = []

    def add(marker: str, length: int, kind: str, start: int | None = None) -> None:
        if start is None:
            start = int(rng.integers(half, frames - half - length))
        entry = {"marker": marker, "start": start, "end": start + length, "kind": kind}
        found.append(entry)

    for kind, rate, low, high in (
        ("short", 11.6, 2, 6),
        ("medium", 4.8, 13, 60),
        ("long", 1.4, 76, 240),
    ):
        for _ in range(round(rate * seconds)):
            longest = min(high, frames - FS - 1)
            add(
                names[int(rng.integers(len(names)))],
                int(rng.integers(low, longest)),
                kind,
            )
    groups = [group for group in on.values() if len(group) > 1]
    for which in rng.choice(len(groups), 2, replace=False).tolist():
        kept = int(rng.integers(len(groups[which])))
        length = int(rng.integers(24, 73))
        start = int(rng.integers(half, frames - half - length))
        for i, name in enumerate(groups[which]):
            if i != kept:
                add(name, length, "segment", start)
    return found


def _shuffled(bare: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, Any]:
    """Return the points in another order each frame, with ghosts, and whose each is."""
    frames, count, _ = bare.shape
    ghosts = np.full((frames, 4, 3), np.nan)
    low, high = np.nanmin(bare, axis=(0, 1)), np.nanmax(bare, axis=(0, 1))
    for ghost in range(4):
        for _ in range(int(rng.integers(1, 4))):
            start = int(rng.integers(0, frames - 10))
            length = int(rng.integers(10, 80))
            ghosts[start : start + length, ghost] = rng.uniform(low, high)
    whole = np.concatenate([bare, ghosts], axis=1)
    order: IntArray = np.argsort(rng.random((frames, count + 4)), axis=1)
    perm = np.where(order < count, order, -1).astype(np.int8)
    return np.take_along_axis(whole, order[..., None], 1), perm


def _planted(
    bare: FloatArray,
    names: list[str],
    pairs: tuple[tuple[str, str], ...],
    rng: np.random.Generator,
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Put spikes and swaps into positions, in place, and return them."""
    frames = len(bare)
    spikes: list[dict[str, Any]] = []
    swaps: list[dict[str, Any]] = []
    for _ in range(int(rng.integers(6, 13))):
        marker, length = int(rng.integers(len(names))), int(rng.integers(1, 4))
        start = int(rng.integers(5, frames - 8))
        bare[start : start + length, marker] += rng.normal(0.0, 30.0, 3)
        spikes.append({"marker": names[marker], "start": start, "end": start + length})
    for a, b in pairs:
        if rng.random() < 0.2:
            continue
        length = int(rng.integers(30, 110))
        start = int(rng.integers(FS // 2, frames - FS // 2 - length))
        both = [names.index(a), names.index(b)]
        span = slice(start, start + length)
        bare[span, both] = bare[span, both[::-1]]
        swaps.append({"a": a, "b": b, "start": start, "end": start + length})
    # A spike goes along with the points that are swapped.
    for spike in spikes:
        for swap in swaps:
            if spike["marker"] in (swap["a"], swap["b"]) and (
                swap["start"] <= spike["start"] < swap["end"]
            ):
                spike["marker"] = swap["a" if spike["marker"] == swap["b"] else "b"]
    return spikes, swaps
