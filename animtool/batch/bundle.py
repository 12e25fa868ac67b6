"""A batch as an Open Job Description bundle, which render farms run.

A task builds a chunk of the items, ``animtool batch JOB --items FIRST+COUNT``; when all
tasks are done, a last one merges their records and builds items that were added
meanwhile.

References:
    Open Job Description, template schemas of revision 2023-09,
    https://github.com/OpenJobDescription/openjd-specifications/wiki
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from animtool.batch.discover import Batch
from animtool.batch.records import (
    RecordError,
    checked_object,
    list_in,
    number_in,
    read_json,
    text_in,
)
from animtool.batch.work import ItemStatus
from animtool.core.arguments import argument, flag
from animtool.core.errors import Fault, FormatError, OptionError
from animtool.core.files.commit import output_error
from animtool.core.files.output import atomic_outputs, check_outputs, write_parts
from animtool.core.names import DOCUMENT_FILE_SUFFIXES
from animtool.core.record import dataclass
from animtool.documents.yaml_text import yaml_text

# Default duration of a task [s]. Starting a process for a chunk and checking the batch
# takes about a hundredth of it.
DEFAULT_TASK_SECONDS = 120.0
# Items per chunk if their duration is unknown: captures take about 0.1 s, long ones a
# second.
DEFAULT_CHUNK_SIZE = 100
# Time between the farm's request to end a task and its kill [s].
NOTICE_SECONDS = 30
TEMPLATE_FILE, VALUES_FILE = "template.yaml", "parameter_values.yaml"
MAX_NAME_LENGTH = 128
# Maximum size of a report, enough for 100,000 items [bytes].
MAX_REPORT_BYTES = 64_000_000
# Upper limit of the mean time of an item [s].
MAX_ITEM_SECONDS = 1e9


@dataclass(frozen=True, slots=True)
class CutArguments:
    """Shot options of the command line that complete a batch file."""

    path: Path | None = None  # the timeline; None uses the batch file's
    # Options of its shots as command-line arguments; they replace those of the batch.
    shot_arguments: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Bundle:
    """An Open Job Description bundle that has not been written yet."""

    template: Mapping[str, Any]  # template of the job
    parameter_values: Mapping[str, str]  # values of parameters without a default
    item_count: int
    chunk_size: int  # number of items per task

    @property
    def task_count(self) -> int:
        """Number of tasks that build the items."""
        return -(-self.item_count // self.chunk_size)


@dataclass(frozen=True, slots=True)
class WrittenBundle:
    """A bundle on disk, with the command that runs it."""

    folder: Path
    files: list[Path]  # the template first
    bundle: Bundle
    json_keys: ClassVar[str] = (
        "'job' files items=bundle.item_count chunk=bundle.chunk_size "
        "tasks=bundle.task_count run"
    )

    @property
    def run(self) -> list[str]:
        """Command that runs the bundle locally."""
        command = ["openjd", "run", str(self.files[0]), "--step", "Settle"]
        command.append("--run-dependencies")
        for name, value in self.bundle.parameter_values.items():
            command += ["-p", f"{name}={value}"]
        return command


def mean_item_seconds(path: Path) -> float:
    """Return the mean build time of an item from a batch's JSON report [s]."""
    try:
        item_records = list_in(read_json(path, MAX_REPORT_BYTES), "items")
        item_seconds = [
            number_in(item, "seconds")
            for item in map(checked_object, item_records)
            if text_in(item, "status") == ItemStatus.DONE
        ]
    except RecordError as error:
        report_options = (flag("items", "1-20"), flag("force"), flag("format", "json"))
        hint = f"animtool batch JOB {' '.join(report_options)} writes one"
        message = f"is not the report of a batch: {error}"
        raise FormatError(Fault("BAT037", message, str(path), (), hint)) from error
    if not item_seconds:
        hint = f"{argument('force', True)} also rebuilds what is up to date"
        fault = Fault("BAT037", "reports no item that was built", str(path), (), hint)
        raise FormatError(fault)
    return min(sum(item_seconds) / len(item_seconds), MAX_ITEM_SECONDS)


def chunk_size(
    item_count: int,
    seconds: float | None = None,
    task_seconds: float = DEFAULT_TASK_SECONDS,
) -> int:
    """Return the number of items per task, given the seconds per item and per task.

    >>> chunk_size(1000, 0.5), chunk_size(1000), chunk_size(10, 0.1)
    (240, 100, 10)
    """
    if seconds is None:
        return min(DEFAULT_CHUNK_SIZE, item_count)
    return max(1, min(item_count, round(task_seconds / max(seconds, 1e-6))))


def batch_bundle(
    batch: Batch, path: Path, items_per_chunk: int, cuts: CutArguments
) -> Bundle:
    """Return the bundle of a batch, with the shot options of the command line."""
    cut_arguments = [] if cuts.path is None else ["--cut", "{{Param.CutList}}"]
    cut_arguments += cuts.shot_arguments
    name = re.sub(r"[{}\x00-\x1f\x7f]", "_", f"animtool {batch.name}")
    template = {
        "specificationVersion": "jobtemplate-2023-09",
        "name": name[:MAX_NAME_LENGTH],
        "parameterDefinitions": _parameters(batch, items_per_chunk, cuts),
        "steps": [
            {
                "name": "Bake",
                "parameterSpace": {
                    "taskParameterDefinitions": [
                        {
                            "name": "First",
                            "type": "INT",
                            "range": "1-{{Param.Items}}:{{Param.ChunkSize}}",
                        }
                    ]
                },
                "script": _script(
                    "--items",
                    "{{Task.Param.First}}+{{Param.ChunkSize}}",
                    *cut_arguments,
                ),
            },
            {
                "name": "Settle",
                "dependencies": [{"dependsOn": "Bake"}],
                "script": _script(*cut_arguments),
            },
        ],
    }
    parameter_values = {"BatchFile": str(path.absolute())}
    if cuts.path is not None:
        parameter_values["CutList"] = str(cuts.path.absolute())
    return Bundle(template, parameter_values, len(batch.items), items_per_chunk)


def _parameters(
    batch: Batch, items_per_chunk: int, cuts: CutArguments
) -> list[dict[str, Any]]:
    """Return the definitions of a job's parameters, with their default values."""
    file_type = {"type": "PATH", "objectType": "FILE", "dataFlow": "IN"}
    integer_type: dict[str, Any] = {"type": "INT", "minValue": 1}
    text_type = {"type": "STRING"}
    item_count, default_jobs = len(batch.items), str(batch.jobs or "auto")
    definitions: list[tuple[str, dict[str, Any], str]] = [
        ("BatchFile", file_type, "The batch file; its relative paths start there."),
        (
            "Items",
            integer_type | {"default": item_count},
            "How many items the batch has.",
        ),
        (
            "ChunkSize",
            integer_type | {"default": items_per_chunk},
            "How many items a task builds.",
        ),
        (
            "Jobs",
            text_type | {"default": default_jobs},
            "Processes per task, or auto: one per processor.",
        ),
        (
            "Command",
            text_type | {"default": "animtool"},
            "Command that starts animtool on the workers.",
        ),
    ]
    if cuts.path is not None:
        definitions.append(
            ("CutList", file_type, "The timeline whose clips are the items.")
        )
    return [
        {"name": name, **properties, "description": description}
        for name, properties, description in definitions
    ]


def _script(*selection: str) -> dict[str, Any]:
    """Return the script of a step; ``selection`` holds flags that choose its items."""
    arguments = ["batch", "{{Param.BatchFile}}", *selection, "-j", "{{Param.Jobs}}"]
    arguments += ["--lines", "openjd"]
    arguments += ["--path-mapping", "{{Session.PathMappingRulesFile}}"]
    cancelation = {
        "mode": "NOTIFY_THEN_TERMINATE",
        "notifyPeriodInSeconds": NOTICE_SECONDS,
    }
    action = {"command": "{{Param.Command}}", "args": arguments}
    return {"actions": {"onRun": {**action, "cancelation": cancelation}}}


def write_bundle(
    bundle: Bundle, folder: Path, *, overwrite: bool = False
) -> WrittenBundle:
    """Write a bundle; refuse files that exist (OUT001) or a file as folder (OUT004)."""
    if folder.suffix.lower() in DOCUMENT_FILE_SUFFIXES and not folder.is_dir():
        message = f"a bundle is a folder, not a {folder.suffix} file"
        hint = f"for example {folder.with_suffix('.job')}"
        raise OptionError(Fault("OUT004", message, str(folder), (), hint))
    parameter_entries = [
        {"name": name, "value": value}
        for name, value in bundle.parameter_values.items()
    ]
    text_by_path = {
        folder / TEMPLATE_FILE: yaml_text(dict(bundle.template)),
        folder / VALUES_FILE: yaml_text({"parameterValues": parameter_entries}),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(folder, error) from error
    check_outputs(list(text_by_path), [], overwrite=overwrite)
    with atomic_outputs():
        for path, text in text_by_path.items():
            write_parts(path, [text.encode()])
    return WrittenBundle(folder, list(text_by_path), bundle)
