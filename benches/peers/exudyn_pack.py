"""The leaf pack in Exudyn: same duty as `benches/leaf_pack.rs`, one thread, its own time printed as JSON.

Each leaf is two chains of ANCF cable elements, one from either side of the clamp, with the free arc as reference curvature.
All start as concentric arcs without overlap, held at the clamp; the eyes slide on their rails, which are led against the
clamp. A circle near the end of each element touches the element of the leaf above: 56 contacts with bristle friction 0.3.
"""
import json
import math
import sys
import time

import exudyn as exu
import numpy as np
from exudyn.itemInterface import *

LEAVES = [(880.0, 1168.0), (920.0, 1035.0), (660.0, 835.0), (400.0, 790.0)]  # length, radius in mm (Table 1)
THICKNESS, WIDTH, E, CLAMP, MU, DENSITY = 6.15e-3, 50e-3, 207e9, 100e-3, 0.3, 7850.0
SEGMENTS = [5, 4, 5]  # of a side between the ends of neighbouring leaves: 84 in all
START_RADIUS = 1.1
CONTACT, DRIVE = 1e7, 1e7  # N/m


def pieces():
    """Arc lengths from the middle, outside of the clamp."""
    halves = [min(l for l, _ in LEAVES[: i + 1]) / 2e3 for i in range(len(LEAVES))]
    out, at = [], CLAMP / 2
    for end, n in zip(sorted(set(halves)), SEGMENTS):
        out += [(at + (end - at) * k / n, at + (end - at) * (k + 1) / n) for k in range(n)]
        at = end
    return halves, out


def build():
    system = exu.SystemContainer()
    mbs = system.AddSystem()
    ground = mbs.AddMarker(MarkerNodeCoordinate(nodeNumber=mbs.AddNode(NodePointGround()), coordinate=0))
    halves, own = pieces()
    area, inertia = WIDTH * THICKNESS, WIDTH * THICKNESS**3 / 12
    drives, eyes = [], []
    for side in (1, -1):
        above = None
        for leaf, (_, free_mm) in enumerate(LEAVES):
            radius = START_RADIUS + leaf * THICKNESS

            def node(arc):
                # Neighbouring leaves keep their stations on one radius.
                angle = (arc - CLAMP / 2) / START_RADIUS
                x = CLAMP / 2 + radius * math.sin(angle)
                y = START_RADIUS - radius * math.cos(angle)
                return mbs.AddNode(
                    NodePoint2DSlope1(referenceCoordinates=[side * x, y, math.cos(angle), side * math.sin(angle)])
                )

            at = node(own[0][0])
            for k in range(4):
                mbs.AddObject(
                    ObjectConnectorCoordinate(
                        markerNumbers=[ground, mbs.AddMarker(MarkerNodeCoordinate(nodeNumber=at, coordinate=k))]
                    )
                )
            cables = []
            for a, b in [p for p in own if p[1] <= halves[leaf] + 1e-9]:
                following = node(b)
                # Elements run with x on either side: the curvature is positive towards the eyes.
                ends = [at, following] if side > 0 else [following, at]
                cables.append(
                    mbs.AddObject(
                        ObjectANCFCable2D(
                            length=(b - a) * radius / START_RADIUS,
                            massPerLength=DENSITY * area,
                            bendingStiffness=E * inertia,
                            axialStiffness=E * area,
                            bendingDamping=1e-3 * E * inertia,
                            referenceCurvature=1e3 / free_mm,
                            nodeNumbers=ends,
                            useReducedOrderIntegration=1,
                        )
                    )
                )
                at = following
            if above is not None:
                for upper, lower in zip(above, cables):
                    length = mbs.GetObjectParameter(lower, "length")
                    circle = mbs.AddMarker(
                        MarkerBodyRigid(bodyNumber=lower, localPosition=[(0.9 if side > 0 else 0.1) * length, 0, 0])
                    )
                    shape = mbs.AddMarker(MarkerBodyCable2DShape(bodyNumber=upper, numberOfSegments=1))
                    data = mbs.AddNode(NodeGenericData(initialCoordinates=[1, 0, 0], numberOfDataCoordinates=3))
                    mbs.AddObject(
                        ObjectContactFrictionCircleCable2D(
                            markerNumbers=[circle, shape],
                            nodeNumber=data,
                            numberOfContactSegments=1,
                            contactStiffness=CONTACT,
                            contactDamping=1e3,
                            frictionVelocityPenalty=1e3,
                            frictionStiffness=CONTACT,
                            frictionCoefficient=MU,
                            # Cables have no thickness: the distance of two midlines is one thickness.
                            circleRadius=THICKNESS,
                        )
                    )
            else:
                eyes.append(at)
                eye = mbs.AddMarker(MarkerNodeCoordinate(nodeNumber=at, coordinate=1))
                drives.append(
                    mbs.AddObject(
                        ObjectConnectorCoordinateSpringDamper(
                            markerNumbers=[ground, eye], stiffness=DRIVE, damping=1e4
                        )
                    )
                )
            above = cables
    mbs.Assemble()
    return system, mbs, drives


def run(dt, displacement_mm, duration_s, from_s):
    """Force and loop energy from `from_s` on, and the thread's own time of the whole."""
    _, mbs, drives = build()
    settings = exu.SimulationSettings()
    settings.timeIntegration.newton.useModifiedNewton = True
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.6
    settings.solution.file.write = False
    settings.linearSolver.solverType = exu.LinearSolverType.EigenSparse

    def lead(seconds, goal):
        """Leads the rails by `goal` (mm over time); displacement and force (N) at every step."""
        seen = []

        def before(system, t):
            force = sum(np.ravel(system.GetObjectOutput(k, exu.OutputVariableType.Force))[0] for k in drives)
            seen.append((goal(t), force))
            for k in drives:
                system.SetObjectParameter(k, "offset", -1e-3 * goal(t + dt))
            return True

        mbs.SetPreStepUserFunction(before)
        settings.timeIntegration.numberOfSteps = int(round(seconds / dt))
        settings.timeIntegration.endTime = seconds
        start = time.thread_time()
        mbs.SolveDynamic(settings, updateInitialValues=True)
        return time.thread_time() - start, np.array(seen)

    # Assembly under the reference curvatures; first touch is where the rails carry nothing (some 75 N/mm).
    zero_mm = 0.0
    for _ in range(3):
        _, seen = lead(0.5, lambda t: zero_mm)
        zero_mm -= seen[-1, 1] / 75
    took, seen = lead(duration_s, lambda t: zero_mm + displacement_mm(t))
    x, f = seen[int(round(from_s / dt)) :].T
    energy = float(np.sum(0.5e-3 * (f[1:] + f[:-1]) * np.diff(x)))
    return {"us_per_step": 1e6 * took * dt / duration_s, "real_time_factor": duration_s / took,
            "peak_n": float(f.max()), "loop_j": energy, "wall_s": took, "zero_mm": zero_mm, "dt_s": dt}


if __name__ == "__main__":
    dt = float(sys.argv[1]) if len(sys.argv) > 1 else 1e-3
    sine = run(dt, lambda t: 5 - 3 * math.cos(2 * math.pi * (t - 0.5)) if t > 0.5 else 4 * t, 2.5, 1.5)
    print(json.dumps({"tool": "exudyn " + exu.config.Version(), "sine": sine}))
