"""The level `single_track`: two axles on a plane, with roll, identified from runs of the whole vehicle.

Conserved are mass, centre of mass, inertia of yaw and roll and their product, loads of the axles, wheelbase and tracks, the inertia of all
that turns with the wheels, the drag, the shares of drive and brakes, the gear from the steering wheel to the road wheels. Measured on the
whole vehicle, on a flat road of friction 1:

    creeping with the steering turned      gear of the steering
    driving and braking straight on        rolling radii and resistance, stiffness against slip, load moved and its lag, pitch
    braking more and more                  longitudinal peaks
    ramp steer, step steer at two speeds   characteristics and relaxation of both axles, roll steer, roll

The last group by least squares of yaw rate, lateral velocity and roll over time, the level itself driving the same inputs
(Levenberg-Marquardt with explicit start; sums, products and the solution of the normal equations have the same bits on every processor).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from solver.analysis.figures import standing
from solver.analysis.modes import named_modes
from solver.compiled.by_reference import Ref
from solver.compiled.portable import inverse, product
from solver.elements.joint import JointSpec
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.road import RoadSpec
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.errors import SceneError
from solver.inputs.maneuver import Maneuver
from solver.inputs.signals import Ramp, Step
from solver.levels.derived import Derived, LevelReport, Limit
from solver.levels.kept import kept
from solver.levels.single_track_simulation import COMMANDS, SingleTrackSimulation, new_frame, new_scratch, rolling, tables_of
from solver.levels.track_runs import CORNERS, EVERY, Drive, H, Run, driven, whole
from solver.model.frames import matrix
from solver.model.spec import ModelSpec
from solver.scene import Scene
from solver.step.single_track import FY, ROLL, SATURATION, SHIFT, SingleTrackTables, advance
from solver.vehicle.hardpoints import marker_at

AXLES = ('front', 'rear')
SPEED, FAST = 22.0, 33.0  # m/s
LATERAL = 4.0  # m/s^2 that the steps are meant for
RAMP = 12.0  # m/s^2 that the ramp would end at if nothing saturated
BRAKING = 5.0  # m/s^2
DRIVING = 1.5  # m/s^2
SATURATED = 7.0  # m/s^2: what is beyond weighs less and less
PRIOR = 0.02  # weight of the start of a parameter against all that was measured
SLOW = 3.0  # m/s: runs straight on are looked at above
SLIP = 0.15  # of the brakes: up to there the characteristic along is fitted
LEAST_SHARE = 0.02  # of the drive torque: less is none
UNDERSTEER = 0.003  # rad s^2/m that runs in bends are laid out with
LAGS = tuple(0.02 * 1.05**k for k in range(60))  # s
SCALES = {'curvature_y': 1.0, 'roll_steer': 0.1, 'axis': 0.1}  # of unknowns that may start at zero; the others are relative to their start
ERROR = 0.05  # of the peak: what the level is meant to keep, and its limits follow from


def derive(scene: Scene) -> Derived:
    """The level `single_track` of a scene. Raises SceneError."""
    model = scene.model
    where = f"scene {scene.name!r}: fidelity = 'single_track'"
    if {tire.name for tire in model.tires} != set(CORNERS):
        raise SceneError(f'{where}: needs the wheels {", ".join(CORNERS)}; name the tires of the vehicle so')
    missing = [name for name in COMMANDS if name not in model.inputs]
    if missing:
        raise SceneError(f'{where}: the vehicle has no input {missing[0]!r}; take another level')
    other = [name for name in scene.maneuver.channels if name not in COMMANDS]
    if other:
        raise SceneError(f'{where}: maneuver: {other[0]!r} acts on what this level does not model; remove it or take another level')
    found = kept('single_track', repr(dataclasses.replace(model, road=RoadSpec())), lambda: identified(model))
    parameters = {name: found[name] for name in ('mounting', 'body', 'front', 'rear')}
    report = LevelReport(
        lost=(
            'left and right of an axle: wheel loads and forces of single wheels, wheel lift',
            'travel of the wheels, bounce, pitch as a motion of its own, wheel hop, engine and subframes on their mounts',
            'unevenness and slope of the road; friction counts as the mean of both wheels of an axle',
            'torsion of steering and driveline',
            'growth of lateral stiffness with the load: braked with 0.3 g in a bend of 0.3 g, yaw rate is 5 to 8 % wrong',
        ),
        validity=tuple(Limit(**limit) for limit in found['validity']),
    )
    given = dataclasses.replace(scene, model=shown(model), require=dataclasses.replace(scene.require, accuracy={}))
    return Derived(
        scene=given, level='single_track', report=report, simulate=functools.partial(SingleTrackSimulation, parameters=parameters)
    )


def shown(model: ModelSpec) -> ModelSpec:
    """What the level shows of a vehicle: chassis with all mass, wheels and steering wheel on it."""
    bodies = {b.name: b for b in model.bodies}
    chassis = bodies[model.chassis or model.bodies[0].name]
    wheels = {tire.name: bodies[tire.marker.body] for tire in model.tires}
    joints = []
    for corner, wheel in wheels.items():
        at = _axis(wheel, corner, model)
        joints.append(JointSpec(name=f'wheel_{corner}', kind='revolute', i=marker_at(chassis, *at), j=marker_at(wheel, *at)))
    shown_bodies = [*wheels.values()]
    for joint in model.joints:
        if joint.name == 'steering_wheel' and joint.i.body == chassis.name:
            shown_bodies.append(bodies[joint.j.body])
            joints.append(joint)
    mass = sum(b.mass for b in model.bodies) - sum(b.mass for b in shown_bodies)
    whole_ = dataclasses.replace(chassis, mass=mass)
    return ModelSpec(
        bodies=(whole_, *shown_bodies), joints=tuple(joints), road=model.road, gravity=model.gravity, inputs=model.inputs,
        chassis=chassis.name,
    )  # fmt: skip


def _axis(wheel: RigidBodySpec, corner: str, model: ModelSpec) -> tuple[Any, Any]:
    """(centre, axis of spin) of a wheel in the design position."""
    tire = next(t for t in model.tires if t.name == corner)
    R = np.array(matrix(wheel.orientation))
    centre = np.array(wheel.position) + product(R, tire.marker.position)
    axis = product(R, np.array(matrix(tire.marker.orientation))[:, 1])
    return tuple(centre.tolist()), tuple(axis.tolist())


# -- what is conserved ------------------------------------------------------------------------------------------------------------------


def masses(model: ModelSpec) -> dict[str, Any]:
    """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m^2] of all bodies in the design position."""
    placed = [(b, np.array(matrix(b.orientation)), np.array(b.position)) for b in model.bodies]
    placed = [(b, R, p + product(R, b.com)) for b, R, p in placed]
    mass = sum(b.mass for b, _, _ in placed)
    com = sum(b.mass * p for b, _, p in placed) / mass
    inertia = np.zeros((3, 3))
    for b, R, p in placed:
        d = p - com
        inertia += product(product(R, b.inertia_matrix()), R.T.copy()) + b.mass * (product(d, d) * np.eye(3) - d[:, None] * d)
    return {'mass': mass, 'com': com, 'inertia': inertia}


def turning(model: ModelSpec, speed: float) -> tuple[dict[str, float], float]:
    """(inertia of both wheels of each axle, inertia of all else that turns with them), in kg m^2 of the mean spin of its axle.

    From the kinetic energy of a vehicle that rolls straight on: nothing else turns then.
    """
    simulation = whole(model, Drive(speed=speed, maneuver=Maneuver(), duration=1.0))
    state, spec = simulation.state, simulation.model.spec
    energy = {b.name: float(product(product(w, b.inertia_matrix()), w)) for b, w in zip(spec.bodies, state.v[:-1, 3:], strict=True)}
    spin = float(np.mean(simulation.snapshot().tire[:, TIRE_COLUMNS.index('spin')]))
    own = dict.fromkeys(AXLES, 0.0)
    for tire in spec.tires:
        own[tire.name.partition('_')[0]] += energy.pop(tire.marker.body)
    return {axle: value / spin**2 for axle, value in own.items()}, sum(energy.values()) / spin**2


def drag(model: ModelSpec) -> float:
    """Drag over the square of the speed [kg/m]."""
    return float(sum(0.5 * a.air_density * a.drag_area for a in model.aero_drags))


def top_spin(model: ModelSpec) -> float:
    """Spin at which the drive torque ends [rad/s], 0: never."""
    for force in model.coordinate_forces:
        if force.input == 'drive_torque' and force.top_rate:
            return float(force.top_rate / abs(sum(factor for _, factor in force.terms)))
    return 0.0


def brakes(model: ModelSpec, axle: str) -> tuple[float, float]:
    """(stiffness [N m/rad], damping [N m s/rad]) of the wind-up of the brakes of an axle."""
    found = [b for b in model.brakes if b.coordinate.startswith(f'wheel_{axle}')]
    if not found:
        return 4e4, 200.0
    return float(sum(b.stiffness for b in found)), float(sum(b.damping for b in found)) or 1e-3 * float(sum(b.stiffness for b in found))


# -- small numerics ---------------------------------------------------------------------------------------------------------------------


def fitted(columns: list[np.ndarray], right: np.ndarray) -> np.ndarray:
    """Coefficients x of the least squares of sum columns x = right, by the normal equations of columns of unit length."""
    A = np.stack(columns, axis=1)
    size = np.sqrt(np.add.reduce(A * A, axis=0))
    A = A / size
    N = product(A.T.copy(), A)
    return product(inverse(N[None])[0], product(A.T.copy(), right)) / size


def least_squares(residual: Callable[[np.ndarray], np.ndarray], x: np.ndarray, *, most: int = 40) -> np.ndarray:
    """x of the smallest sum of squares of residual(x), near the start x: Levenberg-Marquardt with forward differences of 1e-4.

    All of x should be of order one. Source: Nocedal and Wright, Numerical Optimization, 10.3.
    """
    damping, r = 1e-3, residual(x)
    cost = float(np.add.reduce(r * r))
    for _ in range(most):
        J = np.empty((len(r), len(x)))
        for k in range(len(x)):
            moved = x.copy()
            moved[k] += 1e-4
            J[:, k] = (residual(moved) - r) / 1e-4
        N, g = product(J.T.copy(), J), product(J.T.copy(), r)
        diagonal = np.diag(N).copy()
        for _ in range(10):
            step = -product(inverse((N + damping * np.diag(diagonal + 1e-12))[None])[0], g)
            tried = residual(x + step)
            now = float(np.add.reduce(tried * tried))
            if math.isfinite(now) and now < cost:
                break
            damping *= 5.0
        else:
            return x
        gain, cost, r, x = (cost - now) / cost, now, tried, x + step
        damping = max(0.2 * damping, 1e-9)
        if gain < 1e-5:
            break
    return x


# -- identification ---------------------------------------------------------------------------------------------------------------------


def heading(qx: np.ndarray, qy: np.ndarray, qz: np.ndarray, qw: np.ndarray) -> np.ndarray:
    """Yaw of quaternions [rad]."""
    return each(math.atan2, 2.0 * (qx * qy + qz * qw), 1.0 - 2.0 * (qy * qy + qz * qz))


def each(function: Callable[..., float], *arguments: np.ndarray) -> np.ndarray:
    """A function of the C library of every number (docs/decisions/0008-same-bits-on-every-processor.md)."""
    return np.array([function(*numbers) for numbers in zip(*(a.tolist() for a in arguments), strict=True)])


def roll_of(run: Run) -> np.ndarray:
    """Roll of the chassis [rad]."""
    x, y, z, w = run.pose.T
    return each(math.atan2, 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))


def pitch_of(run: Run) -> np.ndarray:
    """Pitch of the chassis [rad]."""
    x, y, z, w = run.pose.T
    return each(math.asin, 2.0 * (w * y - z * x))


def gear(model: ModelSpec) -> tuple[float, float]:
    """(ratio, ratio_3): mean angle of the front wheels = ratio s + ratio_3 s^3 of the steering wheel, creeping."""
    run = driven(model, Drive(speed=2.0, maneuver=Maneuver(steering=Ramp(slope=1.0, start=0.5)), duration=6.0))
    q = [run.tire[name] for name in ('qx', 'qy', 'qz', 'qw')]
    wheels = 0.5 * (heading(*(c[:, 0] for c in q)) + heading(*(c[:, 1] for c in q)))
    angle = wheels - heading(*run.pose.T)
    s = run.inputs[EVERY - 1 :: EVERY, run.names.index('steering')]
    ratio, ratio_3 = fitted([s, s * s * s], angle)
    return float(ratio), float(ratio_3)


def straight(model: ModelSpec, mass: float) -> tuple[dict[str, dict[str, float]], dict[str, float], Run]:
    """(parameters of both axles, of body and mounting) that runs straight on tell, and the run that ended with locked wheels."""
    wheels, rest = turning(model, SPEED)
    R0 = {t.name.partition('_')[0]: t.data.values['UNLOADED_RADIUS'] for t in model.tires}
    torque = 0.5 * mass * (R0['front'] + R0['rear'])  # N m per m/s^2
    steps = {
        'push': Drive(speed=SPEED, maneuver=Maneuver(drive_torque=Step(value=DRIVING * torque, start=0.5, rise=0.1)), duration=3.0),
        'stop': Drive(speed=SPEED, maneuver=Maneuver(brake_torque=Step(value=BRAKING * torque, start=0.5, rise=0.1)), duration=4.0),
        'lock': Drive(speed=35.0, maneuver=Maneuver(brake_torque=Ramp(slope=4.0 * torque, start=0.2)), duration=5.0),
    }
    free = driven(model, Drive(speed=SPEED, maneuver=Maneuver(), duration=0.6))
    push, stop, lock = (driven(model, drive) for drive in steps.values())
    axles = {}
    for i, axle in enumerate(AXLES):
        load = float(np.mean(free.axle('fz')[:, i]))
        lever = R0[axle] - 0.5 * float(np.mean(free.axle('deflection')[:, i]))
        stiffness, peak, shape = along(lock, i, load)
        axles[axle] = {
            'load': load,
            'radius': lever,
            'rolling_radius': float(np.mean((1.0 + 0.5 * free.axle('kappa')[:, i]) * free.vx / free.spin[:, i])),
            'resistance': -float(np.mean(free.axle('my')[:, i])) / (load * lever),
            'half_track': 0.5 * float(np.mean(free.tire['py'][:, 2 * i] - free.tire['py'][:, 2 * i + 1])),
            'inertia': wheels[axle],
            'stiffness_x': stiffness,
            'peak_x': peak,
            'shape_x': shape,
            'brake': share(stop, 'brake_torque', i, lever, -wheels[axle]),
            'drive': share(push, 'drive_torque', i, lever, wheels[axle]),
        }
    driving = {axle: found['drive'] for axle, found in axles.items()}
    for i, axle in enumerate(AXLES):
        whole_ = sum(max(d, 0.0) for d in driving.values())
        part = max(driving[axle], 0.0) / whole_ if whole_ > LEAST_SHARE else 0.0
        if part < LEAST_SHARE:
            axles[axle]['drive'] = 0.0
            continue
        axles[axle]['inertia'] += part * rest
        axles[axle]['drive'] = share(push, 'drive_torque', i, axles[axle]['radius'], axles[axle]['inertia'])
    moved = stop.axle('fz')[:, 1] - axles['rear']['load']
    force = stop.axle('fx').sum(axis=1)
    steady = (stop.time > 1.0) & (stop.vx > SLOW)
    height = float(fitted([force[steady]], moved[steady])[0])
    pitch = pitch_of(stop)
    level = float(np.mean(pitch_of(free)))
    return (
        axles,
        {
            'height': height,
            'lag': lag(height * force, moved, H * EVERY),
            'pitch': level,
            'pitch_by_shift': float(fitted([moved[steady]], (pitch - level)[steady])[0]),
            'z': float(np.mean(free.height)),
        },
        lock,
    )


def along(run: Run, i: int, load: float) -> tuple[float, float, float]:
    """(stiffness [N], peak [N], shape) of an axle's force against slip, from a run that brakes more and more, up to SLIP."""
    slip = -0.5 * run.axle('kappa')[:, i]
    used = (slip > 0.0) & (slip < SLIP) & (run.vx > SLOW)
    share = np.maximum(run.axle('fz')[:, i] / load, 0.05)[used]
    slip, force = slip[used], -run.axle('fx')[:, i][used] / load
    if len(slip) < 10:  # nothing brakes this axle
        return 20.0 * load, load, 1.5

    def residual(x: np.ndarray) -> np.ndarray:
        K, D, C = 20.0 * (1.0 + x[0]), 1.0 + x[1], 1.5 + x[2]
        wanted = D * characteristic(K * slip / (D * share), C, 0.0) * share
        return np.concatenate([(wanted - force) / math.sqrt(len(force)), PRIOR * x])

    x = least_squares(residual, np.zeros(3)).tolist()
    return 20.0 * load * (1.0 + x[0]), load * (1.0 + x[1]), 1.5 + x[2]


def characteristic(s: np.ndarray, C: float, E: float) -> np.ndarray:
    """Force over its peak at the slip s, relative to peak over stiffness (solver.step.single_track)."""
    x = s / C
    return each(math.sin, C * each(math.atan, x - E * (x - each(math.atan, x))))


def share(run: Run, given: str, i: int, lever: float, inertia: float) -> float:
    """Share of the torque `given` that the balance of an axle's spin shows; the inertia counts with the sign of the torque."""
    u = run.inputs[EVERY - 1 :: EVERY, run.names.index(given)]
    late = (run.time > 1.0) & (run.vx > SLOW) & (u > 0.0)
    spinning = np.gradient(run.spin[:, i], run.time)
    balance = lever * run.axle('fx')[:, i] - run.axle('my')[:, i]
    sign = 1.0 if inertia > 0.0 else -1.0
    return float(np.mean((sign * balance + inertia * spinning)[late] / u[late]))


def lag(wanted: np.ndarray, found: np.ndarray, h: float) -> float:
    """Time constant [s] with which `found` follows `wanted` best, of a table of them."""
    best, smallest = LAGS[0], math.inf
    for tau in LAGS:
        x, error, decay = 0.0, 0.0, math.exp(-h / tau)
        for w, y in zip(wanted.tolist(), found.tolist(), strict=True):
            x = w + (x - w) * decay
            error += (x - y) * (x - y)
        if error < smallest:
            best, smallest = tau, error
    return best


class Lateral:
    """The search for what the runs in bends tell; its unknowns are relative to their start, one each."""

    NAMES = (
        *((axle, name) for axle in AXLES for name in ('stiffness_y', 'peak_y', 'shape_y', 'curvature_y', 'length_y', 'roll_steer')),
        *(('body', name) for name in ('coupling', 'roll_stiffness', 'roll_damping')),
        ('mounting', 'axis'),
    )

    def __init__(self, scene: Scene, start: dict[str, dict[str, float]], inertia: np.ndarray, runs: list[tuple[Drive, Run]]) -> None:
        self.scene, self.given, self.inertia, self.runs = scene, start, inertia, runs
        self.scales = [SCALES.get(name, 0.0) or start[part][name] for part, name in self.NAMES]
        self.weights = []
        for _, run in runs:
            lateral = np.abs(run.vx * run.yaw_rate)
            less = 1.0 / np.sqrt(1.0 + (lateral / SATURATED) ** 8)
            shown = (run.yaw_rate, run.vy, roll_of(run))
            self.weights.append([(y, less / (np.abs(y).max() * math.sqrt(len(y)))) for y in shown])

    def parameters(self, x: np.ndarray) -> dict[str, dict[str, float]]:
        """All parameters at the unknowns x."""
        found = {part: dict(values) for part, values in self.given.items()}
        for (part, name), scale, value in zip(self.NAMES, self.scales, x.tolist(), strict=True):
            found[part][name] = self.given[part][name] + scale * value
        S, m = found['body']['coupling'], found['body']['mass']
        found['body']['roll_inertia'] = float(self.inertia[0, 0]) + S * S / m  # about the axis of roll
        return found

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Errors of yaw rate, lateral velocity and roll, relative to their peaks, root mean square over each run; and the prior."""
        tables = tables_of(self.parameters(x), self.scene)
        parts = [PRIOR * x]
        for (drive, run), weights in zip(self.runs, self.weights, strict=True):
            shown = replay(tables, drive, run)
            parts += [(ours - theirs) * weight for ours, (theirs, weight) in zip(shown[:3], weights, strict=True)]
        return np.concatenate(parts)


def replay(tables: SingleTrackTables, drive: Drive, run: Run) -> tuple[np.ndarray, ...]:
    """(yaw rate, lateral velocity, roll; lateral force and saturation of the front axle, load moved to the rear) of the level under
    the inputs of a run, at its samples.
    """
    t, y, w = Ref(tables), rolling(tables, drive.speed), new_scratch()
    frame = Ref(new_frame(len(run.names)))
    index = np.array([run.names.index(name) for name in COMMANDS])
    u = run.inputs[0].copy()
    rows = []
    for k in range(len(run.time)):
        advance(t, y, run.inputs, index, u, k * EVERY, EVERY, False, H, 1, w, frame)
        rows.append((frame.twist[0, 5], frame.twist[0, 1], y[ROLL], w.told[FY], w.told[SATURATION], y[SHIFT]))
    return tuple(np.array(rows).T)


def identified(model: ModelSpec) -> dict[str, Any]:
    """All parameters of the level of a vehicle, and where it holds."""
    scene = Scene(name='identification', model=dataclasses.replace(model, road=RoadSpec()))
    bulk = masses(model)
    mass, com, inertia = bulk['mass'], bulk['com'], bulk['inertia']
    ratio, ratio_3 = gear(model)
    axles, lengthwise, lock = straight(model, mass)
    wheelbase = _wheelbase(model)
    chassis = next(b for b in model.bodies if b.name == (model.chassis or model.bodies[0].name))
    g = -model.gravity[2]
    parameters: dict[str, dict[str, float]] = {}
    for i, axle in enumerate(AXLES):
        found = axles[axle]
        stiffness, damping = brakes(model, axle)
        parameters[axle] = found | {
            'x': wheelbase[i] - float(com[0]),
            'shifted': -1.0 if i == 0 else 1.0,
            'steered': 1.0 if i == 0 else 0.0,
            'stiffness_y': 15.0 * found['load'],
            'peak_y': 1.0 * found['load'],
            'shape_y': 1.3,
            'curvature_x': 0.0,
            'curvature_y': 0.0,
            'length_x': 0.5 * found['radius'],
            'length_y': 0.5,
            'roll_steer': 0.0,
            'trail': 0.0,
            'trail_lost': 0.0,
            'brake_stiffness': stiffness,
            'brake_damping': damping,
        }
    body = {
        'mass': mass,
        'yaw_inertia': float(inertia[2, 2]),
        'roll_inertia': float(inertia[0, 0]),
        'coupling': 0.4 * mass,
        'product': -float(inertia[0, 2]),
        'roll_stiffness': 0.4 * mass * g / math.radians(5.0),
        'roll_damping': 0.05 * 0.4 * mass * g / math.radians(5.0),
        'drag': drag(model),
        'height': lengthwise['height'],
        'lag': lengthwise['lag'],
        'ratio': ratio,
        'ratio_3': ratio_3,
        'steering_inertia': 0.0,
        'steering_damping': 0.0,
        'top_spin': top_spin(model),
        'low_speed': float(model.tires[0].low_speed),
        'contact_time': float(model.tires[0].standstill_damping),
    }
    mounting = {
        'x': -float(com[0]), 'axis': 0.1, 'height': lengthwise['z'], 'pitch': lengthwise['pitch'],
        'pitch_by_shift': lengthwise['pitch_by_shift'],
        'pitch_by_roll': 0.0,
        'com_x': float(chassis.com[0]), 'com_y': float(chassis.com[1]), 'com_z': float(chassis.com[2]), 'yaw': 0.0, 'gravity': g,
    }  # fmt: skip
    start = {'mounting': mounting, 'body': body, **parameters}
    runs = [(drive, driven(model, drive)) for drive in bends(start, wheelbase[0] - wheelbase[1])]
    search = Lateral(scene, start, inertia, runs)
    x = least_squares(search.residual, np.zeros(len(search.NAMES)))
    parameters = search.parameters(x)
    feel(parameters, scene, runs)
    return parameters | {'validity': limits(parameters, scene, runs[0], lock, model)}


def feel(found: dict[str, dict[str, float]], scene: Scene, runs: list[tuple[Drive, Run]]) -> None:
    """Add what the steering wheel feels, inertia, damping and the trail of the front axle, and the pitch that comes with roll, by least
    squares of torque and pitch.
    """
    columns: list[list[np.ndarray]] = [[], [], [], []]
    torque, rolled, pitched = [], [], []
    body, mounting = found['body'], found['mounting']
    for drive, run in runs:
        _, _, roll, force, saturation, moved = replay(tables_of(found, scene), drive, run)
        rolled.append(roll * roll)
        pitched.append(pitch_of(run) - mounting['pitch'] - mounting['pitch_by_shift'] * moved)
        angle, rate, acceleration = (run.inputs[EVERY - 1 :: EVERY, run.names.index(name)] for name in COMMANDS[:3])
        lever = (body['ratio'] + 3.0 * body['ratio_3'] * angle * angle) * force
        for column, values in zip(columns, (acceleration, rate, lever, -lever * saturation), strict=True):
            column.append(values)
        torque.append(run.effort)
    inertia, damping, trail, lost = fitted([np.concatenate(c) for c in columns], np.concatenate(torque)).tolist()
    body |= {'steering_inertia': max(inertia, 0.0), 'steering_damping': max(damping, 0.0)}
    found['front'] |= {'trail': trail, 'trail_lost': lost}
    mounting['pitch_by_roll'] = float(fitted([np.concatenate(rolled)], np.concatenate(pitched))[0])


def limits(found: dict[str, dict[str, float]], scene: Scene, bend: tuple[Drive, Run], lock: Run, model: ModelSpec) -> list[dict[str, Any]]:
    """Where the level holds, as fields of Limit: as far as it follows the ramp and the braking to ERROR, and what it leaves out."""
    drive, run = bend
    shown_ = replay(tables_of(found, scene), drive, run)
    lateral = run.vx * run.yaw_rate
    wrong = (np.abs(shown_[0] - run.yaw_rate) > ERROR * np.abs(run.yaw_rate)) & (lateral > 1.0)
    last = int(np.argmax(wrong)) if wrong.any() else len(wrong) - 1
    last = max(0, min(last, int(np.argmax(lateral))) - 1)
    slips = []
    for i, axle in enumerate(AXLES):
        a = found[axle]
        share = np.maximum(lock.axle('fz')[:, i] / a['load'], 0.05)
        kappa = np.abs(0.5 * lock.axle('kappa')[:, i])
        wanted = a['peak_x'] * characteristic(kappa * a['stiffness_x'] / (a['peak_x'] * share), a['shape_x'], a['curvature_x'])
        error = np.abs(-lock.axle('fx')[:, i] / share - wanted)
        wrong = error > ERROR * a['peak_x']
        slips.append(float(kappa[: int(np.argmax(wrong))].max(initial=0.0)) if wrong.any() else float(kappa.max()))
    hop = min(mode.frequency for name, mode in named_modes(standing(dataclasses.replace(scene, model=model))).items() if 'hop' in name)
    identified_ = f'the runs it was identified from are followed to {100 * ERROR:g} % up to there'
    rows = (
        ('lateral acceleration', 'm/s^2', float(np.abs(lateral[: last + 1]).max()), identified_),
        ('slip angle', 'rad', float(np.abs(0.5 * run.axle('alpha')[last]).max()), identified_),
        ('slip', '', min(slips), identified_),
        ('frequency', 'Hz', math.sqrt(ERROR) * hop, f'wheels hop at {hop:.3g} Hz: what follows them at once is {100 * ERROR:g} % wrong'),
        ('friction difference', '', 0.1, 'both wheels of an axle are one'),
        ('road height', 'm', 0.005, 'it drives on a plane'),
        ('road slope', '', 0.005, 'it drives on the level'),
    )
    return [{'quantity': quantity, 'unit': unit, 'high': float(f'{high:.3g}'), 'why': why} for quantity, unit, high, why in rows]


def bends(start: dict[str, dict[str, float]], wheelbase: float) -> list[Drive]:
    """A ramp and a step at SPEED and a step at FAST, with the torque that keeps the speed straight on."""
    body = start['body']

    def wheel(lateral: float, speed: float) -> float:
        return lateral * (wheelbase / speed**2 + UNDERSTEER) / body['ratio']

    def torque(speed: float) -> float:
        shares = sum(start[axle]['drive'] / start[axle]['radius'] for axle in AXLES)
        resistance = body['drag'] * speed**2 + sum(start[axle]['resistance'] * start[axle]['load'] for axle in AXLES)
        return resistance / shares if shares > 0.0 else 0.0

    end = wheel(RAMP, SPEED)
    ramp = Ramp(slope=end / 6.0, start=0.5, final=end)
    drives = [Drive(speed=SPEED, maneuver=Maneuver(steering=ramp, drive_torque=torque(SPEED)), duration=7.0)]
    for speed in (SPEED, FAST):
        step = Step(value=wheel(LATERAL, speed), start=0.5, rise=0.15)
        drives.append(Drive(speed=speed, maneuver=Maneuver(steering=step, drive_torque=torque(speed)), duration=3.0))
    return drives


def _wheelbase(model: ModelSpec) -> tuple[float, float]:
    """x of both axles in the design position [m]."""
    bodies = {b.name: b for b in model.bodies}
    at = {t.name: _axis(bodies[t.marker.body], t.name, model)[0][0] for t in model.tires}
    front, rear = (0.5 * (at[f'{axle}_left'] + at[f'{axle}_right']) for axle in AXLES)
    return front, rear
