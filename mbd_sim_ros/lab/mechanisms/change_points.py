"""Linkages that pass change points, and their exact motions: one equation of motion each, solved to twelve digits.

All bars of a change-point linkage can lie in one line, where it could go on in another way; a motion through such a
position that keeps its energy and its momentum keeps its branch. On that branch the linkage has one angle theta, so
that with inertia J(theta), potential V(theta) and damping c

    J theta'' + J' theta'^2 / 2 + V' + c theta' = 0

is all there is: parallel cranks turn alike and their rods do not turn; the rod of a slider-crank with equal bars turns
against the crank.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import yaml
from scipy.integrate import solve_ivp

from solver.units import MODEL_GRAVITY

GRAVITY = MODEL_GRAVITY  # m/s^2, along -y in every linkage here


@dataclass(frozen=True)
class Linkage:
    """A linkage with one angle theta about z.

    scene: its data, without step and duration. theta, rate: at t = 0 [rad, rad/s]. inertia: J and J' at theta [kg m^2];
    slope: V' [N m]; damping: c [N m s]. tip: (body, point in its reference frame, place(theta)): where this point is
    [m].
    """

    name: str
    scene: dict[str, Any]
    theta: float
    rate: float
    inertia: Callable[[float], tuple[float, float]]
    slope: Callable[[float], float]
    tip: tuple[str, tuple[float, float, float], Callable[[float], np.ndarray]]
    damping: float = 0.0
    duration: float = 10.0
    _known: dict[float, Any] = field(default_factory=dict, repr=False)

    def text(self, h: float, steps: int, penalty: float) -> str:
        """The scene with a step [s], a number of steps and a penalty."""
        integrator = {**self.scene.get('integrator', {}), 'h': h, 'penalty': penalty}
        return yaml.safe_dump(
            {**self.scene, 'duration': round(h * steps, 9), 'integrator': integrator}, sort_keys=False
        )

    def at(self, t: float) -> np.ndarray:
        """Place of the tip at t [m]."""
        if not self._known:
            ends = (0.0, self.duration + 0.1)
            self._known[0.0] = solve_ivp(
                self._rates, ends, (self.theta, self.rate), 'DOP853', rtol=1e-12, atol=1e-12, dense_output=True
            ).sol
        return self.tip[2](float(self._known[0.0](t)[0]))

    def _rates(self, t: float, y: np.ndarray) -> tuple[float, float]:
        inertia, change = self.inertia(y[0])
        return y[1], -(change * y[1] ** 2 / 2.0 + self.slope(y[0]) + self.damping * y[1]) / inertia


def turned(vector: Sequence[float], angle: float) -> np.ndarray:
    """A vector of the plane, turned by an angle [rad], as (3,)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], 0.0])


@dataclass(frozen=True)
class Crank:
    """A crank: pivot, centre of mass and arms from the pivot in its own axes [m], mass [kg], inertia about its centre
    [kg m^2]."""

    pivot: tuple[float, float]
    centre: tuple[float, float]
    arms: tuple[tuple[float, float], ...]
    mass: float
    inertia: float


def parallel_cranks(
    name: str,
    cranks: Sequence[Crank],
    rods: Sequence[tuple[tuple[int, int], tuple[int, int], float]],
    theta: float,
    rate: float,
    *,
    damping: float = 0.0,
    duration: float = 10.0,
    mode: str = 'fixed',
) -> Linkage:
    """Cranks that turn alike, since rods join equal arms: each rod (crank, arm), (crank, arm), mass [kg]. damping: at
    crank 0 [N m s]. mode: of the integrator."""
    bodies: dict[str, Any] = {}
    joints: dict[str, Any] = {}
    moments, weights = 0.0, np.zeros(2)  # V = weights . (sin theta, cos theta)
    for k, crank in enumerate(cranks):
        thin = 0.1 * crank.inertia  # about the axes that do not turn
        place = np.array([*crank.pivot, 0.0]) + turned(crank.centre, theta)
        bodies[f'crank_{k}'] = _body(crank.mass, (thin, crank.inertia, crank.inertia), place)
        joints[f'A{k}'] = _revolute('world', f'crank_{k}', (*crank.pivot, 0.0))
        moments += crank.inertia + crank.mass * math.hypot(*crank.centre) ** 2
        weights += crank.mass * GRAVITY * np.array(crank.centre)
    for k, ((a, arm), (b, other), mass) in enumerate(rods):
        reach = cranks[a].arms[arm]
        if reach != cranks[b].arms[other]:
            raise ValueError(f'{name}: rod {k} joins arms {reach} and {cranks[b].arms[other]}, which are not equal')
        ends = [np.array([*cranks[c].pivot, 0.0]) + turned(reach, theta) for c in (a, b)]
        moment = mass * float(np.sum((ends[1] - ends[0]) ** 2)) / 12.0
        bodies[f'rod_{k}'] = _body(mass, (0.1 * moment, moment, moment), (ends[0] + ends[1]) / 2.0)
        joints[f'B{k}'] = _revolute(f'crank_{a}', f'rod_{k}', ends[0])
        joints[f'C{k}'] = _revolute(f'rod_{k}', f'crank_{b}', ends[1])
        moments += mass * math.hypot(*reach) ** 2
        weights += mass * GRAVITY * np.array(reach)
    mechanism: dict[str, Any] = {'gravity': [0.0, -GRAVITY, 0.0], 'bodies': bodies, 'joints': joints}
    if damping:
        mechanism['coordinate_forces'] = {'D0': {'terms': {'A0': 1.0}, 'damper': damping}}
    crank = cranks[0]
    return Linkage(
        name=name,
        scene={
            'title': name,
            'mechanism': mechanism,
            'start': {'coordinates': {'A0': {'rate': rate}}},
            'integrator': {'mode': mode},
        },
        theta=theta,
        rate=rate,
        inertia=lambda angle: (moments, 0.0),
        slope=lambda angle: float(weights @ (math.cos(angle), -math.sin(angle))),
        tip=('crank_0', (0.0, 0.0, 0.0), lambda angle: np.array([*crank.pivot, 0.0]) + turned(crank.centre, angle)),
        damping=damping,
        duration=duration,
    )


def equal_slider_crank(
    name: str, length: float, masses: Sequence[float], theta: float, rate: float, duration: float = 10.0
) -> Linkage:
    """Crank and rod of one length [m] and a slider along x, of these masses [kg]: singular where the slider is at the
    pivot."""
    crank, rod, slider = masses
    of_crank, of_rod = crank * length**2 / 12.0, rod * length**2 / 12.0

    def end(angle: float) -> np.ndarray:
        return turned((length, 0.0), angle)

    a, b = end(theta), np.array([2.0 * length * math.cos(theta), 0.0, 0.0])
    bodies = {
        'crank': _body(crank, (0.1 * of_crank, of_crank, of_crank), a / 2.0),
        'rod': _body(rod, (0.1 * of_rod, of_rod, of_rod), (a + b) / 2.0),
        'slider': _body(slider, [0.01 * slider * length**2] * 3, b),
    }
    joints = {
        'A0': _revolute('world', 'crank', (0.0, 0.0, 0.0)),
        'A1': _revolute('crank', 'rod', a),
        'A2': _revolute('rod', 'slider', b),
        'S': {'kind': 'prismatic', 'i': 'world', 'j': 'slider', 'at': b.tolist(), 'axis': [1.0, 0.0, 0.0]},
    }
    round_ = crank * length**2 / 3.0 + of_rod + rod * length**2 / 4.0  # of what turns with a constant radius
    along = (2.0 * rod + 4.0 * slider) * length**2  # times sin(theta)^2

    return Linkage(
        name=name,
        scene={
            'title': name,
            'mechanism': {'gravity': [0.0, -GRAVITY, 0.0], 'bodies': bodies, 'joints': joints},
            'start': {'coordinates': {'A0': {'rate': rate}}},
        },
        theta=theta,
        rate=rate,
        inertia=lambda angle: (round_ + along * math.sin(angle) ** 2, along * math.sin(2.0 * angle)),
        slope=lambda angle: (crank + rod) * GRAVITY * length / 2.0 * math.cos(angle),
        tip=('crank', (0.0, 0.0, 0.0), lambda angle: end(angle) / 2.0),
        duration=duration,
    )


def four_bar_n(loops: int) -> Linkage:
    """The delivered linkage and its scene: cranks and rods of 1 m and 1 kg."""
    cranks, rods, weight = loops + 1, loops, GRAVITY
    return Linkage(
        name=f'four_bar_n_{loops}',
        scene={
            'mechanism': {'kind': 'four_bar_n', 'loops': loops},
            'start': {'coordinates': {'A0': {'rate': -1.0}}},
            'integrator': {'rho_inf': 0.8, 'mode': 'tolerance'},
        },
        theta=math.pi / 2.0,
        rate=-1.0,
        inertia=lambda angle: (cranks / 3.0 + rods, 0.0),
        slope=lambda angle: (cranks / 2.0 + rods) * weight * math.cos(angle),
        tip=('crank_0', (1.0, 0.0, 0.0), lambda angle: turned((1.0, 0.0), angle)),
    )


def linkages() -> tuple[Linkage, ...]:
    """All linkages of the study: the delivered one with three numbers of loops, a six-bar in both modes, three
    relatives."""
    rod = (0.5, 0.0)
    bell = ((0.6, 0.0), (-0.2, 0.5))  # arms of the bell crank: its parallelograms are singular at different angles
    six = (
        Crank((0.0, 0.0), (0.3, 0.0), bell[:1], 1.0, 0.03),
        Crank((0.9, 0.0), (0.1, 0.15), bell, 2.0, 0.09),
        Crank((1.6, 0.35), (-0.1, 0.25), bell[1:], 0.8, 0.025),
    )
    rods = (((0, 0), (1, 0), 0.7), ((1, 1), (2, 0), 0.5))
    return (
        *(four_bar_n(loops) for loops in (2, 5, 10)),
        parallel_cranks('six_bar', six, rods, 2.0, -1.0),
        parallel_cranks('six_bar_tolerance', six, rods, 2.0, -1.0, mode='tolerance'),
        parallel_cranks(
            'rhombus',
            (Crank((0.0, 0.0), (0.25, 0.0), (rod,), 3.0, 0.06), Crank((0.3, 0.4), (0.25, 0.02), (rod,), 0.2, 0.004)),
            (((0, 0), (1, 0), 0.4),),
            1.2,
            5.0,
            damping=0.02,
        ),
        parallel_cranks(
            'small_links',
            (
                Crank((0.0, 0.0), (0.01, 0.0), ((0.02, 0.0),), 2e-3, 1e-7),
                Crank((0.03, 0.0), (0.01, 0.0), ((0.02, 0.0),), 1e-3, 1e-7),
                Crank((0.06, 0.0), (0.01, 0.0), ((0.02, 0.0),), 2e-3, 1e-7),
            ),
            (((0, 0), (1, 0), 2e-3), ((1, 0), (2, 0), 1e-3)),
            1.0,
            -10.0,
            duration=1.5,
        ),
        equal_slider_crank('equal_slider_crank', 0.4, (1.0, 0.6, 2.0), 0.5, 7.0, 5.0),
    )


def _body(mass: float, inertia: Sequence[float], position: np.ndarray) -> dict[str, Any]:
    return {'mass': mass, 'inertia': [float(x) for x in inertia], 'position': [float(x) for x in position]}


def _revolute(i: str, j: str, at: Sequence[float] | np.ndarray) -> dict[str, Any]:
    return {'kind': 'revolute', 'i': i, 'j': j, 'at': [float(x) for x in at], 'axis': [0.0, 0.0, 1.0]}
