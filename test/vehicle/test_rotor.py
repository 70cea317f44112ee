"""Rotors of motors: what they add to the mass that is accelerated, and what they do to the body that carries them."""

from __future__ import annotations

import numpy as np
import pytest

import solver
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.joint import JointSpec
from solver.elements.marker import WORLD, Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.errors import SpecError
from solver.files.scene import load_scene_text
from solver.inputs.maneuver import Maneuver
from solver.model.spec import ModelSpec
from solver.scene import Scene
from solver.simulation import Simulation
from solver.step.settings import IntegratorSettings
from solver.vehicle.hardpoints import marker_at
from solver.vehicle.parts import LEFTWARDS
from solver.vehicle.rotor import Rotor, rotor

INERTIA, RATIO = 0.02, 9.0
OF_WHEELS = tuple(
    f'vehicle.axles.{axle}.drive.rotor={{inertia: {INERTIA}, ratio: {RATIO}}}' for axle in ('front', 'rear')
)


def driven(vehicle: str, *changes: str, level: str = 'full', torque: float = 400.0) -> Simulation:
    text = (
        f'vehicle: vehicles/{vehicle}.yaml\nstart: {{kind: equilibrium, speed: 10}}\nintegrator: {{h: 0.002}}\n'
        f'maneuver: {{drive_torque: {torque}}}\nfidelity: {level}\n'
    )
    return solver.simulation_of(load_scene_text(text, 'rotor', (*changes, 'vehicle.aero=null')))


def acceleration(simulation: Simulation) -> tuple[float, float]:
    """(m/s^2 between 2 and 3 s, when squat has come to rest; rolling radius [m])."""
    chassis = simulation.channels.chassis or 0
    before = simulation.advance(1000).twist[chassis, 0]
    shot = simulation.advance(500)
    rates = dict(zip(simulation.channels.joints, shot.joint_velocity.tolist(), strict=True))
    after = float(shot.twist[chassis, 0])
    return after - float(before), after / rates['wheel_rear_left']


@pytest.mark.slow
@pytest.mark.parametrize(
    ('vehicle', 'changes', 'rotors', 'level', 'torque'),
    [
        ('electric_4wd', OF_WHEELS, 4, 'full', 400.0),
        ('electric_4wd', OF_WHEELS, 4, 'kc', 400.0),
        pytest.param('electric_4wd', OF_WHEELS, 4, 'single_track', 400.0, marks=pytest.mark.long),
        ('formula_student', OF_WHEELS[1:], 1, 'full', 100.0),
        ('full_car', (f'vehicle.driveline.rotor={{inertia: {INERTIA}, ratio: {RATIO}}}',), 1, 'full', 400.0),
    ],
)
def test_a_car_accelerates_as_one_of_its_mass_and_those_of_what_turns(vehicle, changes, rotors, level, torque):
    """m_eff = m + sum of J i^2 / r^2 over rotors and wheels: with the same torque against nearly the same resistance
    accelerations stand in the inverse ratio of these masses. The differential turns its rotor with the mean of its
    wheels. The cars are without air; the tolerance is that of what rolls, some percent of the force, and of the shafts
    that turn besides.
    """
    plain = driven(vehicle, level=level, torque=torque)
    without, radius = acceleration(plain)
    with_rotors, _ = acceleration(driven(vehicle, *changes, level=level, torque=torque))
    spec = load_scene_text(f'vehicle: vehicles/{vehicle}.yaml\n', 'plain').model
    mass = sum(b.mass for b in spec.bodies)
    turning = sum(next(b for b in spec.bodies if b.name == t.marker.body).inertia[1] for t in spec.tires)
    heavier = rotors * INERTIA * RATIO**2 / (mass * radius**2 + turning)
    assert without / with_rotors - 1.0 == pytest.approx(heavier, rel=0.04)


def test_the_bearing_gives_the_carrier_what_the_rotor_takes():
    """A carrier that is free to turn about y, a wheel and a rotor on it, a torque T between wheel and carrier, ratio i:

    kinetic energy  Ic c'^2 / 2 + Iw (c' + x')^2 / 2 + J (c' + i x')^2 / 2     for the angle x of the wheel against the
                    carrier
    so that         (Ic + Iw + J) c'' + (Iw + i J) x'' = 0      and      (Iw + i J) c'' + (Iw + i^2 J) x'' = T
    """
    carrier = RigidBodySpec(name='carrier', mass=10.0, inertia=(5.0, 8.0, 5.0, 0.0, 0.0, 0.0))
    wheel = RigidBodySpec(name='wheel', mass=1.0, inertia=(0.6, 1.0, 0.6, 0.0, 0.0, 0.0))
    parts = rotor(Rotor(inertia=0.05, ratio=4.0), 'rotor', carrier, ('wheel',))
    on_carrier, on_wheel = (marker_at(body, (0.0, 0.0, 0.0), LEFTWARDS) for body in (carrier, wheel))
    fixed = Marker(body=WORLD, orientation=on_carrier.orientation)
    bearings = (
        JointSpec(name='carrier', kind='revolute', i=fixed, j=on_carrier),
        JointSpec(name='wheel', kind='revolute', i=on_carrier, j=on_wheel),
    )
    model = ModelSpec(
        bodies=(carrier, wheel, *parts.bodies), joints=(*bearings, *parts.joints), couplers=parts.couplers,
        gravity=(0.0, 0.0, 0.0),
        coordinate_forces=(CoordinateForceSpec(name='motor', terms=(('wheel', 1.0),), input='torque'),),
        inputs=('torque',),
    )  # fmt: skip
    scene = Scene(
        name='rotor', model=model, maneuver=Maneuver(signals={'torque': 3.0}), integrator=IntegratorSettings(h=1e-3)
    )
    simulation = Simulation(scene)
    shot = simulation.advance(100)
    rates = dict(zip(simulation.channels.joints, shot.joint_velocity.tolist(), strict=True))
    J, i = 0.05, 4.0
    turned = np.linalg.solve([[8.0 + 1.0 + J, 1.0 + i * J], [1.0 + i * J, 1.0 + i * i * J]], [0.0, 3.0]) * 0.1
    assert (rates['carrier'], rates['wheel'], rates['rotor']) == pytest.approx(
        (turned[0], turned[1], i * turned[1]), rel=1e-6
    )


def test_a_rotor_that_cannot_be_is_refused():
    with pytest.raises(SpecError, match=r'rotor: inertia = 0\.0: must be > 0'):
        Rotor(inertia=0.0)
