"""Every code of the checks on USD: how bad it is, its title, what to do about it.

The pages of the codes say more: ``animtool/docs/rules/CODE.md``. No pxr is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

from animtool.errors import Fault, Severity


@dataclass(frozen=True, slots=True)
class Code:
    """What one code stands for."""

    severity: Severity  # how bad it is
    title: str  # what is wrong, in few words
    hint: str  # what to do about it


def _error(title: str, hint: str) -> Code:
    return Code(Severity.ERROR, title, hint)


def _warning(title: str, hint: str) -> Code:
    return Code(Severity.WARNING, title, hint)


CODES: dict[str, Code] = {
    # Any attribute
    "USD171": _error(
        "a number that is not finite",
        "write finite numbers: readers take them as they are",
    ),
    # Animation
    "USD200": _error(
        "a SkelAnimation array of another length than its joints",
        "write one value a joint in every sample",
    ),
    "USD201": _error(
        "a SkelAnimation without translations, rotations or scales",
        "author all three: UsdSkel ignores an animation that lacks one",
    ),
    "USD202": _error(
        "a SkelAnimation value that is not finite", "write finite numbers"
    ),
    "USD203": _error(
        "rotations that are no unit quaternions",
        "normalise them: UsdSkel does not, and the joint is scaled",
    ),
    "USD204": _warning(
        "quaternions that change their sign between samples",
        "negate them so that neighbours are on one side: a tool that interpolates "
        "components turns the long way round",
    ),
    "USD206": _error(
        "blendShapeWeights of another length than blendShapes",
        "write one weight a shape in every sample",
    ),
    "USD207": _error("a joint or shape twice in a SkelAnimation", "name each once"),
    "USD208": _error(
        "a skel binding to a prim that is missing or of another type",
        "point it at a SkelAnimation, Skeleton or BlendShape on this stage",
    ),
    "USD209": _warning(
        "joints of an animation that its Skeleton lacks",
        "use the Skeleton's own joint paths: others are ignored without a word",
    ),
    "USD210": _warning(
        "weights of shapes that no mesh has",
        "name them as the meshes' skel:blendShapes do",
    ),
    "USD211": _error(
        "time samples on an attribute that cannot animate",
        "write a default: readers of a uniform attribute find no value",
    ),
    # Skeleton
    "USD220": _error("a joint twice in a Skeleton", "give each joint its own path"),
    "USD221": _error(
        "a joint before its parent", "list parents first: UsdSkel ignores the Skeleton"
    ),
    "USD222": _warning(
        "a joint path whose parent is no joint",
        "list the parent too: the joint hangs from the next one above, or from none",
    ),
    "USD223": _error(
        "restTransforms of another number than the joints",
        "write one a joint: UsdSkel ignores others",
    ),
    "USD224": _error(
        "bindTransforms of another number than the joints",
        "write one a joint, in world space",
    ),
    "USD225": _error(
        "a rest or bind transform that is not finite", "write finite numbers"
    ),
    "USD226": _error(
        "a bind transform without inverse", "no axis of it may have length 0"
    ),
    "USD227": _warning(
        "bind transforms that are all identity",
        "write where the joints stood when the skin was bound, in world space",
    ),
    "USD228": _warning(
        "inverse bind matrices where rest or bind transforms belong",
        "invert them: bind is in world space, rest relative to the parent",
    ),
    "USD229": _warning(
        "a Skeleton without restTransforms",
        "author them: joints that an animation lacks have no pose",
    ),
    # Skin
    "USD230": _error(
        "a joint index that is out of range",
        "count in skel:joints of the mesh where it has them, else in the Skeleton's",
    ),
    "USD231": _error(
        "influences of another number than points and elementSize ask for",
        "write points x elementSize indices and as many weights (interpolation "
        "vertex), or elementSize of each (constant)",
    ),
    "USD232": _warning(
        "weights of a point that do not sum to one", "divide them by their sum"
    ),
    "USD233": _error(
        "a weight that is negative or not finite", "write weights from 0 to 1"
    ),
    "USD234": _error(
        "jointIndices or jointWeights missing or empty", "write both, or none"
    ),
    "USD235": _error(
        "a geomBindTransform that is not finite or has no inverse",
        "write the mesh's world transform at bind time",
    ),
    "USD236": _error(
        "skel properties on a prim without SkelBindingAPI",
        'add prepend apiSchemas = ["SkelBindingAPI"]: UsdSkel ignores them else',
    ),
    "USD237": _warning(
        "a Skeleton or binding that no SkelRoot holds",
        "put a SkelRoot above it: UsdSkel deforms nothing outside of one",
    ),
    "USD238": _error(
        "a joint of a mesh's skel:joints that the Skeleton lacks",
        "use the Skeleton's own joint paths",
    ),
    # Shapes
    "USD240": _error(
        "offsets of another number than pointIndices or points",
        "write one offset a pointIndex, or one a point where there are none",
    ),
    "USD241": _error(
        "pointIndices that are out of range or stand twice",
        "count the mesh's points from 0, each once",
    ),
    "USD242": _error(
        "normalOffsets of another number than the offsets",
        "write one a pointIndex, or none at all",
    ),
    "USD243": _error(
        "an offset or normalOffset that is not finite", "write finite numbers"
    ),
    "USD244": _error(
        "an inbetween without a weight of its own",
        "give each a weight other than 0, 1 and the others': UsdSkel ignores it else",
    ),
    "USD245": _error(
        "skel:blendShapes and skel:blendShapeTargets of different numbers",
        "name one target a shape, each shape once",
    ),
    "USD246": _warning("a shape that changes nothing", "write its offsets, or drop it"),
    # Stage
    "USD250": _warning(
        "no extent", "author it over time: viewers compute it else, or cull by a guess"
    ),
    "USD251": _warning(
        "an extent that is not what USD computes",
        "author UsdGeom.Boundable.ComputeExtentFromPlugins at each sample",
    ),
    "USD252": _warning(
        "motion without timeCodesPerSecond or framesPerSecond",
        "author both on the layer: 24 is assumed else",
    ),
    "USD253": _error(
        "a rate that is not positive", "author a positive number, such as 24"
    ),
    "USD254": _error(
        "a startTimeCode behind the endTimeCode", "swap them, or author the range anew"
    ),
    "USD255": _warning(
        "motion without startTimeCode or endTimeCode",
        "author both: players show no range, or a guess",
    ),
    "USD256": _warning(
        "samples outside of the stage's range",
        "widen startTimeCode and endTimeCode, or drop the samples",
    ),
    "USD257": _warning(
        "a layer that is retimed by its rate",
        "author the root layer's timeCodesPerSecond in it, or mean the retiming",
    ),
    "USD258": _warning(
        "no metersPerUnit or upAxis",
        "author both: 0.01 and Y are assumed else",
    ),
    "USD259": _warning(
        "no defaultPrim", "author it: a reference without a path finds nothing else"
    ),
    "USD260": _error(
        "a unit or up axis that is none",
        "metersPerUnit is positive, upAxis Y or Z",
    ),
    "USD261": _error(
        "a sublayer, reference or payload that does not resolve",
        "mend the path, or put the file there",
    ),
    "USD262": _warning(
        "an absolute asset path",
        "write it relative to its layer (./x.usda): it leads nowhere elsewhere",
    ),
    "USD263": _warning(
        "an asset that does not resolve", "mend the path, or put the file there"
    ),
    # Points
    "USD264": _error(
        "points of another number than the topology or other samples have",
        "keep their number, or sample the topology at the same times",
    ),
    "USD265": _error(
        "points or velocities that are not finite", "write finite numbers"
    ),
    "USD266": _error("velocities of another number than points", "write one a point"),
    # Units, further
    "USD267": _warning(
        "an unusual metersPerUnit",
        "author the unit that the numbers are in, such as 0.01 or 1",
    ),
    "USD268": _warning(
        "a sublayer in another unit or up axis than the root layer",
        "convert it: USD does not, and a sublayer has no transform to do so",
    ),
    # Physics, splines, clips
    "USD270": _error(
        "a physics joint without bodies",
        "point body0, body1 or both at prims on this stage",
    ),
    "USD271": _error(
        "limits of a physics joint that are reversed or no numbers",
        "write the lower limit first; to lock an axis use the limit API",
    ),
    "USD272": _error(
        "a frame of a physics joint that is no rotation or not finite",
        "write unit quaternions and finite positions",
    ),
    "USD273": _error("an axis of a physics joint that is none", "write X, Y or Z"),
    "USD274": _warning(
        "a spline that goes back in time",
        "shorten the tangents to their segments: Ts clamps them, each tool its way",
    ),
    "USD275": _warning(
        "a spline and time samples on one attribute",
        "keep one: the samples win, and the spline is never seen",
    ),
    "USD276": _error(
        "a value clip that is missing", "mend the path, or put the file there"
    ),
    "USD277": _error(
        "value clips whose active or times are no mapping",
        "active names clips from 0, at ascending times; times come in ascending order",
    ),
    "USD278": _warning(
        "value clips with a gap",
        "add the clips that are missing: the neighbour's values are held there",
    ),
    "USD279": _warning(
        "a manifest that is missing, or lacks attributes of the clips",
        "name every attribute in it: what it lacks is not read from the clips",
    ),
    # What USD's own validators say beyond ours
    "USD280": _warning("found by usdValidation", "see the validator that it names"),
    "USD281": _warning("found by usdGeomValidators", "see the validator that it names"),
    "USD282": _warning(
        "found by usdShadeValidators", "see the validator that it names"
    ),
    "USD283": _warning("found by usdLuxValidators", "see the validator that it names"),
    "USD284": _warning(
        "found by usdPhysicsValidators", "see the validator that it names"
    ),
    "USD285": _warning(
        "found by usdUtilsValidators", "see the validator that it names"
    ),
    "USD286": _warning("found by another validator", "see the validator that it names"),
}


def finding(
    code: str, where: object, message: str, severity: Severity | None = None
) -> Fault:
    """Return the fault of a code, with its hint.

    Args:
        code: Of the table.
        where: Path of a prim or property.
        message: With the numbers at fault.
        severity: Where it is less than the table's.
    """
    entry = CODES[code]
    return Fault(
        code,
        message,
        hint=entry.hint,
        severity=severity or entry.severity,
        where=str(where),
    )
