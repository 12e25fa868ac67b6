"""Text templates of bake reports."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from animtool.core.errors import counted, excerpt, percent_text
from animtool.core.quantities import duration_text, plain_number, size_text
from animtool.report.text import Each, Line, Table, Template

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from animtool.clip.key_report import ChannelDeviation
    from animtool.core.errors import Fault
    from animtool.scene.bake.files import ConvertReport
    from animtool.scene.bake.prims import BakeReport, MeshReport, TakeReport
    from animtool.scene.bake.steps import PlanStep
    from animtool.usd.caches.writer import CachedMesh, CharactersReport
    from animtool.usd.takes.splines import CurveReport

# Channel errors below this are not listed, in their units.
NEGLIGIBLE_ERROR = 1e-9
# Up to three files of an output are listed; chunks can be thousands.
MAX_LISTED_FILES = 3
SHOT_SUFFIX = "[  {shot.label}]"


def _score_lines(indent: str) -> Each:
    """Return the template of the score lines of a take's passes."""
    names = Each("names", (indent + "  {key}: [{value:list 8}]",))
    return Each("scores", (indent + "{pass_name}: [{scores:scores}]", names))


def channel_lines(errors: Sequence[ChannelDeviation]) -> list[str]:
    """Return a line on the number of channels, and on the largest error by unit."""
    if not errors:
        return []
    groups = Counter(error.target.partition("/")[0] for error in errors)
    nouns = {"control": "control", "joint": "joint channel", "shape": "shape"}
    counts = [
        counted(groups[group], noun) for group, noun in nouns.items() if group in groups
    ]
    largest_by_unit: dict[tuple[str | None, bool], ChannelDeviation] = {}
    for error in errors:
        unit_key = error.unit, error.target.startswith("control/")
        largest = largest_by_unit.setdefault(unit_key, error)
        if error.error > largest.error:
            largest_by_unit[unit_key] = error
    errors_text = ", ".join(
        f"{plain_number(error.error)} {error.unit or ''}".rstrip()
        + f" ({error.target})"
        for error in largest_by_unit.values()
        if error.error > NEGLIGIBLE_ERROR
    )
    keys_line = f"keys on {', '.join(counts)}"
    error_lines = [f"largest errors of channels: {errors_text}"] if errors_text else []
    return [keys_line, *error_lines]


_PRINTERS: Mapping[str, Callable[..., Any]] = {
    "scores": lambda scores: ", ".join(
        f"{score.name} {score.text}" for score in scores
    ),
    "channels": channel_lines,
    "next": lambda number: str(number + 1),
}
CONVERT_TEMPLATE = Template(
    "animtool.scene.bake.files:ConvertReport",
    (
        "{output}: {frames:n frame}, {joints:n joint}",
        "  {span}",
        SHOT_SUFFIX,
        _score_lines("  "),
        "[{?reduction.samples}  {reduction.samples:n sample} of animated channels "
        "became {reduction.keys:n key}: {reduction.samples_per_key:.3g} per "
        "key|{?reduction}  nothing moves: [{?reduction.keys}{reduction.keys:n key}, "
        "for what is not at rest|no keys]]",
        "[  largest error: {reduction.error:length}[{?reduction.error} (joint "
        "{reduction.joint:repr}, frame {reduction.frame:next} of {frames})]]",
        "[{?reduction.weight_error}  largest error of a shape's weight: "
        "{reduction.weight_error:plain}]",
        Each("keyed_take.errors:channels", ("  {self}",)),
    ),
    _PRINTERS,
)


def _reduction_lines(indent: str) -> tuple[Line, ...]:
    """Return the templates of the lines on scores, reduction and kept curves."""
    return (
        _score_lines(indent),
        f"[{indent}{{thinned.samples:n sample}} reduced to {{thinned.count}}: "
        "largest error between them {thinned.error:length}"
        "[{?thinned.error} (joint {thinned_joint:repr}, frame {thinned.code:frame})]]",
        f"[{indent}{{written.curves:n curve of a control/curves of controls}} kept, "
        "{written.curves:knots}: largest difference {written.curves:difference}]",
    )


def _frames_text(take: str) -> str:
    """Return the template that states the source frames if the take was resampled."""
    return (
        f"[{{?{take}resampled}}, from {{{take}source_frames:n frame}} at "
        f"{{{take}source_fps:rate}}][{{?{take}between_frames}}, "
        f"{{{take}between_frames}} of which fall between frames]"
    )


_MESHES = Each(
    "only.meshes:groups",
    (
        "  {title}",
        Each(
            "meshes",
            (
                "    {name}: {self:points}, [{?written.characters}{written.samples:n "
                "frame}, {milliseconds_per_frame:ms} per "
                "frame|[{?written.samples}{written.samples:n frame}, "
                "{written.bytes:size}|static, no samples], "
                "{milliseconds_per_frame:ms} per frame, largest float32 error "
                "{written.error:length 2}[{?written.error} ({written:worst_point}, "
                "frame {written.error_code:frame})]]",
                "[      {written.characters.own} with their own animation, "
                "{written.characters:kept} of poses written: joints within "
                "{written.characters.error:length 2}, planted feet "
                "{written.characters.slide:length 2}]",
                "[      {written.characters.shared} with a part in an animation of "
                "standing characters]",
            ),
        ),
    ),
)
_PROPS = "  beside: {props:list}]"


def _file_names_text(files: Sequence[Path]) -> str:
    """Format the files of an output: all, or the main file and a count."""
    if len(files) <= MAX_LISTED_FILES:
        return ", ".join(map(str, files)) or "stdout"
    return f"{files[-1]} and {len(files) - 1} more files"


def _beyond_limits_text(notices: Sequence[Fault]) -> str:
    """Return text that the error omits values beyond float32; empty if none are."""
    has_values_beyond = any(notice.code == "BVH104" for notice in notices)
    return " (without values beyond it)" if has_values_beyond else ""


def _curve_error_text(curves: Sequence[CurveReport]) -> str:
    """Format the largest error of the curves, with the name of the curve."""
    largest = max(curves, key=lambda curve: curve.difference)
    curve_text = f" (control {largest.name!r})" if largest.difference else ""
    return f"{plain_number(largest.difference, 2)}{curve_text}"


def _precision_text(take: TakeReport) -> str:
    """Return the number formats that the take is rounded to."""
    scale_error = take.written.rounding.scale_error
    if scale_error:
        return f"float32 and half scales (up to {percent_text(scale_error)} off)"
    return "float32"


def mesh_groups(meshes: Sequence[MeshReport]) -> list[dict[str, Any]]:
    """Return the deformed and the simulated meshes as groups with titles."""
    groups = []
    for is_simulated, title_of in ((False, _deformed_text), (True, _simulated_text)):
        group_meshes = [mesh for mesh in meshes if mesh.is_simulated is is_simulated]
        if group_meshes:
            groups.append({"title": title_of(group_meshes), "meshes": group_meshes})
    return groups


def _deformed_text(meshes: list[MeshReport]) -> str:
    """Format the counts of deformed meshes and strands, as a title."""
    strand_set_count = sum(mesh.kind == "strands" for mesh in meshes)
    meshes_text = counted(len(meshes) - strand_set_count, "mesh", "meshes")
    if strand_set_count:
        meshes_text += f" and {counted(strand_set_count, 'set', 'sets')} of strands"
    return f"{meshes_text} of {meshes[0].of}, deformed"


def _simulated_text(meshes: list[MeshReport]) -> str:
    """Format a title such as ``2 systems of cloth, simulated``."""
    return f"{counted(len(meshes), 'system')} of {meshes[0].of}, simulated"


# Nouns of counted elements by kind of system.
_NOUNS = {"rigid": ("body", "bodies"), "crowds": ("agent",)}


def _point_count_text(mesh: MeshReport) -> str:
    """Format the count of a mesh's vertices, particles, bodies or agents."""
    vertex_count = mesh.written.vertices
    if not mesh.is_simulated:
        return counted(vertex_count, "vertex", "vertices")
    text = counted(vertex_count, *_NOUNS.get(mesh.kind, ("particle",)))
    return f"up to {text}" if mesh.kind == "particles" else text


def _worst_point_text(cached_mesh: CachedMesh) -> str:
    """Format the point with the largest rounding error: a body or a vertex."""
    point = cached_mesh.error_vertex
    if cached_mesh.names:
        return f"body {excerpt(cached_mesh.names[point])}"
    return f"vertex {point}"


def _kept_samples_text(characters: CharactersReport) -> str:
    """Format the fraction of the characters' poses that are written, in percent."""
    frames = characters.frames
    return f"{characters.samples / frames:.0%}" if frames else "none"


_LOCATION = "joint {@error_joint:repr}, frame {@written.rounding.code:frame}"
BAKE_TEMPLATE = Template(
    "animtool.scene.bake.prims:BakeReport",
    (
        "{files:files}: {form}",
        "  [{?only}{only.written.samples:n sample}, [{?only.written.name}"
        "{only.written.span.frames_text} at {fps:rate}|{span}]"
        f"{_frames_text('only.')}"
        "|{takes:n take}, {span}]",
        SHOT_SUFFIX,
        "[{?has_joints}  {result.joints:n joint}, "
        "[{result.sampled:and}|nothing] animated]",
        f"[{{?has_joints}}{_PROPS}",
        _MESHES,
        f"[{{!has_joints}}{_PROPS}",
        "  {up} up, lengths in {units}[{?is_unit_assumed}; the source is assumed to be "
        "in cm (--units)]",
        "  {result.bytes:size} written in {seconds.total:duration}"
        "[{?has_joints}{?source_bytes}, {self:speed}/s of source]",
        "[{?has_joints}  largest error of {worst:rounded}[{notices:beyond}]: "
        "{worst.written.rounding.error:length 2}[{?worst.written.rounding.error} "
        f"([{{?library}}take {{worst.written.name:repr}}, ]"
        f"{_LOCATION.replace('@', 'worst.')})]]",
        Each("only:with_joints", _reduction_lines("  ")),
        Each(
            "library",
            (
                "  take {written.name}: {written.samples:n sample}, "
                f"{{written.span.frames_text}} at {{fps:rate}}{_frames_text('')}",
                "    error of {self:rounded}: {written.rounding.error:length 2}"
                f"[{{?written.rounding.error}} ({_LOCATION.replace('@', '')})]",
                *_reduction_lines("    "),
            ),
        ),
    ),
    {
        **_PRINTERS,
        "files": _file_names_text,
        "and": " and ".join,
        "groups": mesh_groups,
        "ms": lambda milliseconds: duration_text(milliseconds / 1e3),
        "points": _point_count_text,
        "worst_point": _worst_point_text,
        "kept": _kept_samples_text,
        "speed": lambda bake: size_text(bake.source_bytes / bake.seconds["total"]),
        "rounded": _precision_text,
        "beyond": _beyond_limits_text,
        "with_joints": lambda take: [take] if take.has_joints else [],
        "knots": lambda curves: counted(sum(curve.knots for curve in curves), "knot"),
        "difference": _curve_error_text,
        "stated": lambda values: ", ".join(
            f"{key} {value}" for key, value in values.items()
        ),
        "times": lambda values: ", ".join(
            f"{key} {seconds:.3f}" for key, seconds in values.items()
        ),
    },
    (
        Each(
            "takes",
            (
                "  source: [{details:stated}]",
                "  animation: [{written.animation}]",
                Each("simulated", ("  simulated: [{self:stated}]",)),
            ),
        ),
        "  seconds: [{seconds:times}] (read and author overlap)",
        "  skeleton at rest: {size:length 4} across",
    ),
)
_TEMPLATE_BY_REPORT = {"BakeReport": BAKE_TEMPLATE, "ConvertReport": CONVERT_TEMPLATE}


def template_of(report: BakeReport | ConvertReport) -> Template:
    """Return the text template for the class of an output's report."""
    return _TEMPLATE_BY_REPORT[type(report).__name__]


def _other_prims_text(step: PlanStep, name: str) -> str:
    """Return the prims that a step reads or writes; empty if only its own."""
    prim_names = getattr(step, name)
    return "" if prim_names == (step.name,) else ", ".join(prim_names)


PLAN_TEMPLATE = Template(
    "animtool.scene.bake.steps:PlanSteps",
    (
        Each(
            "steps",
            (
                "{number}  {kind} {name}[ ({where})]",
                "[     reads {self:others reads}]",
                "[     makes {self:others makes}]",
                Each("left_out", ("     skips {self}",)),
            ),
        ),
    ),
    {"others": _other_prims_text},
    is_result=True,
)
STATS_TEMPLATE = Template(
    "animtool.scene.bake.progress:BakeStats",
    (
        Table(
            "costs",
            {
                "stage": "{name}[ ({where})]",
                "seconds": "{seconds:.3f}",
                "peak MB": "{peak:MB}",
                "error mm": "{error:mm}",
            },
            left=("stage",),
        ),
    ),
    {"MB": lambda size: f"{size / 1e6:.1f}"},
)
