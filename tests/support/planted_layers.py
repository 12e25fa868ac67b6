"""Faults planted in USD layers of the samples, with every extent computed anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

Edit = Callable[[Usd.Stage], None]


@dataclass(frozen=True)
class PlantedLayer:
    """One fault in the layer of one sample.

    Attributes:
        name: What is wrong.
        sample: Key of the sample's layer.
        edit: Plants it.
        code: Of the rule that must find it.
        extra: Codes of what follows from it.
        stale: Whether extents stay as they were.
    """

    name: str
    sample: str
    edit: Edit
    code: str
    extra: frozenset[str] = field(default_factory=frozenset)
    stale: bool = False


def planted(case: PlantedLayer, source: Path, output: Path) -> Path:
    """Write a layer with a fault; its extents are those that USD computes."""
    layer = Sdf.Layer.CreateNew(str(output))
    layer.TransferContent(Sdf.Layer.FindOrOpen(str(source)))
    stage = Usd.Stage.Open(layer)
    case.edit(stage)
    if not case.stale:
        compute_extents(stage)
    layer.Save()
    return output


def compute_extents(stage: Usd.Stage) -> None:
    """Author `UsdGeom.Boundable.ComputeExtentFromPlugins` at every time that counts."""
    for prim in stage.Traverse():
        attr = prim.GetAttribute("extent")
        if not attr or not attr.HasAuthoredValue():
            continue
        codes = [Usd.TimeCode(t) for t in _times(stage, attr)]
        attr.Clear()
        for code in codes or [Usd.TimeCode.Default()]:
            bounds = UsdGeom.Boundable.ComputeExtentFromPlugins(
                UsdGeom.Boundable(prim), code
            )
            if bounds is not None:
                attr.Set(bounds, code)


def _times(stage: Usd.Stage, extent: Usd.Attribute) -> list[float]:
    if not extent.GetNumTimeSamples():
        return []
    animation = animation_of(stage)
    times = animation.GetRotationsAttr().GetTimeSamples()
    times += animation.GetTranslationsAttr().GetTimeSamples()
    return sorted(set(times))


def animation_of(stage: Usd.Stage) -> UsdSkel.Animation:
    return next(
        UsdSkel.Animation(p) for p in stage.Traverse() if p.IsA(UsdSkel.Animation)
    )


def skeleton_of(stage: Usd.Stage) -> UsdSkel.Skeleton:
    return next(
        UsdSkel.Skeleton(p) for p in stage.Traverse() if p.IsA(UsdSkel.Skeleton)
    )


def skinned(stage: Usd.Stage) -> Usd.Prim:
    return next(
        p for p in stage.Traverse()
        if p.IsA(UsdGeom.Mesh) and UsdSkel.BindingAPI(p).GetJointIndicesPrimvar()
    )  # fmt: skip


def retimed(change: Callable[[np.ndarray], np.ndarray]) -> Edit:
    """Move the samples of the animation to other time codes."""

    def edit(stage: Usd.Stage) -> None:
        for attr in animation_of(stage).GetPrim().GetAttributes():
            times = attr.GetTimeSamples()
            if not times:
                continue
            values = [attr.Get(t) for t in times]
            for time in times:
                attr.ClearAtTime(time)
            for time, value in zip(
                change(np.array(times)).tolist(), values, strict=True
            ):
                attr.Set(value, time)

    return edit


def hole(first: int, count: int) -> Edit:
    """Leave samples out."""

    def edit(stage: Usd.Stage) -> None:
        for attr in animation_of(stage).GetPrim().GetAttributes():
            for time in attr.GetTimeSamples()[first : first + count]:
                attr.ClearAtTime(time)

    return edit


def in_range(start: float, end: float) -> Edit:
    def edit(stage: Usd.Stage) -> None:
        stage.SetStartTimeCode(start)
        stage.SetEndTimeCode(end)

    return edit


def each(name: str, change: Callable[[np.ndarray, float], np.ndarray]) -> Edit:
    """Change the array of an attribute of the animation in every sample."""

    def edit(stage: Usd.Stage) -> None:
        attr = animation_of(stage).GetPrim().GetAttribute(name)
        times = attr.GetTimeSamples()
        for time in times or [Usd.TimeCode.Default()]:
            value = attr.Get(time)
            code = time if times else 0.0
            attr.Set(_array(change(np.array(value), code), value), time)

    return edit


def _array(values: np.ndarray, like: object) -> object:
    """Return an array of USD as another one."""
    kind = type(like)
    return kind.FromNumpy(np.ascontiguousarray(values))


def scaled_joint(joint: int, first: float) -> Edit:
    """Scale a joint to nothing from a time code on."""

    def edit(stage: Usd.Stage) -> None:
        attr = animation_of(stage).GetScalesAttr()
        one = np.array(attr.Get(Usd.TimeCode.EarliestTime()))
        none = one.copy()
        none[joint] = 0.0
        for time in animation_of(stage).GetRotationsAttr().GetTimeSamples():
            attr.Set(Vt.Vec3hArray.FromNumpy(one if time < first else none), time)

    return edit


def units(meters: float) -> Edit:
    return lambda stage: UsdGeom.SetStageMetersPerUnit(stage, meters)


def up(axis: str) -> Edit:
    return lambda stage: UsdGeom.SetStageUpAxis(stage, axis)


def bind(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Edit:
    """Change the bind transforms, given them and the rest transforms."""

    def edit(stage: Usd.Stage) -> None:
        skeleton = skeleton_of(stage)
        found = np.array(skeleton.GetBindTransformsAttr().Get())
        rest = np.array(skeleton.GetRestTransformsAttr().Get())
        values = [Gf.Matrix4d(*m.ravel().tolist()) for m in change(found, rest)]
        skeleton.GetBindTransformsAttr().Set(Vt.Matrix4dArray(values))

    return edit


def bind_scaled(factor: float) -> Edit:
    def change(found: np.ndarray, _: np.ndarray) -> np.ndarray:
        found[:, 3, :3] *= factor
        return found

    return bind(change)


def shown_rate(rate: float) -> Edit:
    return lambda stage: stage.SetFramesPerSecond(rate)


def one_bind_moved(found: np.ndarray, _: np.ndarray) -> np.ndarray:
    found[9, 3, 1] += 400.0
    return found


def bind_moved(found: np.ndarray, _: np.ndarray) -> np.ndarray:
    found[:, 3, 0] += 5000.0
    return found


def weights(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Edit:
    """Change the weights of the skinned mesh, given them and the indices."""

    def edit(stage: Usd.Stage) -> None:
        binding = UsdSkel.BindingAPI(skinned(stage))
        attr = binding.GetJointWeightsAttr()
        indices = np.array(binding.GetJointIndicesAttr().Get())
        attr.Set(Vt.FloatArray.FromNumpy(change(np.array(attr.Get()), indices)))

    return edit


def without_influence(stage: Usd.Stage) -> None:
    """Give the points of the left arm to the root."""
    mesh = skinned(stage)
    binding = UsdSkel.BindingAPI(mesh)
    names = binding.GetJointsAttr().Get() or skeleton_of(stage).GetJointsAttr().Get()
    arm = [i for i, name in enumerate(names) if "shoulder_l" in str(name)]
    indices = np.array(binding.GetJointIndicesAttr().Get())
    indices[np.isin(indices, arm)] = 0
    binding.GetJointIndicesAttr().Set(Vt.IntArray.FromNumpy(indices))


def flipped(values: np.ndarray, code: float) -> np.ndarray:
    return -values if int(code) % 7 == 3 else values


def stretched(values: np.ndarray, _: float) -> np.ndarray:
    return np.asarray(values * np.float32(1.3))


def holed(values: np.ndarray, code: float) -> np.ndarray:
    if int(code) == 5:
        values[1] = np.nan
    return values


def percent(values: np.ndarray, _: float) -> np.ndarray:
    return np.asarray(values * np.float32(100.0))


def negative(values: np.ndarray, code: float) -> np.ndarray:
    values[0] = -3.0 if code > 20 else values[0]
    return values


def popped(values: np.ndarray, code: float) -> np.ndarray:
    """Put joint 4 half a turn about z further in one sample."""
    if int(code) == 12:
        x, y, z, w = values[4].tolist()
        values[4] = [y, -x, w, -z]
    return values


def teleported(values: np.ndarray, code: float) -> np.ndarray:
    values[0, 0] += 20.0 * (code > 30)
    return values


def drop(name: str) -> Edit:
    def edit(stage: Usd.Stage) -> None:
        animation_of(stage).GetPrim().RemoveProperty(name)

    return edit


def tokens_twice(stage: Usd.Stage) -> None:
    attr = animation_of(stage).GetJointsAttr()
    names = list(attr.Get())
    attr.Set([*names[:-1], names[0]])


def fewer_rest(stage: Usd.Stage) -> None:
    attr = skeleton_of(stage).GetRestTransformsAttr()
    attr.Set(Vt.Matrix4dArray(list(attr.Get())[:-1]))


def identity_bind(found: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.tile(np.eye(4), (len(found), 1, 1))


def unbound(stage: Usd.Stage) -> None:
    for prim in stage.Traverse():
        relationship = prim.GetRelationship("skel:animationSource")
        if relationship and relationship.GetTargets():
            relationship.SetTargets(["/nowhere"])


def fewer_offsets(stage: Usd.Stage) -> None:
    shape = next(
        UsdSkel.BlendShape(p) for p in stage.Traverse() if p.IsA(UsdSkel.BlendShape)
    )
    shape.GetOffsetsAttr().Set(list(shape.GetOffsetsAttr().Get())[:-1])


def raised_points(stage: Usd.Stage) -> None:
    """Move the points of the mesh, and leave its extent."""
    mesh = UsdGeom.Mesh(skinned(stage))
    points = np.array(mesh.GetPointsAttr().Get())
    mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(points * np.float32(1.5)))


def index_beyond(stage: Usd.Stage) -> None:
    attr = UsdSkel.BindingAPI(skinned(stage)).GetJointIndicesAttr()
    indices = np.array(attr.Get())
    indices[10] = 999
    attr.Set(Vt.IntArray.FromNumpy(indices))


def heavier(found: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.asarray(found * np.float32(1.2))


def below_zero(found: np.ndarray, _: np.ndarray) -> np.ndarray:
    found[0] = -0.5
    return found


_BOUNDS = frozenset({"USD251"})

LAYERS = [
    PlantedLayer("a joint turned half round in one sample", "stride",
                 each("rotations", popped), "MOT202"),
    PlantedLayer("a root displaced from a sample on", "walk",
                 each("translations", teleported), "MOT203", frozenset({"MOT208"})),
    PlantedLayer("one sample missing", "walk", hole(30, 1), "MOT205"),
    PlantedLayer("four samples missing", "carry", hole(50, 4), "MOT205"),
    PlantedLayer("samples 1.25 time codes apart", "walk",
                 retimed(lambda t: 1.0 + (t - 1.0) * 1.25), "MOT207",
                 frozenset({"USD256"})),
    PlantedLayer("25 frames a second stated beside 30", "walk", shown_rate(25.0),
                 "MOT207"),
    PlantedLayer("one sample astray", "walk",
                 retimed(lambda t: t + 0.3 * (t == 20.0)), "MOT216",
                 frozenset({"MOT205"})),
    PlantedLayer("a bind transform far away", "stride", bind(one_bind_moved), "MOT220"),
    PlantedLayer("drifting samples", "walk",
                 retimed(lambda t: t + 1e-4 * (t - 1.0)), "MOT216"),
    PlantedLayer("samples half a frame off", "stride", retimed(lambda t: t + 0.5),
                 "MOT216"),
    PlantedLayer("a range that starts 30 before", "walk", in_range(-30, 64), "MOT217"),
    PlantedLayer("a range that ends 40 behind", "stride", in_range(1, 64), "MOT217"),
    PlantedLayer("samples before the range", "walk", in_range(40, 64), "USD256"),
    PlantedLayer("a joint scaled to nothing", "stride", scaled_joint(10, 8), "MOT218"),
    PlantedLayer("shape weights in percent", "speech",
                 each("blendShapeWeights", percent), "MOT219"),
    PlantedLayer("a shape weight of -3", "speech",
                 each("blendShapeWeights", negative), "MOT219"),
    PlantedLayer("a bind pose 100 times larger", "stride", bind_scaled(100.0),
                 "MOT220"),
    PlantedLayer("a bind pose far away", "stride", bind(bind_moved), "MOT220"),
    PlantedLayer("an arm without weights", "stride", without_influence, "MOT221"),
    PlantedLayer("centimetres stated as metres", "walk", units(1.0), "MOT213"),
    PlantedLayer("a biped of 2.4 mm", "carry", units(0.001), "USD126"),
    PlantedLayer("Y up, stated as Z", "stride", up("Z"), "MOT214"),
    PlantedLayer("signs of quaternions that change", "walk",
                 each("rotations", flipped), "USD204"),
    PlantedLayer("quaternions of length 1.3", "walk",
                 each("rotations", stretched), "USD203", _BOUNDS),
    PlantedLayer("a rotation that is not finite", "walk", each("rotations", holed),
                 "USD202", _BOUNDS),
    PlantedLayer("no scales", "walk", drop("scales"), "USD201", _BOUNDS),
    PlantedLayer("a joint twice", "walk", tokens_twice, "USD207",
                 frozenset({"USD209", "MOT211"})),
    PlantedLayer("an animation that is nowhere", "walk", unbound, "USD208"),
    PlantedLayer("a rest transform too few", "walk", fewer_rest, "USD223", _BOUNDS),
    PlantedLayer("a bind pose of identities", "stride", bind(identity_bind), "USD227"),
    PlantedLayer("an index beyond the joints", "stride", index_beyond, "USD230"),
    PlantedLayer("weights that sum to 1.2", "stride", weights(heavier), "USD232"),
    PlantedLayer("a negative weight", "stride", weights(below_zero), "USD233",
                 frozenset({"USD232"})),
    PlantedLayer("an offset too few", "speech", fewer_offsets, "USD240"),
    PlantedLayer("a range in reverse", "walk", in_range(64, 1), "USD254"),
    PlantedLayer("points that leave their extent", "stride", raised_points, "USD251",
                 stale=True),
]  # fmt: skip
