"""A line on the ground and the places of cars along it: distance to its side, turn to it, curvature ahead."""

from __future__ import annotations

import math

import numpy as np

from solver.inputs.driver import Course

# Points of the line, at most 0.25 m apart, that are searched to both sides of the last place of a car: 15 m. A car that
# has gone further is followed from the end of one search to the next. Ten times as many would find the other side of a
# hairpin.
WINDOW = 60
# Points to both sides of a place, 1.5 m, over which its curvature is averaged: the turn at a single corner of the line
# is noise. Ten times as many would round a chicane off.
SMOOTH = 6


class Line:
    """points (n, 2) [m] in their order, at most 0.25 m apart; closed: the last one is followed by the first.

    s (n,) distance from the first point [m]; heading (n,) [rad]; curvature (n,) [1/m], positive to the left.
    """

    def __init__(self, points: np.ndarray, *, closed: bool) -> None:
        self.points, self.closed = points, closed
        ends = np.concatenate([points[1:], points[:1]]) if closed else points[1:]
        parts = ends - points[: len(ends)]
        lengths = np.hypot(*parts.T)
        self.s = np.concatenate([[0.0], np.cumsum(lengths)])[: len(points)]
        self.length = float(lengths.sum())
        turned = np.unwrap(np.arctan2(parts[:, 1], parts[:, 0]))
        self.heading = turned if closed else np.append(turned, turned[-1])
        at = np.arange(len(points))
        low, high = (self._index(at + off) for off in (-SMOOTH, SMOOTH))
        turn = (self.heading[high] - self.heading[low] + math.pi) % (2.0 * math.pi) - math.pi
        way = (self.s[high] - self.s[low]) % self.length if closed else self.s[high] - self.s[low]
        self.curvature = turn / np.maximum(way, lengths.min())

    @classmethod
    def of(cls, course: Course) -> Line:
        """That of a driver's course, without the straight ends of an open one."""
        return cls(course.line[:-1] if course.closed else course.line[1:-1], closed=course.closed)

    def _index(self, k: np.ndarray) -> np.ndarray:
        return k % len(self.points) if self.closed else np.clip(k, 0, len(self.points) - 1)

    def nearest(self, x: float, y: float, near: int | None = None) -> int:
        """Index of the point nearest to x, y [m]; near: the index before, from which the line is followed (None: all
        points are searched)."""
        if near is None:
            return self._nearest_of(np.arange(len(self.points)), x, y)
        while True:
            some = self._index(np.arange(near - WINDOW, near + WINDOW + 1))
            found = self._nearest_of(np.unique(some), x, y)
            if found == near or found not in (some[0], some[-1]):
                return found
            near = found  # nearer than before: this comes to an end

    def _nearest_of(self, some: np.ndarray, x: float, y: float) -> int:
        gaps = self.points[some] - (x, y)
        return int(some[np.argmin(np.einsum('ij,ij->i', gaps, gaps))])

    def offset(self, k: int, x: float, y: float) -> float:
        """Distance [m] of x, y to the left of the line at point k."""
        dx, dy = (x, y) - self.points[k]
        return float(math.cos(self.heading[k]) * dy - math.sin(self.heading[k]) * dx)

    def turn_to(self, k: int, heading: float) -> float:
        """Heading [rad] relative to the line at point k, between -pi and pi."""
        return float((heading - self.heading[k] + math.pi) % (2.0 * math.pi) - math.pi)

    def ahead(self, k: int, way: float) -> int:
        """Index of the first point at least `way` [m] further along the line than point k; of an open line, its last
        point at most."""
        s = self.s[k] + way
        return int(self._index(np.asarray(np.searchsorted(self.s, s % self.length if self.closed else s))))
