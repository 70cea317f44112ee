"""Motions known in closed form, or from ordinary differential equations in minimal coordinates at tolerance 1e-13.

Nothing here uses the solver: each function t -> Motion stands on its own derivation, the scene text beside it is the
same problem. Differential equations are solved when a motion is first asked for: every process of tests collects them
all, and runs a part of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.integrate import quad, solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk

G = 9.81
TIGHT = {'method': 'DOP853', 'rtol': 1e-13, 'atol': 1e-13, 'dense_output': True}


class Motion(NamedTuple):
    """State of all bodies' reference frames at an instant; NaN: not judged."""

    p: np.ndarray  # (nb, 3) origin in the world [m]
    R: np.ndarray  # (nb, 3, 3)
    v: np.ndarray  # (nb, 3) velocity of the origin in the world [m/s]
    w: np.ndarray  # (nb, 3) angular velocity in the body [rad/s]
    reaction: np.ndarray  # (nc,) multipliers, rows in the order of the model


class Problem(NamedTuple):
    """A scene and its exact motion."""

    scene: str
    exact: Callable[[float], Motion]


def turned(axis: str, angle: float) -> np.ndarray:
    """(3, 3) rotation about a coordinate axis."""
    return Rotation.from_euler(axis, angle).as_matrix()


def pendulum() -> Problem:
    """Point mass 1 kg at 1 m, released at rest from the horizontal: sin(phi/2) = k sn(K + t sqrt(g/l)), k = sin(45
    deg)."""
    k = np.sin(np.pi / 4)
    rate = np.sqrt(G)

    def exact(t):
        sn, cn, _, _ = ellipj(rate * t + ellipk(k * k), k * k)
        phi, dphi = -2 * np.arcsin(k * sn), -2 * k * rate * cn  # from the vertical; released at phi = -90 deg
        radial, tangent = np.array([np.sin(phi), -np.cos(phi), 0.0]), np.array([np.cos(phi), np.sin(phi), 0.0])
        force = -(dphi**2) * radial - G * np.sin(phi) * tangent + np.array([0.0, G, 0.0])
        zero = np.zeros((1, 3))
        return Motion(
            zero, turned('z', phi + np.pi / 2)[None], zero, np.array([[0.0, 0.0, dphi]]), np.array([*force, 0.0, 0.0])
        )

    return Problem('mechanism: mechanisms/pendulum.yaml', exact)


def spring_mass(stiffness: float = 100.0, damping: float = 2.0) -> Problem:
    """Damped oscillator on a guide, centre of mass 0.2 m beside it: x = e^(-d t) (...), reaction torque m (g + a) 0.2 m
    about y."""
    w0, d = np.sqrt(stiffness), damping / 2
    wd = np.sqrt(w0**2 - d**2)
    sag = G / stiffness

    def exact(t):
        decay, c, s = np.exp(-d * t), np.cos(wd * t), np.sin(wd * t)
        x = -1 - sag + sag * decay * (c + d / wd * s)
        dx = -sag * decay * w0**2 / wd * s
        ddx = -2 * d * dx - w0**2 * (x + 1 + sag)
        # rows x, y, xy, xz, yz; F_x . G_z = 0 turns the mass about +y where it is positive, the weight pulls its far
        # side down (also +y)
        torque = -(G + ddx) * 0.2
        reaction = np.array([0.0, 0.0, 0.0, torque, 0.0])
        zero = np.zeros((1, 3))
        return Motion(np.array([[0, 0, x]]), np.eye(3)[None], np.array([[0, 0, dx]]), zero, reaction)

    scene = f"""
mechanism:
  bodies:
    mass: {{mass: 1, inertia: [0.01, 0.01, 0.01], com: [0.2, 0, 0], position: [0, 0, -1]}}
  joints:
    guide: {{kind: prismatic, i: world, j: mass, at: [0, 0, -1], axis: [0, 0, 1]}}
  spring_dampers:
    spring: {{i: world, j: mass, free_length: 1, spring: {stiffness}, damper: {damping}}}
"""
    return Problem(scene, exact)


def torque_free_top() -> Problem:
    """Euler's asymmetric top (Landau and Lifshitz, Mechanics, par. 37): Jacobi functions; the precession by quadrature
    of its rate."""
    I1, I2, I3 = inertia = np.array([0.010, 0.020, 0.025])
    w0 = np.array([2.0, 0.0, 3.0])
    E2, L2 = float(inertia @ w0**2), float((inertia * w0) @ (inertia * w0))
    assert L2 > E2 * I2  # rotation about the axis of largest inertia
    m = (I2 - I1) * (E2 * I3 - L2) / ((I3 - I2) * (L2 - E2 * I1))
    rate = np.sqrt((I3 - I2) * (L2 - E2 * I1) / (I1 * I2 * I3))
    size = np.sqrt(
        [(E2 * I3 - L2) / (I1 * (I3 - I1)), (E2 * I3 - L2) / (I2 * (I3 - I2)), (L2 - E2 * I1) / (I3 * (I3 - I1))]
    )

    def spin(t):
        sn, cn, dn, _ = ellipj(rate * t, m)
        return size * (cn, sn, dn)

    def precession(t):
        w = spin(t)
        return np.sqrt(L2) * (I1 * w[0] ** 2 + I2 * w[1] ** 2) / ((I1 * w[0]) ** 2 + (I2 * w[1]) ** 2)

    def in_momentum_frame(t):
        L = inertia * spin(t)
        angle, _ = quad(precession, 0.0, t, epsabs=1e-13, epsrel=1e-13, limit=400)
        return turned('z', angle) @ turned('x', np.arccos(L[2] / np.sqrt(L2))) @ turned('z', np.arctan2(L[0], L[1]))

    world = in_momentum_frame(0.0).T

    def exact(t):
        zero = np.zeros((1, 3))
        return Motion(zero, (world @ in_momentum_frame(t))[None], zero, spin(t)[None], np.empty(0))

    scene = """
mechanism:
  gravity: [0, 0, 0]
  bodies:
    body: {mass: 1, inertia: [0.010, 0.020, 0.025], angular_velocity: [2, 0, 3]}
"""
    return Problem(scene, exact)


def steady_top() -> Problem:
    """Heavy symmetric top in steady precession at 2 rad/s, tilted by 30 deg: A W^2 cos(theta) - C w3 W + m g l = 0."""
    A, C, length, tilt, W = 0.1, 0.019, 0.3, np.pi / 6, 2.0
    w3 = (A * W**2 * np.cos(tilt) + G * length) / (C * W)

    def exact(t):
        own = turned('z', (w3 - W * np.cos(tilt)) * t)
        R = turned('z', W * t) @ turned('x', tilt) @ own
        w = own.T @ np.array([0.0, W * np.sin(tilt), w3])
        axis = R[:, 2]
        force = np.array([-(W**2) * length * axis[0], -(W**2) * length * axis[1], G])
        zero = np.zeros((1, 3))
        return Motion(zero, R[None], zero, w[None], force)

    scene = f"""
mechanism:
  bodies:
    top: {{mass: 1, inertia: [0.01, 0.01, {C}], com: [0, 0, {length}], rpy_deg: [30, 0, 0], angular_velocity: [0, {W / 2}, {float(w3)!r}]}}
  joints:
    tip: {{kind: spherical, i: world, j: top}}
"""  # noqa: E501
    return Problem(scene, exact)


@cache
def heavy_body(duration: float) -> Problem:
    """Any heavy body about a fixed point: J_tip dw/dt + w x J_tip w = m c x R^T g with a quaternion, integrated
    tightly."""
    inertia, c, w0 = np.array([0.02, 0.05, 0.04]), np.array([0.1, -0.05, 0.3]), np.array([1.0, -2.0, 6.0])
    J = np.diag(inertia) + np.dot(c, c) * np.eye(3) - np.outer(c, c)

    def acceleration(w, R):
        return np.linalg.solve(J, np.cross(c, R.T @ (0, 0, -G)) - np.cross(w, J @ w))

    def rate(t, y):
        q, w = y[:4], y[4:]
        R = Rotation.from_quat(q).as_matrix()
        return np.concatenate([0.5 * np.append(q[3] * w + np.cross(q[:3], w), -q[:3] @ w), acceleration(w, R)])

    solution = cache(lambda: solve_ivp(rate, (0, duration), [0, 0, 0, 1, *w0], **TIGHT).sol)

    def exact(t):
        y = solution()(t)
        R, w = Rotation.from_quat(y[:4]).as_matrix(), y[4:]
        a = R @ (np.cross(acceleration(w, R), c) + np.cross(w, np.cross(w, c)))
        zero = np.zeros((1, 3))
        return Motion(zero, R[None], zero, w[None], a + (0, 0, G))

    scene = f"""
mechanism:
  bodies:
    body: {{mass: 1, inertia: {inertia.tolist()}, com: {c.tolist()}, angular_velocity: {w0.tolist()}}}
  joints:
    tip: {{kind: spherical, i: world, j: body}}
"""
    return Problem(scene, exact)


class FourBar:
    """Planar four-bar of uniform bars (config/mechanisms/four_bar.yaml) in its crank angle; Newton-Euler equations of
    each bar."""

    length = np.array([0.2, 0.5, 0.4])
    ground = 0.5
    mass = length  # 1 kg/m

    def __init__(self) -> None:
        self.inertia = np.array([6.666666666666667e-4, 0.010416666666666666, 0.005333333333333333])

    def angles(self, crank: float) -> np.ndarray:
        """Angles of crank, coupler and rocker: the closing point is the upper intersection of the circles about B and
        D."""
        l1, l2, l3 = self.length
        B, D = l1 * np.array([np.cos(crank), np.sin(crank)]), np.array([self.ground, 0.0])
        r = D - B
        along = (r @ r + l2**2 - l3**2) / (2 * np.sqrt(r @ r))
        n = r / np.sqrt(r @ r)
        C = B + along * n + np.sqrt(l2**2 - along**2) * np.array([-n[1], n[0]])
        return np.array([crank, np.arctan2(*(C - B)[::-1]), np.arctan2(*(C - D)[::-1])])

    def kinematics(self, crank: float, rate: float):
        """(angles, rates, (s, b)): angular accelerations of the bars are s * crank acceleration + b."""
        a = self.angles(crank)
        e, n = np.array([np.cos(a), np.sin(a)]), np.array([-np.sin(a), np.cos(a)])
        l1, l2, l3 = self.length
        loop = np.column_stack([l2 * n[:, 1], -l3 * n[:, 2]])
        ratio = np.array([1.0, *np.linalg.solve(loop, -l1 * n[:, 0])])
        w = ratio * rate
        b = np.linalg.solve(loop, l1 * e[:, 0] * w[0] ** 2 + l2 * e[:, 1] * w[1] ** 2 - l3 * e[:, 2] * w[2] ** 2)
        return a, w, (ratio, np.array([0.0, *b]))

    def balance(self, crank: float, rate: float):
        """(matrix, rhs) of the nine equations in (crank acceleration, torque on the crank, forces at A, B, D, C in x
        and z)."""
        a, w, (s, b) = self.kinematics(crank, rate)
        e, n = np.array([np.cos(a), np.sin(a)]).T, np.array([-np.sin(a), np.cos(a)]).T
        L = self.length
        M, rhs = np.zeros((9, 10)), np.zeros(9)
        # acceleration of the centres of mass = p * crank acceleration + c
        p = np.array([n[0] * L[0] / 2, n[0] * L[0] + n[1] * s[1] * L[1] / 2, n[2] * s[2] * L[2] / 2])
        c = np.array([
            -e[0] * w[0] ** 2 * L[0] / 2,
            -e[0] * w[0] ** 2 * L[0] + (n[1] * b[1] - e[1] * w[1] ** 2) * L[1] / 2,
            (n[2] * b[2] - e[2] * w[2] ** 2) * L[2] / 2,
        ])  # fmt: skip
        # forces act on: A the crank at its start, B the coupler at its start, D the rocker at its start, C the rocker
        # at its end
        ends = [(0, 2, -1, 1), (1, 4, -1, 1), (2, 6, -1, 1), (2, 8, 1, 1), (0, 4, 1, -1), (1, 8, 1, -1)]
        for k in range(3):
            M[3 * k : 3 * k + 2, 0] = -self.mass[k] * p[k]
            rhs[3 * k : 3 * k + 2] = self.mass[k] * (c[k] + (0.0, G))
            M[3 * k + 2, 0] = -self.inertia[k] * s[k]
            rhs[3 * k + 2] = self.inertia[k] * b[k]
        for bar, column, end, sign in ends:
            arm = end * L[bar] / 2 * e[bar]
            M[3 * bar, column] = M[3 * bar + 1, column + 1] = sign
            M[3 * bar + 2, column : column + 2] = sign * -arm[1], sign * arm[0]
        M[2, 1] = 1.0
        return M, rhs

    def motion(self, crank: float, rate: float, forces: np.ndarray, torque: float | None) -> Motion:
        """The Motion of the mechanism file: x-z plane, bars turn about -y; forces at A, B, D, C."""
        a, w, _ = self.kinematics(crank, rate)
        B = self.length[0] * np.array([np.cos(crank), np.sin(crank)])
        dB = self.length[0] * rate * np.array([-np.sin(crank), np.cos(crank)])
        p = np.array([[0, 0, 0], [B[0], 0, B[1]], [self.ground, 0, 0]])
        v = np.array([[0, 0, 0], [dB[0], 0, dB[1]], [0, 0, 0]])
        reaction = np.full((4, 5), np.nan)  # across the plane the constraints are redundant
        reaction[:, 0], reaction[:, 2] = forces.reshape(4, 2).T
        rows = reaction.ravel() if torque is None else np.append(reaction, torque)
        return Motion(p, np.array([turned('y', -x) for x in a]), v, np.outer(w, [0, -1, 0]), rows)


@cache
def falling_four_bar(duration: float) -> Problem:
    """The four-bar without motor, released with the crank upright: one equation for the crank angle."""
    bar = FourBar()

    def accelerate(crank, rate):
        M, rhs = bar.balance(crank, rate)
        return np.linalg.solve(np.delete(M, 1, axis=1), rhs)

    start = [np.pi / 2, 0.0]
    solution = cache(lambda: solve_ivp(lambda t, y: [y[1], accelerate(*y)[0]], (0, duration), start, **TIGHT).sol)

    def motion(t: float) -> Motion:
        crank, rate = solution()(t)
        return bar.motion(crank, rate, accelerate(crank, rate)[1:], None)

    return Problem('mechanism: mechanisms/four_bar.yaml\noverride: {mechanism.couplers: {}}', motion)


def driven_four_bar(speed: float) -> Problem:
    """The four-bar with its crank turned at constant speed [rad/s]: inverse dynamics."""
    bar = FourBar()

    def exact(t):
        crank = np.pi / 2 + speed * t
        M, rhs = bar.balance(crank, speed)
        unknown = np.linalg.solve(M[:, 1:], rhs)
        return bar.motion(crank, speed, unknown[1:], unknown[0])

    motor = f'{{kind: ramp, slope: {speed}, start: -1, initial: {-speed}}}'
    return Problem(f'mechanism: mechanisms/four_bar.yaml\nmaneuver: {{signals: {{motor: {motor}}}}}', exact)
