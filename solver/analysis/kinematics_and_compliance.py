"""A test bench for kinematics and compliance: curves of toe, camber, load over wheel travel, steering and loads at the
tires.

The rig holds the chassis in its design position, takes the tires off, locks the wheels to their carriers, and
prescribes the wheel travels and the steering wheel; power steering helps as on the road (ASSISTED_AT). Travels, loads
and speeds are those of passenger cars and grow with the vehicle (solver.vehicle.size). Every point of a sweep is a
static equilibrium. It works on any vehicle model whose corners are called front_left ... and that has the coordinates
wheel_<corner> and travel_<corner> (docs/vehicle.md). Angles in rad, SI units; signs:

    toe      positive: toe-in            camber   negative: top inwards
    steer    road-wheel angle, positive to the left
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from solver.analysis.modes import AXLES
from solver.elements.applied_force import AppliedForceSpec
from solver.elements.coupler import CouplerSpec
from solver.elements.joint import JointSpec
from solver.elements.marker import WORLD, Marker
from solver.errors import ConsistencyError
from solver.inputs.maneuver import ACCELERATION, RATE
from solver.model.evaluate import prepare
from solver.model.frames import matrix
from solver.model.spec import ModelSpec
from solver.model.state import new_state
from solver.start.equilibrium import Equilibrium
from solver.vehicle.hardpoints import SIDES
from solver.vehicle.size import size_of

CORNERS = tuple(f'{axle}_{side}' for axle in AXLES for side in SIDES)
LOADS = {'fx': ('force', (1.0, 0.0, 0.0)), 'fy': ('force', (0.0, 1.0, 0.0)), 'mz': ('torque', (0.0, 0.0, 1.0))}
AT_CENTER = {
    'cx': ('force', (1.0, 0.0, 0.0)),
    'cy': ('force', (0.0, 1.0, 0.0)),
    'mx': ('torque', (1.0, 0.0, 0.0)),
    'my': ('torque', (0.0, 1.0, 0.0)),
}
STEPS = {'travel': 0.03, 'steering': 0.5}  # largest change of an input of the rig at once [m or rad]
# steps for one of STEPS, each with its equilibrium, where guides push wheels the harder the further these are moved
# without
GUIDED = 4.0
ASSISTED_AT = 22.0  # m/s: power steering helps as at this speed, that of the ramp for the understeer gradient
TURNED = 0.35  # rad of the road wheels, for Ackermann's share
HOLD = 1e6  # brake input that locks wheels [N m]


def wheel_centers(spec: ModelSpec) -> dict[str, np.ndarray]:
    """Corner -> centre of the wheel in the design position (3,) [m]."""
    bodies = {b.name: b for b in spec.bodies}
    return {
        t.name: np.array(bodies[t.marker.body].position)
        + matrix(bodies[t.marker.body].orientation) @ np.array(t.marker.position)
        for t in spec.tires
    }


class Rig:
    """A kinematics and compliance test bench for a vehicle model; see the module.

    at_center: with inputs for what else a wheel can be loaded with and moved by: forces cx_<corner>, cy_ [N] at the
    wheel centre, moments mx_, my_ [N m], and the angle spin_ [rad] of the wheel in its carrier. Wheels without a
    bearing are locked by their brakes.
    """

    def __init__(self, spec: ModelSpec, *, at_center: bool = False) -> None:
        self.spec, self.size = spec, size_of(spec)
        self.centers = wheel_centers(spec)
        bodies = {b.name: b for b in spec.bodies}
        chassis = bodies[spec.chassis or spec.bodies[0].name]
        carrier = {}
        for joint in spec.joints:
            for tire in spec.tires:
                if joint.name == f'wheel_{tire.name}':
                    carrier[tire.name] = joint.i.body if joint.j.body == tire.marker.body else joint.j.body
        self._locked = {} if carrier else dict.fromkeys({guide.input for guide in spec.guides}, HOLD * self.size.torque)
        spin = [f'spin_{c}' for c in CORNERS] if at_center else [None] * len(CORNERS)
        rows = [
            CouplerSpec(
                name=f'hold_{c}', terms=((f'wheel_{c}', 1.0),), offset=None if name is None else 0.0, input=name
            )
            for c, name in zip(CORNERS, spin, strict=True)
            if c in carrier
        ]
        rows += [
            CouplerSpec(name=f'travel_{c}', terms=((f'travel_{c}', 1.0),), offset=0.0, input=f'travel_{c}')
            for c in CORNERS
        ]
        loads = []
        for c in CORNERS:
            b = bodies[carrier.get(c) or next(tire.marker.body for tire in spec.tires if tire.name == c)]
            center = self.centers[c]
            for here, height in ((LOADS, 0.0), (AT_CENTER if at_center else {}, float(center[2]))):
                # a body that may turn about the spin axis is loaded at its centre by the force and its moment
                free = c not in carrier
                at = center if free else np.array([*center[:2], height])
                x, y, z = (float(v) for v in matrix(b.orientation).T @ (at - np.array(b.position)))
                marker = Marker(body=b.name, position=(x, y, z))
                for n, (kind, direction) in here.items():
                    load: dict[str, Any] = {kind: direction}
                    if free and kind == 'force':
                        load['torque'] = tuple(np.cross((0.0, 0.0, height - center[2]), direction).tolist())
                    loads.append(AppliedForceSpec(name=f'{n}_{c}', marker=marker, input=f'{n}_{c}', **load))
        driven = [row.input for row in rows if row.input is not None]
        names = [n + end for n in driven for end in ('', RATE, ACCELERATION)] + [f.name for f in loads]
        fixed = JointSpec(
            name='rig',
            kind='fixed',
            i=Marker(body=WORLD, position=chassis.position, orientation=chassis.orientation),
            j=Marker(body=chassis.name),
        )
        self.inputs = (*spec.inputs, *names)
        model = ModelSpec(
            **{
                **spec.__dict__,
                'joints': (*spec.joints, fixed),
                'couplers': (*spec.couplers, *rows),
                'applied_forces': (*spec.applied_forces, *loads),
                'servos': tuple(servo.at_speed(ASSISTED_AT * self.size.speed) for servo in spec.servos),
                'tires': (),
                'inputs': self.inputs,
            }
        )
        self.model = prepare(model)
        self.start = Equilibrium(self.model)
        self.reset()

    def reset(self) -> None:
        """To the equilibrium of the design position, from the placement."""
        self.state = new_state(self.model)
        self._u = np.zeros(len(self.inputs))
        self.settle({})

    def settle(self, inputs: Mapping[str, float]) -> dict[str, dict[str, float]]:
        """Equilibrium under the given inputs (travel_<corner> [m], steering [rad], fx_, fy_ [N] or mz_<corner> [N m] at
        the contact patch); returns by corner toe, camber, steer [rad], x, y of wheel centre and contact patch relative
        to the design [m], load: vertical force at the wheel [N]."""
        before, u = self._u, np.array([inputs.get(name, self._locked.get(name, 0.0)) for name in self.inputs])
        steps = {**STEPS, 'travel': STEPS['travel'] * self.size.length}
        limits = np.array([steps.get(name.partition('_')[0], np.inf) for name in self.inputs])
        finer = GUIDED if self.spec.guides else 1.0
        count = max(1, int(np.ceil(finer * np.max(np.abs(u - before) / limits))))
        # an equilibrium each: what stands on soft rubber would be led to another one from farther away
        for k in range(1, count + 1):
            way = u if k == count else before + (u - before) * (k / count)
            self.start.assemble(self.state, way)
            self.start.equilibrium(self.state, way)
        self._u = u
        return {c: self._corner(c) for c in CORNERS}

    def _corner(self, corner: str) -> dict[str, float]:
        tire = next(t for t in self.spec.tires if t.name == corner)
        b = self.model.body_names.index(tire.marker.body)
        side = SIDES[corner.partition('_')[2]]
        R = matrix(tuple(self.state.q[b, 3:]))
        center = self.state.q[b, :3] + R @ np.subtract(tire.marker.position, self.spec.bodies[b].com)
        s = R @ matrix(tire.marker.orientation)[:, 1]
        up = np.array([0.0, 0.0, 1.0]) - s[2] * s
        contact = center - self.centers[corner][2] * up / np.linalg.norm(up)
        at = self.centers[corner]
        row = self.model.row_names.index(f'travel_{corner}')
        return {
            'toe': side * float(np.arctan2(s[0], s[1])),
            'steer': float(np.arctan2(-s[0], s[1])),
            'camber': -side * float(np.arcsin(s[2])),
            'center_x': float(center[0] - at[0]),
            'center_y': float(center[1] - at[1]),
            'contact_x': float(contact[0] - at[0]),
            'contact_y': float(contact[1] - at[1]),
            'load': float(self.state.lam[row]),
        }

    def travel(self, values: Sequence[float], *, opposite: bool = False) -> dict[str, dict[str, np.ndarray]]:
        """Sweep of all wheels in parallel, or left and right opposite (left in bump); curves over the left travel by
        corner."""
        return self._sweep(
            [{f'travel_{c}': z * (SIDES[c.partition('_')[2]] if opposite else 1.0) for c in CORNERS} for z in values]
        )

    def steering(self, values: Sequence[float]) -> dict[str, dict[str, np.ndarray]]:
        """Sweep of the steering wheel [rad]."""
        return self._sweep([{'steering': angle} for angle in values])

    def loading(
        self, load: str, values: Sequence[float], *, opposite: bool = False
    ) -> dict[str, dict[str, np.ndarray]]:
        """Sweep of one load at all wheels (see LOADS), equal or of opposite sign left and right."""
        return self._sweep(
            [{f'{load}_{c}': f * (SIDES[c.partition('_')[2]] if opposite else 1.0) for c in CORNERS} for f in values]
        )

    def _sweep(self, points: Sequence[Mapping[str, float]]) -> dict[str, dict[str, np.ndarray]]:
        results = [self.settle(point) for point in points]
        self.settle({})
        return {c: {key: np.array([r[c][key] for r in results]) for key in results[0][c]} for c in CORNERS}


def kinematic_figures(rig: Rig, step: float = 0.01) -> dict[str, float]:
    """Slopes at the design position from central differences over +- step [m] of a passenger car: per axle wheel rate
    [N/m], roll stiffness [N m/rad], roll-centre height [m] (in roll, so that it holds for dependent suspensions too),
    toe and camber change [rad/m], roll steer (to the left per roll to the right [-]); the ratio of steering wheel to
    mean road wheel [-] and the share of Ackermann's condition [-]; compliances: toe by lateral force, both to the left
    (left wheel, [rad/N], positive: towards the force) and by aligning moment [rad/(N m)], longitudinal displacement by
    braking force [m/N], for models with bushings."""
    step, force, moment = step * rig.size.length, 1000.0 * rig.size.mass, 50.0 * rig.size.torque
    both, roll = rig.travel([-step, step]), rig.travel([-step, step], opposite=True)
    side, brake, align = (
        rig.loading('fy', [-force, force]),
        rig.loading('fx', [-force, force]),
        rig.loading('mz', [-moment, moment]),
    )
    steer = rig.steering([-0.2, 0.2])
    figures: dict[str, float] = {}
    for axle in AXLES:
        c = f'{axle}_left'
        track = rig.centers[c][1] - rig.centers[f'{axle}_right'][1]

        def slope(curves: dict[str, dict[str, np.ndarray]], key: str, width: float, c: str = c) -> float:
            low, high = curves[c][key]
            return float((high - low) / (2.0 * width))

        figures |= {
            f'wheel_rate_{axle}': slope(both, 'load', step),
            f'roll_stiffness_{axle}': 0.5 * slope(roll, 'load', step) * track * track,
            f'roll_center_{axle}': 0.5 * track * slope(roll, 'contact_y', step),
            f'bump_toe_{axle}': slope(both, 'toe', step),
            f'bump_camber_{axle}': slope(both, 'camber', step),
            # opposite travel z of the left wheel is a roll angle of the body of -2 z / track
            f'roll_steer_{axle}': -0.5 * track * slope(roll, 'steer', step),
        }
        if rig.spec.bushings or rig.spec.guides:
            figures |= {
                f'lateral_steer_{axle}': slope(side, 'steer', force),
                f'lateral_compliance_{axle}': slope(side, 'contact_y', force),
                f'longitudinal_compliance_{axle}': slope(brake, 'center_x', force),
                f'aligning_steer_{axle}': slope(align, 'steer', moment),
            }
    mean = 0.5 * (steer['front_left']['steer'] + steer['front_right']['steer'])
    figures['steering_ratio'] = float(0.4 / (mean[1] - mean[0]))
    with suppress(ConsistencyError):  # of a steering that does not turn so far there is none
        turned = rig.steering([TURNED * figures['steering_ratio']])
        inner, outer = (float(turned[f'front_{side}']['steer'][0]) for side in SIDES)
        figures['ackermann'] = ackermann_share(rig, inner, outer)
    return figures


def ackermann(rig: Rig, inner: float) -> float:
    """Angle [rad] of the outer wheel with which both front wheels roll about one point on the rear axle's line."""
    at = rig.centers
    base = at['front_left'][0] - at['rear_left'][0]
    track = at['front_left'][1] - at['front_right'][1]
    return float(np.arctan(1.0 / (1.0 / np.tan(inner) + track / base)))


def ackermann_share(rig: Rig, inner: float, outer: float) -> float:
    """Angle by which the inner wheel turns more than the outer one [rad both], over the angle with which both would
    roll about one point."""
    return (inner - outer) / (inner - ackermann(rig, inner))
