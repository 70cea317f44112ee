"""The light car in a bend: the formulas of the bicycle model where they hold, and understeer."""

from __future__ import annotations

import numpy as np
import pytest

from solver.analysis.kinematics_and_compliance import Rig, kinematic_figures
from solver.elements.magic_formula import load_increment, magic_formula, slip_stiffness
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.files.scene import load_scene
from solver.model.frames import matrix
from solver.simulation import Simulation

G = 9.81
WHEELBASE = 2.65
SPEED = 20.0
ALPHA, FZ = TIRE_COLUMNS.index('alpha'), TIRE_COLUMNS.index('fz')


def steady_bend(*overrides: str, steering: float) -> Simulation:
    """After 5 s at nearly constant speed: the slowest mode, roll and yaw, has died out to 1e-4."""
    maneuver = f'{{steering: {{kind: step, value: {steering}, start: 0.2, rise: 0.5}}, drive_torque: 130}}'
    sim = Simulation(
        load_scene(
            'light_car_circle', [f'maneuver={maneuver}', f'start={{kind: equilibrium, speed: {SPEED}}}', *overrides]
        )
    )
    sim.advance(5000)
    return sim


def steer_angles(sim: Simulation) -> tuple[float, float]:
    """Mean angle [rad] of the front and of the rear wheels about z of the chassis."""
    pose = sim.snapshot().pose
    R = matrix(pose[0, 3:])
    angle = {}
    for body, p in zip(sim.channels.bodies, pose, strict=True):
        if body.startswith('wheel_'):
            axis = R.T @ matrix(p[3:])[:, 1]
            angle[body] = -np.arctan2(axis[0], axis[1])
    front, rear = (np.mean([angle[f'wheel_{end}_{side}'] for side in ('left', 'right')]) for end in ('front', 'rear'))
    return float(front), float(rear)


def tire_stiffness(sim: Simulation, e: int, load: float, camber: float) -> tuple[float, float]:
    """(cornering stiffness [N/rad], pneumatic trail [m]) of tire e at a load [N], at small slip."""
    c = sim.model.elements['tires'].c[e]
    dfz = load_increment(c, load)
    Kx, Ky = slip_stiffness(c, camber, load, dfz)
    small = 1e-3
    _, fy, _, _, mz = magic_formula(c, 0.0, small, 0.0, load, dfz, 1.0, SPEED, Kx, Ky, 1.0, 1.0)
    return abs(Ky), abs(mz / fy)


@pytest.mark.parametrize('x', [-0.10, 0.15, 0.37])
def test_understeer_gradient_is_that_of_the_bicycle_model(x):
    # Without roll (anti-roll bars 1000 times as stiff) and with upright wheels (else load transfer makes camber and toe
    # push, in proportion to a_y) the car is a bicycle at small lateral acceleration:
    #   delta_f - delta_r - L r / v = F_f / C_f - F_r / C_r,   F_f = m a_y (b + t_r) / (L - t_f + t_r)
    # with the axle forces shifted by the pneumatic trails t, and C of both tires of an axle at the load they carry (1 %
    # off the static one: drive and drag). Neglected at 0.05 g: load transfer (quadratic in a_y), the side force of
    # steered traction (0.2 % of the front force), and camber from the roll on the tires, 0.04 deg: up to 1.7 % of the
    # slip angle, nearly the same on both axles.
    stiff = ['vehicle.front.anti_roll_bar=1.6e7', 'vehicle.rear.anti_roll_bar=6e6', f'vehicle.chassis.com[0]={x}']
    stiff += [f'vehicle.{axle}.wheel.{angle}_deg=0' for axle in ('front', 'rear') for angle in ('toe', 'camber')]
    sim = steady_bend(*stiff, steering=0.05)
    snapshot = sim.snapshot()
    v, r = snapshot.twist[0, 0], snapshot.twist[0, 5]
    lateral = v * r
    assert 0.2 < lateral < 1.0
    bodies = sim.scene.model.bodies
    mass = sum(b.mass for b in bodies)
    b = 0.5 * WHEELBASE + sum(part.mass * (part.position[0] + part.com[0]) for part in bodies) / mass
    fz = snapshot.tire[:, FZ]
    C_f, t_f = tire_stiffness(sim, 0, 0.5 * (fz[0] + fz[1]), 0.0)
    C_r, t_r = tire_stiffness(sim, 2, 0.5 * (fz[2] + fz[3]), 0.0)
    front_force = mass * lateral * (b + t_r) / (WHEELBASE - t_f + t_r)
    slip_f, slip_r = 0.5 * front_force / C_f, 0.5 * (mass * lateral - front_force) / C_r
    alpha = snapshot.tire[:, ALPHA]
    assert 0.5 * (alpha[0] + alpha[1]) == pytest.approx(slip_f, rel=0.02)
    assert 0.5 * (alpha[2] + alpha[3]) == pytest.approx(slip_r, rel=0.02)
    front, rear = steer_angles(sim)
    gradient = (front - rear - WHEELBASE * r / v) / lateral
    assert gradient == pytest.approx((slip_f - slip_r) / lateral, abs=0.01 * slip_f / lateral)


def test_the_car_understeers_mildly():
    # all of it: load transfer, roll steer, camber. Passenger cars: 2 to 4 deg/g at the road wheels up to 0.4 g
    ratio = (0.0468 / (2 * np.pi)) / 0.135  # road wheels per steering wheel
    points = []
    for steering in (0.2, 0.5):
        snapshot = steady_bend(steering=steering).snapshot()
        v, r = snapshot.twist[0, 0], snapshot.twist[0, 5]
        points.append((v * r, ratio * steering - WHEELBASE * r / v))
    (a0, d0), (a1, d1) = points
    gradient = np.degrees((d1 - d0) / (a1 - a0)) * G
    assert 1.5 < gradient < 4.0


def test_roll_angle_is_that_of_the_roll_stiffness():
    # phi (K - m_s g h) = m_s a_y h, with h from the roll axis to the sprung mass; K: springs and bars as the bench
    # measures them, in series with the tires. Neglected: progressive tires, jacking, the stops (travel stays in the
    # free range).
    sim = steady_bend(steering=0.3)
    snapshot = sim.snapshot()
    lateral = snapshot.twist[0, 0] * snapshot.twist[0, 5]
    roll = np.arcsin(matrix(snapshot.pose[0, 3:])[2, 1])
    bench = kinematic_figures(Rig(sim.model.spec))
    tire, tracks = 215e3, {'front': 1.53, 'rear': 1.52}
    stiffness = sum(
        1.0 / (1.0 / bench[f'roll_stiffness_{axle}'] + 2.0 / (tire * track**2)) for axle, track in tracks.items()
    )
    share = (0.37 + 1.325) / WHEELBASE
    h = 0.59 - (share * bench['roll_center_front'] + (1.0 - share) * bench['roll_center_rear'])
    expected = 1250.0 * lateral * h / (stiffness - 1250.0 * G * h)
    assert abs(roll) == pytest.approx(expected, rel=0.10)
