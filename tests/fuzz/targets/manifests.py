"""What batches and farms write for later runs: records, owners, rules, reports."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from support.bvh import random_rows, small_bvh

from animtool.batch.bundle import chunk_size, mean_item_seconds
from animtool.batch.cluster_client import scheduler_address
from animtool.batch.discover import find_batch
from animtool.batch.file import load_batch
from animtool.batch.item import map_path, read_path_rules
from animtool.batch.ledger import _owner_text, _RecordFiles, locked_ledger, read_history
from animtool.batch.manifest import ItemRecord, record_file
from animtool.batch.plan import Planner
from animtool.batch.run import RunOptions, run_batch
from animtool.batch.spec import BatchSpec, relative_name
from animtool.batch.variants import read_variants
from animtool.batch.work import ItemStatus
from animtool.cli.batch_progress import scores_table
from animtool.core.errors import AnimtoolError
from animtool.core.files.reading import FileState
from animtool.motion.scores import PassScores, Score, ScoreUnit
from fuzz.mutations import spoil, spoil_values

ABOUT = "records of batches, owners, path rules, reports, addresses, tables of variants"

COUNT = 4
SCORES = (
    PassScores(
        (
            Score("drift", 0.003, ScoreUnit.LENGTH, 0.001),
            Score("acceleration", 1.5, ScoreUnit.RATIO, 1.25, 1.0),
        ),
        {"not mapped": ("jaw", "eye_l")},
        "retarget",
        "passes[0].retarget",
    ),
)
Run = Callable[[np.random.Generator], str]


def make(folder: Path) -> Run:
    """Return what runs a case in a folder."""
    batch = _Recorded(folder / "batch")
    others = [
        _other(folder / "rules.json", RULES, _mapped),
        _other(folder / "report.json", REPORT, _mean),
        _other(folder / "scheduler.json", ADDRESS, scheduler_address),
        _other(folder / "table.csv", TABLE, read_variants),
        _other(folder / "a.batch.json", BATCH, load_batch),
        _other(folder / "a.batch.yaml", BATCH_TEXT, load_batch),
    ]

    def run(rng: np.random.Generator) -> str:
        if rng.random() < 0.6:
            return batch.run(rng)
        return others[int(rng.integers(len(others)))](rng)

    return run


class _Recorded:
    """A batch that is up to date, by records that are spoilt."""

    def __init__(self, folder: Path) -> None:
        takes, self.out = folder / "takes", folder / "out"
        takes.mkdir(parents=True)
        self.out.mkdir()
        self.takes = [takes / f"take{i}.bvh" for i in range(COUNT)]
        for i, path in enumerate(self.takes):
            path.write_text(small_bvh(random_rows(1, seed=i)), "utf-8")
            os.utime(path, ns=(10**18, 10**18))
        spec = BatchSpec((str(takes),), output=str(self.out / "{stem}.usdc"))
        self.batch = find_batch(spec)
        for part in ("1-2", ""):
            self._record(part)
        self.records_folder = self.batch.records_folder
        self.first = self.out / "records"
        shutil.copytree(self.records_folder, self.first)
        self.data = {
            path.relative_to(self.first): path.read_bytes()
            for path in sorted(self.first.rglob("*"))
            if path.is_file() and path.suffix != ".lock"
        }

    def _record(self, part: str) -> None:
        batch = self.batch
        with locked_ledger(batch.records_folder, batch.name, part) as ledger:
            planner = Planner(batch, ledger.history)
            for item in batch.items[:2] if part else batch.items[2:]:
                item.output.write_bytes(b"made")
                files = [
                    (
                        record_file(
                            path, relative_name(path, batch.root), FileState.of(path)
                        ),
                    )
                    for path in (item.file.path, item.output)
                ]
                key, how = planner.record_key(item), planner.settings_digest(item)
                ledger.add_names([key])
                made = ItemRecord(
                    key, how, planner.versions, *files, 2 * 10**18, SCORES
                )
                ledger.add(made)
            ledger.add_failure("other.usdc", "BAT020 it crashed")

    def run(self, rng: np.random.Generator) -> str:
        names = list(self.data)
        chosen = names[int(rng.integers(len(names)))]
        by_bytes = bool(rng.integers(2))
        for name, data in self.data.items():
            (self.records_folder / name).write_bytes(
                _spoilt_lines(rng, data, by_bytes=by_bytes) if name == chosen else data
            )
        changed = int(rng.integers(COUNT))
        text = self.takes[changed].read_bytes()
        self.takes[changed].write_bytes(text + b" ")
        try:
            report = run_batch(self.batch, RunOptions(dry_run=True))
            # What accidents do to a record never makes an item seem up to date.
            scores_table(report.items_with_scores)
            status = report.items[changed].status
            assert not by_bytes or status is ItemStatus.NOT_RUN
            self._settled()
        except AnimtoolError as error:
            return error.code
        finally:
            self.takes[changed].write_bytes(text)
            os.utime(self.takes[changed], ns=(10**18, 10**18))
        return f"{report.count(ItemStatus.SKIPPED)} of {COUNT - 1} known"

    def _settled(self) -> None:
        """Write records anew, which then are whole."""
        batch = self.batch
        with locked_ledger(batch.records_folder, batch.name) as ledger:
            ledger.add_failure("another.usdc", "why")
            ledger.merge_records(lambda _: True)
            made = ledger.history.manifest.items
        again = read_history(batch.records_folder, batch.name)
        assert again.manifest.items == made
        assert not again.damage_warnings
        _owner_text(_RecordFiles(batch.records_folder, batch.name))


def _spoilt_lines(rng: np.random.Generator, data: bytes, *, by_bytes: bool) -> bytes:
    """Return a file of lines of JSON with some bytes or some values spoilt."""
    if by_bytes:
        return spoil(rng, data)
    lines = data.splitlines(keepends=True)
    for _ in range(int(min(rng.geometric(0.5), 4))):
        i = int(rng.integers(len(lines)))
        try:
            found = json.loads(lines[i])
        except (ValueError, RecursionError):
            continue
        value = spoil_values(rng, found)
        separators = (",", ":") if rng.integers(2) else None
        text = json.dumps(value, separators=separators)
        if rng.random() < 0.05:
            text = "[" * 100_000 + text
        lines[i] = text.encode() + b"\n"
    return b"".join(lines)


def _other(path: Path, data: bytes, read: Callable[[Path], object]) -> Run:
    def run(rng: np.random.Generator) -> str:
        whole = data.startswith(b"{") and rng.integers(2)
        path.write_bytes(
            _spoilt_lines(rng, data, by_bytes=False) if whole else spoil(rng, data)
        )
        try:
            read(path)
        except AnimtoolError as error:
            return error.code
        return f"{path.name} read"

    return run


def _mapped(path: Path) -> None:
    rules = read_path_rules(path)
    for text in ("/show/takes/a.bvh", "Z:\\show\\a.bvh", "a"):
        assert map_path(text, rules)


def _mean(path: Path) -> None:
    seconds = mean_item_seconds(path)
    assert 0 <= seconds < float("inf")
    assert 1 <= chunk_size(100, seconds) <= 100


RULES = json.dumps(
    {
        "version": "pathmapping-1.0",
        "path_mapping_rules": [
            {
                "source_path_format": "POSIX",
                "source_path": "/show",
                "destination_path": "/mnt/show",
            },
            {
                "source_path_format": "WINDOWS",
                "source_path": "Z:\\show",
                "destination_path": "/mnt/show",
            },
        ],
    }
).encode()
REPORT = json.dumps(
    {
        "batch": "animtool/1",
        "done": 2,
        "seconds": 0.5,
        "items": [
            {"item": 1, "input": "a.bvh", "status": "done", "seconds": 0.25},
            {"item": 2, "input": "b.bvh", "status": "done", "seconds": 0.5},
            {"item": 3, "input": "c.bvh", "status": "skipped"},
        ],
    }
).encode()
BATCH = json.dumps(
    {
        "batch": "animtool/1",
        "inputs": ["batch/takes/*.bvh"],
        "exclude": ["old/*.bvh"],
        "output": "out/{parent}/{stem}_{k}.usdc",
        "variables": {"shot": "sh010", "first": 2},
        "overrides": [{"inputs": ["batch/takes/a*"], "variables": {"first": 1e-3}}],
        "variants": {"k": [1, 2], "s": "0..1/0.25", "t": {"start": 0, "stop": 1}},
        "options": {"reduce": "0.5mm", "range": [1, 4], "fps": 24},
        "limits": {"seconds": 60, "memory": "2GB"},
        "jobs": 2,
    }
).encode()
BATCH_TEXT = b"""batch: animtool/1
inputs: [batch/takes/*.bvh]
output: out/{stem}_{k}_{s}.usdc
variants: {k: 1..20/0.5, s: {start: 0, stop: 1, step: 1e-1}}
options: {source_fps: 30000/1001, reduce_at: {hand: 1mm}}
limits: {seconds: 1e3, memory: 512MiB}
"""
ADDRESS = b'{"type": "Scheduler", "id": "s", "address": "tcp://127.0.0.1:8786"}'
TABLE = b'k,s,name\n1,0.5,"a, b"\n2,0.25,c\n\n3,1e-3,d\n'
