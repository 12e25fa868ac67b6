"""A folder with the files that examples of pages of codes refer to."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

__all__ = ["CAPTURE", "HOPS", "make_stage"]

WALKER = """\
rig: animtool/1
name: walker
joints:
- {name: hips, type: free, translate: [0, 1, 0]}
- {name: foot_l, parent: hips, type: free, translate: [0, -1, 0]}
"""
PUPPET = """\
rig: animtool/1
name: puppet
joints:
- {name: elbow, type: pin, axis: [0, 0, 1], limits: [0, 140]}
- {name: twin, type: pin, axis: [0, 0, 1], limits: [0, 140], mimic: {joint: elbow}}
controls:
- {name: curl, range: [0, 1], drives: [{joint: elbow.angle, expr: curl * 90}]}
"""
HERO = """\
rig: animtool/1
name: hero
joints:
- {name: hips, type: free, translate: [0, 1, 0]}
- {name: chest, parent: hips, type: ball, translate: [0, 0.4, 0]}
- {name: shoulder_l, parent: chest, type: ball, translate: [0.2, 0, 0],
   mirror: shoulder_r}
- {name: elbow_l, parent: shoulder_l, type: pin, axis: [0, 1, 0],
   translate: [0.3, 0, 0], limits: [-150, 0], mirror: elbow_r}
- {name: wrist_l, parent: elbow_l, type: ball, translate: [0.25, 0, 0],
   mirror: wrist_r}
ik:
- {name: arm_l, root: shoulder_l, tip: wrist_l, pole_dir: [0, 0, -1]}
- {name: arm_r, root: shoulder_r, tip: wrist_r, pole_dir: [0, 0, -1]}
"""
# Both arms swing once in 24 frames; the hips go straight on.
WALK = """\
clip: animtool/1
rig: hero.rig.yaml
fps: 24
range: [1, 49]
channels:
- {target: joint/hips.translation,
   keys: [{t: 1, v: [0, 0, 0]}, {t: 49, v: [0, 0, 2]}]}
- {target: joint/elbow_l.angle, post: cycle,
   keys: [{t: 1, v: -20}, {t: 13, v: -60}, {t: 25, v: -20}]}
- {target: joint/elbow_r.angle, post: cycle,
   keys: [{t: 1, v: -60}, {t: 13, v: -20}, {t: 25, v: -60}]}
"""
WAVE = """\
clip: animtool/1
rig: hero.rig.yaml
fps: 24
channels:
- {target: joint/elbow_l.angle, keys: [{t: 1, v: 0}, {t: 24, v: -90}]}
"""
CURL = """\
clip: animtool/1
rig: puppet.rig.yaml
fps: 24
channels:
- {target: control/curl, keys: [{t: 1, v: 0}, {t: 24, v: 1}]}
"""
REACH = """\
targets: animtool/1
goals:
- {effector: arm_l, position: [0.4, 1.4, 0.2]}
"""
MOVING = """\
targets: animtool/1
fps: 24
goals:
- effector: arm_l
  position: {keys: [{t: 1, v: [0.4, 1.4, 0.2]}, {t: 24, v: [0.4, 1.5, 0.2]}]}
"""
TURN = """\
targets: animtool/1
goals:
- {effector: arm_l, orientation: [1, 0, 0, 0]}
"""
PROP = """\
#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Y"
)

def Xform "World"
{
    def Xform "box"
    {
        double3 xformOp:translate = (0.4, 1.4, 0.2)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
"""
CAPTURE = """\
HIERARCHY
ROOT hips
{
  OFFSET 0 0 0
  CHANNELS 3 Zrotation Xrotation Yrotation
  JOINT leg.l
  {
    OFFSET 10 0 0
    CHANNELS 0
    End Site
    {
      OFFSET 0 -10 0
    }
  }
  JOINT leg.r
  {
    OFFSET -10 0 0
    CHANNELS 0
    End Site
    {
      OFFSET 0 -10 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0 0 0
0 0 5
"""
# Both legs swing, one forward, one back.
HOPS = """\
HIERARCHY
ROOT hips
{
  OFFSET 0 0 0
  CHANNELS 1 Xrotation
  JOINT leg_l
  {
    OFFSET 10 0 0
    CHANNELS 2 Yposition Xrotation
    End Site
    {
      OFFSET 0 -10 0
    }
  }
  JOINT leg_r
  {
    OFFSET -10 0 0
    CHANNELS 1 Xrotation
    End Site
    {
      OFFSET 0 -10 0
    }
  }
}
MOTION
Frames: 8
Frame Time: 0.0333333
0 0 0 0
2 0 5 -5
4 0 10 -10
6 0 15 -15
8 0 20 -20
10 0 25 -25
12 0 30 -30
14 0 35 -35
"""
OTHER = """\
scene: animtool/1
source: {file: wave.clip.yaml}
output: {file: other.usda}
"""
# Brings the clip to the targets of an example.
SOLVED = """\
scene: animtool/1
source: {file: wave.clip.yaml}
passes: [{ik: {targets: page.targets.yaml}}]
"""
BASE = "rig: animtool/1\nname: base\njoints: [{name: hips, type: free}]\n"
PROPS = """\
#usda 1.0
(
    startTimeCode = 1001
    endTimeCode = 1096
    timeCodesPerSecond = 24
)
def Xform "ball"
{
    double3 xformOp:translate.timeSamples = {1001: (0, 0, 0), 1096: (0, 0, 4)}
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
FILES = {
    "props.usda": PROPS,
    "base.rig.yaml": BASE,
    "walker.rig.yaml": WALKER,
    "puppet.rig.yaml": PUPPET,
    "hero.rig.yaml": HERO,
    "walk.clip.yaml": WALK,
    "wave.clip.yaml": WAVE,
    "curl.clip.yaml": CURL,
    "reach.targets.yaml": REACH,
    "moving.targets.yaml": MOVING,
    "turn.targets.yaml": TURN,
    "other.scene.yaml": OTHER,
    "solved.scene.yaml": SOLVED,
    "walk.scene.yaml": "scene: animtool/1\nsource: {file: walk.bvh}\n",
    "body.usda": "#usda 1.0\n",
    "prop.usda": PROP,
    "walk.bvh": CAPTURE,
    "takes/walk.bvh": CAPTURE,
    "still.bvh": CAPTURE.replace("0 0 5", "0 0 0"),
    "dog.bvh": re.sub("hips|leg", "paw", CAPTURE),
}


def make_stage(folder: Path) -> None:
    """Write the files into a folder."""
    (folder / "takes").mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text, "utf-8")
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    ninth = np.full((4, 9), 1 / 9)
    eighth = np.tile([0.125] * 8 + [0.0], (4, 1))
    np.savez(
        folder / "body.npz",
        points=points,
        large=points * 100,
        holed=points * [1, np.nan, 1],
        normals=points,
        short=points[:3],
        faces=np.array([[0, 1, 2, 3]]),
        objects=np.array([{}], object),
        indices=np.array([[0, 1]] * 4),
        weights=np.full((4, 2), 0.5),
        loose=np.full((4, 2), 0.45),
        rounded=np.full((4, 2), 128 / 255),
        nine=np.tile(np.arange(9), (4, 1)),
        ninth=ninth,
        eighth=eighth,
        smile=points,
        half=points / 2,
        still=points * 0,
    )
    along, around = np.repeat(np.linspace(0.3, 2.3, 3), 4), np.arange(12) * np.pi / 2
    arm = np.stack([along, 0.1 * np.cos(around), 0.1 * np.sin(around)], axis=1)
    np.savez(
        folder / "arm.npz",
        points=arm,
        faces=np.array([[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10, 11]]),
        indices=np.repeat(np.arange(3), 4)[:, None],
        weights=np.ones((12, 1)),
    )
    places = np.linspace([0.4, 1.4, 0.2], [0.5, 1.5, 0.3], 49)
    np.savez(folder / "hands.npz", left=places[:24], short=places[:23], long=places)
