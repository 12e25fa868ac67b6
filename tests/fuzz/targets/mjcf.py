"""MJCF files: elements, attributes and bytes spoiled; MuJoCo compiles what is left."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from animtool.formats.mjcf.read import read_mjcf
from animtool.formats.robots.xml import XmlElement, parse_xml
from fuzz.characters import outcome
from fuzz.mutations import pick, spoil
from fuzz.targets.urdf import CODES, text_of, watch

ABOUT = "MJCF, read by MuJoCo; what is outside of the project is never opened"

_MODEL = """\
<mujoco model="arm">
  <compiler angle="radian" autolimits="true" meshdir="."/>
  <default><joint damping="1"/><default class="thick"><geom size="0.1"/></default>
    </default>
  <asset><mesh name="m" file="part.obj"/></asset>
  <worldbody>
    <include file="part.xml"/>
    <body name="a" pos="0.1 0.2 0.3" euler="0.3 0.1 0.2" childclass="thick">
      <joint name="one" axis="1 2 0" pos="0.1 0 0" range="-1 1"/>
      <joint name="push" type="slide" axis="0 1 1" ref="-0.2"/>
      <geom fromto="0 0 0 0 0 1" type="capsule"/>
      <body name="b" quat="1 0 1 0"><joint type="ball" pos="0 0 0.1"/><geom/>
        <body name="c" axisangle="0 1 0 1"><joint name="c" axis="1 0 0"/>
          <geom type="mesh" mesh="m"/><inertial pos="0 0 0" mass="1"
          diaginertia="1 1 1"/><site name="tip" pos="0 0 0.5"/></body></body>
    </body>
    <body name="free" pos="1 0 0" xyaxes="0 1 0 -1 0 0"><freejoint name="float"/>
      <geom class="thick" type="box" size="1 2 3"/></body>
  </worldbody>
  <equality><joint joint1="c" joint2="one" polycoef="0.1 2 0 0 0"/></equality>
  <actuator><motor joint="one"/></actuator>
</mujoco>
"""
_PART = (
    '<mujocoinclude><body name="p"><joint name="q"/><geom size="1"/></body>'
    "</mujocoinclude>"
)
_VALUES = (
    *("", " ", "0", "1", "-1", "0 0 0", "1 0 0", "0 0 1e-320", "nan 0 0", "inf"),
    *("1e308", "-1e300", "1e999", "a", "one", "c", "ball", "free", "slide", "hinge"),
    *("mesh", "box", "true", "false", "auto", "thick", "part.xml", "arm.xml"),
    *("../secret.obj", "/etc/passwd", "99999999999", "é", "\x7f", "zyx", "degree"),
    *("0 0 0 0", "a" * 3000),
)
_TAGS = (
    *("body", "joint", "freejoint", "geom", "site", "inertial", "frame", "replicate"),
    *("attach", "composite", "flexcomp", "camera", "plugin", "include", "default"),
    *("equality", "compiler", "worldbody", "x", "mesh", "key", "tendon"),
)


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    pytest.importorskip("mujoco")
    inside = folder / "inside"
    inside.mkdir(exist_ok=True)
    opened = watch(folder)

    def run(rng: np.random.Generator) -> str:
        path = inside / "arm.xml"
        path.write_bytes(_spoiled(rng, _MODEL))
        part = _PART.encode() if rng.random() < 0.7 else _spoiled(rng, _PART)
        (inside / "part.xml").write_bytes(part)
        found = outcome(rng, path, read_mjcf)
        assert not opened, opened
        return found

    return run


def _spoiled(rng: np.random.Generator, text: str) -> bytes:
    """Return a model that is spoiled in its elements, its bytes, or both."""
    how = rng.random()
    if how < 0.85:
        root = parse_xml(text.encode(), Path("arm"), CODES)
        for _ in range(int(rng.geometric(0.6))):
            _spoil(rng, list(root.walk()))
        text = text_of(root)
    content = text.encode()
    return content if how < 0.75 else spoil(rng, content)


def _spoil(rng: np.random.Generator, elements: list[XmlElement]) -> None:
    """Change, drop, double or add an element, or one of its attributes."""
    one = elements[int(rng.integers(len(elements)))]
    match int(rng.integers(6)):
        case 0 if one.children:
            del one.children[int(rng.integers(len(one.children)))]
        case 1 if one.children:
            one.children.append(one.children[int(rng.integers(len(one.children)))])
        case 2:
            tag = _TAGS[int(rng.integers(len(_TAGS)))]
            made = {"name": "x", "file": pick(rng, list(_VALUES)), "pos": "0 0 1"}
            kept = {k: v for k, v in made.items() if rng.random() < 0.5}
            one.children.append(XmlElement(tag, kept, one.path, 1, 1))
        case 3:
            one.tag = _TAGS[int(rng.integers(len(_TAGS)))]
        case _ if one.attributes:
            names = sorted(one.attributes)
            name = names[int(rng.integers(len(names)))]
            one.attributes[name] = pick(rng, list(_VALUES))
