"""Folders of small takes, and takes that bring a process into trouble."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from support.bvh import random_rows, small_bvh

# A reader of ".trouble" files, whose text says what happens to who opens them.
READER = """
import os, signal, threading
from pathlib import Path
from animtool.formats.bvh.read import read_bvh
from animtool.core.readers import Reader

READER = Reader("takes in trouble", source="trouble_reader:open_trouble")


def open_trouble(path):
    word, _, rest = Path(path).read_text().strip().partition(" ")
    if word == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if word == "exit":
        os._exit(7)
    if word == "hang":
        threading.Event().wait()
    if word == "fill":
        held = []
        while True:
            held.append(bytearray(b"x" * 1_000_000))
    if word == "fault":
        raise ZeroDivisionError("never divide")
    if word == "once":
        flag = Path(rest)
        if not flag.exists():
            flag.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    if word == "touch":
        # Somebody writes to the file while it is read.
        os.utime(path, ns=(1, 1))
    if word == "vanish":
        Path(rest).unlink()
    return read_bvh(Path(__file__).with_name("good.bvh"))
"""


def take_files(folder: Path, count: int, frames: int = 4) -> list[Path]:
    """Make a folder of takes that all differ."""
    folder.mkdir(parents=True, exist_ok=True)
    made = []
    for i in range(count):
        path = folder / f"take{i:03}.bvh"
        path.write_text(small_bvh(random_rows(frames, seed=i)), "utf-8")
        made.append(path)
    return made


def trouble_files(folder: Path, words: Iterable[str]) -> list[Path]:
    """Make takes that bring a process into trouble."""
    folder.mkdir(parents=True, exist_ok=True)
    made = []
    for i, word in enumerate(words):
        path = folder / f"{word.split()[0]}{i}.trouble"
        path.write_text(word, "utf-8")
        made.append(path)
    return made


def trouble_plug_in(folder: Path) -> dict[str, str]:
    """Make the plug-in that reads them; return the environment that it needs."""
    info = folder / "trouble_reader-1.0.dist-info"
    info.mkdir(parents=True)
    (folder / "trouble_reader.py").write_text(READER, "utf-8")
    (folder / "good.bvh").write_text(small_bvh(random_rows(4)), "utf-8")
    head = "Metadata-Version: 2.1\nName: trouble-reader\nVersion: 1.0\n"
    (info / "METADATA").write_text(head, "utf-8")
    points = "[animtool.readers]\ntrouble = trouble_reader:READER\n"
    (info / "entry_points.txt").write_text(points, "utf-8")
    return {"PYTHONPATH": str(folder)}


def whole_outputs(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder but records of batches."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and ".animtool" not in path.relative_to(folder).parts
    }
