"""A take from one file format to another."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from animtool.clip.reduction.tolerance import KEY_TOLERANCE
from animtool.core.arguments import argument
from animtool.core.clock import Clock, FrameSpan
from animtool.core.errors import Fault, OptionError, Severity, listed, refuse_warnings
from animtool.core.files.output import (
    check_outputs,
    together,
    write_arrays,
    write_parts,
)
from animtool.core.files.reading import seen_from
from animtool.core.names import KINDS
from animtool.core.plugins import load_object
from animtool.core.shot import Shot
from animtool.core.units import parse_length
from animtool.motion.passes import Pass, PassContext, apply_pass
from animtool.motion.scores import PassScores
from animtool.motion.take import Take, TakeStream
from animtool.rig.skeleton import JointType, Rig
from animtool.scene.bake.progress import Progress
from animtool.scene.sources.open import (
    Opener,
    SourceOptions,
    is_usd,
    open_source,
)

if TYPE_CHECKING:
    from animtool.clip.keyed_take import KeyedTake
    from animtool.clip.reduction.keys import Reduction
    from animtool.rig.surfaces import StoredArrays

_MOT = "animtool.formats.mot.write:mot_text"
# What writes a take as text: ``module:object`` of a function from a take to its parts
# and notices.
_TEXTS = {
    ".bvh": "animtool.formats.bvh.write:bvh_text",
    ".csv": "animtool.formats.livelink.write:livelink_text",
    ".mot": _MOT,
    ".sto": _MOT,
}
_WRITES = ".bvh, .clip.yaml, .csv, .mot, .sto, .usd, .usda, .usdc"
MAX_NAMES = 6


@dataclass(frozen=True, slots=True)
class ConvertReport:
    """What a conversion did."""

    output: Path  # the file written
    span: FrameSpan  # first frame, last frame and rate, as the file has them
    frames: int
    joints: int
    notices: list[Fault]  # warnings and notes
    # The keys, where a clip was written, and how far they are off.
    keyed: KeyedTake | None = None
    # Every file written, ``output`` last.
    files: list[Path] = field(default_factory=list)
    shot: Shot | None = None  # the shot that was written; None is no shot
    # How well the passes of the source did.
    scores: list[PassScores] = field(default_factory=list)

    @property
    def reduction(self) -> Reduction | None:
        """The keys and their error, where a clip was written."""
        return None if self.keyed is None else self.keyed.reduction


def convert(
    source: Path | str,
    output: Path | str,
    options: SourceOptions | None = None,
    *,
    overwrite: bool = False,
    strict: bool = False,
    reduce: float | None = None,
    reduce_at: tuple[tuple[str, float], ...] = (),
    base: Path | None = None,
    rig_file: Path | None = None,
    progress: Progress = None,
    opener: Opener = open_source,
) -> ConvertReport:
    """Convert a take to a BVH, to sparse keys, or to a USD stage as a bake would.

    Keys go to a clip file, with the rig file that it is for beside it, and the arrays
    of its meshes and shapes.

    Args:
        source: BVH, USD or clip.
        output: ``.bvh``, ``.csv`` (Live Link Face), ``.mot`` or ``.sto`` (OpenSim),
            ``.clip.yaml`` or a USD file.
        options: What the source is.
        overwrite: Replace outputs that exist.
        strict: Take warnings for errors.
        reduce: Largest distance that keys may move a joint, or a point 3 cm off it
            [m]; None is half a millimetre. For clips.
        reduce_at: Other tolerances for some joints: names or patterns, and [m].
        base: For an additive take what it is put on: keys are fitted so that the
            sum is within the tolerance. For clips.
        rig_file: For clips, a file with the take's rig, which is then named; None
            writes one.
        progress: Called with the share done, 0 to 1.
        opener: What opens the source, called as `animtool.open_source`.

    Raises:
        FormatError: The source is malformed.
        OptionError: The output's suffix is unknown, it exists, or an option is not
            for it.
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
    """
    source, output = Path(source), Path(output)
    _check_name(output)
    given = {
        argument("reduce"): reduce,
        argument("reduce_at"): reduce_at,
        argument("base"): base,
    }
    to_clip = _is_clip(output)
    for name, value in given.items():
        if value and not to_clip:
            message = f"{name} is for keys, and this output holds samples"
            hint = f"write a .clip.yaml, or bake with {argument('reduce')}"
            raise OptionError(Fault("CLI004", message, str(output), (), hint))
    if is_usd(output):
        return _to_usd(source, output, options, overwrite, strict, progress, opener)
    with together():
        if to_clip:
            tolerance = parse_length(KEY_TOLERANCE) if reduce is None else reduce
            keys = _Keys(tolerance, dict(reduce_at), base, rig_file)
            return _to_clip(
                source, output, options, keys, overwrite, strict, progress, opener
            )
        return _to_text(source, output, options, overwrite, strict, progress, opener)


def convert_with_passes(
    source: Path,
    output: Path,
    passes: Sequence[tuple[Pass, Any]],
    reading: SourceOptions | None = None,
    *,
    overwrite: bool = False,
    strict: bool = False,
    progress: Progress = None,
) -> ConvertReport:
    """Convert a take as `convert` does, after passes.

    Args:
        source: BVH, USD or clip.
        output: ``.bvh``, ``.clip.yaml`` or a USD file.
        passes: Each with its options, in their order.
        reading: What the source is.
        overwrite: Replace outputs that exist.
        strict: Take warnings for errors.
        progress: Called with the share done, 0 to 1.

    Raises:
        OptionError: Options make no sense, for any take or for this one.
        AnimtoolError: As `convert` does.
    """
    contexts: list[PassContext] = []

    def opened(path: Path, reading: Any = None, *, progress: Progress) -> TakeStream:
        stream = open_source(path, reading, progress=progress)
        for pass_, options in passes:
            context = PassContext(lambda path: open_source(path).collect(), path.parent)
            contexts.append(context)
            stream = apply_pass(stream, pass_, options, context)
            stream.notices = [*stream.notices, *context.notices]
        return stream

    for pass_, options in passes:
        for check in pass_.checks(options).values():
            check()
    report = convert(
        source,
        output,
        reading,
        overwrite=overwrite,
        strict=strict,
        progress=progress,
        opener=opened,
    )
    scores = [
        one.of_pass(pass_.name, "")
        for (pass_, _), context in zip(passes, contexts, strict=True)
        for one in context.scores
    ]
    return replace(report, scores=scores)


def _to_text(
    source: Path,
    output: Path,
    options: SourceOptions | None,
    overwrite: bool,
    strict: bool,
    progress: Progress,
    opener: Opener,
) -> ConvertReport:
    check_outputs([output], [source], overwrite=overwrite)
    from animtool.edit.resample import resampled

    stream = opener(source, options, progress=progress)
    take = stream.collect()
    if take.clock.step > 1:
        take = resampled(take, take.clock.fps)
    writer = _TEXTS[output.suffix.lower()]
    text = cast(Callable[[Take], Any], load_object(writer))(take)
    noted = [notice for notice in take.notices if notice not in stream.notices]
    notices = stream.notices + noted + text.notices
    refuse_warnings(notices, strict=strict)
    write_parts(output, text.parts)
    count = take.clock.count
    # Most of these files number no frames; whatever reads one begins with the first.
    start = Fraction(1)
    if writer == _MOT:
        start += (take.clock.start - 1) / take.clock.step
    span = Clock(take.clock.rate, start, Fraction(1), count).span
    joints = len(take.rig.joints)
    return ConvertReport(output, span, count, joints, notices, files=[output])


def convert_outputs(output: Path, rig_file: Path | None = None) -> list[Path]:
    """Return the files that hold a take in the format of an output, it last.

    The arrays of a clip's rig are left out: not every rig has some. With a file of the
    rig given there is none to write.

    >>> [path.name for path in convert_outputs(Path("walk.clip.yaml"))]
    ['walk.rig.yaml', 'walk.clip.yaml']
    """
    if rig_file is not None or not _is_clip(output):
        return [output]
    return [output.with_name(f"{_stem(output)}.rig.yaml"), output]


def _check_name(output: Path) -> None:
    """Refuse names of what is no take (OUT004)."""
    if is_usd(output) or output.suffix.lower() in _TEXTS:
        return
    if _is_clip(output):
        stated = Path(output.stem).suffix.lower().removeprefix(".")
        if stated not in KINDS or stated == "clip":
            return
        message = f"is the name of a {stated} file, and holds no motion"
    else:
        kind = f"suffix {output.suffix!r}" if output.suffix else "a name without suffix"
        message = f"{kind} is no format that animtool writes"
    raise OptionError(Fault("OUT004", message, str(output), (), f"allowed: {_WRITES}"))


def _is_clip(output: Path) -> bool:
    return output.suffix.lower() in {".yaml", ".yml"}


def _stem(output: Path) -> str:
    return output.name.removesuffix(output.suffix).removesuffix(".clip")


@dataclass(frozen=True, slots=True)
class _Keys:
    """How near keys are to be [m], near which joints nearer, on which take and rig."""

    tolerance: float
    tolerances: Mapping[str, float]
    base: Path | None
    rig_file: Path | None


def _to_clip(
    source: Path,
    output: Path,
    options: SourceOptions | None,
    keys: _Keys,
    overwrite: bool,
    strict: bool,
    progress: Progress,
    opener: Opener,
) -> ConvertReport:
    from animtool.clip.clip import clip_text
    from animtool.clip.keyed_take import keyed_take
    from animtool.rig.surfaces import with_file
    from animtool.rig.write import rig_text

    stem = _stem(output)
    outputs = convert_outputs(output, keys.rig_file)
    rig_path = keys.rig_file or outputs[0]
    inputs = [source] if keys.base is None else [source, keys.base]
    check_outputs(outputs, inputs, overwrite=overwrite)
    stream = opener(source, options, progress=progress)
    take = stream.collect()
    left_out = _left_out(take)
    refuse_warnings([*stream.notices, *left_out], strict=strict)
    below = None
    if keys.base is not None:
        alike = keys.base.suffix.lower() == source.suffix.lower()
        below = _below(take, keys.base, options if alike else None)
        take = replace(take, rig=without_rest(take.rig))
    arrays_path = output.with_name(f"{stem}.npz")
    rig: Rig = take.rig
    arrays: StoredArrays = {}
    if keys.rig_file is None:
        rig, arrays = with_file(typed_by_motion(take), arrays_path, moved=True)
    if arrays:
        check_outputs([arrays_path, *outputs], inputs, overwrite=overwrite)
    keyed = keyed_take(
        take, rig, stem, keys.tolerance, joint_tolerances=keys.tolerances, base=below
    )
    text = clip_text(keyed.clip, rig, seen_from(rig_path, output.parent))
    if arrays:
        write_arrays(arrays_path, arrays)
    if keys.rig_file is None:
        write_parts(rig_path, [rig_text(rig).encode()])
    write_parts(output, [text.encode()])
    files = [arrays_path] if arrays else []
    files += [output] if keys.rig_file is not None else [rig_path, output]
    return ConvertReport(
        output,
        FrameSpan(keyed.clip.first, keyed.clip.last, keyed.clip.fps),
        take.clock.count,
        len(rig.joints),
        [*stream.notices, *left_out, *keyed.notices],
        keyed,
        files,
    )


def _left_out(take: Take) -> list[Fault]:
    """Return a warning of what a clip has no place for."""
    names = [*(track.path for track in take.tracks), *take.motion.points]
    if not names:
        return []
    message = f"a clip has no place for {listed(names, MAX_NAMES)}: left out"
    hint = "write USD too, which holds them"
    return [Fault("CLIP119", message, severity=Severity.WARNING, hint=hint)]


def _below(take: Take, path: Path, options: SourceOptions | None) -> Take:
    """Return what an additive take is put on, at its frames."""
    from animtool.edit.combine import check_same_rig, other_frames

    base = open_source(path, options).collect()
    check_same_rig(take.rig, base.rig)
    motion = other_frames(base, take.clock.rate, 0, take.clock.count)
    return replace(take, motion=motion)


def without_rest(rig: Rig) -> Rig:
    """Return a rig whose rest pose, for an additive take, changes nothing."""
    joints = tuple(
        replace(joint, translation=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0, 1.0))
        for joint in rig.joints
    )
    return replace(rig, joints=joints, bind={})


def typed_by_motion(take: Take) -> Rig:
    """Return the rig of a take with joints that can do what the take does.

    A joint whose translation moves, or is not that of rest, is free; the others are
    balls. A rig with controls, pins, slides or fixed joints
    keeps its own types.
    """
    free = {JointType.FREE, JointType.BALL}
    if take.rig.controls or any(j.type not in free for j in take.rig.joints):
        return take.rig
    channel = take.motion.translations
    moved = (channel.rest != take.rig.rest_translations).any(axis=1)
    moved[channel.animated] = True
    joints = tuple(
        replace(joint, type=JointType.FREE if moves else JointType.BALL)
        if joint.type is JointType.FREE
        else joint
        for joint, moves in zip(take.rig.joints, moved.tolist(), strict=True)
    )
    return replace(take.rig, joints=joints)


def _to_usd(
    source: Path,
    output: Path,
    options: SourceOptions | None,
    overwrite: bool,
    strict: bool,
    progress: Progress,
    opener: Opener,
) -> ConvertReport:
    from animtool.scene.bake.bake import bake_file
    from animtool.scene.bake.options import BakeOptions

    reading = options or SourceOptions()
    settings = BakeOptions(
        source=reading,
        placement=reading.placement,
        overwrite=overwrite,
        strict=strict,
    )
    report = bake_file(source, output, settings, progress=progress, opener=opener)
    return ConvertReport(
        output,
        report.span,
        report.result.samples,
        report.joints,
        report.notices,
        files=report.files,
    )
