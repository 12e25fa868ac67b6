"""Springs in MuJoCo: the edges of flexes, one a family, which share their bodies."""

import mujoco
import numpy as np
from springs_given import given, measure

AXES = ("1 0 0", "0 1 0", "0 0 1")

asked = given()
body = asked.body
free = body["inverse_masses"] > 0


def numbers(values: np.ndarray) -> str:
    """Return them as an attribute."""
    return " ".join(repr(value) for value in np.ravel(values).tolist())


def point(n: int) -> str:
    """Return the body of a particle."""
    joints = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in AXES)
    place, mass = numbers(body["positions"][n]), numbers(body["masses"][n])
    inertia = f'pos="0 0 0" mass="{mass}" diaginertia="1e-6 1e-6 1e-6"'
    return (
        f'<body name="p{n}" pos="{place}"><inertial {inertia}/>'
        f"{joints if free[n] else ''}</body>"
    )


def flex(stiffness: float, damping: float) -> str:
    """Return the springs of a family: where edges are at rest is where they start."""
    mine = (body["stiffness"] == stiffness) & (body["damping"] == damping)
    names = " ".join(f"p{n}" for n in range(len(free)))
    return (
        f'<flex name="k{stiffness!r}" dim="1" radius="1e-4" body="{names}" '
        f'element="{numbers(body["ends"][mine])}">'
        f'<contact selfcollide="none" contype="0" conaffinity="0"/>'
        f'<edge stiffness="{stiffness!r}" damping="{damping!r}"/></flex>'
    )


families = np.unique(np.stack([body["stiffness"], body["damping"]], 1), axis=0)
model = mujoco.MjModel.from_xml_string(
    f'<mujoco><option timestep="{1 / asked.rate!r}" integrator="implicitfast" '
    'gravity="0 0 -9.81"><flag contact="disable" constraint="disable"/></option>'
    f"<worldbody>{''.join(point(n) for n in range(len(free)))}</worldbody><deformable>"
    f"{''.join(flex(*family) for family in families.tolist())}"
    "</deformable></mujoco>"
)
# The compiler takes no damping of joints below a flex.
model.dof_damping[:] = float(body["drag"]) * np.repeat(body["masses"][free], 3)
data = mujoco.MjData(model)


def run(count: int) -> list[np.ndarray]:
    """Return positions at frames."""
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    found = [data.xpos[1:].copy()]
    for _ in range(count):
        mujoco.mj_step(model, data, asked.steps)
        # Steps leave what is made of coordinates one behind.
        mujoco.mj_kinematics(model, data)
        found.append(data.xpos[1:].copy())
    return found


run(1)
measure(asked, lambda: run(asked.frames))
