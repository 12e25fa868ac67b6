"""Run a part of the tests against the animtool that is installed, not the sources.

The working folder must not be that of the sources: cibuildwheel has one of its own.
Arguments go to pytest.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SUBSET = (
    *("kernels", "maths", "formats", "documents", "rig", "clip", "skin", "ik", "edit"),
    *("usd", "wheels"),
)


def main(arguments: list[str]) -> int:
    """Run the subset; return the exit code of pytest."""
    found = importlib.util.find_spec("animtool")
    if found is None or not found.origin:
        sys.exit("animtool is not installed")
    if Path(found.origin).resolve().is_relative_to(ROOT / "animtool"):
        sys.exit(f"{found.origin} is no installed wheel: install one, run elsewhere")
    print(f"animtool from {found.origin}", flush=True)
    folders = [str(ROOT / "tests" / name) for name in SUBSET]
    command = [sys.executable, "-P", "-m", "pytest", f"--rootdir={ROOT}"]
    command += ["-c", str(ROOT / "pyproject.toml"), "-p", "no:cacheprovider", "-q"]
    return subprocess.run([*command, *folders, *arguments], check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
