"""Plans a page without building it: files read, contents shown, output path."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

from animtool.core.errors import counted
from animtool.core.names import is_named
from animtool.core.rates import rate_label
from animtool.preview.open_file import OpenFile, ShownTake, open_file, shown_scene
from animtool.preview.options import PreviewOptions
from animtool.scene.bake.outline import outlined
from animtool.scene.bake.steps import PlanStep, StepKind, bake_steps
from animtool.scene.file.read import load_scene

_KINDS = {
    "mesh": ("mesh", "meshes"),
    "curves": ("set of curves", "sets of curves"),
    "points": ("set of points", "sets of points"),
    "copies": ("set of copies", "sets of copies"),
}


def page_steps(
    files: Sequence[Path], output: Path | None, options: PreviewOptions | None = None
) -> list[PlanStep]:
    """Return the steps of a page; files are read, scenes are not baked.

    Args:
        files: As `animtool.preview.build.write_page` has them.
        output: The page; None is a temporary file.
        options: What it shows.

    Raises:
        FormatError: A file cannot be read, or is malformed.
        OptionError: A file shows nothing (PRV001).
    """
    options = options or PreviewOptions()
    steps: list[PlanStep] = []
    with ExitStack() as context:
        for path in files:
            if is_named(path, "scene"):
                steps += _baked(path, options)
            else:
                steps.append(_read(open_file(path, options, files, context)))
    reads = tuple(str(path) for path in files)
    left_out = () if options.findings else ("findings: not requested (findings)",)
    makes = ("a page" if output is None else str(output),)
    name = "a temporary file" if output is None else output.name
    return [*steps, PlanStep(StepKind.OUTPUT, name, "", reads, makes, left_out)]


def _baked(path: Path, options: PreviewOptions) -> Iterator[PlanStep]:
    """Yield the bake steps of a scene."""
    scene = shown_scene(load_scene(path, dict(options.variables)))
    for step in bake_steps(outlined(scene, None)):
        if step.kind is not StepKind.OUTPUT:
            yield step


def _read(file: OpenFile) -> PlanStep:
    notices = tuple(f"{notice.code} {notice.message}" for notice in file.notices)
    return PlanStep(
        StepKind.SOURCE,
        str(file.path),
        "",
        (str(file.path),),
        tuple(_shown(file)),
        notices,
    )


def _shown(file: OpenFile) -> Iterator[str]:
    """Yield the contents of a file."""
    for fact, count in Counter(map(_take_text, file.takes)).items():
        yield fact if count == 1 else f"{count} times {fact}"
    contents = file.contents
    if contents is not None:
        kinds = Counter(prim.kind for prim in contents.prims)
        yield from (
            counted(kinds[k], *words) for k, words in _KINDS.items() if kinds[k]
        )
        if cameras := contents.cameras():
            yield counted(len(cameras), "camera")
    if file.markers is not None:
        frames = counted(file.markers.clock.count, "frame")
        yield f"{counted(len(file.markers.names), 'marker')}, {frames}"
    if file.targets is not None:
        frames = counted(file.targets.clock.count, "frame")
        yield f"{counted(len(file.targets.goals), 'target')}, {frames}"


def _take_text(take: ShownTake) -> str:
    stream = take.stream
    frames = counted(sum(block.frames for block in stream.blocks), "frame")
    meshes = counted(len(take.surfaces), "mesh", "meshes")
    joints = counted(len(stream.rig.joints), "joint")
    parts = [f"take of {joints}", f"{frames} at {rate_label(stream.fps)}"]
    return " and ".join([", ".join(parts), *([meshes] if take.surfaces else [])])
