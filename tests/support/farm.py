"""Workers of dask whose view of the disks or packages differs from this machine's."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest


def can_hide() -> bool:
    """Return whether this system gives a process mounts of its own."""
    if sys.platform != "linux" or shutil.which("unshare") is None:
        return False
    command = ["unshare", "-rm", "mount", "-t", "tmpfs", "none", "/mnt"]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


@contextmanager
def other_worker(
    address: str,
    folder: Path,
    hidden: Mapping[Path, Path | None] | None = None,
    environment: Mapping[str, str] | None = None,
) -> Iterator[int]:
    """Give the process of a worker that sees other folders of some names.

    Args:
        address: Of its scheduler.
        folder: For its own files.
        hidden: By folder, what it has in its place; None is an empty disk.
        environment: What it has beside this process's.
    """
    script = ""
    for place, other in (hidden or {}).items():
        how = "-t tmpfs none" if other is None else f"--bind '{other}'"
        script += f"mount {how} '{place}' && "
    worker = [
        *(sys.executable, "-m", "distributed.cli.dask_worker", address),
        *("--nthreads", "1", "--no-dashboard", "--no-nanny"),
        *("--local-directory", str(folder / "dask")),
    ]
    command = worker
    if script:
        if not can_hide():
            pytest.skip("no mounts for one process here")
        command = ["unshare", "-rm", "sh", "-c", f'{script}exec "$@"', "sh", *worker]
    process = subprocess.Popen(
        command,
        env={**os.environ, **(environment or {})},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process.pid
    finally:
        process.kill()
        process.wait()


def packages(folder: Path, **versions: str) -> dict[str, str]:
    """Make records of packages of other versions; return the environment for them."""
    for name, version in versions.items():
        info = folder / f"{name}-{version}.dist-info"
        info.mkdir(parents=True)
        head = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
        (info / "METADATA").write_text(head, "utf-8")
    return {"PYTHONPATH": str(folder)}
