"""Motions under nonholonomic constraints, in closed form or from the equations in minimal coordinates (see
closed_forms.py).

The disc: e1 horizontal in its plane, e3 its axis, e2 = e3 x e1 from the contact to the centre; T the angle of e3 from
the vertical, W
the rate of precession of e1, p = W sin T, w3 the spin along e3. With angular momentum A T' e1 + A p e2 + C w3 e3 about
the centre and the
centre at r e2 from a contact point at rest, Euler's equations are
    (A + m r^2) T'' = -p ((C + m r^2) w3 - A W cos T) - m g r cos T
    A p' = T' (C w3 - A W cos T)
    (C + m r^2) w3' = m r^2 T' p
The last two are linear in (p, w3) with T as the variable: their solution is a fundamental matrix times two constants of
the motion.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from closed_forms import TIGHT, G, Motion, Problem, turned
from scipy.integrate import solve_ivp

MASS, RADIUS = 2.0, 0.5
ACROSS, ALONG, ROLL = MASS * RADIUS**2 / 4, MASS * RADIUS**2 / 2, MASS * RADIUS**2
TILT, NOD, PRECESSION = np.deg2rad(70.0), 0.8, 1.5
STEADY_SPIN = (-MASS * G * RADIUS * np.cos(TILT) / (PRECESSION * np.sin(TILT)) + ACROSS * PRECESSION * np.cos(TILT)) / (
    ALONG + ROLL
)


def spin_slopes(T: float, p: float, w3: float) -> tuple[float, float]:
    """d(p, w3)/dT of the disc."""
    return (ALONG * w3 - ACROSS * p / np.tan(T)) / ACROSS, ROLL * p / (ALONG + ROLL)


def disc_rates(_t: float, y: np.ndarray) -> list[float]:
    """Rates of T, T', azimuth of e1, p, w3, turn about the own axis, x and y of the centre."""
    T, nod, azimuth, p, w3, _, _, _ = y
    W = p / np.sin(T)
    tipping = (-p * ((ALONG + ROLL) * w3 - ACROSS * W * np.cos(T)) - MASS * G * RADIUS * np.cos(T)) / (ACROSS + ROLL)
    dp, dw3 = spin_slopes(T, p, w3)
    v = RADIUS * (turned('z', azimuth) @ turned('x', T) @ [-w3, 0.0, nod])
    return [nod, tipping, W, nod * dp, nod * dw3, w3 - W * np.cos(T), v[0], v[1]]


def rolling_disc(duration: float, nod: float = NOD) -> Problem:
    """The disc of config/mechanisms/rolling_disc.yaml; nod = 0: steady rolling in a circle."""
    start = [TILT, nod, 0.0, PRECESSION * np.sin(TILT), STEADY_SPIN, 0.0, 0.0, RADIUS * np.cos(TILT)]
    solution = cache(lambda: solve_ivp(disc_rates, (0, duration), start, **TIGHT).sol)

    def exact(t):
        y = solution()(t)
        T, nodding, azimuth, p, w3, own, px, py = y
        rates = disc_rates(t, y)
        frame, spun = turned('z', azimuth) @ turned('x', T), turned('z', own)
        v = RADIUS * frame @ [-w3, 0.0, nodding]
        W = rates[2]
        force = (
            MASS * RADIUS * np.array([-rates[4] + nodding * p, -(nodding**2) - w3 * W * np.cos(T), rates[1] + w3 * p])
        )
        fx, fy, fz = frame @ force + [0.0, 0.0, MASS * G]
        w = spun.T @ [nodding, p, w3]
        return Motion(
            np.array([[px, py, RADIUS * np.sin(T)]]), (frame @ spun)[None], v[None], w[None], np.array([fz, fx, fy])
        )

    changes = f'[{nod}, {PRECESSION * np.sin(TILT)}, {STEADY_SPIN}]'
    return Problem(
        f"""
mechanism:
  bodies:
    disc:
      mass: {MASS}
      inertia: [{ACROSS}, {ACROSS}, {ALONG}]
      position: [0, {RADIUS * np.cos(TILT)}, {RADIUS * np.sin(TILT)}]
      rpy: [{TILT}, 0, 0]
      velocity: [{-RADIUS * STEADY_SPIN}, {-RADIUS * nod * np.sin(TILT)}, {RADIUS * nod * np.cos(TILT)}]
      angular_velocity: {changes}
  contacts:
    road: {{kind: rolling, i: world, j: disc, radius: {RADIUS}}}
""",
        exact,
    )


def knife_edge() -> Problem:
    """Plate on a blade under its centre of mass, on an incline, turning: speed (g'/w) sin(w t), a cycloid; blade force
    2 m g' sin(w t)."""
    w, along, normal = 2.0, 4.905, 8.495709211125343

    def exact(t):
        s, c = np.sin(w * t), np.cos(w * t)
        p = along / (2 * w * w) * np.array([[s * s, w * t - s * c, 0.0]])
        v = along / w * s * np.array([[c, s, 0.0]])
        return Motion(
            p, turned('z', w * t)[None], v, np.array([[0, 0, w]]), np.array([normal, 0.0, 0.0, 2 * along * s])
        )

    return Problem('mechanism: mechanisms/knife_edge.yaml', exact)


def chaplygin_sleigh(duration: float) -> Problem:
    """Sleigh with its centre of mass a ahead of the blade: v = V tanh(k t + c), w = sqrt(2 E/K) / cosh(k t + c), k = a
    m V / K."""
    m, a, inertia, v0, w0 = 2.0, 0.3, 0.08, -0.4, 3.0
    K = inertia + m * a * a
    E = 0.5 * (m * v0**2 + K * w0**2)
    V, turn = np.sqrt(2 * E / m), np.sqrt(2 * E / K)
    k, c = a * m * V / K, np.arctanh(v0 / V)

    def heading(t):
        return turn / k * 2 * (np.arctan(np.tanh((k * t + c) / 2)) - np.arctan(np.tanh(c / 2)))

    def rates(t, _):
        return V * np.tanh(k * t + c) * np.array([np.cos(heading(t)), np.sin(heading(t))])

    path = cache(lambda: solve_ivp(rates, (0, duration), [0.0, 0.0], **TIGHT).sol)

    def exact(t):
        v, w = V * np.tanh(k * t + c), turn / np.cosh(k * t + c)
        blade = m * (v * w + a * (-m * a * v * w / K))
        R = turned('z', heading(t))
        return Motion(
            np.array([[*path()(t), 0.0]]),
            R[None],
            (R @ [v, 0, 0])[None],
            np.array([[0, 0, w]]),
            np.array([m * G, a * m * G, 0.0, blade]),
        )

    return Problem('mechanism: mechanisms/chaplygin_sleigh.yaml', exact)
