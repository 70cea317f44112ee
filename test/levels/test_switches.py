"""Switches: what is off is not in the model, and the report says what is on, what is off, and why."""

from __future__ import annotations

import dataclasses

import pytest

import solver
from solver.analysis.figures import mass_figures
from solver.files.scene import load_scene, load_scene_text
from solver.levels import derive
from solver.levels.condensed import condensed
from solver.levels.switches import RULES, switched
from solver.model.compile import compile_model
from solver.model.spec import ModelSpec
from solver.scene import SUBSYSTEMS

# bodies, rows and elements that are gone, in the full car and in the condensed one
GONE = {
    'engine_mounts': ((1, 0, {'bushings': 3}), (1, 0, {'bushings': 2})),
    'subframes': ((2, 0, {'bushings': 3}), (2, 0, {'bushings': 3})),
    'steering_column': ((3, 18, {}), (0, 0, {})),  # the servo of the saloon without harmonics
    'driveline_torsion': ((3, 17, {'coordinate_forces': 1}), (1, 5, {'coordinate_forces': 1})),
    'anti_roll_bars': ((8, 28, {'bushings': 4, 'coordinate_forces': 2}), (0, 0, {'coordinate_forces': 2})),
    'drag': ((0, 0, {'aero_drags': 1}), (0, 0, {'aero_drags': 1})),
}


def model(*overrides: str) -> ModelSpec:
    return load_scene('car_rough_road', overrides).model


def off(given: ModelSpec, name: str) -> ModelSpec:
    return switched(given, {name: 'off'})[0]


def test_every_subsystem_of_the_key_has_a_rule() -> None:
    assert tuple(RULES) == SUBSYSTEMS


@pytest.mark.parametrize('name', GONE)
def test_what_is_off_costs_nothing(name: str) -> None:
    """Counted where it costs: bodies, rows and entries in the tables of the compiled model."""
    for level, (bodies, rows, elements) in zip((lambda m: m, lambda m: condensed(m)[0]), GONE[name], strict=True):
        with_it, without = level(model()), level(off(model(), name))
        large, small = compile_model(with_it), compile_model(without)
        assert large.n_bodies - small.n_bodies == bodies
        assert large.n_rows - small.n_rows == rows
        for kind, count in elements.items():
            assert len(getattr(with_it, kind)) - len(getattr(without, kind)) == count, kind


def test_turn_slip_costs_a_state_of_each_tire() -> None:
    """Of those that have all of it, and of those that nothing is said of: the moment against turning on the spot goes
    too."""
    for overrides in (
        [],
        ['vehicle.front.turn_slip=true'],
        ['vehicle.front.turn_slip=true', 'vehicle.rear.turn_slip=false'],
    ):
        given = load_scene('light_car_step_steer', overrides).model
        without, report = switched(given, {'turn_slip': 'off'})
        twisting = 2 if len(overrides) == 2 else 4
        assert compile_model(given).n_internal - compile_model(without).n_internal == twisting
        assert all(tire.turn_slip is False for tire in without.tires)
        assert {s.subsystem: s.on for s in switched(given, {})[1]}['turn_slip']
        assert not {s.subsystem: s.on for s in report}['turn_slip']


def test_an_even_road_has_no_grids_and_keeps_its_friction() -> None:
    given = load_scene('car_rough_road', ['road.patches=[{center: [0, 0], size: [10, 10], factor: 0.5}]']).model
    flat = off(given, 'road_unevenness')
    assert given.road.grids
    assert flat.road.grids == ()
    assert flat.road.patches == given.road.patches


def test_without_stops_springs_and_dampers_stay() -> None:
    for scene in ('car_step_steer', 'light_car_step_steer'):
        given = load_scene(scene).model
        without = off(given, 'stops')
        laws = [
            force.spring for force in (*without.spring_dampers, *without.coordinate_forces) if force.spring is not None
        ]
        assert len(compile_model(without).tables.laws.start) < len(compile_model(given).tables.laws.start)
        assert all(len(law.x) == 1 for law in laws), 'springs and bars are linear; what is left has no dead travel'
        assert {s.name for s in given.spring_dampers} == {s.name for s in without.spring_dampers}


@pytest.mark.parametrize('name', ['engine_mounts', 'subframes', 'steering_column', 'driveline_torsion'])
def test_what_is_made_rigid_keeps_its_mass(name: str) -> None:
    """The inertia of a propeller shaft turns with the wheels afterwards: by the square of the ratio more, about their
    axes."""
    before, after = mass_figures(model()), mass_figures(off(model(), name))
    for key in ('mass', 'com_x', 'com_y', 'com_z'):
        assert after[key] == pytest.approx(before[key], rel=1e-12, abs=1e-12)
    for key in ('roll_inertia', 'yaw_inertia'):
        assert after[key] == pytest.approx(before[key], rel=1e-3)


def test_the_report_names_every_subsystem_and_why() -> None:
    scene = load_scene('car_step_steer', ['fidelity=condensed', 'switches.drag=off', 'switches.stops=on'])
    report = {s.subsystem: s for s in derive(scene).report.switched}
    assert tuple(report) == SUBSYSTEMS
    assert (report['drag'].on, report['drag'].why) == (False, 'switched off in the scene')
    assert (report['stops'].on, report['stops'].why) == (True, 'switched on in the scene')
    assert (report['road_unevenness'].on, report['road_unevenness'].why) == (False, 'the vehicle or its road has none')
    assert report['anti_roll_bars'].on
    assert 'element aero' in derive(scene).report.absent


def test_what_no_rule_takes_out_is_on_whatever_the_scene_says() -> None:
    """A pickup winds up its final drive, whose pinion turns with the transfer case too; a preloaded mesh keeps its
    steering column."""
    pickup = load_scene_text('vehicle: vehicles/pickup_awd.yaml').model
    assert 'final_drive' in {force.name for force in pickup.coordinate_forces}
    saloon = load_scene_text('vehicle: vehicles/wishbone_car.yaml').model
    forces = tuple(f.replace(preload=1.0) if f.name == 'rack_and_pinion' else f for f in saloon.coordinate_forces)
    for given, name in (
        (pickup, 'driveline_torsion'),
        (dataclasses.replace(saloon, coordinate_forces=forces), 'steering_column'),
    ):
        left, report = switched(given, {name: 'off'})
        assert left == given
        (told,) = (one for one in report if one.subsystem == name)
        assert (told.on, told.why) == (True, 'switched off in the scene, but no rule takes it out of this vehicle')
        (told,) = (one for one in switched(given, {})[1] if one.subsystem == name)
        assert (told.on, told.why) == (True, 'part of the vehicle')


def test_switches_that_are_on_leave_the_model_alone() -> None:
    given = model()
    assert switched(given, dict.fromkeys(SUBSYSTEMS, 'on'))[0] is given


@pytest.mark.slow
@pytest.mark.parametrize('fidelity', ['full', 'condensed'])
def test_a_car_without_anything_drives_on(fidelity: str) -> None:
    """All off: it starts in equilibrium, steps, and its energy account closes."""
    overrides = [f'fidelity={fidelity}', *(f'switches.{name}=off' for name in SUBSYSTEMS)]
    simulation = solver.simulation_of(load_scene('car_step_steer', overrides))
    snapshot = simulation.advance(500)
    assert snapshot.counters.stagnated == 0
    speed = snapshot.twist[simulation.channels.chassis or 0, 0]
    assert 21.0 < speed < 23.0
    assert simulation.totals()['energy_error_max'] < 5.0
    assert simulation.level is not None
    assert not any(s.on for s in simulation.level.switched)


@pytest.mark.slow
@pytest.mark.parametrize('vehicle', ['full_car', 'compact_fwd'])
def test_without_its_column_the_hand_holds_the_same_torque(vehicle: str) -> None:
    """The gear acts on the steering wheel itself: but for the universal joints the hand feels it as before."""
    held = []
    for state in ('on', 'off'):
        changes = [f'vehicle=vehicles/{vehicle}.yaml', f'switches.steering_column={state}']
        simulation = solver.simulation_of(
            load_scene('car_step_steer', [*changes, 'maneuver.steering={kind: ramp, slope: 1.0}'])
        )
        held.append(simulation.advance(400).joint_effort[simulation.channels.joints.index('steering_wheel')])
    assert held[0] > 2.0
    assert held[1] == pytest.approx(held[0], rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize('name', ['relaxation', 'camber'])
def test_what_a_tire_leaves_out_changes_its_force(name: str) -> None:
    """Relaxation: the side force follows a step of the steering at once. Camber: a cambered wheel that rolls straight
    pushes less."""
    runs = []
    for state in ('on', 'off'):
        overrides = [f'switches.{name}={state}', 'maneuver.steering={kind: step, value: 0.5, start: 0.05, rise: 0.02}']
        simulation = solver.simulation_of(load_scene('car_step_steer', overrides))
        wheel = simulation.channels.wheels.index('front_left')
        runs.append([float(simulation.advance(1).tire[wheel, 1]) for _ in range(90)])
    if name == 'relaxation':  # 0.5 m at 22 m/s are 22 ms
        reached = [next(k for k in range(50, 90) if abs(run[k] - run[49]) > 300.0) for run in runs]
        assert reached[1] + 4 <= reached[0]
    else:
        assert abs(runs[0][20] - runs[1][20]) > 5.0
