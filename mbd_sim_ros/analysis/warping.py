"""Dynamic time warping of two signals, for rating one against the other (mbd_sim_ros.analysis.rating)."""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import kernel


@kernel
def warped(a, b, band):
    """Sum of |a - b| and of |b| over the pairs of the warping path with the least sum of (a - b)^2 and |i - j| < band.

    Nothing beyond what the diagonal costs is followed: no part of the cheapest path costs more than all of it
    [Silva2016].
    """
    n = a.size
    width = 2 * band - 1
    step = np.zeros((n, width), np.uint8)  # from where the cheapest way comes: 1 above, 2 left, 3 both
    cost = np.full(width + 2, np.inf)
    before = np.full(width + 2, np.inf)
    most = 0.0
    for i in range(n):
        most += (a[i] - b[i]) * (a[i] - b[i])
    first, behind = band - 1, band - 1  # columns of the row before that cost no more
    for i in range(n):
        begin, end = max(0, band - 1 - i, first - 1), min(width, n - i + band - 1)
        first, last = width, begin - 1
        left = np.inf
        c = begin
        while c < end and (c <= behind or left <= most):
            gap = a[i] - b[i + c - band + 1]
            least, origin = np.inf, 0
            if i == 0 and c == band - 1:
                least = 0.0
            if before[c + 1] < least:
                least, origin = before[c + 1], 1
            if left < least:
                least, origin = left, 2
            if before[c] < least:
                least, origin = before[c], 3
            left = least + gap * gap
            step[i, c] = origin
            cost[c] = left
            if left <= most:
                first, last = min(first, c), c
            c += 1
        cost[c : c + 2] = np.inf
        if begin > 0:
            cost[begin - 1] = np.inf
        behind = last + 1
        cost, before = before, cost
    error, size = 0.0, 0.0
    i, j = n - 1, n - 1
    while True:
        error += abs(a[i] - b[j])
        size += abs(b[j])
        if i == 0 and j == 0:
            break
        origin = step[i, j - i + band - 1]
        if origin != 2:
            i -= 1
        if origin != 1:
            j -= 1
    return error, size
