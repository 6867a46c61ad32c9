"""SciPy constructs, evaluates and measures the splines of a JSON list on standard input."""

import json
import sys

import numpy
from scipy.integrate import quad
from scipy.interpolate import BSpline, make_interp_spline

WITHIN = 1e-12


def interpolated(through):
    """The spline through data points, by the calls that the controller documents."""
    points, ends = numpy.array(through["points"]), through["ends"]
    u = numpy.concatenate([[0.0], numpy.cumsum(numpy.linalg.norm(numpy.diff(points, axis=0), axis=1))])
    if ends == "averaged":
        inner = [sum(u[j : j + 3]) / 3 for j in range(1, len(u) - 3)]
        t = numpy.concatenate([[u[0]] * 4, inner, [u[-1]] * 4])
        return make_interp_spline(u, points, k=3, t=t)
    if ends in ("not-a-knot", "natural"):
        return make_interp_spline(u, points, k=3, bc_type=ends)
    start, end = ends
    return make_interp_spline(u, points, k=3, bc_type=([(1, start)], [(1, end)]))


def apart(ours, theirs):
    """Largest difference, relative to the largest value."""
    theirs = numpy.asarray(theirs)
    assert theirs.shape == numpy.shape(ours), (theirs.shape, numpy.shape(ours))
    return float(abs(numpy.asarray(ours) - theirs).max() / abs(theirs).max())


def main():
    worst = {}

    def compared(what, ours, theirs):
        worst[what] = max(worst.get(what, 0.0), apart(ours, theirs))

    splines = json.load(sys.stdin)
    assert len(splines) > 10, len(splines)
    for spline in splines:
        theirs = BSpline(spline["knots"], spline["controls"], 3)
        u = numpy.array(spline["parameters"])
        for derivative, values in enumerate(spline["values"]):
            compared(f"derivative {derivative}", values, theirs.derivative(derivative)(u) if derivative else theirs(u))
        if spline["through"] is not None:
            found = interpolated(spline["through"])
            compared("knots", spline["knots"], found.t)
            compared("controls", spline["controls"], found.c)
            compared("interpolated", spline["values"][0], found(u))
        slope = theirs.derivative()
        spans = numpy.unique(theirs.t[3 : len(theirs.c) + 1])
        lengths = [
            quad(lambda u: numpy.linalg.norm(slope(u)), a, b, epsabs=1e-15, epsrel=1e-13, limit=200)[0]
            for a, b in zip(spans, spans[1:])
        ]
        compared("length", [spline["length"]], [sum(lengths)])
    assert all(difference < WITHIN for difference in worst.values()), worst
    told = ", ".join(f"{what} {difference:.1e}" for what, difference in worst.items())
    print(f"{len(splines)} splines, apart by at most {told}")


main()
