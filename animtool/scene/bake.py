"""The bake: a source to a USD animation, planned and then run."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from animtool.errors import refuse_warnings
from animtool.output import together
from animtool.scene.options import BakeOptions
from animtool.scene.plan import plan_bake
from animtool.scene.prims import BakePlan, Draft, TakeRun
from animtool.scene.progress import Progress, share_of
from animtool.scene.reading import Source
from animtool.scene.report import BakeReport
from animtool.scene.sources import Opener, open_source


def bake(
    source: Source | Sequence[Source],
    output: Path | str | None,
    options: BakeOptions | None = None,
    *,
    progress: Progress = None,
    opener: Opener = open_source,
) -> BakeReport:
    """Bake a BVH, USD file, clip or scene to a USD animation, or several to a library.

    Args:
        source: The file to read, or a scene that is loaded already; or several, each to
            be a take of a clip library.
        output: The file to write, ``.usda``, ``.usdc`` or ``.usd``; None writes
            usda to stdout.
        options: How.
        progress: Called with the share done, 0 to 1.
        opener: What opens the sources, called as `animtool.open_source`.

    Raises:
        FormatError: A source is malformed, or the takes of a library have other
            joints.
        OptionError: An option makes no sense, or the output exists.
        OutputError: The output cannot be written.
        StrictError: There were warnings, and ``strict`` is on.
    """
    # Passes may keep states as soon as a source is opened.
    with together():
        plan = plan_bake(source, output, options, progress=progress, opener=opener)
        return run_bake(plan, progress=progress)


def run_bake(plan: BakePlan, *, progress: Progress = None) -> BakeReport:
    """Run a planned bake: read, author, write."""
    with together():
        return _run(plan, share_of(progress, 1, 2) if plan.takes else progress)


def _run(plan: BakePlan, progress: Progress) -> BakeReport:
    began = time.perf_counter()
    draft = Draft(plan, progress, [TakeRun(take, plan.watch) for take in plan.takes])
    completions = []
    for prims in plan.prims:
        completions.append(prims.author(draft))
        assert draft.report is not None
        refuse_warnings(draft.report.notices, strict=plan.options.strict)
    assert draft.write is not None
    assert draft.report is not None
    authored = time.perf_counter()
    draft.write(draft.save)
    for complete in completions:
        complete()
    total = time.perf_counter() - began
    read = sum(draft.read)
    # Frames of systems alone are made while they are written.
    author = authored - began if plan.takes else total - read
    draft.report.seconds |= {
        "read": read,
        "author": author,
        "save": total - author if plan.takes else 0.0,
        "total": total,
    }
    return draft.report
