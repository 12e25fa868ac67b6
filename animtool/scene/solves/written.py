"""Writing a take that a command makes, or that passes do: to USD or another format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from animtool.motion.take import TakeStream
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.progress import Progress
from animtool.scene.convert.takes import ConvertReport, convert, convert_outputs
from animtool.scene.sources.open import is_usd

if TYPE_CHECKING:
    from animtool.scene.bake.prims import BakeReport


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
        from animtool.scene.bake.bake import bake_file

        return bake_file(source, output, options, progress=progress, opener=opener)
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


def take_outputs(
    source: Path, output: Path | None, options: BakeOptions, rig_file: Path | None
) -> list[Path]:
    """Return the files that `write_take` writes; of a clip the output last."""
    if output is None:
        return []
    if is_usd(output):
        from animtool.scene.bake.reading import bake_outputs

        return bake_outputs([source], output, options)
    return convert_outputs(output, rig_file)
