"""Conversion of a take between file formats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from animtool.core.arguments import argument
from animtool.core.errors import OptionError
from animtool.core.files.output import protect_inputs
from animtool.core.writers import take_writer
from animtool.motion.passes import Pass, PassContext, apply_pass
from animtool.scene.bake.bake import OutputReport, bake_take, run_request
from animtool.scene.bake.files import ConvertReport
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.progress import Progress
from animtool.scene.bake.reading import key_option_fault
from animtool.scene.bake.request import check_request, create_request
from animtool.scene.sources.open import (
    OpenTake,
    SourceOptions,
    open_checked,
    open_source,
)


def convert(
    source: Path | str | OpenTake,
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
) -> ConvertReport:
    """Convert a take to BVH, sparse keys or a USD stage.

    Keys are written to a clip file, next to its rig file and the arrays of its meshes
    and shapes.

    Args:
        source: BVH, USD file or clip, or an open take.
        output: A USD file, a ``.clip.yaml``, a ``.bvh``, or any format that
            `animtool.core.writers` lists or a plug-in writes.
        options: Properties of the source.
        overwrite: Replace outputs that exist.
        strict: Treat warnings as errors.
        reduce: Maximum distance by which keys may displace a joint, or a point 3 cm
            from it [m]; None is half a millimetre. For clips only.
        reduce_at: Other tolerances for some joints: names or patterns, and [m].
        base: For an additive take: its base take. Keys are fitted so that the sum is
            within the tolerance. For clips only.
        rig_file: For clips: a file with the take's rig, to which the clip refers; None
            writes one.
        progress: Called with the fraction done, 0 to 1.

    Raises:
        FormatError: The source is malformed.
        OptionError: The output's suffix is unknown, it exists, or an option is not
            for it.
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
    """
    output = Path(output)
    writer = take_writer(output)
    key_options = {"reduce": reduce, "reduce_at": reduce_at, "base": base}
    for name, value in key_options.items():
        if value and "reduce" not in writer.options:
            raise OptionError(key_option_fault(argument(name), output))
    bake_options = _conversion_options(options, overwrite=overwrite, strict=strict)
    bake_options = replace(bake_options, reduce=reduce, reduce_at=reduce_at)
    source = source if isinstance(source, OpenTake) else Path(source)
    request = create_request(source, output, bake_options, base=base, rig_file=rig_file)
    (report,) = run_request(request, progress=progress)
    return _conversion_report(report, output)


def convert_with_passes(
    source: Path,
    output: Path,
    passes: Sequence[tuple[Pass, Any]],
    source_options: SourceOptions | None = None,
    *,
    overwrite: bool = False,
    strict: bool = False,
    progress: Progress = None,
) -> ConvertReport:
    """Apply passes to a take, each with its options, and convert it like `convert`."""
    for pass_, options in passes:
        for check in pass_.checks(options).values():
            check()
    bake_options = _conversion_options(
        source_options, overwrite=overwrite, strict=strict
    )
    request = create_request(source, output, bake_options)
    check_request(request)
    contexts: list[PassContext] = []
    with protect_inputs(request.files):
        stream = open_checked(source, source_options, progress=progress)
        for pass_, options in passes:
            context = PassContext(
                lambda path: open_source(path).collect(), source.parent
            )
            contexts.append(context)
            stream = apply_pass(stream, pass_, options, context)
            stream.notices = [*stream.notices, *context.notices]
        report = bake_take(stream, request)
    scores = [
        score.with_pass(pass_.name, "")
        for (pass_, _), context in zip(passes, contexts, strict=True)
        for score in context.scores
    ]
    return replace(_conversion_report(report, output), scores=scores)


def _conversion_options(
    source_options: SourceOptions | None, *, overwrite: bool, strict: bool
) -> BakeOptions:
    """Return bake options that leave the take unchanged except for its format."""
    source_options = source_options or SourceOptions()
    return BakeOptions(
        source=source_options,
        placement=source_options.placement,
        force_fit=source_options.force_fit,
        overwrite=overwrite,
        strict=strict,
    )


def _conversion_report(report: OutputReport, output: Path) -> ConvertReport:
    """Return the report of a bake as a conversion report."""
    if isinstance(report, ConvertReport):
        return report
    return ConvertReport(
        output,
        report.span,
        report.result.samples,
        report.joints,
        report.notices,
        files=report.files,
    )
