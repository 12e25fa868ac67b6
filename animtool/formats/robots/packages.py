"""Finds files that a robot refers to, in the project's folders only."""

from __future__ import annotations

import re
from itertools import islice
from pathlib import Path

from animtool.core.config import may_be_project, outside_hint, project_roots
from animtool.core.errors import AnimtoolError
from animtool.core.files.reading import exists
from animtool.core.names import MAX_SEARCHED_NAMES
from animtool.core.record import dataclass
from animtool.formats.robots.xml import XmlCodes, read_xml

_URI_SCHEME_PATTERN = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://(.*)", re.DOTALL)
_PACKAGE_SCHEMES = {"package", "model"}
# Maximum number of parent folders that are searched for a file's package.
MAX_PARENT_FOLDERS = 12
PACKAGE_FILE = "package.xml"
# Folders of a package that contain its robots, beside those of its meshes.
ROBOT_FOLDER_NAMES = {"mjcf", "robot", "robots", "urdf", "xacro", "xml"}
_LEADING_DOTS = re.compile(r"^(?:\.\.?/)+")


class OutsideError(ValueError):
    """Raised for a file outside the project, which was not opened."""

    def __init__(self, message: str, path: Path | None = None) -> None:
        super().__init__(message)
        self.path = path  # of the file; None if the name leads to none

    def hint(self, robot_path: Path) -> str:
        """Return how to let a robot's file refer to the file."""
        if self.path is None:
            return "copy it into the project, and write its path there"
        return outside_hint(robot_path, str(self.path))


@dataclass(frozen=True, slots=True)
class PackageFolders:
    """Folders in which a robot may refer to files."""

    folder: Path  # folder of the file, to which names are relative
    roots: tuple[Path, ...]  # folders that names may lead into
    packages: dict[str, Path]  # folders of the packages that contain the file, by name

    @staticmethod
    def from_file(path: Path, codes: XmlCodes) -> PackageFolders:
        """Return the folders in which a file's references may lie.

        The package that contains a file is part of its project: the parent folder with
        that name, or with it in ``package.xml``, or else the folder that contains
        ``urdf/`` or another folder of robots.
        """
        folder = path.resolve().parent
        packages: dict[str, Path] = {}
        for parent in [folder, *folder.parents][:MAX_PARENT_FOLDERS]:
            if parent == Path(parent.anchor):
                break
            name = _package_name(parent, codes)
            if name:
                packages.setdefault(name, parent)
                break
        roots = [*project_roots(path), *packages.values()]
        is_in_layout = folder.name.lower() in ROBOT_FOLDER_NAMES
        if is_in_layout and not packages and may_be_project(folder.parent):
            roots.append(folder.parent)
        return PackageFolders(folder, tuple(root.resolve() for root in roots), packages)

    def find(self, name: str) -> Path | None:
        """Return the file of a name or URI; None if missing. Raise if it is outside."""
        uri_match = _URI_SCHEME_PATTERN.fullmatch(name)
        if uri_match is None:
            return self._inside_project(self.folder / name, name)
        scheme, uri_path = uri_match[1].lower(), uri_match[2]
        if scheme == "file":
            return self._inside_project(Path("/" + uri_path.lstrip("/")), name)
        if scheme not in _PACKAGE_SCHEMES:
            raise OutsideError(
                f"{scheme}:// is a network address, which is never opened"
            )
        # Some writers add a third slash.
        package, _, relative_path = uri_path.lstrip("/").partition("/")
        candidates = [
            folder for folder in self._candidate_folders(package) if relative_path
        ]
        for folder in candidates:
            path = self._inside_project(folder / relative_path, name)
            if path is not None:
                return path
        if not candidates:
            # A name that leaves one candidate folder leaves all of them.
            self._inside_project(self.folder / package / relative_path, name)
        return None

    def suggest(self, name: str) -> str | None:
        """Return a name that leads to the file that a missing name probably means.

        It has the same path in another package, such as the one of the robot's file,
        or the same name in other letters in the same folder.
        """
        uri_match = _URI_SCHEME_PATTERN.fullmatch(name)
        if uri_match is None:
            relative_path = _LEADING_DOTS.sub("", name)
            for package in self.packages:  # in a folder of another machine
                relative_path = relative_path.rpartition(f"/{package}/")[2]
        elif uri_match[1].lower() in _PACKAGE_SCHEMES:
            relative_path = uri_match[2].lstrip("/").partition("/")[2]
        else:
            return None
        if not relative_path or relative_path.startswith("/"):
            return None
        candidate_names = [
            f"package://{package}/{relative_path}" for package in self.packages
        ]
        for root in self.roots:
            for parent in (self.folder, *self.folder.parents):
                if not parent.is_relative_to(root):
                    break
                if uri_match is None:
                    levels = len(self.folder.relative_to(parent).parts)
                    candidate_names.append("../" * levels + relative_path)
                elif parent.name:
                    candidate_names.append(f"package://{parent.name}/{relative_path}")
        similar_name = self._similar_file(name)
        if similar_name is not None:
            candidate_names.append(similar_name)
        return next(
            (
                candidate
                for candidate in candidate_names
                if self._leads_to_file(candidate)
            ),
            None,
        )

    def _leads_to_file(self, name: str) -> bool:
        try:
            path = self.find(name)
        except OutsideError:
            return False
        return path is not None and path.is_file()

    def _similar_file(self, name: str) -> str | None:
        """Return a name with its last part replaced by that of a similar file."""
        folder_name, _, file_name = name.rpartition("/")
        try:
            folder = self.find(f"{folder_name}/.") if folder_name else self.folder
            if folder is None or not folder.is_dir():
                return None
            files = islice(folder.iterdir(), MAX_SEARCHED_NAMES)
            file_names = sorted(file.name for file in files)
        except (OSError, OutsideError):
            return None
        key = _file_key(file_name)
        similar_name = next(
            (
                file_name_candidate
                for file_name_candidate in file_names
                if _file_key(file_name_candidate) == key
            ),
            None,
        )
        if similar_name is None:
            return None
        return f"{folder_name}/{similar_name}" if folder_name else similar_name

    def _candidate_folders(self, package: str) -> list[Path]:
        """Return the folders that may contain a package."""
        folders = []
        if package in self.packages:
            folders.append(self.packages[package])
        if package in {"", ".", ".."}:
            return folders
        for root in self.roots:
            parents = [self.folder, *self.folder.parents]
            project_folders = [
                parent for parent in parents if parent.is_relative_to(root)
            ]
            folders += [parent for parent in project_folders if parent.name == package]
            folders += [parent / package for parent in project_folders]
        return folders

    def _inside_project(self, path: Path, name: str) -> Path | None:
        try:
            real_path = path.resolve()
        except (OSError, RuntimeError, ValueError) as error:
            raise OutsideError(f"{name!r} leads nowhere: {error}") from error
        if not any(real_path.is_relative_to(root) for root in self.roots):
            roots = " and ".join(f"'{root}'" for root in dict.fromkeys(self.roots))
            raise OutsideError(f"it is outside of {roots}", real_path)
        return real_path if exists(real_path) else None


def _file_key(name: str) -> str:
    """Return a file name in lower case, without hyphens, underscores and blanks."""
    return re.sub(r"[-_ ]", "", name.casefold())


def package_of(name: str) -> str:
    """Return the package in a URI of a file; empty without one.

    >>> package_of("package://arm/meshes/a.stl"), package_of("a.stl")
    ('arm', '')
    """
    uri_match = _URI_SCHEME_PATTERN.fullmatch(name)
    if uri_match is None or uri_match[1].lower() not in _PACKAGE_SCHEMES:
        return ""
    return uri_match[2].lstrip("/").partition("/")[0]


def _package_name(folder: Path, codes: XmlCodes) -> str:
    """Return the ROS package name of a folder; empty if it is not a package."""
    file = folder / PACKAGE_FILE
    if not exists(file):
        return ""
    try:
        root = read_xml(file, codes)
    except AnimtoolError:
        return ""
    names = root.find_all("name") if root.tag == "package" else []
    return names[0].text.strip() if names else ""
