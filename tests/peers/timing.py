"""toppra and Ruckig plan the motions of a JSON object on standard input. Prints durations and computing times as JSON.

For each path, SciPy also judges the profile of the controller: the largest use of a limit at the nodes and between
them. A computing time is the minimum of several rounds, in µs. The time of toppra contains neither the construction of
the spline nor the evaluation of the trajectory.
"""

import json
import math
import sys
import time

import numpy
import ruckig
from scipy.interpolate import CubicSpline
from toppra import SplineInterpolator
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint
from toppra.parametrizer import ParametrizeConstAccel

# Rounds of a path without its own number, and of a move, which is planned in microseconds.
ROUNDS = 5
MOVE_ROUNDS = 50
BETWEEN = 20


def fastest(call, rounds):
    """Result of a call, and its time in the fastest round, µs."""
    least = math.inf
    for _ in range(rounds):
        begin = time.perf_counter_ns()
        result = call()
        least = min(least, (time.perf_counter_ns() - begin) / 1e3)
    return result, least


def use_of_limits(spline, s, x, u, limits):
    """Largest velocity or acceleration of a joint, relative to its limit."""
    first, second = spline(s, 1), spline(s, 2)
    velocity = abs(first) * numpy.sqrt(x)[:, None] / limits[0]
    acceleration = abs(first * u[:, None] + second * x[:, None]) / limits[1]
    return float(max(velocity.max(), acceleration.max()))


def judged_path(path):
    points = numpy.array(path["points"])
    limits = numpy.array(path["max_velocity"]), numpy.array(path["max_acceleration"])
    s, rate = numpy.array(path["s"]), numpy.array(path["rate"])
    parameters = numpy.concatenate([[0.0], numpy.cumsum(numpy.linalg.norm(numpy.diff(points, axis=0), axis=1))])
    # toppra wants the ends of spline and grid to be the same numbers.
    assert abs(parameters[-1] - s[-1]) < 1e-12 * s[-1], (parameters[-1], s[-1])
    parameters[-1] = s[-1]
    geometry = SplineInterpolator(parameters, points, path["ends"])

    def plan():
        constraints = [JointVelocityConstraint(limits[0]), JointAccelerationConstraint(limits[1])]
        instance = TOPPRA(constraints, geometry, gridpoints=s, solver_wrapper="seidel")
        return instance.compute_parameterization(0, 0)[1]

    speeds, time_us = fastest(plan, path.get("rounds", ROUNDS))
    if speeds is None:
        return {"duration": None}
    spline = CubicSpline(parameters, points, bc_type=path["ends"])
    x, steps = rate**2, numpy.diff(s)
    u = numpy.diff(x) / (2 * steps)
    between = 0.0
    for share in (numpy.arange(BETWEEN) + 0.5) / BETWEEN:
        between = max(between, use_of_limits(spline, s[:-1] + share * steps, x[:-1] + share * numpy.diff(x), u, limits))
    return {
        "duration": ParametrizeConstAccel(geometry, s, speeds).duration,
        "time_us": time_us,
        "at_nodes": max(use_of_limits(spline, s[ends], x[ends], u, limits) for ends in (slice(0, -1), slice(1, None))),
        "between": between,
    }


def planned_move(move):
    axes = len(move["target"])
    given = ruckig.InputParameter(axes)
    for name in ("position", "velocity", "acceleration"):
        setattr(given, f"current_{name}", move[name])
    given.target_position = move["target"]
    given.target_velocity = given.target_acceleration = [0.0] * axes
    for name in ("max_velocity", "max_acceleration", "max_jerk"):
        setattr(given, name, move[name])
    planner, trajectory = ruckig.Ruckig(axes), ruckig.Trajectory(axes)
    result, time_us = fastest(lambda: planner.calculate(given, trajectory), MOVE_ROUNDS)
    assert result in (ruckig.Result.Working, ruckig.Result.Finished), result
    return {"duration": trajectory.duration, "time_us": time_us}


def main():
    asked = json.load(sys.stdin)
    paths = [judged_path(path) for path in asked["paths"]]
    moves = [planned_move(move) for move in asked["moves"]]
    print(json.dumps({"paths": paths, "moves": moves}))


main()
