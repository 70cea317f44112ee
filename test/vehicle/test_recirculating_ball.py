"""Steering box with pitman arm, idler arm and relay link: the four-bar linkage, its ratio, its symmetry, and what the
hand holds."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from saloon import without_bushings

from solver.analysis.kinematics_and_compliance import Rig
from solver.errors import MbdError
from solver.files.mechanism import MechanismReader
from solver.files.scene import config_directories, find_file, load_scene_text
from solver.files.yaml_tree import read
from solver.levels.condensed import condensed
from solver.scene import Scene
from solver.simulation import Simulation
from solver.vehicle.car import Car, car_model
from solver.vehicle.parts import Bushing
from solver.vehicle.recirculating_ball import Lever, RecirculatingBall

# behind the link; shafts of the column in line, so that they turn as one
BOX = RecirculatingBall(
    ratio=18.0,
    pitman=Lever(pivot=(1.595, 0.34, 0.332), ball=(1.745, 0.34, 0.332), mass=1.6),
    idler=Lever(pivot=(1.595, -0.34, 0.332), ball=(1.745, -0.34, 0.332), mass=1.2),
    link_mass=2.4, link_damping=2200.0, stiffness=330.0, damping=1.8,
    pinion_foot=(1.62, 0.36, 0.43), pinion_joint=(1.40, 0.36, 0.58), column_joint=(0.96, 0.36, 0.88),
    wheel_hub=(0.52, 0.36, 1.18),
    pinion_mass=0.8, shaft_mass=1.9, wheel_mass=4.0, wheel_inertia=0.042,
)  # fmt: skip
SKEW = dataclasses.replace(
    BOX,
    pitman=dataclasses.replace(BOX.pitman, ball=(1.755, 0.32, 0.332)),
    idler=dataclasses.replace(BOX.idler, ball=(1.725, -0.36, 0.332)),
)


def pickup(steering: RecirculatingBall | None = None) -> Car:
    """The delivered pickup, with a steering box instead of its rack."""
    root = read(find_file('pickup_awd', 'vehicles'), config_directories())
    builder = MechanismReader().builder()
    fields = builder.mapping(root, '')
    fields.pop('kind')
    car = builder.construct(Car, fields, root, '')
    return car if steering is None else dataclasses.replace(car, steering=steering)


def angles(rig: Rig, steering: float) -> tuple[float, float, float, np.ndarray]:
    """(turn of the pinion, of the pitman arm, of the idler arm, place of the relay link (3,)) at an angle of the
    steering wheel."""
    rig.settle({'steering': steering})
    names, angle = list(rig.model.coordinate_names), rig.state.angle
    pinion, pitman, idler = (float(angle[names.index(name)]) for name in ('steering_pinion', 'pitman_arm', 'idler_arm'))
    return pinion, pitman, idler, rig.state.q[rig.model.body_names.index('relay_link'), :3].copy()


def idler_angle(box: RecirculatingBall, turn: float) -> float:
    """Turn of the idler arm by the closing triangle of the four-bar linkage, in the plane: the ball of the turned
    pitman arm, the pivot of the idler arm, and the other ball between them by the law of cosines, on the side where it
    was."""
    pivot, ball = np.array(box.pitman.pivot[:2]), np.array(box.pitman.ball[:2])
    base, other = np.array(box.idler.pivot[:2]), np.array(box.idler.ball[:2])
    a, b = math.dist(base, other), math.dist(ball, other)

    def direction(at: np.ndarray) -> float:
        line = at - base
        d = math.hypot(*line)
        return math.atan2(line[1], line[0]) - math.acos((a * a + d * d - b * b) / (2.0 * a * d))

    c, s = math.cos(turn), math.sin(turn)
    moved = pivot + np.array([[c, -s], [s, c]]) @ (ball - pivot)
    return direction(moved) - direction(ball)


@pytest.mark.parametrize('box', [BOX, SKEW])
def test_the_linkage_turns_as_the_four_bar_linkage_does(box: RecirculatingBall) -> None:
    rig = Rig(car_model(without_bushings(pickup(box))))
    driver = rig.model.row_names.index('driver')
    for steering in (-6.0, 2.0, 7.0):
        pinion, pitman, idler, _ = angles(rig, steering)
        assert pinion == pytest.approx(steering, abs=1e-9)  # shafts in line
        # the torsion bar gives way
        assert pitman == pytest.approx((steering - rig.state.lam[driver] / 330.0) / 18.0, rel=1e-9)
        assert idler == pytest.approx(idler_angle(box, pitman), rel=1e-9)


def test_a_parallelogram_carries_its_link_on_a_circle() -> None:
    rig = Rig(car_model(without_bushings(pickup(BOX))))
    start = angles(rig, 0.0)[3]
    _, pitman, idler, moved = angles(rig, 5.0)
    assert idler == pytest.approx(pitman, rel=1e-9)
    np.testing.assert_allclose(
        moved - start, (0.15 * (math.cos(pitman) - 1.0), 0.15 * math.sin(pitman), 0.0), atol=1e-9
    )


def test_left_and_right_are_alike_and_left_is_left() -> None:
    rig = Rig(car_model(without_bushings(pickup(BOX))))
    left, right = rig.settle({'steering': 4.0}), rig.settle({'steering': -4.0})
    assert left['front_left']['steer'] > 0.1
    for one, other in (('left', 'right'), ('right', 'left')):
        assert left[f'front_{one}']['steer'] == pytest.approx(-right[f'front_{other}']['steer'], rel=1e-6)
        assert left[f'front_{one}']['camber'] == pytest.approx(right[f'front_{other}']['camber'], rel=1e-6)


def test_the_hand_holds_what_virtual_work_asks_for() -> None:
    """Aligning moments at both wheels: the torque at the steering wheel times its turn is their work at the turn of the
    wheels."""
    rig = Rig(car_model(without_bushings(pickup(BOX))))
    driver = rig.model.row_names.index('driver')
    turned = {}
    for steering in (1.99, 2.01):
        corners = rig.settle({'steering': steering})
        turned[steering] = [corners[f'front_{side}']['steer'] for side in ('left', 'right')]
    torque = []
    for moment in (-20.0, 20.0):
        rig.settle({'steering': 2.0, 'mz_front_left': moment, 'mz_front_right': moment})
        torque.append(rig.state.lam[driver])
    slopes = np.subtract(turned[2.01], turned[1.99]) / 0.02
    assert (torque[1] - torque[0]) / 40.0 == pytest.approx(-slopes.sum(), rel=5e-3)


def test_degrees_of_freedom_are_those_of_a_rack_and_nothing_is_redundant() -> None:
    cars = without_bushings(pickup(BOX)), without_bushings(pickup())
    counts, others = (Simulation(Scene(name='ideal', model=car_model(car))).describe() for car in cars)
    assert counts['redundant_rows'] == others['redundant_rows']
    assert counts['dof'] == others['dof']
    assert (counts['bodies'], counts['joints']) == (others['bodies'] + 2, others['joints'] + 3)


EXAMPLE = 'vehicle.steering=docs/examples/steering_box.yaml'


def drive(*changes: str, seconds: float = 1.5) -> tuple[Simulation, np.ndarray]:
    """The pickup in a step steer at 22 m/s: (simulation, (n, 2) yaw rate and hand torque over time)."""
    text = 'vehicle: vehicles/pickup_awd.yaml\nstart: {kind: equilibrium, speed: 22.0}\nintegrator: {h: 0.002}\n'
    text += 'maneuver: {steering: {kind: step, value: 0.55, start: 0.1, rise: 0.2}, drive_torque: 300}\n'
    simulation = Simulation(load_scene_text(text, 'box', changes))
    return simulation, run(simulation, seconds)


def run(simulation: Simulation, seconds: float) -> np.ndarray:
    k, chassis = simulation.channels.joints.index('steering_wheel'), simulation.channels.chassis or 0
    rows = []
    for _ in range(round(seconds / 0.05)):
        shot = simulation.advance(25)
        rows.append((shot.twist[chassis, 5], shot.joint_effort[k]))
    return np.array(rows)


def test_the_example_drives_as_the_pickup_with_its_rack() -> None:
    """The same travel of the tie rods per turn of the pinion and the same help: for the same angle of the road wheels
    on the bench, which differs by the joints of the column, the same bend, and the same torque."""
    (box, ours), (other, rack) = drive(EXAMPLE, 'vehicle.steering.friction=0'), drive()
    wheels = [Rig(s.model.spec).settle({'steering': 0.55}) for s in (box, other)]
    ratio, theirs = (sum(corners[f'front_{side}']['steer'] for side in ('left', 'right')) for corners in wheels)
    assert ratio == pytest.approx(theirs, rel=0.05)
    assert ours[-1, 0] / ratio == pytest.approx(rack[-1, 0] / theirs, rel=0.01)
    assert 3.0 < ours[-1, 1] < 5.0
    assert ours[-1, 1] == pytest.approx(rack[-1, 1], rel=0.05)
    assert box.totals()['energy_error_max'] < 1.0


def test_the_level_condensed_keeps_the_linkage() -> None:
    whole, ours = drive(EXAMPLE)
    model, _ = condensed(whole.model.spec)
    assert {'pitman_arm', 'idler_arm', 'relay_link'} <= {body.name for body in model.bodies}
    assert 'steering_pinion' not in {body.name for body in model.bodies}
    less = run(Simulation(dataclasses.replace(whole.scene, model=model)), 1.5)
    assert np.abs(less - ours).max(axis=0) == pytest.approx(0.0, abs=0.03 * np.abs(ours).max())


def test_an_idler_arm_on_rubber_gives_way() -> None:
    soft = Bushing(stiffness=(5e6, 5e6, 5e6, 2000.0, 2000.0, 0.0), axis=(0.0, 0.0, 1.0))
    car = dataclasses.replace(without_bushings(pickup()), steering=dataclasses.replace(BOX, idler_bushing=soft))
    counts = Simulation(Scene(name='soft', model=car_model(car))).describe()
    assert (
        counts['dof']
        == Simulation(Scene(name='ideal', model=car_model(without_bushings(pickup(BOX))))).describe()['dof'] + 5
    )


@pytest.mark.parametrize(
    ('change', 'sentence'),
    [
        ('ratio=0', r'vehicle\.steering\.ratio = 0\.0: must be > 0'),
        ('link_damping=-1', r'vehicle\.steering\.link_damping = -1\.0: must be >= 0'),
        (
            'pitman.ball=[1.560, 0.2, 0.332]',
            r'vehicle\.steering\.pitman = 0\.0: its ball must move sideways when it turns',
        ),
        (
            'kind=recirculating_bal',
            "vehicle\\.steering\\.kind = recirculating_bal: unknown kind; did you mean 'recirculating_ball'",
        ),
        ('rack_per_turn=0.05', r'vehicle\.steering\.rack_per_turn: unknown key'),
    ],
)
def test_what_cannot_be_is_one_sentence(change: str, sentence: str) -> None:
    with pytest.raises(MbdError, match=sentence):
        drive(EXAMPLE, f'vehicle.steering.{change}')
