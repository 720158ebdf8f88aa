"""The leaf pack in MuJoCo: same duty as `benches/leaf_pack.rs`, one thread, its own time printed as JSON.

Each leaf is two chains of capsules joined by hinges whose springs are the beam (E I / segment), one from either side of the
clamp. The clamp is driven along the load by a stiff position actuator; the eyes slide on their rail. A sphere at the end of
each segment touches the segment of the leaf above: 56 named pairs and no search, friction 0.3, elliptic cone, impratio 1000:
at the default the static loop creeps away.
"""
import json
import math
import sys
import time

import mujoco
import numpy as np

LEAVES = [(880.0, 1168.0), (920.0, 1035.0), (660.0, 835.0), (400.0, 790.0)]  # length, radius in mm (Table 1)
THICKNESS, WIDTH, E, CLAMP, MU = 6.15e-3, 50e-3, 207e9, 100e-3, 0.3
SEGMENTS = [5, 4, 5]  # of a side between the ends of neighbouring leaves: 84 in all


def stations(count):
    """Arc lengths from the middle, outside of the clamp, with how many leaves reach each piece."""
    halves = [min(l for l, _ in LEAVES[: i + 1]) / 2e3 for i in range(len(LEAVES))]
    ends = sorted(set(halves))
    pieces, at = [], CLAMP / 2
    for end, n in zip(ends, count):
        pieces += [(at + (end - at) * k / n, at + (end - at) * (k + 1) / n) for k in range(n)]
        at = end
    return halves, pieces


def chain(side, leaf, halves, pieces, dt):
    """Bodies of one side of one leaf: segments between hinges, the free arc in the springs' rest angles."""
    radius = LEAVES[leaf][1] * 1e-3
    inertia = WIDTH * THICKNESS**3 / 12
    # MuJoCo steps springs explicitly: without added inertia of the joints, 2e-3 kg m2 at 0.5 ms, they blow up.
    armature = 2e-3 * (dt / 5e-4) ** 2
    own = [p for p in pieces if p[1] <= halves[leaf] + 1e-9]
    xml, close, length = "", "", 0.0
    for k, (a, b) in enumerate(own):
        size = b - a
        # Half of the segment before and half of this one bend at the hinge.
        bends = (length + size) / 2 if k else size / 2
        rest = bends / radius
        stiffness = E * inertia / bends
        pos = f"{side * length} 0 0" if k else f"{side * CLAMP / 2} 0 {-leaf * THICKNESS}"
        mass = 7850 * THICKNESS * WIDTH * size
        xml += (
            f'<body name="b{side}_{leaf}_{k}" pos="{pos}"><joint type="hinge" axis="0 {-side} 0" stiffness="{stiffness}"'
            f' springref="{math.degrees(rest)}" armature="{armature}" damping="0.02"/>'
            # A little longer than the segment: the sphere below slides along it.
            f'<geom name="g{side}_{leaf}_{k}" type="capsule" fromto="{-side * 4e-3} 0 0 {side * (size + 4e-3)} 0 0"'
            f' size="{THICKNESS / 2}" mass="{mass}" contype="0" conaffinity="0"/>'
        )
        if leaf > 0:
            xml += (
                f'<geom name="s{side}_{leaf}_{k}" type="sphere" pos="{side * size} 0 0" size="{THICKNESS / 2}" mass="0"'
                f' contype="0" conaffinity="0"/>'
            )
            PAIRS.append(
                f'<pair geom1="g{side}_{leaf - 1}_{k}" geom2="s{side}_{leaf}_{k}" condim="3"'
                f' friction="{MU} {MU} 0 0 0" solref="{{solref}} 1"/>'
            )
        if leaf == 0 and k == len(own) - 1:
            xml += f'<site name="eye{side}" pos="{side * size} 0 0" size="0.003"/>'
        close += "</body>"
        length = size
    return xml + close


PAIRS = []


def model(dt):
    PAIRS.clear()
    halves, pieces = stations(SEGMENTS)
    chains = "".join(chain(side, leaf, halves, pieces, dt) for side in (1, -1) for leaf in range(len(LEAVES)))
    # The eyes' rail: a slide that carries each eye, pinned to it.
    rails = "".join(
        f'<body name="rail{s}" pos="{s * EYE_X} 0 {EYE_Z}"><joint type="slide" axis="1 0 0"/>'
        f'<geom type="sphere" size="0.004" mass="0.5" contype="0" conaffinity="0"/></body>'
        for s in (1, -1)
    )
    pins = "".join(f'<connect site1="eye{s}" site2="pin{s}" solref="0.004 1"/>' for s in (1, -1))
    rails = rails.replace("</body>", "{}</body>")
    rails = rails.format(*(f'<site name="pin{s}" size="0.003"/>' for s in (1, -1)))
    return f"""<mujoco><option timestep="{dt}" gravity="0 0 0" cone="elliptic" impratio="1000" integrator="implicitfast"
 solver="Newton" tolerance="1e-8" iterations="100"/>
 <worldbody><body name="clamp" pos="0 0 0"><joint name="push" type="slide" axis="0 0 1" armature="8"/>
 <geom type="box" size="0.01 0.02 0.002" mass="3" contype="0" conaffinity="0"/>{chains}</body>{rails}</worldbody>
 <equality>{pins}</equality>
 <contact>{"".join(PAIRS).format(solref=max(2e-3, 3 * dt))}</contact>
 <actuator><position name="drive" joint="push" kp="1e7" kv="1.5e4"/></actuator></mujoco>"""


def run(dt, displacement_mm, duration_s, from_s):
    """Force and loop energy from `from_s` on, and the thread's own time of the whole."""
    m = mujoco.MjModel.from_xml_string(model(dt))
    d = mujoco.MjData(m)
    # Assembly: the springs pull the leaves together, the eyes settle on their rail. First touch of the pusher is where the
    # pack asks for no force, found with some 75 N/mm.
    zero_mm = 0.0
    for _ in range(4):
        d.ctrl[0] = 1e-3 * zero_mm
        for _ in range(int(0.5 / dt)):
            mujoco.mj_step(m, d)
        zero_mm -= d.actuator_force[0] / 75
    steps = int(round(duration_s / dt))
    x, f = np.zeros(steps), np.zeros(steps)
    start = time.thread_time()
    for k in range(steps):
        d.ctrl[0] = 1e-3 * (zero_mm + displacement_mm((k + 1) * dt))
        mujoco.mj_step(m, d)
        x[k], f[k] = d.qpos[0] * 1e3, d.actuator_force[0]
    took = time.thread_time() - start
    part = slice(int(round(from_s / dt)), None)
    energy = float(np.sum(0.5e-3 * (f[part][1:] + f[part][:-1]) * np.diff(x[part])))
    return {"us_per_step": 1e6 * took / steps, "real_time_factor": duration_s / took,
            "peak_n": float(f[part].max()), "loop_j": energy, "wall_s": took, "contacts": int(d.ncon), "zero_mm": zero_mm, "iterations": int(d.solver_niter[0]), "dt_s": dt}


def straight_eye():
    """Where the eyes of the assembled pack lie: from the arc of the first leaf (the pack's own rest is close to it)."""
    radius = 1.05
    angle = (min(l for l, _ in LEAVES[:1]) / 2e3 - CLAMP / 2) / radius
    return CLAMP / 2 + radius * math.sin(angle), radius * (1 - math.cos(angle))


EYE_X, EYE_Z = straight_eye()

if __name__ == "__main__":
    dt = float(sys.argv[1]) if len(sys.argv) > 1 else 1e-3
    sine = run(dt, lambda t: 5 - 3 * math.cos(2 * math.pi * (t - 0.5)) if t > 0.5 else 4 * t, 2.5, 1.5)
    rows = {"tool": "mujoco " + mujoco.__version__, "sine": sine}
    if "--static" in sys.argv:
        rows["static"] = run(dt, lambda t: 26 * (1 - abs(1 - t / 60)), 120.0, 0.0)
    print(json.dumps(rows))
