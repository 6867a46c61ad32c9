"""pinocchio reads the URDF of a robot. Its results are compared with those of `mrroc kinematics`."""

import argparse
import json
import math
import random
import subprocess

import numpy
import pinocchio

POSTURES = 40
WITHIN = 1e-9


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--mrroc", required=True)
    parser.add_argument("--robot", required=True)
    options = parser.parse_args()

    def mrroc(*words):
        command = [options.mrroc, *words, "--robot", options.robot]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout

    def asked(question, joints=None):
        given = [] if joints is None else ["--joints", ",".join(map(repr, joints))]
        return json.loads(mrroc("kinematics", question, "--json", *given))

    model = pinocchio.buildModelFromXML(mrroc("urdf"))
    data = model.createData()
    flange = model.getFrameId("flange")
    base = model.getFrameId("base_link")
    assert max(base, flange) < model.nframes, "no base or no flange"

    def configuration(links):
        q = pinocchio.neutral(model)
        assert len(links) == model.njoints - 1, (links, list(model.names))
        for name, position in links.items():
            joint = model.joints[model.getJointId(name)]
            # The position of a continuous joint is a point on the unit circle.
            q[joint.idx_q : joint.idx_q + joint.nq] = (
                [position] if joint.nq == 1 else [math.cos(position), math.sin(position)]
            )
        return q

    def links_of(joints):
        return asked("fk", joints)["links"]

    limits = [(limit["low"], limit["high"]) for limit in asked("limits")["joints"]]
    axes = len(limits)
    assert model.nv == axes, (model.nv, axes)

    # Joint positions of the description are sums of the robot's joint positions: the share of each.
    coupling = numpy.zeros((axes, axes))
    for axis in range(axes):
        unit = [float(axis == other) for other in range(axes)]
        for name, position in links_of(unit).items():
            coupling[model.joints[model.getJointId(name)].idx_v, axis] = position

    rng = random.Random(20020714)
    worst = {"position": 0.0, "rotation": 0.0, "jacobian": 0.0}
    travelled = 0.0
    for _ in range(POSTURES):
        joints = [rng.uniform(-9 if low is None else low, 9 if high is None else high) for low, high in limits]
        answer = asked("fk", joints)
        q = configuration(answer["links"])
        pinocchio.forwardKinematics(model, data, q)
        pinocchio.updateFramePlacements(model, data)
        placed = data.oMf[base].actInv(data.oMf[flange])
        jacobian = pinocchio.computeFrameJacobian(model, data, q, flange, pinocchio.LOCAL_WORLD_ALIGNED) @ coupling
        # The root of the description may be the floor; the root of `mrroc kinematics` is the base.
        base_from_root = data.oMf[base].rotation.T
        jacobian = numpy.vstack([base_from_root @ jacobian[:3], base_from_root @ jacobian[3:]])
        ours = {
            "position": numpy.array(answer["position"]),
            "rotation": numpy.array(answer["rotation"]),
            "jacobian": numpy.array(asked("jacobian", joints)["jacobian"]),
        }
        theirs = {"position": placed.translation, "rotation": placed.rotation, "jacobian": jacobian}
        for what, value in ours.items():
            assert value.shape == theirs[what].shape, (what, value.shape)
            worst[what] = max(worst[what], abs(value - theirs[what]).max())
        travelled = max(travelled, abs(ours["position"]).max())
    assert travelled > 0.5, travelled
    assert all(apart < WITHIN for apart in worst.values()), (options.robot, worst)
    told = ", ".join(f"{what} {apart:.1e}" for what, apart in worst.items())
    print(f"{options.robot}: {POSTURES} postures, apart by at most {told}")


main()
