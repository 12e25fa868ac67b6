"""Writing a take that a command makes, or that passes do: to USD or another format."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animtool.passes import Pass, PassContext, apply_pass
from animtool.scene.convert import ConvertReport, convert
from animtool.scene.options import BakeOptions
from animtool.scene.progress import Progress
from animtool.scene.sources import SourceOptions, is_usd, open_source
from animtool.take import TakeStream

if TYPE_CHECKING:
    from animtool.scene.prims import BakeReport


def write_take(
    source: Path,
    output: Path | None,
    options: BakeOptions,
    *,
    rig_file: Path | None,
    opener: Callable[..., TakeStream],
    progress: Progress,
) -> BakeReport | ConvertReport:
    """Write the take that an opener makes of a source.

    Args:
        source: What the take is made of.
        output: USD file, ``.clip.yaml`` or ``.bvh``; None writes usda to stdout.
        options: How USD is written; other formats use ``overwrite``, ``strict`` and
            ``reduce`` of them.
        rig_file: Rig file that a clip names; None writes one beside it.
        opener: Called as the readers of sources are.
        progress: Called with the share done, 0 to 1.
    """
    if output is None or is_usd(output):
        from animtool.scene.bake import bake

        return bake(source, output, options, progress=progress, opener=opener)
    return convert(
        source,
        output,
        overwrite=options.overwrite,
        strict=options.strict,
        reduce=options.reduce,
        rig_file=rig_file,
        progress=progress,
        opener=opener,
    )


def convert_passed(
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
