"""Output of a solve: checked before the work, baked after it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from animtool.core.errors import Fault, OptionError, refuse_warnings
from animtool.core.files.output import check_outputs
from animtool.core.names import has_kind_suffix
from animtool.core.record import dataclass
from animtool.core.units import unit_name
from animtool.motion.take import TakeStream
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.progress import Progress
from animtool.scene.bake.request import BakeRequest, check_request, create_request

if TYPE_CHECKING:
    from animtool.scene.bake.bake import OutputReport


def check_file_name(path: Path, kind: str, *, allows_json: bool = True) -> None:
    """Refuse a file to write whose name does not end in its kind, such as ``map``."""
    is_json = path.suffix.lower() == ".json"
    if not has_kind_suffix(path, kind) or (is_json and not allows_json):
        message = f"is not the name of a {kind} file"
        hint = f"allowed: .{kind}.yaml, .{kind}.yml"
        raise OptionError(Fault("OUT004", message, str(path), (), hint))


class SolveReport(Protocol):
    """A report of a solve, to which the report of the written output is added."""

    notices: list[Fault]
    written: OutputReport | None


@dataclass(frozen=True, slots=True)
class SolvedOutput:
    """Files that a solve writes: the take, and others such as a map."""

    request: BakeRequest | None  # the take as output; None if it is not written
    bake: BakeOptions
    extra_files: tuple[Path, ...] = ()  # further files to write

    @staticmethod
    def of(
        output: Path | None,
        source: Path,
        bake: BakeOptions,
        rig: Path | None,
        extra_files: Iterable[Path | None] = (),
    ) -> SolvedOutput:
        """Return the request of a solve's output; a clip refers to a rig file."""
        request = None
        if output is not None:
            clip_rig = rig if rig is not None and has_kind_suffix(rig, "rig") else None
            request = create_request(source, output, bake, rig_file=clip_rig)
        return SolvedOutput(request, bake, tuple(filter(None, extra_files)))

    @property
    def files(self) -> list[Path]:
        """Files to write; for a clip, the clip itself is last."""
        requested_files = [] if self.request is None else self.request.files
        return [*self.extra_files, *requested_files]

    def check(self, inputs: Iterable[Path | None]) -> None:
        """Check the output, and raise its faults before the solve."""
        if self.files:
            input_files = list(filter(None, inputs))
            check_outputs(self.files, input_files, overwrite=self.bake.overwrite)
        if self.request is not None:
            check_request(self.request)

    def write(
        self,
        stream: TakeStream,
        report: SolveReport,
        source_kind: str | None = None,
        progress: Progress = None,
    ) -> None:
        """Write a take and complete the report; only solve if there is no output.

        ``source_kind`` replaces the take's details in the report; None keeps them.

        Raises:
            OutputError: A file cannot be written.
            StrictError: There were warnings, and ``strict`` is on.
        """
        if source_kind is not None:
            units = unit_name(stream.rig.meters_per_unit)
            stream.details = {"format": source_kind, "units": units}
        if self.request is None:
            deque(stream.blocks, maxlen=0)
            stream_notices = stream.notices
        else:
            from animtool.scene.bake.bake import bake_take

            report.written = bake_take(stream, self.request, progress=progress)
            stream_notices = report.written.notices
        reported_notices = set(report.notices)
        report.notices += [
            notice for notice in stream_notices if notice not in reported_notices
        ]
        if self.request is None:
            refuse_warnings(report.notices, strict=self.bake.strict)
