"""Engine map, clutch and gearbox in front of several driven axles: speeds and torques by their ratios and shares, the
power that goes through, what housings carry, and what is locked or slips."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from axle_statics import links, loads
from live_axle_cars import GEARS, RATIO, SPINNING, car, forces, off_roader, rates, scene, shaft, truck

from mbd_sim_ros.node.gearbox import Gearbox
from solver import simulation_of
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.errors import MbdError
from solver.files.scene import load_scene_text
from solver.simulation import Simulation

LOCK = {'axle': 'front', 'to': 'rear', 'stiffness': 2e4, 'damping': 60.0}
SIDES = ('left', 'right')


def driving(vehicle: dict[str, Any], speed: float, gear: int, accelerator: Any, **more: Any) -> Simulation:
    """In a gear from the start on, with the clutch closed."""
    maneuver = {'signals': {'gear': gear, 'accelerator': accelerator}} | more.pop('maneuver', {})
    start = {'kind': 'equilibrium', 'speed': speed}
    return Simulation(scene(vehicle, start=start, maneuver=maneuver, duration=30.0, **more))


def mean(turning: dict[str, float], axle: str) -> float:
    return float(np.mean([turning[f'wheel_{axle}_{side}'] for side in SIDES]))


def outputs(turning: dict[str, float], axle: str) -> float:
    """Of a differential: of a steered axle these are the shafts before the joints in the kingpins."""
    name = 'shaft' if f'shaft_{axle}_left' in turning else 'wheel'
    return float(np.mean([turning[f'{name}_{axle}_{side}'] for side in SIDES]))


def six_by_six() -> dict[str, Any]:
    vehicle = truck()
    vehicle['axles']['front']['drive'] = shaft([0.55, 0.25, 0.47], [1.29, 0.25, 0.42], share=0.2)
    for axle in ('middle', 'rear'):
        vehicle['axles'][axle]['drive']['share'] = 0.4
    return vehicle


@pytest.mark.parametrize(
    ('vehicle', 'dof'),
    [
        (off_roader(power=True), 6 + 4 + 4 + 1 + 2 + 1),
        (truck(), 6 + 6 + 6 + 1 + 2 + 1),
        (six_by_six(), 6 + 6 + 6 + 1 + 3 + 1),
    ],
)
def test_the_crankshaft_is_one_more_degree_of_freedom(vehicle: dict[str, Any], dof: int) -> None:
    """Chassis, wheels, axles, pitman arm, shafts, crankshaft; gears and centre differential have none: they are
    friction over speeds."""
    counts = Simulation(scene(vehicle)).describe()
    assert counts['redundant_rows'] == []
    assert counts['dof'] == dof


@pytest.mark.parametrize(
    ('vehicle', 'shares'),
    [
        (off_roader(power=True, shares=(0.4, 0.6)), {'front': 0.4, 'rear': 0.6}),
        (truck(), {'middle': 0.5, 'rear': 0.5}),
        (six_by_six(), {'front': 0.2, 'middle': 0.4, 'rear': 0.4}),
    ],
)
@pytest.mark.parametrize('accelerator', [0.5, 0.0])  # drive, and coast on the brake of the engine
def test_speeds_and_torques_stand_in_the_ratios_and_shares(
    vehicle: dict[str, Any], shares: dict[str, float], accelerator: float
) -> None:
    """In a bend, where the axles turn differently fast: the crankshaft by ratio of gear and final drive faster than the
    mean of the axles that the shares weigh; torques at the wheels are the shares of that of the engine times these,
    less what shafts take to turn faster (1 %)."""
    steering = {'maneuver': {'steering': {'kind': 'step', 'value': 3.0, 'start': 0.1, 'rise': 0.5}}}
    run = driving(vehicle, 8.0, 2, accelerator, **steering)
    run.advance(2000)
    turning, box = rates(run), forces(run, 'clutches')['clutch']
    weighed = sum(share * mean(turning, axle) for axle, share in shares.items())
    assert turning['crankshaft'] == pytest.approx(GEARS[1] * RATIO * weighed, rel=2e-3)  # the final drives twist
    assert abs(box['rate']) < 0.05
    drives = forces(run)
    for axle, share in shares.items():
        wheels = -drives[f'final_drive_{axle}']['force']
        assert wheels == pytest.approx(-GEARS[1] * RATIO * share * box['torque'], rel=0.03, abs=1.0)
        assert np.sign(box['torque']) == (1.0 if accelerator else -1.0)
    assert len({round(mean(turning, axle), 2) for axle in shares}) == len(shares)


@pytest.mark.parametrize('transfer', [None, LOCK, {'damping': 150.0}])
def test_power_into_the_gearbox_is_that_at_the_wheels_and_what_is_stored_and_lost(
    transfer: dict[str, Any] | None,
) -> None:
    """Full accelerator in a bend, over 1.5 s from the crankshaft to the differentials: work in = work at the wheels +
    what rolls the axles against the engine, whose shafts twist with it + spin of the shafts + springs of final drives,
    clutch and transfer case + their heat, within 0.1 J of 31 kJ. The account of energy of the whole car closes
    likewise."""
    steering = {'maneuver': {'steering': {'kind': 'step', 'value': 4.0, 'start': 0.1, 'rise': 0.5}}}
    run = driving(off_roader(power=True, shares=(0.3, 0.7), transfer=transfer), 6.0, 2, 1.0, **steering)

    def now() -> tuple[float, float, float, float]:
        """Power in, power out and lost, and energy stored [W], [J]."""
        turning, drives, box = rates(run), forces(run), forces(run, 'clutches')['clutch']
        inner = [
            drives['final_drive_front'],
            drives['final_drive_rear'],
            box,
            *([drives['transfer']] if transfer else []),
        ]
        out = sum(drives[f'final_drive_{axle}']['force'] * outputs(turning, axle) for axle in ('front', 'rear'))
        lock = drives['transfer']['force'] / RATIO if transfer else 0.0
        for axle, torque in (('front', box['on_first'] + lock), ('rear', box['on_second'] - lock)):
            out += torque * (turning[f'gearbox_output_{axle}'] - turning[f'drive_pinion_{axle}/angle'])
        spin = sum(0.5 * SPINNING * turning[f'drive_pinion_{axle}/angle'] ** 2 for axle in ('front', 'rear'))
        stored = spin + sum(one['energy'] for one in inner)
        return -box['on_shaft'] * turning['crankshaft'], out, sum(one['dissipation'] for one in inner), stored

    run.advance(200)
    work = np.zeros(3)
    before = now()
    first = before[3]
    for _ in range(1500):
        run.advance(1)
        after = now()
        work += 0.5 * run.h * (np.array(before[:3]) + after[:3])
        before = after
    into, out, lost = work
    assert into > 3e4
    assert into == pytest.approx(out + lost + before[3] - first, abs=0.1)
    assert run.totals()['energy_error_max'] < 1.0


@pytest.mark.parametrize('shares', [(0.5, 0.5), (0.0, 1.0)])
def test_a_housing_carries_the_torque_of_its_shaft_along_and_none_across(shares: tuple[float, float]) -> None:
    """The free body of the rear axle, straight on at 0.6 of the accelerator: besides tires, springs, links, weight and
    inertia it gets the torque of its propeller shaft about x, and none about y, where that of the drive is an inner
    one. Within 1 % of the torques of shaft and wheels; without drive none at all. The shaft turns clockwise seen from
    the front, as a real engine does: that takes load off the right wheel."""
    run = driving(off_roader(power=True, shares=shares), 4.0, 1, 0.6)
    run.advance(1500)
    torque = forces(run, 'clutches')['clutch']['on_second']
    found = loads(run, 'rear', links('rear'))
    assert torque > 200.0
    assert found.along == pytest.approx(-torque, rel=0.01)
    assert found.across == pytest.approx(0.0, abs=0.01 * RATIO * torque)
    left, right = run.snapshot().tire[2:, TIRE_COLUMNS.index('fz')]
    assert 0.1 * torque < left - right < torque / 0.79
    coasting = driving(off_roader(power=True, shares=shares), 4.0, 0, 0.0)
    coasting.advance(1500)
    free = loads(coasting, 'rear', links('rear'))
    assert free.along == pytest.approx(0.0, abs=0.1) and free.across == pytest.approx(0.0, abs=1.0)


def test_of_a_shaft_through_an_axle_that_carries_no_more_than_its_own_share() -> None:
    """The tandem of the truck: torques about x on both housings are those of their pinions."""
    run = driving(truck(), 4.0, 1, 0.6)
    run.advance(1500)
    box = forces(run, 'clutches')['clutch']
    for axle, torque in (('middle', box['on_first']), ('rear', box['on_second'])):
        found = loads(run, axle, links(axle))
        assert found.along == pytest.approx(-torque, rel=0.01)
        assert found.across == pytest.approx(0.0, abs=0.01 * RATIO * torque)


# from 1 m before the middle of the car on
ICE = {'patches': [{'center': [11.0, 0.0], 'size': [20.0, 10.0], 'factor': 0.1, 'blend': 0.1}]}


FLOORED = {'kind': 'step', 'value': 1.0, 'start': 0.05, 'rise': 0.1}


class OnIce:
    """A car that starts with its front axle on ice: speeds of its axles, and the torque that each needs at its
    wheels."""

    def __init__(self, transfer: dict[str, Any] | None, share: float) -> None:
        run = driving(off_roader(power=True, shares=(share, 1.0 - share), transfer=transfer), 1.0, 1, FLOORED, road=ICE)
        run.advance(800)
        before = rates(run)
        run.advance(10)
        now, shot = rates(run), run.snapshot()
        box = forces(run, 'clutches')['clutch']
        column = {name: shot.tire[:, k].reshape(2, 2) for k, name in enumerate(TIRE_COLUMNS)}
        inertia = {body.name: body.inertia for body in run.model.spec.bodies}
        needs = (column['fx'] * (0.401 - column['deflection']) - column['my']).sum(axis=1)
        self.speeds = np.array([mean(now, axle) for axle in ('front', 'rear')])
        for k, axle in enumerate(('front', 'rear')):
            faster = (mean(now, axle) - mean(before, axle)) / (10 * run.h)
            needs[k] += faster * (2.0 * inertia[f'wheel_{axle}_left'][1] + RATIO**2 * SPINNING)
        self.needs, self.pulls = needs, column['fx'].sum(axis=1)
        self.given = RATIO * np.array([box['on_first'], box['on_second']])
        self.locked = forces(run)['transfer']['force'] if transfer else 0.0


@pytest.mark.parametrize('share', [0.5, 0.7])
def test_an_open_centre_differential_gives_the_axle_with_grip_what_slips_in_front_by_the_shares(share: float) -> None:
    """Front wheels spin on ice. The torques at the wheels stay in the ratio of the shares, whatever the speeds are."""
    found = OnIce(None, share)
    assert found.speeds[0] > 2.0 * found.speeds[1] > 0.0
    assert found.needs == pytest.approx(found.given, rel=0.02)
    assert found.needs[1] / found.needs[0] == pytest.approx((1.0 - share) / share, rel=0.02)


def test_a_locked_one_gives_the_rest_to_the_axle_with_grip() -> None:
    """Both axles turn alike, and what the front tires cannot hold pulls behind: the torque of the gearbox less that of
    the ice."""
    found, opened = OnIce(LOCK, 0.5), OnIce(None, 0.5)
    assert found.speeds[0] == pytest.approx(found.speeds[1], rel=0.05)
    assert found.needs == pytest.approx(found.given + np.array([1.0, -1.0]) * found.locked, rel=0.02)
    assert found.locked < -100.0
    assert found.pulls[1] > opened.pulls[1]


@pytest.mark.slow
def test_the_level_condensed_keeps_it() -> None:
    """A step of the steering wheel under power, of the off-roader with a locked transfer case and of the truck."""
    maneuver = {
        'signals': {'gear': 3, 'accelerator': 0.5},
        'steering': {'kind': 'step', 'value': 1.0, 'start': 0.2, 'rise': 0.3},
    }
    for vehicle in (off_roader(power=True, transfer=LOCK), truck()):
        found = []
        for level in ('full', 'condensed'):
            run = simulation_of(
                scene(vehicle, fidelity=level, start={'kind': 'equilibrium', 'speed': 12.0}, maneuver=maneuver)
            )
            run.advance(2000)
            twist = run.snapshot().twist[run.channels.chassis or 0]
            found.append((twist[5], twist[0], rates(run)['crankshaft']))
        assert found[1] == pytest.approx(found[0], rel=1e-3)


def test_the_level_without_an_engine_says_so() -> None:
    with pytest.raises(MbdError, match='an engine with a gearbox, which this level does not have'):
        simulation_of(scene(off_roader(power=True), fidelity='single_track'))


def test_the_adapter_knows_the_ratios() -> None:
    box = Gearbox.of(scene(off_roader(power=True, shares=(0.3, 0.7))))
    assert box is not None
    assert box.ratios == pytest.approx([RATIO * gear for gear in GEARS])


BEHIND = """
kind: propshaft
share: 0.4
differential: {mass: 25, com: [-1.29, 0, 0.30], inertia: [0.4, 0.4, 0.4]}
mounts: [[-1.20, 0, 0.30]]
ratio: 2.5
stiffness: 14000
damping: 25
engine_flange: [1.00, 0.05, 0.30]
pinion_flange: [-1.10, 0, 0.30]
propshaft_front: {mass: 9, radius: 0.035}
pinion: {mass: 2, radius: 0.025}
output: [-1.30, 0.14, 0.30]
output_shaft: {mass: 1.4, radius: 0.04}
half_shaft: {mass: 4.5, radius: 0.014}
inset: 0.08
"""


@pytest.mark.slow
def test_a_gearbox_across_the_car_drives_its_half_shafts_and_a_shaft_to_the_rear_axle() -> None:
    """The compact: torques at the wheels are the shares times the final drive of each axle, 4.06 in front and 2.5
    behind; speeds too."""
    text = (
        'vehicle: vehicles/compact_fwd.yaml\nstart: {kind: equilibrium, speed: 12}\nmaneuver: {signals: {gear: 2, '
        'accelerator: 0.5}}\n'
    )
    drive = '{' + ', '.join(line for line in BEHIND.strip().split('\n')) + '}'
    changes = (
        'vehicle.engine.power=docs/examples/power.yaml',
        'vehicle.axles.front.drive.share=0.6',
        f'vehicle.axles.rear.drive={drive}',
    )
    run = Simulation(load_scene_text(text, 'compact', changes))
    run.advance(2000)
    turning, box, drives = rates(run), forces(run, 'clutches')['clutch'], forces(run)
    assert turning['crankshaft'] == pytest.approx(
        GEARS[1] * (0.6 * 4.06 * mean(turning, 'front') + 0.4 * 2.5 * mean(turning, 'rear')), rel=3e-3
    )
    assert box['on_first'] + box['on_second'] == pytest.approx(0.6 * 4.06 * GEARS[1] * box['torque'], rel=1e-9)
    assert drives['final_drive']['force'] == pytest.approx(0.4 * 2.5 * GEARS[1] * box['torque'], rel=0.03)


def _with(axle: str, vehicle: dict[str, Any], drive: dict[str, Any]) -> dict[str, Any]:
    vehicle['axles'][axle]['drive'] = drive
    return vehicle


@pytest.mark.parametrize(
    ('vehicle', 'says'),
    [
        (
            _with('rear', off_roader(power=True), {'kind': 'motors', 'share': 0.5}),
            'power: drive of axle rear = .?motors.*choose one of these',
        ),
        (_with('front', six_by_six(), {'kind': 'motors', 'share': 0.2}), 'power: drive of axle front = .?motors'),
    ],
)
def test_what_a_gearbox_does_not_reach_is_refused_by_name(vehicle: dict[str, Any], says: str) -> None:
    with pytest.raises(MbdError, match=f'(?s){says}'):
        scene(vehicle)


def test_a_ratio_in_the_gearbox_needs_a_differential_there() -> None:
    vehicle = car({'front': 1.6, 'rear': -1.6}, {'rear': shaft([0.3, 0, 0.5], [-1.29, 0, 0.42])}, 1500, power=True)
    with pytest.raises(MbdError, match=r'power: final = 4\.06: belongs to a differential in the gearbox'):
        scene(vehicle, 'vehicle.engine.power.final=4.06')
