"""Reference in maximal coordinates: Newton and Euler for every body, constraints on accelerations, and an integrator of
order eight.

Nothing of it is shared with the solver: the scene is read from its text (maximal_reader.py), rows and forces are its
own. In velocities that are weighted by the roots of masses and inertias the accelerations are those of Gauss'
principle,

    u' = f + B+ (-c - B f)

with the free accelerations f, the rows B (each of unit length), their second derivatives c without accelerations, and
B+ by as many singular values as rows were independent anywhere so far: rows that depend on others change nothing, also
where the stages of a step are a little off the constraints. DOP853 integrates; after every step positions and
velocities are projected onto the constraints in the same metric. A reference exists where two tolerances agree
(Motion.spread); where a start that is changed by a part of 1e-7 grows, the motion magnifies errors (Motion.growth).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import DOP853
from scipy.spatial.transform import Rotation

from mbd_sim_ros.lab.mechanisms.maximal_forces import forces, tables
from mbd_sim_ros.lab.mechanisms.maximal_reader import Mechanism, read
from mbd_sim_ros.lab.mechanisms.maximal_rows import BLADE, COUPLED, SLIP, all_rows, compiled, cross, matrices, turn

# of the largest singular value: rows below depend on others. Times ten: near-singular starts lose a row
DEPENDENT = 1e-8
ZERO = 1e-12  # of the largest: a singular value that cannot be divided by
NOT_PROJECTED = 1e-5  # the same of a projection, which would throw a mechanism along what is nearly free
TIGHT, LOOSE = 1e-11, 1e-8  # tolerances of the two solutions, relative to size and speed of the mechanism
CHANGE = 1e-7  # of the velocities at the start, in the third solution
EVALUATIONS = 60_000  # of a solution, beyond which it is given up: a minute
# Times the evaluations of the loose solution that the tight one may take; a smooth motion takes 10^(3/8) = 2.4 times,
# and ten times as many are spent where a motion has no eight derivatives, or none at all
ROUGH = 20


class Unresolved(Exception):
    """The reference is given up: its steps collapse or are too many."""


@compiled
def unpacked(y, n):
    """Positions, quaternions, velocities and angular velocities along the body, of the vector that is integrated."""
    return (
        y[: 3 * n].reshape(n, 3),
        y[3 * n : 7 * n].reshape(n, 4),
        y[7 * n : 10 * n].reshape(n, 3),
        y[10 * n :].reshape(n, 3),
    )


@compiled
def placed(y, n):
    """Rotation matrices, positions, velocities, angular velocities along the world, with the world as the last body."""
    p, q, v, w = unpacked(y, n)
    unit = np.empty((n, 4))
    for b in range(n):
        unit[b] = q[b] / np.sqrt(np.sum(q[b] ** 2))
    R = matrices(unit)
    P, V, W = np.zeros((n + 1, 3)), np.zeros((n + 1, 3)), np.zeros((n + 1, 3))
    P[:n], V[:n] = p, v
    for b in range(n):
        W[b] = turn(R[b], w[b])
    return R, P, V, W


@compiled
def weighted(gradient, R, root, n):
    """Rows in weighted velocities, each of length one, and the lengths they had. root: (nb, 3, 3) W with W W^T the
    inverse inertia."""
    m = len(gradient)
    B = np.empty((m, 6 * n))
    size = np.empty(m)
    for k in range(m):
        for b in range(n):
            B[k, 6 * b : 6 * b + 3] = gradient[k, b, :3] * root[b, 0, 0]
            B[k, 6 * b + 3 : 6 * b + 6] = root[b, 1:].T.copy() @ (R[b].T.copy() @ gradient[k, b, 3:].copy())
        size[k] = max(np.sqrt(np.sum(B[k] ** 2)), 1e-300)
        B[k] /= size[k]
    return B, size


@compiled
def least(B, b, rank, cut):
    """The shortest x with B x = b, by the first singular values, so many as the rank, that are above cut of the
    largest."""
    U, S, Vt = np.linalg.svd(B, full_matrices=False)
    x = np.zeros(B.shape[1])
    for k in range(min(rank, len(S))):
        if S[k] > cut * S[0]:
            x += Vt[k] * (np.sum(U[:, k] * b) / S[k])
    return x


@compiled
def rates(y, n, masses, of_rows, of_forces, before, signals, rank):
    """Derivative of the vector that is integrated."""
    mass, inertia, root, gravity = masses
    codes, numbers, which, frames = of_rows
    state = placed(y, n)
    f = forces(state, which, frames, before, of_forces)
    _, q, _, w = unpacked(y, n)
    free = np.empty(6 * n)
    for b in range(n):
        free[6 * b : 6 * b + 3] = (f[b, :3] / mass[b] + gravity) / root[b, 0, 0]
        torque = state[0][b].T.copy() @ f[b, 3:].copy() - cross(w[b], inertia[b] @ w[b].copy())
        free[6 * b + 3 : 6 * b + 6] = root[b, 1:].T.copy() @ torque
    if len(codes):
        _, _, second, gradient = all_rows(state, codes, numbers, which, frames, before, signals)
        B, size = weighted(gradient, state[0], root, n)
        free += least(B, -second / size - B @ free, rank, ZERO)
    out = np.empty(13 * n)
    out[: 3 * n] = y[7 * n : 10 * n]
    for b in range(n):
        qx, qy, qz, qw = q[b]
        x, yy, z = w[b]
        k = 3 * n + 4 * b
        out[k] = 0.5 * (qw * x + qy * z - qz * yy)
        out[k + 1] = 0.5 * (qw * yy + qz * x - qx * z)
        out[k + 2] = 0.5 * (qw * z + qx * yy - qy * x)
        out[k + 3] = -0.5 * (qx * x + qy * yy + qz * z)
        out[7 * n + 3 * b : 7 * n + 3 * b + 3] = free[6 * b : 6 * b + 3] * root[b, 0, 0]
        out[10 * n + 3 * b : 10 * n + 3 * b + 3] = root[b, 1:] @ free[6 * b + 3 : 6 * b + 6].copy()
    return out


class Maximal:
    """A mechanism in maximal coordinates.

    freedoms: of velocity at the start. y: the state at the start, as it is integrated.
    """

    def __init__(self, mechanism: Mechanism | str) -> None:
        self.of = read(mechanism) if isinstance(mechanism, str) else mechanism
        of, n = self.of, len(self.of.names)
        self.n = n
        self.forces = tables(of)
        root = np.zeros((n, 4, 3))
        root[:, 0, 0] = of.mass**-0.5
        for b in range(n):
            root[b, 1:] = np.linalg.inv(np.linalg.cholesky(of.inertia[b])).T
        self.root = root
        self._masses = (of.mass, of.inertia, root, of.gravity)
        self.rows = (of.codes, of.numbers.copy(), of.coordinates, of.frames)
        self.before = np.zeros(len(of.coordinates))
        self.evaluations, self.most = 0, EVALUATIONS
        self.y = np.concatenate((of.p.ravel(), of.q.ravel(), of.v.ravel(), of.w.ravel()))
        self.look(0.0, self.y)
        self._close_couplers()
        self.start = self.before.copy()
        self.holonomic = ~np.isin(of.codes[:, 0], (SLIP, BLADE))
        S = self.singular_values(0.0, self.y)
        # the largest so far; between steps rows depart from it
        self.rank = int(np.sum(DEPENDENT * S[0] < S)) if len(S) else 0
        self.freedoms = 6 * n - self.rank
        inside = np.vstack((of.p, np.zeros(3)))
        radius = np.sqrt(np.max(np.trace(of.inertia, axis1=1, axis2=2) / of.mass))
        self.size = max(float(np.max(np.linalg.norm(inside - inside.mean(axis=0), axis=1))), float(radius))

    def _close_couplers(self) -> None:
        """Couplers without an offset take what holds at the start, where their signals are zero."""
        codes, numbers = self.rows[:2]
        for k in np.flatnonzero(codes[:, 0] == COUPLED):
            if numbers[k, 3]:
                continue
            if codes[k, 4] >= 0 and self.of.signals[codes[k, 4]](0.0)[0] != 0.0:
                raise ValueError('couplers: an offset that is not given goes with a signal that begins at 0')
            numbers[k, 4] = sum(numbers[k, term] * self.before[c] for term, c in enumerate(codes[k, 1:4]) if c >= 0)

    def _signals(self, t: float) -> np.ndarray:
        return np.array([s(t) for s in self.of.signals]).reshape(-1, 3)

    def values(self, t: float, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Values, rates, second derivatives and gradients of all rows."""
        return all_rows(placed(y, self.n), *self.rows, self.before, self._signals(t))

    def singular_values(self, t: float, y: np.ndarray) -> np.ndarray:
        """Singular values of the rows, each of length one in weighted velocities."""
        if not len(self.rows[0]):
            return np.zeros(0)
        B, _ = weighted(self.values(t, y)[3], placed(y, self.n)[0], self.root, self.n)
        return np.linalg.svd(B, compute_uv=False)

    def free_directions(self) -> np.ndarray:
        """Velocities (freedoms, 6 nb) that the rows allow at the start, each of kinetic energy one half: v along the
        world, w the body."""
        full = np.eye(6 * self.n)
        if len(self.rows[0]):
            B, _ = weighted(self.values(0.0, self.y)[3], placed(self.y, self.n)[0], self.root, self.n)
            full = np.linalg.svd(B)[2][self.rank :]
        return np.array([self.unweighted(u) for u in full])

    def unweighted(self, u: np.ndarray) -> np.ndarray:
        """Velocities or displacements (6 nb) of weighted ones."""
        out = u.reshape(-1, 6).copy()
        out[:, :3] *= self.root[:, 0, :1]
        out[:, 3:] = np.einsum('bij,bj->bi', self.root[:, 1:], out[:, 3:])
        return out.ravel()

    def look(self, t: float, y: np.ndarray) -> None:
        """Note the values of the coordinates, near which angles are continued."""
        R, P, _, _ = placed(y, self.n)
        for k, (kind, F, G) in enumerate(self.of.coordinates):
            frame = self.of.frames[k]
            if kind == 0:
                x, along, turned = R[F] @ frame[0:3], R[F] @ frame[3:6], R[G] @ frame[9:12]
                value = np.arctan2(along @ turned, x @ turned)
                self.before[k] = value + 2.0 * np.pi * np.round((self.before[k] - value) / (2.0 * np.pi))
            else:
                self.before[k] = (R[F] @ frame[6:9]) @ (P[G] + R[G] @ frame[15:18] - P[F] - R[F] @ frame[12:15])

    def rates(self, t: float, y: np.ndarray) -> np.ndarray:
        """Derivative of the state. Raises Unresolved when there were too many."""
        self.evaluations += 1
        if self.evaluations > self.most or not np.all(np.isfinite(y)):
            raise Unresolved(f'given up at t = {t:.4g} s after {self.evaluations} evaluations')
        return rates(y, self.n, self._masses, self.rows, self.forces, self.before, self._signals(t), self.rank)

    def projected(self, t: float, y: np.ndarray) -> np.ndarray:
        """The state on the constraints: the least weighted displacement, then the least weighted change of velocity."""
        y, n = y.copy(), self.n
        p, q, v, w = unpacked(y, n)
        q /= np.linalg.norm(q, axis=1)[:, None]
        if not len(self.rows[0]):
            return y
        for _ in range(2):
            value, _, _, gradient = self.values(t, y)
            B, size = weighted(gradient[self.holonomic], placed(y, n)[0], self.root, n)
            if len(B):
                change = self.unweighted(least(B, -value[self.holonomic] / size, len(B), NOT_PROJECTED)).reshape(-1, 6)
                p += change[:, :3]
                q[:] = (Rotation.from_quat(q) * Rotation.from_rotvec(change[:, 3:])).as_quat()
        _, rate, _, gradient = self.values(t, y)
        B, size = weighted(gradient, placed(y, n)[0], self.root, n)
        change = self.unweighted(least(B, -rate / size, len(B), NOT_PROJECTED)).reshape(-1, 6)
        v += change[:, :3]
        w += change[:, 3:]
        return y

    def scale(self, y: np.ndarray) -> np.ndarray:
        """Size of each number of the state: of the mechanism, and of its velocities, at least its size or a radian in a
        second."""
        n = self.n
        speed = max(float(np.max(np.linalg.norm(y[7 * n : 10 * n].reshape(-1, 3), axis=1))), self.size)
        spin = max(float(np.max(np.abs(y[10 * n :]))), 1.0)
        return np.repeat((self.size, 1.0, speed, spin), (3 * n, 4 * n, 3 * n, 3 * n))

    def solve(self, times: np.ndarray, tolerance: float, y: np.ndarray | None = None) -> tuple[np.ndarray, float]:
        """States at times that begin with 0 [s], and the least singular value of a row that counts, over the largest,
        on the way."""
        y = self.projected(0.0, self.y if y is None else y)
        self.before, self.evaluations = self.start.copy(), 0
        self.look(0.0, y)
        scale = self.scale(y)
        out, lowest = [y], self._closest(0.0, y)
        stops = [*(t for t in self.of.knots if 0.0 < t < times[-1]), float(times[-1])]
        t = 0.0
        for stop in stops:
            stepper = DOP853(self.rates, t, y, stop, rtol=tolerance, atol=tolerance * scale)
            while stepper.status == 'running':
                message = stepper.step()
                if stepper.status == 'failed':
                    raise Unresolved(f'steps collapse at t = {stepper.t:.4g} s: {message}')
                if len(out) < len(times) and times[len(out)] <= stepper.t:
                    between = stepper.dense_output()
                    while len(out) < len(times) and times[len(out)] <= stepper.t:
                        out.append(between(times[len(out)]))
                t, y = stepper.t, self.projected(stepper.t, stepper.y)
                self.look(t, y)
                stepper.y, stepper.f = y, self.rates(t, y)
                lowest = min(lowest, self._closest(t, y))
        return np.array(out), lowest

    def _closest(self, t: float, y: np.ndarray) -> float:
        if not self.rank:
            return 1.0
        S = self.singular_values(t, y)
        self.rank = max(self.rank, int(np.sum(DEPENDENT * S[0] < S)))
        return float(S[self.rank - 1] / S[0])


@dataclass(frozen=True)
class Motion:
    """A motion by the reference: places of centres of mass (times, nb, 3) [m], rotations (times, nb, 4).

    spread: difference of two tolerances, by `difference`; inf where one was given up, and `text` says why. growth:
    difference of a start with velocities that are changed by CHANGE of their size, over CHANGE. lowest: least singular
    value on the way.
    """

    times: np.ndarray
    p: np.ndarray
    q: np.ndarray
    com: np.ndarray  # (nb, 3), in the frames of the file
    spread: float
    growth: float
    lowest: float
    range: float  # m
    turn: float  # rad
    text: str = ''


def turn_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle between unit quaternions (..., 4) [rad]."""
    chord = np.minimum(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return 4.0 * np.arcsin(np.minimum(1.0, chord / 2.0))


def extent(p: np.ndarray, q: np.ndarray, size: float) -> tuple[float, float]:
    """Range of motion [m]: the farthest that a centre of mass gets from where it began; and turn [rad], the farthest
    from the first orientation; at least a thousandth of the size, and of a radian: a mechanism that stands still has no
    small errors."""
    range_ = float(np.max(np.linalg.norm(p - p[0], axis=2)))
    return max(range_, 1e-3 * size), max(float(np.max(turn_between(q, q[0]))), 1e-3)


def difference(
    p: np.ndarray, q: np.ndarray, other_p: np.ndarray, other_q: np.ndarray, range_: float, turn: float
) -> float:
    """The largest error of a place over the range of motion, or of an orientation over the turn, of any body at any
    time."""
    place = float(np.max(np.linalg.norm(p - other_p, axis=2))) / range_
    return max(place, float(np.max(turn_between(q, other_q))) / turn)


def motion(text: str, duration: float, sample: float = 0.01) -> Motion:
    """The motion of a scene's text over a duration [s], every `sample` seconds."""
    maximal = Maximal(text)
    times = np.arange(round(duration / sample) + 1) * sample
    n = maximal.n

    def solution(tolerance: float, y: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, float]:
        states, lowest = maximal.solve(times, tolerance, y)
        q = states[:, 3 * n : 7 * n].reshape(-1, n, 4)
        return states[:, : 3 * n].reshape(-1, n, 3), q / np.linalg.norm(q, axis=2)[:, :, None], lowest

    try:
        loose = solution(LOOSE)
        maximal.most = min(EVALUATIONS, ROUGH * maximal.evaluations)
        p, q, lowest = solution(TIGHT)
    except Unresolved as error:
        nothing = np.zeros((0, n, 3)), np.zeros((0, n, 4))
        return Motion(times, *nothing, maximal.of.com, np.inf, np.inf, 0.0, np.nan, np.nan, str(error))
    range_, turn = extent(p, q, maximal.size)
    spread = difference(p, q, *loose[:2], range_, turn)
    try:
        changed = maximal.y.copy()
        changed[7 * n :] += CHANGE * maximal.scale(changed)[7 * n :] * np.resize((1.0, -1.0, 0.5), 6 * n)
        growth = difference(p, q, *solution(0.1 * LOOSE, changed)[:2], range_, turn) / CHANGE
    except Unresolved as error:
        return Motion(times, p, q, maximal.of.com, np.inf, np.inf, lowest, range_, turn, str(error))
    return Motion(times, p, q, maximal.of.com, spread, growth, lowest, range_, turn)
