"""A small FBX of numbers that are known, binary and ASCII."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

Tree = tuple[str, list[Any], list[Any]]  # name, values, elements below
TICKS = 46_186_158_000
MAGIC = b"Kaydara FBX Binary  \x00\x1a\x00"
_SCALARS = {"<i8": b"L", "<f8": b"D", "<f4": b"F", "<i4": b"I"}


def array(values: Any, kind: str) -> npt.NDArray[Any]:
    """Return numbers that a file has as an array."""
    return np.array(values, kind)


def _property(name: str, kind: str, *values: Any) -> Tree:
    return "P", [name, kind, "", "A", *values], []


def _vector(name: str, *values: float) -> Tree:
    return _property(name, name, *(float(value) for value in values))


def _properties(*rows: Tree) -> Tree:
    return "Properties70", [], list(rows)


def _model(own: int, name: str, kind: str, *rows: Tree) -> Tree:
    return "Model", [own, f"{name}\x00\x01Model", kind], [_properties(*rows)]


def _curve(own: int, seconds: list[float], values: list[float], flags: int) -> Tree:
    count = len(seconds)
    ticks = [round(one * TICKS) for one in seconds]
    return (
        "AnimationCurve",
        [own, "\x00\x01AnimCurve", ""],
        [
            ("KeyTime", [array(ticks, "<i8")], []),
            ("KeyValueFloat", [array(values, "<f4")], []),
            ("KeyAttrFlags", [array([flags], "<i4")], []),
            ("KeyAttrDataFloat", [array([0, 0, 218434821, 0], "<i4")], []),
            ("KeyAttrRefCount", [array([count], "<i4")], []),
        ],
    )


def _cluster(
    own: int, name: str, points: list[int], weights: list[float], up: float
) -> Tree:
    link, mesh = np.eye(4), np.eye(4)
    link[3, 1], mesh[3, 1] = up, -up  # files have matrices for rows
    return (
        "Deformer",
        [own, f"{name}\x00\x01SubDeformer", "Cluster"],
        [
            ("Indexes", [array(points, "<i4")], []),
            ("Weights", [array(weights, "<f8")], []),
            ("Transform", [array(mesh.ravel(), "<f8")], []),
            ("TransformLink", [array(link.ravel(), "<f8")], []),
        ],
    )


def small_fbx() -> list[Tree]:
    """Return an arm of two bones with a skin, a shape and a take of two layers.

    The fore bone is 10 above the first and turns about Z from 0 to 90 degrees in 1 s,
    linearly; a layer adds 20 at half weight.
    """
    corners = [[-1, 0, 0], [1, 0, 0], [1, 20, 0], [-1, 20, 0]]
    objects: list[Tree] = [
        _model(1, "arm", "LimbNode", _vector("Lcl Translation", 0, 0, 0)),
        _model(2, "fore", "LimbNode", _vector("Lcl Translation", 0, 10, 0)),
        _model(3, "skin", "Mesh"),
        (
            "Geometry",
            [4, "\x00\x01Geometry", "Mesh"],
            [
                ("Vertices", [array(np.ravel(corners), "<f8")], []),
                ("PolygonVertexIndex", [array([0, 1, 2, ~3], "<i4")], []),
            ],
        ),
        ("Deformer", [5, "\x00\x01Deformer", "Skin"], []),
        _cluster(6, "arm", [0, 1], [1.0, 1.0], 0.0),
        _cluster(7, "fore", [2, 3], [1.0, 0.5], 10.0),
        ("Deformer", [8, "\x00\x01Deformer", "BlendShape"], []),
        (
            "Deformer",
            [9, "wide\x00\x01SubDeformer", "BlendShapeChannel"],
            [
                ("DeformPercent", [25.0], []),
                ("FullWeights", [array([100.0], "<f8")], []),
            ],
        ),
        (
            "Geometry",
            [10, "wide\x00\x01Geometry", "Shape"],
            [
                ("Indexes", [array([2], "<i4")], []),
                ("Vertices", [array([4.0, 0.0, 0.0], "<f8")], []),
            ],
        ),
        (
            "AnimationStack",
            [11, "bend\x00\x01AnimStack", ""],
            [
                _properties(
                    _property("LocalStart", "KTime", 0),
                    _property("LocalStop", "KTime", TICKS),
                )
            ],
        ),
        ("AnimationLayer", [12, "base\x00\x01AnimLayer", ""], []),
        (
            "AnimationLayer",
            [13, "more\x00\x01AnimLayer", ""],
            [
                _properties(
                    _property("Weight", "Number", 50.0),
                    _property("RotationAccumulationMode", "enum", 1),
                )
            ],
        ),
        ("AnimationCurveNode", [14, "R\x00\x01AnimCurveNode", ""], [_properties()]),
        ("AnimationCurveNode", [15, "R\x00\x01AnimCurveNode", ""], [_properties()]),
        _curve(16, [0.0, 1.0], [0.0, 90.0], 4),
        _curve(17, [0.0, 1.0], [20.0, 20.0], 0x6108),
    ]
    links = [(1, 0), (2, 1), (3, 0), (4, 3), (5, 4), (6, 5), (7, 5), (1, 6), (2, 7)]
    links += [(8, 4), (9, 8), (10, 9), (12, 11), (13, 11), (14, 12), (15, 13)]
    named = [(14, 2, "Lcl Rotation"), (15, 2, "Lcl Rotation")]
    named += [(16, 14, "d|Z"), (17, 15, "d|Z")]
    connections: list[Tree] = [("C", ["OO", a, b], []) for a, b in links]
    connections += [("C", ["OP", a, b, name], []) for a, b, name in named]
    settings = [("UpAxis", 1), ("FrontAxis", 2), ("CoordAxis", 0), ("TimeMode", 11)]
    rows = [_property(name, "int", value) for name, value in settings]
    rows.append(_property("UnitScaleFactor", "double", 1.0))
    return [
        ("FBXHeaderExtension", [], [("FBXVersion", [7400], [])]),
        ("GlobalSettings", [], [_properties(*rows)]),
        ("Objects", [], objects),
        ("Connections", [], connections),
    ]


def with_pose_take(trees: list[Tree]) -> list[Tree]:
    """Return a small FBX with a take before its own that moves nothing."""
    still = [
        ("AnimationStack", [21, "pose\x00\x01AnimStack", ""], [_properties()]),
        ("AnimationLayer", [22, "base\x00\x01AnimLayer", ""], []),
        ("AnimationCurveNode", [23, "R\x00\x01AnimCurveNode", ""], [_properties()]),
        _curve(24, [0.0, 1.0], [5.0, 5.0], 4),
    ]
    links = [("OO", 22, 21), ("OO", 23, 22)]
    links += [("OP", 23, 2, "Lcl Rotation"), ("OP", 24, 23, "d|Z")]
    objects, connections = trees[-2][2], trees[-1][2]
    objects[:0] = still
    connections += [("C", list(link), []) for link in links]
    return trees


def as_binary(
    trees: list[Tree], version: int = 7400, *, inflated: bool = False
) -> bytes:
    """Return a binary FBX of elements."""
    wide = version >= 7500
    head = "<QQQB" if wide else "<IIIB"
    content = MAGIC + struct.pack("<I", version)
    for tree in trees:
        content += _record(tree, len(content), head, inflated)
    return content + bytes(struct.calcsize(head))


def _record(tree: Tree, at: int, head: str, inflated: bool) -> bytes:
    name, values, below = tree
    raw = name.encode()
    stored = b"".join(_value(value, inflated) for value in values)
    size = struct.calcsize(head) + len(raw) + len(stored)
    inner = b""
    for child in below:
        inner += _record(child, at + size + len(inner), head, inflated)
    if below:
        inner += bytes(struct.calcsize(head))
    end = at + size + len(inner)
    start = struct.pack(head, end, len(values), len(stored), len(raw))
    return start + raw + stored + inner


def _value(value: Any, inflated: bool) -> bytes:
    if isinstance(value, str):
        return b"S" + struct.pack("<I", len(value.encode())) + value.encode()
    if isinstance(value, np.ndarray):
        raw = value.tobytes()
        data = raw if inflated else zlib.compress(raw)
        kind = _SCALARS[value.dtype.str].lower()
        return kind + struct.pack("<III", value.size, not inflated, len(data)) + data
    if isinstance(value, float):
        return b"D" + struct.pack("<d", value)
    return b"L" + struct.pack("<q", value)


def as_text(trees: list[Tree], version: int = 7400) -> bytes:
    """Return an FBX of text of elements."""
    first = f"; FBX {version // 1000}.{version // 100 % 10}.0 project file\n"
    return (first + "".join(_lines(tree, "") for tree in trees)).encode()


def _lines(tree: Tree, indent: str) -> str:
    name, values, below = tree
    if len(values) == 1 and isinstance(values[0], np.ndarray):
        numbers = ",".join(repr(one) for one in values[0].tolist())
        count = values[0].size
        return f"{indent}{name}: *{count} {{\n{indent}\ta: {numbers}\n{indent}}}\n"
    parts = ", ".join(_word(value) for value in values)
    text = f"{indent}{name}: {parts}"
    if below:
        inner = "".join(_lines(child, f"{indent}\t") for child in below)
        text += f" {{\n{inner}{indent}}}"
    return f"{text}\n"


def _word(value: Any) -> str:
    if isinstance(value, str):
        own, _, kind = value.partition("\x00\x01")
        return f'"{kind}::{own}"' if kind else f'"{value}"'
    return repr(value)


def _channels(turn: list[Any]) -> Tree:
    """Return the transform of a model in a take, turned about Z by keys."""

    def group(name: str, *parts: list[Any]) -> Tree:
        rows = [
            ("Channel", [axis], part) for axis, part in zip("XYZ", parts, strict=True)
        ]
        return "Channel", [name], rows

    def still(value: float) -> list[Any]:
        return [("Default", [value], [])]

    rest = still(0.0)
    moves = group("T", rest, still(10.0), rest)
    keys = [*still(0.0), ("KeyVer", [4005], []), ("Key", turn, [])]
    turns = group("R", rest, rest, keys)
    scales = group("S", still(1.0), still(1.0), still(1.0))
    return "Channel", ["Transform"], [moves, turns, scales]


def _old_take(model: str) -> Tree:
    turn = [0, 0.0, "U", "s", 90.0, 90.0, "n", TICKS, 90.0, "L"]
    parts: list[Tree] = [
        ("LocalTime", [0, TICKS], []),
        ("Model", [model], [_channels(turn)]),
    ]
    return "Takes", [], [("Current", ["bend"], []), ("Take", ["bend"], parts)]


def _old_mesh() -> list[Tree]:
    corners = [-1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 20.0, 0.0, -1.0, 20.0, 0.0]
    return [("Vertices", corners, []), ("PolygonVertexIndex", [0, 1, 2, ~3], [])]


def _old_cluster(up: float) -> list[Tree]:
    link, mesh = np.eye(4), np.eye(4)
    link[3, 1], mesh[3, 1] = up, -up
    return [
        ("Indexes", [2, 3], []),
        ("Weights", [1.0, 1.0], []),
        ("Transform", mesh.ravel().tolist(), []),
        ("TransformLink", link.ravel().tolist(), []),
    ]


def small_6100() -> list[Tree]:
    """Return an arm of two bones with a skin that turns as `small_fbx` does."""

    def moved(up: float) -> list[Tree]:
        row = ("Property", ["Lcl Translation", "", "A", 0.0, up, 0.0], [])
        return [("Properties60", [], [row])]

    objects: list[Tree] = [
        ("Model", ["arm\x00\x01Model", "Limb"], moved(0.0)),
        ("Model", ["fore\x00\x01Model", "Limb"], moved(10.0)),
        ("Model", ["skin\x00\x01Model", "Mesh"], _old_mesh()),
        ("Deformer", ["s\x00\x01Deformer", "Skin"], []),
        ("Deformer", ["c\x00\x01SubDeformer", "Cluster"], _old_cluster(10.0)),
    ]
    links = [("fore", "arm")]
    rows: list[Tree] = [
        ("Connect", ["OO", f"{a}\x00\x01Model", f"{b}\x00\x01Model"], [])
        for a, b in [*links, ("arm", "Scene"), ("skin", "Scene")]
    ]
    rows += [
        ("Connect", ["OO", "s\x00\x01Deformer", "skin\x00\x01Model"], []),
        ("Connect", ["OO", "c\x00\x01SubDeformer", "s\x00\x01Deformer"], []),
        ("Connect", ["OO", "fore\x00\x01Model", "c\x00\x01SubDeformer"], []),
    ]
    return [
        ("FBXHeaderExtension", [], [("FBXVersion", [6100], [])]),
        ("Objects", [], objects),
        ("Connections", [], rows),
        _old_take("fore\x00\x01Model"),
    ]


def small_5000() -> list[Tree]:
    """Return the same as version 5000 has it."""
    still = _channels([])[2][0]
    fore = ("Channel", ["Transform"], [still])
    skin = [*_old_mesh(), ("Link", ["fore"], _old_cluster(10.0))]
    return [
        ("FBXHeaderExtension", [], [("FBXVersion", [5000], [])]),
        ("Model", ["arm"], [("Type", ["LimbNode"], []), ("Children", ["fore"], [])]),
        ("Model", ["fore"], [("Type", ["LimbNode"], []), fore]),
        ("Model", ["skin"], skin),
        _old_take("fore"),
        ("Settings", [], [("FrameRate", ["24"], [])]),
    ]
