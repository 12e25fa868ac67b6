"""Check that a tag, pyproject.toml and the files to publish have one version.

``tag.py v1.2.3 dist`` ends with exit code 1 where a file is of another version, or the
source or a wheel is missing.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

PYPROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"
# Of each wheel, what its name has for the platform.
PLATFORMS = ("manylinux*_x86_64", "manylinux*_aarch64", "macosx*_arm64", "win_amd64")
PYTHONS = ("cp311-cp311", "cp312-abi3")


def disagreements(tag: str, version: str, files: Sequence[str]) -> list[str]:
    """Return what keeps files from being published.

    Args:
        tag: Of git, such as ``v1.2.3``.
        version: Of the project.
        files: Names of the files to publish.
    """
    lines = []
    if tag != f"v{version}":
        lines.append(f"tag {tag}: the version in pyproject.toml is {version}")
    source = f"animtool-{version}.tar.gz"
    wanted = {source: source} | {
        f"animtool-{version}-{python}-*{platform}.whl": f"wheel {python} {platform}"
        for python in PYTHONS
        for platform in PLATFORMS
    }
    names = [Path(name) for name in files]
    for pattern, title in wanted.items():
        if not any(name.match(pattern) for name in names):
            lines.append(f"{title}: no file {pattern}")
    lines += [
        f"{name}: not a file of version {version}"
        for name in names
        if not any(name.match(pattern) for pattern in wanted)
    ]
    return lines


def main(arguments: list[str]) -> int:
    """Print what disagrees; return the exit code."""
    if len(arguments) != 2:
        sys.exit("usage: tag.py TAG FOLDER")
    tag, folder = arguments
    with PYPROJECT.open("rb") as file:
        version = tomllib.load(file)["project"]["version"]
    names = sorted(path.name for path in Path(folder).iterdir())
    lines = disagreements(tag, version, names)
    print(*lines, sep="\n", file=sys.stderr)
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
