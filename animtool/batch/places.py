"""How records name files: from the folder of all outputs, so that both may move."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

UP = ".."


def named_from(path: Path, root: Path) -> str:
    """Return the name of a file, seen from a folder; absolute where they share none.

    Args:
        path: The file.
        root: The folder, absolute.

    >>> named_from(Path("/job/takes/a.bvh"), Path("/job/out"))
    '../takes/a.bvh'
    """
    where = path.absolute()
    # What a step up leads to is not known where a folder may be a link.
    if UP in where.parts or UP in root.parts:
        return where.as_posix()
    shared = 0
    for one, other in zip(where.parts, root.parts, strict=False):
        if one != other:
            break
        shared += 1
    if shared < 2:
        return where.as_posix()
    steps = [UP] * (len(root.parts) - shared)
    return PurePosixPath(*steps, *where.parts[shared:]).as_posix()


def place_of(name: str, root: Path) -> Path:
    """Return the file that a name means; the inverse of `named_from`.

    >>> place_of("../takes/a.bvh", Path("/job/out")).as_posix()
    '/job/takes/a.bvh'
    """
    path = Path(name)
    if path.is_absolute():
        return path
    steps = 0
    while steps < len(path.parts) and path.parts[steps] == UP:
        steps += 1
    # Above the uppermost folder is that itself.
    above = (root, *root.parents)[min(steps, len(root.parents))]
    return above.joinpath(*path.parts[steps:])
