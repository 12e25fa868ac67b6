"""A good USD layer that animtool writes, and ways to break it, or nearly so."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Ts, Vt

from animtool.rig.limits import BallLimit, RangeLimit
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.usd.rigs.layer import author_physics
from support.cli import animtool
from support.skinned_rig import write_pair

Break = Callable[[Sdf.Layer], None]

RIG = "/pair/Rig"
ANIM = f"{RIG}/Anim"
SKEL = f"{RIG}/Skel"
BODY = f"{RIG}/body"
FACE = f"{RIG}/face"
SMILE = f"{FACE}/smile"
CACHE = "/pair/Cache"
FLOCK = "/pair/Flock"
CLIPS = "/pair/Clips"
HINGE = "/pair/Physics/Joints/hinge"
BALL = "/pair/Physics/Joints/ball"
CURVE = "/pair.animtool:control:size"
TYPES = Sdf.ValueTypeNames


@dataclass(frozen=True)
class Case:
    """One change to the good layer: the code that it is found by, and where."""

    code: str
    name: str
    change: Break
    where: str = ""

    @property
    def id(self) -> str:
        return f"{self.code} {self.name}"


def write_good(folder: Path) -> Path:
    """Write a layer with everything that the checks look at; return its path."""
    path = folder / "good.usda"
    assert animtool("bake", write_pair(folder), "-o", path).code == 0
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.pseudoRoot.SetInfo("kilogramsPerUnit", 1.0)
    _add_physics(layer)
    _add_cache(layer)
    _add_copies(layer)
    _add_clips(layer, folder)
    _add_curve(layer)
    (folder / "picture.png").write_bytes(b"")
    layer.Save()
    return path


def _add_physics(layer: Sdf.Layer) -> None:
    joints = (
        Joint("root", -1),
        Joint("hinge", 0, JointType.PIN, limits=RangeLimit(-0.5, 1.0)),
        Joint("ball", 0, JointType.BALL, limits=BallLimit((0.5, 0.9), (-0.2, 0.7))),
    )
    rig = Rig("pair", joints, 0.01)
    author_physics(layer, "/pair", rig, rig.names)
    layer.GetPrimAtPath("/pair").specifier = Sdf.SpecifierDef


def _add_cache(layer: Sdf.Layer) -> None:
    """Add a triangle whose points move."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    spec = _define(layer, CACHE, "Mesh")
    _attribute(spec, "faceVertexCounts", TYPES.IntArray, Vt.IntArray([3]))
    _attribute(spec, "faceVertexIndices", TYPES.IntArray, Vt.IntArray([0, 1, 2]))
    for name, kind in (
        ("points", TYPES.Point3fArray),
        ("extent", TYPES.Float3Array),
        ("velocities", TYPES.Vector3fArray),
    ):
        _attribute(spec, name, kind)
    for code in (1.0, 2.0, 3.0):
        at = points * code
        bounds = np.stack([at.min(axis=0), at.max(axis=0)])
        for name, rows in (
            ("points", at),
            ("extent", bounds),
            ("velocities", points * 24),
        ):
            value = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(rows))
            layer.SetTimeSample(f"{CACHE}.{name}", code, value)


def _add_copies(layer: Sdf.Layer) -> None:
    """Add three copies of the triangle that come, move and go."""
    spec = _define(layer, FLOCK, "PointInstancer")
    bird = _define(layer, f"{FLOCK}/Bird", "Mesh")
    points = Vt.Vec3fArray([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    _attribute(bird, "points", TYPES.Point3fArray, points)
    extent = Vt.Vec3fArray([(0, 0, 0), (1, 1, 0)])
    _attribute(bird, "extent", TYPES.Float3Array, extent)
    _attribute(bird, "faceVertexCounts", TYPES.IntArray, Vt.IntArray([3]))
    _attribute(bird, "faceVertexIndices", TYPES.IntArray, Vt.IntArray([0, 1, 2]))
    relationship = Sdf.RelationshipSpec(spec, "prototypes")
    relationship.targetPathList.explicitItems = [Sdf.Path(bird.path)]
    for name, kind in (
        ("protoIndices", TYPES.IntArray),
        ("ids", TYPES.Int64Array),
        ("positions", TYPES.Point3fArray),
        ("orientationsf", TYPES.QuatfArray),
        ("scales", TYPES.Float3Array),
        ("extent", TYPES.Float3Array),
    ):
        _attribute(spec, name, kind)
    for code, count in ((1.0, 3), (2.0, 2), (3.0, 0)):
        turns = Vt.QuatfArray([Gf.Quatf(0.6, 0, 0.8, 0)] * count)
        ones = Vt.Vec3fArray.FromNumpy(np.ones((count, 3), np.float32))
        for name, value in (
            ("protoIndices", Vt.IntArray([0] * count)),
            ("ids", Vt.Int64Array(range(count))),
            ("positions", ones),
            ("orientationsf", turns),
            ("scales", ones),
            ("extent", Vt.Vec3fArray([(0.72, 1, 0.04), (1, 2, 1)])),
        ):
            layer.SetTimeSample(f"{FLOCK}.{name}", code, value)


def _add_clips(layer: Sdf.Layer, folder: Path) -> None:
    for name, codes in (("one", (1, 5)), ("two", (6, 9)), ("manifest", ())):
        clip = Sdf.Layer.CreateAnonymous(".usda")
        spec = _define(clip, "/Model", "Scope")
        clip.defaultPrim = "Model"
        _attribute(spec, "size", TYPES.Float)
        for code in codes:
            clip.SetTimeSample("/Model.size", float(code), float(code))
        for number in (1, 2) if name == "one" else ():
            clip.Export(str(folder / f"part.{number}.usda"))
        clip.Export(str(folder / f"{name}.usda"))
    _attribute(_define(layer, CLIPS, "Scope"), "size", TYPES.Float)
    set_clips(layer)


def set_clips(layer: Sdf.Layer, **changes: Any) -> None:
    """Author the clip set, with changes; None leaves a key out."""
    clips = {
        "assetPaths": assets("./one.usda", "./two.usda"),
        "primPath": "/Model",
        "manifestAssetPath": Sdf.AssetPath("./manifest.usda"),
        "active": Vt.Vec2dArray([(1, 0), (6, 1)]),
        "times": Vt.Vec2dArray([(1, 1), (9, 9)]),
    } | changes
    kept = {key: value for key, value in clips.items() if value is not None}
    layer.GetPrimAtPath(CLIPS).SetInfo("clips", {"default": kept})


def assets(*paths: str) -> Any:
    return Sdf.AssetPathArray([Sdf.AssetPath(path) for path in paths])


def template(folder_stem: str, end: float) -> dict[str, Any]:
    """Return the keys of a clip set by template."""
    return {
        "assetPaths": None,
        "active": None,
        "times": None,
        "templateAssetPath": f"./{folder_stem}.#.usda",
        "templateStartTime": 1.0,
        "templateEndTime": end,
        "templateStride": 1.0,
    }


def spline(width: float = 1.0, value: float = 0.0) -> Any:
    """Return a spline of two knots, 8 apart, whose tangents have a width."""
    made = Ts.Spline("double")
    with Ts.AntiRegressionAuthoringSelector(Ts.AntiRegressionNone):
        for time in (1.0, 9.0):
            knot = Ts.Knot("double", time=time, value=value + time)
            knot.SetNextInterpolation(Ts.InterpCurve)
            knot.SetPreTanWidth(width)
            knot.SetPostTanWidth(width)
            made.SetKnot(knot)
    return made


def _add_curve(layer: Sdf.Layer) -> None:
    name = CURVE.partition(".")[2]
    spec = _attribute(layer.GetPrimAtPath("/pair"), name, TYPES.Double)
    spec.custom = True
    spec.SetSpline(spline())


def _define(layer: Sdf.Layer, path: str, kind: str) -> Any:
    spec = Sdf.CreatePrimInLayer(layer, path)
    spec.specifier = Sdf.SpecifierDef
    spec.typeName = kind
    return spec


def _attribute(spec: Any, name: str, kind: Any, value: Any = None) -> Any:
    made = Sdf.AttributeSpec(spec, name, kind)
    if value is not None:
        made.default = value
    return made


# Ways to change a layer


def value_at(layer: Sdf.Layer, path: str, code: float | None) -> Any:
    if code is None:
        return layer.GetAttributeAtPath(path).default
    return layer.QueryTimeSample(path, code)


def rows(path: str, edit: Callable[[Any], Any], code: float | None = None) -> Break:
    """Return a change of an array: of its default, or of one sample."""

    def change(layer: Sdf.Layer) -> None:
        old = value_at(layer, path, code)
        new = np.ascontiguousarray(edit(np.array(old)))
        made = type(old).FromNumpy(new.astype(np.array(old).dtype))
        if code is None:
            layer.GetAttributeAtPath(path).default = made
        else:
            layer.SetTimeSample(path, code, made)

    return change


def put(path: str, value: Any) -> Break:
    def change(layer: Sdf.Layer) -> None:
        layer.GetAttributeAtPath(path).default = value

    return change


def tokens(path: str, *names: str) -> Break:
    return put(path, Vt.TokenArray(list(names)))


def drop(path: str) -> Break:
    """Return a change that takes a property out."""

    def change(layer: Sdf.Layer) -> None:
        spec = layer.GetPropertyAtPath(path)
        spec.owner.RemoveProperty(spec)

    return change


def target(path: str, *targets: str) -> Break:
    def change(layer: Sdf.Layer) -> None:
        found = layer.GetRelationshipAtPath(path)
        if found is None:
            owner, _, name = path.partition(".")
            found = Sdf.RelationshipSpec(layer.GetPrimAtPath(owner), name)
        found.targetPathList.explicitItems = [Sdf.Path(text) for text in targets]

    return change


def info(path: str, key: str, value: Any) -> Break:
    """Return a change of the metadata of a prim, a property, or the layer (/)."""

    def change(layer: Sdf.Layer) -> None:
        spec = layer.pseudoRoot if path == "/" else layer.GetObjectAtPath(path)
        if value is None:
            spec.ClearInfo(key)
        else:
            spec.SetInfo(key, value)

    return change


def both(*changes: Break) -> Break:
    def change(layer: Sdf.Layer) -> None:
        for one in changes:
            one(layer)

    return change


def cell(row: Any, value: Any) -> Callable[[Any], Any]:
    """Return an edit that puts a value at one place."""

    def edit(array: Any) -> Any:
        array = array.astype(np.float64)
        array[row] = value
        return array

    return edit


def shorter(array: Any) -> Any:
    return array[:-1]


def fresh(path: str, name: str, kind: Any, value: Any, uniform: bool = False) -> Break:
    """Return a change that adds an attribute."""

    def change(layer: Sdf.Layer) -> None:
        how = Sdf.VariabilityUniform if uniform else Sdf.VariabilityVarying
        made = Sdf.AttributeSpec(layer.GetPrimAtPath(path), name, kind, how)
        made.default = value

    return change


def sample(path: str, code: float, value: Any) -> Break:
    def change(layer: Sdf.Layer) -> None:
        layer.SetTimeSample(path, code, value)

    return change


def reference(asset: str, path: str = "/pair/Extra", *, payload: bool = False) -> Break:
    def change(layer: Sdf.Layer) -> None:
        spec = _define(layer, path, "Scope")
        if payload:
            spec.payloadList.Prepend(Sdf.Payload(asset))
        else:
            spec.referenceList.Prepend(Sdf.Reference(asset))

    return change


def sublayer(asset: str) -> Break:
    def change(layer: Sdf.Layer) -> None:
        layer.subLayerPaths.append(asset)

    return change


def props(name: str, **metadata: Any) -> Break:
    """Return a change that adds a sublayer with samples, and metadata of its own."""

    def change(layer: Sdf.Layer) -> None:
        other = Sdf.Layer.CreateAnonymous(".usda")
        spec = _define(other, "/pair/Beside", "Scope")
        _attribute(spec, "size", TYPES.Float)
        for code in (2.0, 3.0):
            other.SetTimeSample("/pair/Beside.size", code, code)
        for key, value in metadata.items():
            other.pseudoRoot.SetInfo(key, value)
        other.Export(str(Path(layer.realPath).with_name(name)))
        layer.subLayerPaths.append(f"./{name}")

    return change


def clip_set(**changes: Any) -> Break:
    return lambda layer: set_clips(layer, **changes)


def define(path: str, kind: str, **defaults: tuple[Any, Any]) -> Break:
    def change(layer: Sdf.Layer) -> None:
        spec = _define(layer, path, kind)
        for name, (value_type, value) in defaults.items():
            _attribute(spec, name, value_type, value)

    return change


def in_all_samples(path: str, edit: Callable[[Any], Any]) -> Break:
    def change(layer: Sdf.Layer) -> None:
        for code in layer.ListTimeSamplesForPath(path):
            rows(path, edit, code)(layer)

    return change


def without_samples(layer: Sdf.Layer) -> None:
    """Drop every sample, spline and clip: nothing moves."""

    def look(path: Sdf.Path) -> None:
        for code in layer.ListTimeSamplesForPath(path) if path.IsPropertyPath() else ():
            layer.EraseTimeSample(path, code)

    layer.Traverse(Sdf.Path.absoluteRootPath, look)
    drop(CURVE)(layer)
    layer.GetPrimAtPath(CLIPS).ClearInfo("clips")


ROT, MOVE, SIZE = (f"{ANIM}.{name}" for name in ("rotations", "translations", "scales"))
WEIGHTS = f"{ANIM}.blendShapeWeights"
JOINTS, REST, BIND = (
    f"{SKEL}.{name}" for name in ("joints", "restTransforms", "bindTransforms")
)
INDICES = f"{BODY}.primvars:skel:jointIndices"
HEAVY = f"{BODY}.primvars:skel:jointWeights"
GEOM = f"{BODY}.primvars:skel:geomBindTransform"
OFFSETS = f"{SMILE}.offsets"
STEP = f"{SMILE}.inbetweens:step_1"
POINTS, VELOCITIES = f"{CACHE}.points", f"{CACHE}.velocities"
NAMES = ("hips", "hips/chest", "hips/chest/arm", "post")
CLIP_PLACE = f"{CLIPS}.clips:default"
FLAT = Gf.Matrix4d(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1)
NAN, INF, TINY = math.nan, math.inf, 1e-5


def _moved_to_parent(bind: Any) -> Any:
    """Return bind transforms of which the second joint is at the first."""
    moved = np.array(bind)
    moved[1, 3] = moved[0, 3]
    return moved


def _invert_bind(layer: Sdf.Layer) -> None:
    """Put the inverse of where the joints rest where they are bound."""
    rest = np.array(value_at(layer, REST, None))
    world = rest.copy()
    for joint, parent in ((1, 0), (2, 1)):
        world[joint] = rest[joint] @ world[parent]
    rows(BIND, lambda _: np.linalg.inv(world))(layer)


def _invert_rest(layer: Sdf.Layer) -> None:
    bind = np.array(value_at(layer, BIND, None))
    rows(REST, lambda _: np.linalg.inv(bind))(layer)


def _indexed(*indices: int, offsets: int | None = None) -> Break:
    """Let the smile move some points alone."""
    count = len(indices) if offsets is None else offsets

    def change(layer: Sdf.Layer) -> None:
        drop(f"{SMILE}.normalOffsets")(layer)
        drop(STEP)(layer)
        rows(OFFSETS, lambda old: old[:count])(layer)
        values = Vt.IntArray(list(indices))
        fresh(SMILE, "pointIndices", TYPES.IntArray, values, uniform=True)(layer)

    return change


def _second_step(weight: float) -> Break:
    def change(layer: Sdf.Layer) -> None:
        rows_ = layer.GetAttributeAtPath(STEP).default
        name = "inbetweens:step_2"
        fresh(SMILE, name, TYPES.Vector3fArray, rows_, uniform=True)(layer)
        layer.GetAttributeAtPath(f"{SMILE}.{name}").SetInfo("weight", weight)

    return change


def _binding_api(layer: Sdf.Layer) -> None:
    layer.GetPrimAtPath(BODY).ClearInfo("apiSchemas")


def _regress(layer: Sdf.Layer) -> None:
    layer.GetAttributeAtPath(CURVE).SetSpline(spline(width=30.0))


def _without(*joints: int) -> Break:
    kept = [name for i, name in enumerate(NAMES) if i not in joints]
    cut: Callable[[Any], Any] = lambda old: np.delete(old, joints, axis=0)  # noqa: E731
    return both(tokens(JOINTS, *kept), rows(REST, cut), rows(BIND, cut))


BROKEN = [
    Case(
        "USD171",
        "an infinite extent",
        rows(f"{RIG}.extent", cell((1, 1), INF), 3.0),
        f"{RIG}.extent",
    ),
    Case(
        "USD171",
        "a default beside samples",
        put(MOVE, Vt.Vec3fArray(4, Gf.Vec3f(NAN))),
        MOVE,
    ),
    Case("USD171", "an attribute of no schema", fresh(RIG, "a", TYPES.Half, NAN)),
    Case(
        "USD171", "an infinite unit below", info(RIG, "customData", {"a": {"b": INF}})
    ),
    Case("USD171", "a layer's data", info("/", "customLayerData", {"a": NAN})),
    Case(
        "USD171",
        "a force that is NaN",
        fresh(HINGE, "physics:breakForce", TYPES.Float, NAN),
    ),
    Case(
        "USD171",
        "a matrix",
        fresh(RIG, "xformOp:transform", TYPES.Matrix4d, Gf.Matrix4d(INF)),
        f"{RIG}.xformOp:transform",
    ),
    Case("USD200", "a rotation too few in one sample", rows(ROT, shorter, 4.0), ROT),
    Case(
        "USD200",
        "a translation too many",
        rows(MOVE, lambda old: np.concatenate([old, old[:1]]), 2.0),
        MOVE,
    ),
    Case("USD200", "scales of another count", rows(SIZE, shorter), SIZE),
    Case("USD200", "an empty sample", rows(MOVE, lambda old: old[:0], 9.0), MOVE),
    Case("USD201", "no scales", drop(SIZE), ANIM),
    Case("USD201", "no translations", drop(MOVE), ANIM),
    Case("USD202", "NaN in a rotation", rows(ROT, cell((1, 2), NAN), 6.0), ROT),
    Case(
        "USD202",
        "infinity in a translation",
        rows(MOVE, cell((0, 0), math.inf), 6.0),
        MOVE,
    ),
    Case("USD202", "NaN in a weight", rows(WEIGHTS, cell(1, NAN), 3.0), WEIGHTS),
    Case("USD203", "a doubled quaternion", rows(ROT, lambda old: old * 2, 3.0), ROT),
    Case("USD203", "a zero quaternion", rows(ROT, cell(0, [0, 0, 0, 0]), 3.0), ROT),
    Case("USD204", "a sign flip", rows(ROT, lambda old: -old, 5.0), ROT),
    Case("USD206", "a weight too few", rows(WEIGHTS, shorter, 8.0), WEIGHTS),
    Case("USD206", "weights without shapes", drop(f"{ANIM}.blendShapes"), WEIGHTS),
    Case(
        "USD207",
        "a joint of the animation twice",
        tokens(f"{ANIM}.joints", "hips", "hips", *NAMES[2:]),
        f"{ANIM}.joints",
    ),
    Case(
        "USD208",
        "a dangling source",
        target(f"{RIG}.skel:animationSource", "/no"),
        f"{RIG}.skel:animationSource",
    ),
    Case(
        "USD208",
        "a source of another type",
        target(f"{RIG}.skel:animationSource", SKEL),
        f"{RIG}.skel:animationSource",
    ),
    Case(
        "USD208",
        "a dangling skeleton",
        target(f"{RIG}.skel:skeleton", "/no"),
        f"{RIG}.skel:skeleton",
    ),
    Case(
        "USD208",
        "a dangling shape",
        target(f"{FACE}.skel:blendShapeTargets", "/no"),
        f"{FACE}.skel:blendShapeTargets",
    ),
    Case(
        "USD209",
        "a joint that the skeleton lacks",
        tokens(f"{ANIM}.joints", *NAMES[:3], "pole"),
        f"{ANIM}.joints",
    ),
    Case(
        "USD210",
        "a weight of no shape",
        tokens(f"{ANIM}.blendShapes", "grin", "bulge", "both"),
        f"{ANIM}.blendShapes",
    ),
    Case(
        "USD211",
        "samples on restTransforms",
        lambda layer: layer.SetTimeSample(REST, 1.0, value_at(layer, REST, None)),
        REST,
    ),
    Case("USD220", "a joint twice", tokens(JOINTS, "hips", "hips", *NAMES[2:]), JOINTS),
    Case(
        "USD221",
        "a child before its parent",
        tokens(JOINTS, "hips/chest", "hips", *NAMES[2:]),
        JOINTS,
    ),
    Case(
        "USD222",
        "a missing parent",
        tokens(JOINTS, "hips", "hip/chest", "hips/arm", "post"),
        JOINTS,
    ),
    Case("USD223", "a rest transform too few", rows(REST, shorter), REST),
    Case("USD224", "a bind transform too few", rows(BIND, shorter), BIND),
    Case("USD224", "no bind transforms", drop(BIND), BIND),
    Case("USD225", "NaN at rest", rows(REST, cell((1, 3, 0), NAN)), REST),
    Case("USD226", "a flat bind transform", rows(BIND, cell((1, 2), 0.0)), BIND),
    Case(
        "USD227",
        "identity at bind time",
        rows(BIND, lambda old: np.tile(np.eye(4), (len(old), 1, 1))),
        BIND,
    ),
    Case("USD290", "a joint bound at its parent", rows(BIND, _moved_to_parent), BIND),
    Case("USD228", "inverse bind matrices at bind time", _invert_bind, BIND),
    Case("USD228", "inverse bind matrices at rest", _invert_rest, REST),
    Case("USD229", "no rest transforms", drop(REST), REST),
    Case("USD229", "no rest or bind transforms", both(drop(REST), drop(BIND)), REST),
    Case(
        "USD239",
        "no rest transforms, and an animation of some joints",
        both(
            drop(REST),
            tokens(f"{ANIM}.joints", *NAMES[:-1]),
            *(in_all_samples(path, shorter) for path in (MOVE, ROT)),
            rows(SIZE, shorter),
        ),
        REST,
    ),
    Case("USD230", "an index beyond the joints", rows(INDICES, cell(5, 3)), INDICES),
    Case("USD230", "a negative index", rows(INDICES, cell(5, -1)), INDICES),
    Case("USD231", "an index too few", rows(INDICES, shorter), INDICES),
    Case("USD231", "another elementSize", info(HEAVY, "elementSize", 2), INDICES),
    Case(
        "USD231",
        "interpolation of the whole mesh",
        both(
            info(HEAVY, "interpolation", "constant"),
            info(INDICES, "interpolation", "constant"),
        ),
        INDICES,
    ),
    Case("USD232", "weights that sum to 0.9", rows(HEAVY, lambda w: w * 0.9), HEAVY),
    Case("USD233", "a negative weight", rows(HEAVY, cell(0, -0.4)), HEAVY),
    Case("USD233", "NaN in a weight", rows(HEAVY, cell(0, NAN)), HEAVY),
    Case("USD234", "no weights", drop(HEAVY), BODY),
    Case(
        "USD234",
        "empty influences",
        both(rows(HEAVY, lambda w: w[:0]), rows(INDICES, lambda i: i[:0])),
        BODY,
    ),
    Case("USD235", "a flat geomBindTransform", put(GEOM, FLAT), GEOM),
    Case("USD236", "no SkelBindingAPI", _binding_api, BODY),
    Case(
        "USD237",
        "no SkelRoot",
        lambda layer: setattr(layer.GetPrimAtPath(RIG), "typeName", "Xform"),
        SKEL,
    ),
    Case(
        "USD238",
        "a joint that the skeleton lacks",
        tokens(f"{BODY}.skel:joints", "hips", "hips/chest", "arm"),
        f"{BODY}.skel:joints",
    ),
    Case("USD240", "an offset too few", rows(OFFSETS, shorter), OFFSETS),
    Case("USD240", "offsets for other indices", _indexed(0, 1, offsets=3), OFFSETS),
    Case("USD240", "an inbetween too short", rows(STEP, shorter), STEP),
    Case(
        "USD241",
        "an index beyond the points",
        _indexed(0, 12),
        f"{SMILE}.pointIndices",
    ),
    Case("USD241", "an index twice", _indexed(3, 3), f"{SMILE}.pointIndices"),
    Case(
        "USD242",
        "a normal too few",
        rows(f"{SMILE}.normalOffsets", shorter),
        f"{SMILE}.normalOffsets",
    ),
    Case("USD243", "NaN in an offset", rows(OFFSETS, cell((2, 0), NAN)), OFFSETS),
    Case("USD244", "an inbetween at 0", info(STEP, "weight", 0.0), STEP),
    Case("USD244", "an inbetween at 1", info(STEP, "weight", 1.0), STEP),
    Case("USD244", "an inbetween nowhere", info(STEP, "weight", None), STEP),
    Case(
        "USD244",
        "two inbetweens at one weight",
        _second_step(0.5),
        f"{SMILE}.inbetweens:step_2",
    ),
    Case(
        "USD245",
        "a target too few",
        target(f"{BODY}.skel:blendShapeTargets", f"{BODY}/bulge"),
        f"{BODY}.skel:blendShapes",
    ),
    Case(
        "USD245",
        "a shape twice",
        tokens(f"{BODY}.skel:blendShapes", "bulge", "bulge"),
        f"{BODY}.skel:blendShapes",
    ),
    Case(
        "RIG209",
        "a shape without effect",
        both(
            rows(OFFSETS, lambda o: o * 0),
            rows(STEP, lambda o: o * 0),
            drop(f"{SMILE}.normalOffsets"),
        ),
        OFFSETS,
    ),
    Case("USD250", "a SkelRoot without extent", drop(f"{RIG}.extent"), RIG),
    Case("USD250", "a cache without extent", drop(f"{CACHE}.extent"), CACHE),
    Case(
        "USD251",
        "a wrong extent in one sample",
        rows(f"{RIG}.extent", lambda old: old * 2, 7.0),
        f"{RIG}.extent",
    ),
    Case(
        "USD251",
        "an extent that the cache leaves",
        rows(f"{CACHE}.extent", lambda old: old / 2, 2.0),
        f"{CACHE}.extent",
    ),
    Case(
        "USD251",
        "a mesh's extent of another size",
        rows(f"{BODY}.extent", lambda old: old + 1),
        f"{BODY}.extent",
    ),
    Case("USD252", "no rate", info("/", "timeCodesPerSecond", None), "/"),
    Case("USD252", "no frame rate", info("/", "framesPerSecond", None), "/"),
    Case("USD253", "no time codes a second", info("/", "timeCodesPerSecond", 0.0), "/"),
    Case(
        "USD253",
        "a sublayer without time codes",
        props("x.usda", timeCodesPerSecond=0.0),
        "/",
    ),
    Case(
        "USD254",
        "start behind end",
        both(info("/", "startTimeCode", 9.0), info("/", "endTimeCode", 1.0)),
        "/",
    ),
    Case("USD255", "no end", info("/", "endTimeCode", None), "/"),
    Case("USD256", "samples behind the end", info("/", "endTimeCode", 5.0), ""),
    Case("USD289", "an end after the last frame", info("/", "endTimeCode", 9.5), "/"),
    Case("USD289", "a start before the first", info("/", "startTimeCode", 0.25), "/"),
    Case(
        "USD257",
        "a sublayer of another rate",
        props("x.usda", timeCodesPerSecond=60.0),
        "/",
    ),
    Case("USD258", "no unit", info("/", "metersPerUnit", None), "/"),
    Case("USD258", "no up axis", info("/", "upAxis", None), "/"),
    Case("USD259", "no default prim", info("/", "defaultPrim", None), "/"),
    Case("USD260", "a unit of 0", info("/", "metersPerUnit", 0.0), "/"),
    Case("USD260", "X is up", info("/", "upAxis", "X"), "/"),
    Case("USD267", "a unit of 13 mm", info("/", "metersPerUnit", 0.013), "/"),
    Case(
        "USD268",
        "a sublayer in metres",
        props("x.usda", timeCodesPerSecond=24.0, metersPerUnit=1.0),
        "/",
    ),
    Case(
        "USD268",
        "a sublayer with Z up",
        props("x.usda", timeCodesPerSecond=24.0, upAxis="Z"),
        "/",
    ),
    Case("USD261", "a missing reference", reference("./gone.usda"), "/pair/Extra"),
    Case(
        "USD261",
        "a missing payload",
        reference("./gone.usda", payload=True),
        "/pair/Extra",
    ),
    Case("USD261", "a missing sublayer", sublayer("./gone.usda"), "/"),
    Case("USD262", "an absolute reference", reference("/gone.usda"), "/pair/Extra"),
    Case(
        "USD263",
        "a missing picture",
        fresh("/pair", "picture", TYPES.Asset, Sdf.AssetPath("./gone.png")),
        "/pair.picture",
    ),
    Case("USD264", "a point too few", rows(POINTS, shorter, 2.0), POINTS),
    Case("USD265", "NaN in points", rows(POINTS, cell((1, 1), NAN), 3.0), POINTS),
    Case(
        "USD265",
        "infinite velocities",
        rows(VELOCITIES, cell((1, 1), math.inf), 3.0),
        VELOCITIES,
    ),
    Case("USD266", "a velocity too few", rows(VELOCITIES, shorter, 2.0), VELOCITIES),
    Case(
        "USD251",
        "an extent that copies leave",
        rows(f"{FLOCK}.extent", lambda old: old * 0.9, 2.0),
        f"{FLOCK}.extent",
    ),
    Case(
        "USD269",
        "a position too few",
        rows(f"{FLOCK}.positions", shorter, 2.0),
        f"{FLOCK}.positions",
    ),
    Case(
        "USD287",
        "a number that no prototype has",
        rows(f"{FLOCK}.protoIndices", cell(1, 1), 2.0),
        f"{FLOCK}.protoIndices",
    ),
    Case(
        "USD287",
        "a prototype that is not there",
        target(f"{FLOCK}.prototypes", "/no"),
        f"{FLOCK}.prototypes",
    ),
    Case(
        "USD287",
        "copies of what holds them",
        target(f"{FLOCK}.prototypes", "/pair"),
        f"{FLOCK}.prototypes",
    ),
    Case(
        "USD288",
        "a quaternion of length 2",
        rows(f"{FLOCK}.orientationsf", lambda old: old * 2, 1.0),
        f"{FLOCK}.orientationsf",
    ),
    Case(
        "USD265",
        "a scale that is infinite",
        rows(f"{FLOCK}.scales", cell((1, 1), math.inf), 1.0),
        f"{FLOCK}.scales",
    ),
    Case(
        "USD270",
        "no bodies",
        both(target(f"{HINGE}.physics:body0"), target(f"{HINGE}.physics:body1")),
        HINGE,
    ),
    Case(
        "USD270",
        "a missing body",
        target(f"{HINGE}.physics:body0", "/no"),
        f"{HINGE}.physics:body0",
    ),
    Case(
        "USD271",
        "reversed limits",
        put(f"{HINGE}.physics:lowerLimit", 90.0),
        f"{HINGE}.physics:lowerLimit",
    ),
    Case(
        "USD272",
        "a frame that is no rotation",
        put(f"{HINGE}.physics:localRot0", Gf.Quatf(2, 0, 0, 0)),
        f"{HINGE}.physics:localRot0",
    ),
    Case(
        "USD273",
        "an axis that is none",
        put(f"{HINGE}.physics:axis", "W"),
        f"{HINGE}.physics:axis",
    ),
    Case("USD274", "a spline that goes back", _regress, CURVE),
    Case("USD275", "samples over a spline", sample(CURVE, 3.0, 1.0), CURVE),
    Case(
        "USD276",
        "a missing clip",
        clip_set(assetPaths=assets("./one.usda", "./gone.usda")),
        CLIP_PLACE,
    ),
    Case(
        "USD276",
        "a missing manifest",
        clip_set(manifestAssetPath=Sdf.AssetPath("./gone.usda")),
        CLIP_PLACE,
    ),
    Case(
        "USD277",
        "a clip number beyond the clips",
        clip_set(active=Vt.Vec2dArray([(1, 0), (6, 2)])),
        CLIP_PLACE,
    ),
    Case(
        "USD277",
        "times that go back",
        clip_set(times=Vt.Vec2dArray([(9, 9), (1, 1)])),
        CLIP_PLACE,
    ),
    Case("USD277", "a primPath of no clip", clip_set(primPath="/No"), CLIP_PLACE),
    Case(
        "USD278", "a gap in a sequence", clip_set(**template("part", 4.0)), CLIP_PLACE
    ),
    Case(
        "USD278",
        "a clip without samples",
        clip_set(assetPaths=assets("./one.usda", "./manifest.usda")),
        CLIP_PLACE,
    ),
    Case("USD279", "no manifest", clip_set(manifestAssetPath=None), CLIP_PLACE),
    Case(
        "USD279",
        "an empty manifest",
        clip_set(manifestAssetPath=Sdf.AssetPath("./empty.usda")),
        CLIP_PLACE,
    ),
    Case(
        "USD281",
        "geometry in geometry",
        define(f"{CACHE}/Inner", "Cube"),
        f"{CACHE}/Inner",
    ),
    Case(
        "USD282",
        "a material without its API",
        target(f"{CACHE}.material:binding", "/pair"),
        CACHE,
    ),
]

NEAR = [
    Case(
        "USD171",
        "an infinity that its schema has",
        fresh(HINGE, "physics:breakForce", TYPES.Float, INF),
    ),
    Case("USD171", "large numbers", fresh(RIG, "a", TYPES.Float, 3.4e38)),
    Case(
        "USD200", "one value for all frames", put(SIZE, Vt.Vec3hArray(4, Gf.Vec3h(2)))
    ),
    Case(
        "USD201",
        "an animation of shapes alone",
        both(tokens(f"{ANIM}.joints"), drop(SIZE), drop(MOVE), drop(ROT)),
    ),
    Case("USD202", "a very large number", rows(WEIGHTS, cell(1, 1e30), 3.0)),
    Case("USD203", "a rounded quaternion", rows(ROT, lambda q: q * (1 + TINY), 3.0)),
    Case("USD204", "all signs changed", in_all_samples(ROT, lambda old: -old)),
    Case("USD206", "a weight beyond one", rows(WEIGHTS, cell(1, 3.0), 3.0)),
    Case(
        "USD207",
        "a name in another case",
        tokens(f"{ANIM}.blendShapes", "smile", "Smile", "both"),
    ),
    Case("USD208", "a binding to nothing", target(f"{RIG}.skel:animationSource")),
    Case(
        "USD209",
        "fewer joints than the skeleton",
        both(
            tokens(f"{ANIM}.joints", *NAMES[:3]),
            rows(SIZE, shorter),
            in_all_samples(ROT, shorter),
            in_all_samples(MOVE, shorter),
        ),
    ),
    Case(
        "USD210",
        "fewer shapes than the meshes",
        both(
            tokens(f"{ANIM}.blendShapes", "smile", "bulge"),
            in_all_samples(WEIGHTS, shorter),
        ),
    ),
    Case(
        "USD211",
        "samples on the visibility",
        both(
            fresh("/pair", "visibility", TYPES.Token, "inherited"),
            sample("/pair.visibility", 3.0, "invisible"),
        ),
    ),
    Case(
        "USD220",
        "one name below two joints",
        tokens(JOINTS, "hips", "hips/chest", "hips/chest/chest", "post"),
    ),
    Case(
        "USD221",
        "another root first",
        tokens(JOINTS, "post", "hips", "hips/chest", "hips/chest/arm"),
    ),
    Case("USD222", "a root with a long name", tokens(JOINTS, *NAMES[:3], "pair_post")),
    Case("USD223", "scaled rest transforms", rows(REST, cell((3, 0, 0), 2.0))),
    Case("USD224", "a turned bind transform", rows(BIND, cell((3, 0, 0), -1.0))),
    Case("USD225", "a joint far away", rows(REST, cell((3, 3, 0), 1e20))),
    Case(
        "USD226",
        "a small bind transform",
        rows(
            BIND,
            lambda m: np.concatenate([m[:3], m[3:] * [[[1e-4], [1e-4], [1e-4], [1]]]]),
        ),
    ),
    Case(
        "USD227",
        "identity where the joints rest",
        lambda layer: (
            rows(BIND, lambda old: np.tile(np.eye(4), (len(old), 1, 1)))(layer),
            rows(REST, lambda old: np.tile(np.eye(4), (len(old), 1, 1)))(layer),
        )[0],
    ),
    Case(
        "USD290",
        "a helper joint at its parent",
        both(
            rows(BIND, _moved_to_parent),
            rows(REST, cell((1, 3, slice(0, 3)), 0.0)),
        ),
    ),
    Case("USD228", "bind as at rest", rows(BIND, cell((slice(0, 3), 3, 0), 0.0))),
    Case("USD239", "no rest transforms, and an animation of all joints", drop(REST)),
    Case(
        "USD229",
        "identity at rest",
        rows(REST, lambda old: np.tile(np.eye(4), (len(old), 1, 1))),
    ),
    Case("USD230", "the last joint", rows(INDICES, cell(5, 2))),
    Case(
        "USD231",
        "a rigid mesh",
        both(
            rows(INDICES, lambda i: i[:1]),
            rows(HEAVY, lambda w: w[:1] * 0 + 1),
            info(INDICES, "interpolation", "constant"),
            info(INDICES, "elementSize", 1),
            info(HEAVY, "interpolation", "constant"),
            info(HEAVY, "elementSize", 1),
        ),
    ),
    Case("USD232", "rounded weights", rows(HEAVY, lambda w: np.round(w, 3))),
    Case(
        "USD233",
        "a weight of 0",
        rows(
            HEAVY,
            lambda w: np.where(np.arange(len(w)) < 3, [1, 0, 0] * (len(w) // 3), w),
        ),
    ),
    Case("USD234", "no influences at all", both(drop(HEAVY), drop(INDICES))),
    Case(
        "USD235",
        "a mirrored geomBindTransform",
        put(GEOM, Gf.Matrix4d(-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)),
    ),
    Case("USD236", "no skel properties", define("/pair/Plain", "Mesh")),
    Case(
        "USD237",
        "a SkelRoot far above",
        lambda layer: (
            setattr(layer.GetPrimAtPath("/pair"), "typeName", "SkelRoot"),
            setattr(layer.GetPrimAtPath(RIG), "typeName", "Xform"),
        )[0],
    ),
    Case(
        "USD238",
        "joints in another order",
        tokens(f"{BODY}.skel:joints", "hips/chest/arm", "hips", "hips/chest"),
    ),
    Case("USD240", "offsets of some points", _indexed(0, 1)),
    Case("USD241", "the last point", _indexed(11, 0)),
    Case("USD242", "no normals", drop(f"{SMILE}.normalOffsets")),
    Case("USD243", "a large offset", rows(OFFSETS, cell((2, 0), 1e20))),
    Case("USD244", "an inbetween beyond 1", _second_step(1.5)),
    Case(
        "USD245",
        "shapes in another order",
        both(
            tokens(f"{BODY}.skel:blendShapes", "both", "bulge"),
            target(f"{BODY}.skel:blendShapeTargets", f"{BODY}/both", f"{BODY}/bulge"),
        ),
    ),
    Case("RIG209", "a shape that comes and goes", rows(OFFSETS, lambda o: o * 0)),
    Case(
        "RIG209",
        "a shape that turns normals alone",
        both(rows(OFFSETS, lambda o: o * 0), rows(STEP, lambda o: o * 0)),
    ),
    Case("USD250", "a sphere", define("/pair/Ball", "Sphere")),
    Case(
        "USD251",
        "a rounded extent",
        in_all_samples(f"{RIG}.extent", lambda old: np.round(old, 3)),
    ),
    Case(
        "USD251",
        "one extent for all the samples",
        lambda layer: (
            fresh("/pair/Cache", "x", TYPES.Float, 1.0)(layer),
            [layer.EraseTimeSample(f"{CACHE}.extent", c) for c in (1.0, 2.0, 3.0)],
            put(f"{CACHE}.extent", Vt.Vec3fArray([(0, 0, 0), (3, 3, 0)]))(layer),
        )[0],
    ),
    Case(
        "USD252",
        "no rate where nothing moves",
        both(without_samples, info("/", "timeCodesPerSecond", None)),
    ),
    Case(
        "USD253",
        "a slow rate",
        both(info("/", "timeCodesPerSecond", 0.5), info("/", "framesPerSecond", 0.5)),
    ),
    Case("USD254", "a negative range", both(info("/", "startTimeCode", -9.0))),
    Case(
        "USD255",
        "no range where nothing moves",
        both(
            without_samples,
            info("/", "startTimeCode", None),
            info("/", "endTimeCode", None),
        ),
    ),
    Case(
        "USD256",
        "samples within a frame of the end",
        sample(
            f"{CACHE}.points", 9.25, Vt.Vec3fArray([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
        ),
    ),
    Case(
        "USD289",
        "an end at a sample between frames",
        both(
            sample(
                f"{CACHE}.points",
                9.25,
                Vt.Vec3fArray([(0, 0, 0), (1, 0, 0), (0, 1, 0)]),
            ),
            info("/", "endTimeCode", 9.25),
        ),
    ),
    Case(
        "USD257",
        "a sublayer of the same rate",
        props("y.usda", timeCodesPerSecond=24.0),
    ),
    Case(
        "USD257",
        "a sublayer that states frames",
        props("z.usda", framesPerSecond=24.0),
    ),
    Case("USD258", "metres", info("/", "metersPerUnit", 1.0)),
    Case("USD259", "another default prim", define("/other", "Scope")),
    Case("USD260", "Z is up", info("/", "upAxis", "Z")),
    Case("USD267", "inches", info("/", "metersPerUnit", 0.0254)),
    Case(
        "USD268",
        "a sublayer in the same unit",
        props("y.usda", timeCodesPerSecond=24.0, metersPerUnit=0.01, upAxis="Y"),
    ),
    Case("USD261", "a reference that resolves", reference("./one.usda")),
    Case("USD262", "a relative reference", reference("./one.usda")),
    Case(
        "USD263",
        "a picture that is there",
        fresh("/pair", "picture", TYPES.Asset, Sdf.AssetPath("./picture.png")),
    ),
    Case(
        "USD263",
        "a pattern of pictures",
        fresh("/pair", "picture", TYPES.Asset, Sdf.AssetPath("./p.<UDIM>.png")),
    ),
    Case(
        "USD264",
        "a topology that changes too",
        both(
            rows(POINTS, shorter, 2.0),
            sample(f"{CACHE}.faceVertexIndices", 2.0, Vt.IntArray([0, 1, 0])),
        ),
    ),
    Case("USD265", "points far away", rows(POINTS, cell((1, 1), 1e30), 3.0)),
    Case("USD266", "no velocities in a sample", rows(VELOCITIES, lambda v: v[:0], 2.0)),
    Case(
        "USD269", "no scales in a sample", rows(f"{FLOCK}.scales", lambda v: v[:0], 1.0)
    ),
    Case(
        "USD287",
        "a prototype that nothing shows",
        both(target(f"{FLOCK}.prototypes", f"{FLOCK}/Bird", f"{FLOCK}/Bird")),
    ),
    Case(
        "USD288",
        "a quaternion rounded to half",
        rows(f"{FLOCK}.orientationsf", lambda old: old * 1.001, 1.0),
    ),
    Case("USD270", "a joint to the world", target(f"{HINGE}.physics:body0")),
    Case(
        "USD271",
        "an axis that the limit API locks",
        both(
            put(f"{BALL}.limit:rotX:physics:low", 1.0),
            put(f"{BALL}.limit:rotX:physics:high", -1.0),
        ),
    ),
    Case(
        "USD271",
        "equal limits",
        both(
            put(f"{HINGE}.physics:lowerLimit", 9.0),
            put(f"{HINGE}.physics:upperLimit", 9.0),
        ),
    ),
    Case(
        "USD272",
        "a rounded frame",
        put(f"{HINGE}.physics:localRot0", Gf.Quatf(1.0001, 0, 0, 0)),
    ),
    Case("USD273", "another axis", put(f"{HINGE}.physics:axis", "Z")),
    Case(
        "USD274",
        "tangents as long as the segment",
        lambda layer: layer.GetAttributeAtPath(CURVE).SetSpline(spline(width=8 / 3)),
    ),
    Case("USD275", "a default under a spline", put(CURVE, 1.0)),
    Case(
        "USD276",
        "a clip twice",
        clip_set(assetPaths=assets("./one.usda", "./one.usda")),
    ),
    Case(
        "USD277",
        "a jump cut",
        clip_set(times=Vt.Vec2dArray([(1, 1), (6, 5), (6, 6), (9, 9)])),
    ),
    Case("USD278", "a whole sequence", clip_set(**template("part", 2.0))),
    Case(
        "USD279",
        "a manifest that names more",
        clip_set(assetPaths=assets("./one.usda", "./one.usda")),
    ),
    Case("USD281", "geometry beside geometry", define("/pair/Inner", "Cube")),
    Case("USD282", "no material", define("/pair/Inner", "Cube")),
]
