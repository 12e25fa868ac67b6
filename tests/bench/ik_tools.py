"""The tools that `ik.py` compares, each in a process of its own, and what they take."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from ik_problems import Array, Case
from ik_serve import Asked
from measuring import HERE

OWN, SINGLE = "animtool", "animtool, a call each"
TOOLBOX, TRAC, MINK, PINK = "roboticstoolbox", "TRAC-IK", "mink", "Pink"
BLENDER = "Blender"
# The success of the data, limits included; hard problems count lengths in chains.
NEAR = Asked(1e-4, 1e-3, 50, 1.0)
TRAC_SECONDS = 0.02


@dataclass
class Tool:
    """A tool's process, and what it can be asked.

    Attributes:
        name: In the tables.
        command: Starts it.
        trees: Takes models of any shape and goals of a part; else chains to one pose.
        balls: Keeps limits of ball joints.
        aims: Takes goals to aim.
        places: How near its kinematics are to the data's own [m], in matrices too.
        finest: The least tolerance that its numbers allow.
        seconds: Most time for one problem [s].
    """

    name: str
    command: list[str]
    trees: bool = True
    balls: bool = False
    aims: bool = False
    places: float = 1e-9
    finest: float = 0.0
    seconds: float = NEAR.seconds
    jobs: IO[str] = field(init=False, repr=False)
    answers: IO[str] = field(init=False, repr=False)

    def takes(self, case: Case, asked: Asked) -> bool:
        """Return whether it can be asked this."""
        if asked.position < self.finest or asked.angle < self.finest:
            return False
        if "aim" in case.targets and not self.aims:
            return False
        if not self.balls and any(
            joint["type"] == "ball" and joint.get("limits") for joint in case.joints
        ):
            return False
        pose = len(case.effectors) == 1 and set(case.targets) == {"pos", "rot"}
        return self.trees or pose

    def ask(self, file: Path, folder: Path, **job: Any) -> dict[str, Array]:
        """Return the arrays that answer a job."""
        out = folder / "answer.npz"
        job |= {"file": str(file), "out": str(out)}
        try:
            self.jobs.write(json.dumps(job) + "\n")
            self.jobs.flush()
            line = self.answers.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            sys.exit(f"{self.name} ended; what it said is above")
        with np.load(out) as arrays:
            return dict(arrays)


@contextmanager
def started(tool: Tool) -> Iterator[Tool]:
    """Run a tool's process."""
    paths = os.pathsep.join([str(HERE), str(HERE.parent)])
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    pipe = subprocess.PIPE
    environment = os.environ | threads | {"PYTHONPATH": paths}
    command = tool.command
    with subprocess.Popen(
        command, stdin=pipe, stdout=pipe, text=True, env=environment
    ) as process:
        assert process.stdin
        assert process.stdout
        tool.jobs, tool.answers = process.stdin, process.stdout
        yield tool


def tools(peer_python: str | None, bpy_python: str | None) -> list[Tool]:
    """Return the tools; those of others only with an interpreter that has them."""
    folder = HERE / "peers"
    own = [sys.executable, str(folder / "ik_animtool.py")]
    made = [Tool(OWN, own, balls=True, aims=True), Tool(SINGLE, [*own, "single"])]
    others = {TOOLBOX: "toolbox", TRAC: "trac", MINK: "mink", PINK: "pink"}
    if peer_python is None:
        print(f"  {', '.join(others)} skipped: no --peer-python", file=sys.stderr)
    else:
        for name, script in others.items():
            command = [peer_python, str(folder / f"ik_{script}.py")]
            # TRAC-IK ends by time alone.
            seconds = TRAC_SECONDS if name == TRAC else NEAR.seconds
            trees = name in (MINK, PINK)
            made.append(Tool(name, command, trees=trees, seconds=seconds))
    if bpy_python is None:
        print("  Blender skipped: no --bpy-python", file=sys.stderr)
    else:
        command = [bpy_python, str(folder / "ik_blender.py")]
        # Its poses are float32.
        made.append(Tool(BLENDER, command, trees=False, places=1e-5, finest=1e-5))
    return made
