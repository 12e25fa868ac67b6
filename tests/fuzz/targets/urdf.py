"""URDF files: elements, attributes and bytes spoiled, entities and paths put in."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from support.robots import ARM, random_robot

from animtool.core.errors import FormatError
from animtool.formats.robots.xml import XmlCodes, XmlElement, parse_xml
from animtool.formats.urdf.read import read_urdf
from fuzz.characters import outcome
from fuzz.mutations import pick, spoil

ABOUT = "URDF, read; what is outside of the project is never opened"

CODES = XmlCodes("X", "X", "X")
_SECRET = "secret.obj"
_VALUES = (
    *(
        "",
        " ",
        "0",
        "1",
        "-1",
        "0 0 0",
        "1 0 0",
        "0 0 1e-320",
        "nan 0 0",
        "inf",
        "1e999",
    ),
    *("1e308 1e308 1e308", "-1e9", "0x10", "1_0", "1,5 0 0", "a", "j1", "base", "tool"),
    *("revolute", "continuous", "prismatic", "fixed", "floating", "planar", "ball"),
    *("part.obj", "part.stl", "package://inside/part.stl", "part.dae", "0.1 -1 1"),
    *("package://robot/../../secret.obj", "../secret.obj", "../../secret.obj"),
    *("file:///etc/passwd", "/etc/passwd", "http://localhost/a.obj", "package://"),
    *("package://../secret.obj", "\x7f", "é", "${x}", "$(find x)", "&amp;", "a" * 5000),
)
_TAGS = (
    *("link", "joint", "origin", "axis", "limit", "mimic", "parent", "child", "mesh"),
    *(
        "inertial",
        "mass",
        "inertia",
        "collision",
        "visual",
        "geometry",
        "box",
        "sphere",
    ),
    *("cylinder", "transmission", "gazebo", "xacro:macro", "material", "robot", "x"),
)
_DTDS = (
    '<!DOCTYPE robot [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>',
    '<!DOCTYPE robot SYSTEM "../secret.obj">',
    '<!DOCTYPE robot [<!ENTITY x SYSTEM "../secret.obj">]>',
    '<!DOCTYPE robot [<!ENTITY % p SYSTEM "../secret.obj"> %p;]>',
)
_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
_MESHES = {
    "part.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1/1/1 2 4 -2\nf 1 2 3\n",
    "part.stl": bytes(80)
    + (2).to_bytes(4, "little")
    + 2 * (bytes(12) + _CORNERS.tobytes() + bytes(2)),
}
_opened: list[str] = []


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    """Record what of the secrets is opened, by whoever does it."""
    if event == "open" and isinstance(arguments[0], str | bytes):
        name = str(arguments[0])
        if _SECRET in name or "passwd" in name:
            _opened.append(name)
    elif event in {"socket.connect", "socket.getaddrinfo"}:
        _opened.append(event)


def watch(folder: Path) -> list[str]:
    """Put a secret into a folder; return what of it, and of others, will be opened."""
    (folder / _SECRET).write_text("v 0 0 0\n")
    sys.addaudithook(_watch)
    return _opened


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    inside = folder / "inside"
    inside.mkdir(exist_ok=True)
    watch(folder)

    def run(rng: np.random.Generator) -> str:
        path = inside / "robot.urdf"
        path.write_bytes(_spoiled(rng))
        for name, content in _MESHES.items():
            whole = rng.random() < 0.5
            (inside / name).write_bytes(content if whole else spoil(rng, content))
        found = outcome(rng, path, read_urdf)
        assert not _opened, _opened
        return found

    return run


def _spoiled(rng: np.random.Generator) -> bytes:
    """Return a robot that is spoiled in its elements, its bytes, or both."""
    shown = '<visual><geometry><mesh filename="{}" scale="1 2 3"/></geometry></visual>'
    meshes = "".join(map(shown.format, _MESHES))
    text = ARM.replace('<link name="tool"/>', f'<link name="tool">{meshes}</link>')
    if rng.random() < 0.7:
        text = random_robot(rng, int(rng.integers(1, 12))).text
    how = rng.random()
    if how < 0.75:
        root = parse_xml(text.encode(), Path("robot"), CODES)
        for _ in range(int(rng.geometric(0.5))):
            _spoil(rng, list(root.walk()))
        text = text_of(root)
    if rng.random() < 0.05:
        text = pick(rng, list(_DTDS)) + text.partition("?>")[2].replace("é", "&b;")
    content = text.encode()
    try:
        return content if how < 0.65 else spoil(rng, content)
    except FormatError:
        return content


def _spoil(rng: np.random.Generator, elements: list[XmlElement]) -> None:
    """Change, drop, double or move an element, or one of its attributes."""
    one = elements[int(rng.integers(len(elements)))]
    other = elements[int(rng.integers(len(elements)))]
    match int(rng.integers(7)):
        case 0 if one.children:
            del one.children[int(rng.integers(len(one.children)))]
        case 1 if one.children:
            one.children.append(one.children[int(rng.integers(len(one.children)))])
        case 2:
            tag = _TAGS[int(rng.integers(len(_TAGS)))]
            made = {"name": "x", "filename": pick(rng, list(_VALUES)), "xyz": "0 0 1"}
            one.children.append(XmlElement(tag, made, one.path, 1, 1))
        case 3 if other not in one.walk() and one not in other.walk():
            one.children.append(other)
        case 4:
            one.tag = _TAGS[int(rng.integers(len(_TAGS)))]
        case _ if one.attributes:
            names = sorted(one.attributes)
            name = names[int(rng.integers(len(names)))]
            donor = sorted(other.attributes)
            if rng.random() < 0.2:
                del one.attributes[name]
            elif donor and rng.random() < 0.4:
                value = other.attributes[donor[int(rng.integers(len(donor)))]]
                one.attributes[name] = value
            else:
                one.attributes[name] = pick(rng, list(_VALUES))


def text_of(root: XmlElement) -> str:
    """Return a tree as XML."""
    inner = "".join(text_of(child) for child in root.children)
    given = "".join(f" {k}={quoteattr(v)}" for k, v in root.attributes.items())
    return f"<{root.tag}{given}>{inner}</{root.tag}>\n"
