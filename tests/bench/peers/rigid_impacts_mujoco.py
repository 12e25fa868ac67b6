"""What bounces, by MuJoCo. Prints where it was as JSON.

Contacts are damped springs there: stiffness for a contact of eight steps, and the
damping that gives the restitution (`solref` of negative numbers, as its manual has it).
"""

import json
import math
import sys

import mujoco
import numpy as np

LASTS = 8


def spring(e: float, step: float) -> str:
    """Return `solref` of a restitution."""
    rate = math.pi / (LASTS * step)
    ratio = -math.log(e) / math.hypot(math.pi, math.log(e)) if e > 0 else 1.0
    return f"{-(rate**2)!r} {-2 * ratio * rate!r}"


def run(problem: dict) -> dict:
    """Return what happened at each step."""
    kind, step, low = problem["kind"], problem["step"], 0.0
    gravity = 0.0 if kind == "row" else -9.81
    text = (
        f'<mujoco><option gravity="0 {gravity} 0" timestep="{step!r}" cone="elliptic" '
        'integrator="implicitfast"/><default><geom condim="1" solimp="0.99 0.99 0.001" '
        f'solref="{spring(problem["e"], step)}"/></default><worldbody>'
    )
    body = '<body pos="{} {} 0" quat="{}"><freejoint/><geom {} mass="1"/></body>'
    if kind == "row":
        r = problem["radius"]
        for k in range(problem["count"]):
            x = 2 * r * k - (0.5 if k == 0 else 0)
            text += body.format(x, 0.0, "1 0 0 0", f'type="sphere" size="{r}"')
    else:
        text += '<geom type="plane" size="0 0 1" zaxis="0 1 0"/>'
        turn, at, size = "1 0 0 0", 1.5, problem["size"]
        name = problem.get("shape", "box")
        if kind == "tumble":
            turn = "0.1 0.3 0.2 0.9"
        else:
            low = size[0] if name in ("ball", "capsule") else size[1] / 2
            at = low + 1
        geom = {
            "ball": lambda: f'type="sphere" size="{size[0]}"',
            "capsule": lambda: (
                f'type="capsule" size="{size[0]} {size[1] / 2}" zaxis="1 0 0"'
            ),
        }.get(name, lambda: f'type="box" size="{" ".join(str(s / 2) for s in size)}"')
        text += body.format(0.0, at, turn, geom())
    model = mujoco.MjModel.from_xml_string(text + "</worldbody></mujoco>")
    data = mujoco.MjData(model)
    if kind == "row":
        data.qvel[0] = 2.0
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    seconds = problem.get("seconds", 3.0 if kind == "tumble" else 0.8)
    found: dict = {"times": [], "heights": [], "energy": [], "spins": []}
    mujoco.mj_forward(model, data)
    for k in range(math.floor(seconds / step)):
        found["times"].append(k * step)
        found["heights"].append(float(data.xpos[1, 1]) - low)
        found["energy"].append(float(data.energy.sum()))
        found["spins"].append(float(np.linalg.norm(data.qvel[3:6])))
        mujoco.mj_step(model, data)
    found["velocities"] = data.qvel.reshape(-1, 6)[:, 0].tolist()
    return found


if __name__ == "__main__":
    paths = [run(problem) for problem in json.loads(sys.argv[1])]
    print("\n" + json.dumps({"paths": paths}), flush=True)
