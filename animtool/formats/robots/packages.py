"""Files that a robot names, restricted to the project's folders."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from animtool.core.config import project_roots
from animtool.core.errors import AnimtoolError
from animtool.core.files.reading import exists
from animtool.core.record import dataclass
from animtool.formats.robots.xml import XmlCodes, read_xml

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://(.*)", re.DOTALL)
_PACKAGES = {"package", "model"}
# Folders above a file that are looked at for its package.
MAX_ABOVE = 12
PACKAGE = "package.xml"


class OutsideError(ValueError):
    """A name points outside the project; that file was not opened."""


@dataclass(frozen=True, slots=True)
class PackageFolders:
    """Folders in which a robot may name files.

    Attributes:
        folder: Of the file; relative names are seen from it.
        roots: Folders that names may lead into.
        packages: Folders of the packages that the file is in, by name.
    """

    folder: Path
    roots: tuple[Path, ...]
    packages: dict[str, Path]

    @staticmethod
    def of(path: Path, codes: XmlCodes) -> PackageFolders:
        """Return the folders of a file.

        The package that a file is in is part of its project: the folder above it whose
        ``package.xml`` names it, or that has its name.
        """
        folder = path.resolve().parent
        packages: dict[str, Path] = {}
        for above in [folder, *folder.parents][:MAX_ABOVE]:
            if above == Path(above.anchor):
                break
            name = _package_name(above, codes)
            if name:
                packages.setdefault(name, above)
                break
        roots = (*project_roots(path), *packages.values())
        return PackageFolders(folder, tuple(root.resolve() for root in roots), packages)

    def find(self, name: str) -> Path | None:
        """Return the path of a file name; None if missing.

        Raises:
            OutsideError: It leads out of the project.
        """
        scheme = _SCHEME.fullmatch(name)
        if scheme is None:
            return self._inside(self.folder / name, name)
        kind, rest = scheme[1].lower(), scheme[2]
        if kind == "file":
            return self._inside(Path("/" + rest.lstrip("/")), name)
        if kind not in _PACKAGES:
            raise OutsideError(f"{kind}:// is of a network, and is never opened")
        # Some writers add a third slash.
        package, _, inner = rest.lstrip("/").partition("/")
        tried = [folder for folder in self._folders(package) if inner]
        for folder in tried:
            path = self._inside(folder / inner, name)
            if path is not None:
                return path
        if not tried:
            # A name that leaves one folder leaves all of them.
            self._inside(self.folder / package / inner, name)
        return None

    def _folders(self, package: str) -> list[Path]:
        """Return candidate folders of a package."""
        folders = []
        if package in self.packages:
            folders.append(self.packages[package])
        if package in {"", ".", ".."}:
            return folders
        for root in self.roots:
            above = [self.folder, *self.folder.parents]
            inside = [one for one in above if one.is_relative_to(root)]
            folders += [one for one in inside if one.name == package]
            folders += [one / package for one in inside]
        return folders

    def _inside(self, path: Path, name: str) -> Path | None:
        try:
            resolved = path.resolve()
        except (OSError, RuntimeError, ValueError) as error:
            raise OutsideError(f"{name!r} leads nowhere: {error}") from error
        if not any(resolved.is_relative_to(root) for root in self.roots):
            raise OutsideError(f"it leads out of {_shown(self.roots)}")
        return resolved if exists(resolved) else None


def _shown(roots: Sequence[Path]) -> str:
    return ", ".join(dict.fromkeys(map(str, roots)))


def _package_name(folder: Path, codes: XmlCodes) -> str:
    """Return the ROS package name of a folder; empty if it is none."""
    file = folder / PACKAGE
    if not exists(file):
        return ""
    try:
        root = read_xml(file, codes)
    except AnimtoolError:
        return ""
    names = root.all("name") if root.tag == "package" else []
    return names[0].text.strip() if names else ""
