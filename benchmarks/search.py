"""The fewest records of all, by exhaustive dynamic programming, compiled by Numba.

A state is a knot: a millisecond, an integer position within the tolerance, an integer velocity.
From every state that can be reached every segment of 1 … `longest_ms` that keeps the tolerance is
followed, so that no choice is left out.

From a knot (p0, v0) the curves x(t) = p0 + v0·t + b·t² + a·t³ that are within the tolerance at
t = i are those with lower[i] <= b + a·i <= upper[i]: the straight lines through a row of gates.
An end at T with position p1 fixes b + a·T = g, so what is left is the range of slopes a of lines
through (T, g) and all earlier gates; each slope is one end velocity v0 + 2·g·T + a·T². When no
line at all passes the gates up to T, neither does one pass more of them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
SLACK_QC = 1e-9
UNREACHED = np.iinfo(np.uint16).max
WILD_QC_MS = 9.0  # see `fewest`


def fewest(
    position_qc: Array,
    velocity_qc_s: Array,
    velocity_unit_qc_s: float,
    tolerance_qc: float = 1.0,
    longest_ms: int = 255,
) -> int:
    """Records of one axis at best, the one that ends the motion included; 0: there is no way.

    The commanded curve is given at k = 0 … end [ms]. The motion begins and ends at rest, at the
    whole counts nearest to the commanded ones.

    Velocities may differ from the commanded one by 9 tolerances per millisecond: with more, no
    segment of three milliseconds or longer begins or ends. (Let them differ by x and y at the ends
    of a segment of 3 ms. Then at 1 and 2 ms it is (4x − 2y)/9·1 ms and (2x − 4y)/9·1 ms off the
    curve with the commanded ones, each 2 tolerances at most as the ends may be one off as well;
    so x is 9 tolerances/ms at most, and less for longer segments.) Segments of 1 and 2 ms alone
    don't need more either: those between two such velocities do as well with lesser ones.
    """
    unit = velocity_unit_qc_s * 1e-3  # [qc/ms]
    window = math.ceil(WILD_QC_MS * tolerance_qc / unit)
    speed = velocity_qc_s * 1e-3
    speed[[0, -1]] = 0.0
    return int(_fewest(position_qc, speed, unit, tolerance_qc, longest_ms, window))


@njit(cache=True, fastmath=True)
def _fewest(x, speed, unit, tolerance, longest, window):  # type: ignore[no-untyped-def]
    end = len(x) - 1
    tolerance += SLACK_QC
    lowest = np.ceil(x - tolerance)
    places = int(2 * tolerance) + 1
    slowest = np.rint(speed / unit) - window
    speeds = 2 * window + 1
    first, last = np.rint(x[0]), np.rint(x[end])
    cost = np.full((end + 1, places, speeds), UNREACHED, dtype=np.uint16)
    cost[0, int(first - lowest[0]), int(-slowest[0])] = 0
    lower, upper = np.empty(longest + 1), np.empty(longest + 1)
    inverse = 1.0 / np.arange(1, longest + 1)
    for k in range(end):
        for place in range(places):
            p0 = lowest[k] + place
            for swift in range(speeds):
                so_far = cost[k, place, swift]
                if so_far == UNREACHED:
                    continue
                v0 = (slowest[k] + swift) * unit
                least, most = -np.inf, np.inf  # slopes of lines through all gates so far
                for time in range(1, min(longest, end - k) + 1):
                    k1 = k + time
                    straight = p0 + v0 * time
                    square = 1.0 / (time * time)
                    lower[time] = (x[k1] - tolerance - straight) * square
                    upper[time] = (x[k1] + tolerance - straight) * square
                    for end_place in range(places):
                        p1 = lowest[k1] + end_place
                        if p1 > x[k1] + tolerance or (k1 == end and p1 != last):
                            continue
                        g = (p1 - straight) * square
                        flattest, steepest = -np.inf, np.inf
                        for i in range(1, time):
                            far = inverse[time - i - 1]
                            flattest = max(flattest, (g - upper[i]) * far)
                            steepest = min(steepest, (g - lower[i]) * far)
                        if flattest > steepest:
                            continue
                        v1 = v0 + 2 * g * time
                        a, b = 0, speeds - 1
                        if time > 1:
                            span = time * time / unit
                            a = max(a, math.ceil(v1 / unit + flattest * span - slowest[k1] - 1e-9))
                            b = min(b, math.floor(v1 / unit + steepest * span - slowest[k1] + 1e-9))
                        if k1 == end:
                            a, b = max(a, int(-slowest[end])), min(b, int(-slowest[end]))
                        for s in range(a, b + 1):
                            cost[k1, end_place, s] = min(cost[k1, end_place, s], so_far + 1)
                    for i in range(1, time):
                        far = inverse[time - i - 1]
                        least = max(least, (lower[time] - upper[i]) * far)
                        most = min(most, (upper[time] - lower[i]) * far)
                    if least > most:
                        break
    best = cost[end, int(last - lowest[end]), int(-slowest[end])]
    return 0 if best == UNREACHED else best + 1
