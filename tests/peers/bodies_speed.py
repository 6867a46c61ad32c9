"""Computing time of pinocchio for the kinematics in closed form: reads the links of robots, prints times as JSON.

Every time is the time per call in the fastest of several rounds of a Python loop, without corrections. `call` is the overhead
of Python: the time of `pinocchio.neutral` for a model with one joint, which computes almost nothing. The inverse kinematics is
the Newton method with damped least squares of pinocchio's own examples, because pinocchio has no closed form.
"""

import json
import math
import sys
import time

import numpy
import pinocchio

ROUNDS = 7
WITHIN = 1e-9
DAMPING = 1e-12
MOST_STEPS = 100


def model_of(links):
    model = pinocchio.Model()
    parent = 0
    for link in links:
        axis = numpy.array(link["axis"])
        joint = {
            "revolute": pinocchio.JointModelRevoluteUnaligned,
            "prismatic": pinocchio.JointModelPrismaticUnaligned,
        }[link["kind"]](axis)
        x, y, z, w = link["quaternion"]
        placement = pinocchio.SE3(pinocchio.Quaternion(w, x, y, z).matrix(), numpy.array(link["position"]))
        parent = model.addJoint(parent, joint, placement, link["name"])
    model.addFrame(pinocchio.Frame("flange", parent, 0, pinocchio.SE3.Identity(), pinocchio.FrameType.OP_FRAME))
    return model


def share(call, times):
    """Time of one call in the fastest round, ns."""
    rounds = []
    for _ in range(ROUNDS):
        begin = time.perf_counter_ns()
        for _ in range(times):
            call()
        rounds.append((time.perf_counter_ns() - begin) / times)
    return min(rounds)


def solve(model, data, joint, target, seed):
    """Joint positions with the flange at the target, and number of steps; None without convergence."""
    q = seed.copy()
    for steps in range(MOST_STEPS):
        pinocchio.forwardKinematics(model, data, q)
        apart = data.oMi[joint].actInv(target)
        error = pinocchio.log(apart).vector
        if numpy.linalg.norm(error) < WITHIN:
            return q, steps
        jacobian = pinocchio.computeJointJacobian(model, data, q, joint)
        jacobian = -pinocchio.Jlog6(apart.inverse()) @ jacobian
        change = -jacobian.T @ numpy.linalg.solve(jacobian @ jacobian.T + DAMPING * numpy.eye(6), error)
        q = pinocchio.integrate(model, q, change)
    return None, MOST_STEPS


def measured(robot):
    model = model_of(robot["links"])
    data = model.createData()
    joint, flange = model.njoints - 1, model.nframes - 1
    postures = [numpy.array(posture) for posture in robot["postures"]]
    seeds = [numpy.array(seed) for seed in robot["seeds"]]

    def forward():
        pinocchio.forwardKinematics(model, data, postures[0])
        pinocchio.updateFramePlacements(model, data)

    forward()
    apart = max(abs(data.oMf[flange].translation - numpy.array(robot["flange"])))
    assert apart < WITHIN, (robot["name"], apart)

    targets = []
    for posture in postures:
        pinocchio.forwardKinematics(model, data, posture)
        targets.append(data.oMi[joint].copy())
    steps, converged, times = 0, 0, []
    for target, seed in zip(targets, seeds):
        found, taken = solve(model, data, joint, target, seed)
        if found is not None:
            converged += 1
            steps += taken
            times.append(share(lambda: solve(model, data, joint, target, seed), 3))
    return {
        "name": robot["name"],
        "forward_ns": share(forward, 2000),
        "inverse_ns": sum(times) / len(times) if times else math.nan,
        "steps": steps / converged if converged else math.nan,
        "converged": converged,
        "asked": len(seeds),
    }


def main():
    robots = json.load(sys.stdin)
    one = pinocchio.Model()
    one.addJoint(0, pinocchio.JointModelRZ(), pinocchio.SE3.Identity(), "one")
    call = share(lambda: pinocchio.neutral(one), 2000)
    print(json.dumps({"call_ns": call, "robots": [measured(robot) for robot in robots]}))


main()
