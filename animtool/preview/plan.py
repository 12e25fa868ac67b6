"""Lists the steps of a page without building it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

from animtool.core.errors import counted
from animtool.core.names import has_kind_suffix
from animtool.core.rates import rate_label
from animtool.preview.open_file import OpenFile, TakeToShow, open_file, scene_to_show
from animtool.preview.options import PreviewOptions
from animtool.scene.bake.request import create_request
from animtool.scene.bake.steps import PlanStep, StepKind, bake_steps
from animtool.scene.file.read import load_scene

_KIND_NOUNS = {
    "mesh": ("mesh", "meshes"),
    "curves": ("set of curves", "sets of curves"),
    "points": ("set of points", "sets of points"),
    "copies": ("set of copies", "sets of copies"),
}


def page_steps(
    files: Sequence[Path], output: Path | None, options: PreviewOptions
) -> list[PlanStep]:
    """Return the steps of building a page; this reads files but bakes no scene.

    Args:
        files: As in `animtool.preview.build.write_page`.
        output: Path of the page; None is a temporary file.
        options: What the page shows.
    """
    steps: list[PlanStep] = []
    with ExitStack() as context:
        for path in files:
            if has_kind_suffix(path, "scene"):
                steps += _bake_steps(path, options)
            else:
                steps.append(_read_step(open_file(path, options, files, context)))
    read_paths = tuple(str(path) for path in files)
    omissions = () if options.findings else ("findings: not requested (findings)",)
    outputs = ("a page" if output is None else str(output),)
    output_name = "a temporary file" if output is None else output.name
    return [
        *steps,
        PlanStep(StepKind.OUTPUT, output_name, "", read_paths, outputs, omissions),
    ]


def _bake_steps(path: Path, options: PreviewOptions) -> Iterator[PlanStep]:
    """Yield the steps of baking a scene, without its outputs."""
    scene = scene_to_show(load_scene(path, dict(options.variables)))
    for step in bake_steps(create_request(scene, None)):
        if step.kind is not StepKind.OUTPUT:
            yield step


def _read_step(file: OpenFile) -> PlanStep:
    """Return the step that reads a file, with a description of its contents."""
    notices = tuple(f"{notice.code} {notice.message}" for notice in file.notices)
    return PlanStep(
        StepKind.SOURCE,
        str(file.path),
        "",
        (str(file.path),),
        tuple(_content_texts(file)),
        notices,
    )


def _content_texts(file: OpenFile) -> Iterator[str]:
    """Yield descriptions of the contents of a file."""
    for text, count in Counter(map(_describe_take, file.takes)).items():
        yield text if count == 1 else f"{count} times {text}"
    contents = file.contents
    if contents is not None:
        count_by_kind = Counter(prim.kind for prim in contents.prims)
        yield from (
            counted(count_by_kind[k], *words)
            for k, words in _KIND_NOUNS.items()
            if count_by_kind[k]
        )
        if cameras := contents.cameras():
            yield counted(len(cameras), "camera")
    if file.markers is not None:
        frames_text = counted(file.markers.clock.count, "frame")
        yield f"{counted(len(file.markers.names), 'marker')}, {frames_text}"
    if file.targets is not None:
        frames_text = counted(file.targets.clock.count, "frame")
        yield f"{counted(len(file.targets.goals), 'target')}, {frames_text}"


def _describe_take(take: TakeToShow) -> str:
    """Return a take's joints, frames and meshes as text."""
    stream = take.stream
    frames_text = counted(sum(block.frames for block in stream.blocks), "frame")
    meshes_text = counted(len(take.surfaces), "mesh", "meshes")
    joints_text = counted(len(stream.rig.joints), "joint")
    texts = [f"take of {joints_text}", f"{frames_text} at {rate_label(stream.fps)}"]
    return " and ".join([", ".join(texts), *([meshes_text] if take.surfaces else [])])
