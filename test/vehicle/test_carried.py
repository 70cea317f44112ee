"""What a scene adds to its vehicle (vehicle.elements): at every level on it, or refused by name, and driven like
anything else."""

from __future__ import annotations

import numpy as np
import pytest

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.batch import simulate
from solver import load_scene, simulation_of
from solver.errors import MbdError
from solver.inputs.command_filter import COMMANDS, commands_of
from solver.levels import derive

DAMPER = 'adjustable_dampers: {%s: {terms: {travel_front_left: 1}, soft: 300, firm: 3000, lag: 0.02, input: %s}}'
SKYHOOK = 'vehicle.elements={' + DAMPER % ('skyhook', 'skyhook') + '}'
STRAIGHT = ['maneuver={name: straight, speed: {}}', 'start={kind: equilibrium, speed: 20}', 'duration=0.5', 'road={}']
COMMANDED = 'maneuver.signals={skyhook: {kind: table, interpolation: linear, points: [[0, 0], [0.1, 0], [0.5, 0.8]]}}'


def scene(*changes):
    return load_scene('car_step_steer', [*STRAIGHT, *changes])


@pytest.mark.slow
@pytest.mark.parametrize('level', ['full', 'condensed', 'kc'])
def test_a_damper_with_a_state_and_a_command_is_on_every_level_that_has_its_wheel(level, tmp_path):
    """The valve is the answer of a lag of first order to its command, the force lies where it puts it, and the account
    of energy closes."""
    h, lag = 1e-3, 0.02
    simulation = simulation_of(scene(SKYHOOK, COMMANDED, f'fidelity={level}', 'record.elements_rate=1000'))
    run = simulate(simulation, 500, directory=tmp_path / 'run')
    assert run['status'] == 'ok', run['findings']
    data = bag.read(tmp_path / 'run')
    t, valve = data.time, data['element_states/skyhook/valve']
    past = np.maximum(t - 0.1, 0.0)
    expected = 2.0 * (past - lag * (1.0 - np.exp(-past / lag)))
    # a command is held over a step: it comes up to a step late
    np.testing.assert_allclose(valve, expected, atol=2.0 * h)
    rate, force = data['element_states/skyhook/rate'], data['element_states/skyhook/force']
    np.testing.assert_allclose(force, -(300.0 + 2700.0 * valve) * rate, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(data['element_states/skyhook/dissipation'], -force * rate, rtol=1e-9, atol=1e-12)
    assert np.any(np.abs(force) > 0.0)


def test_its_input_is_a_command():
    model = scene(SKYHOOK).model
    assert commands_of(model.inputs) == (*COMMANDS, 'skyhook')
    assert model.added == (('adjustable_dampers', 'skyhook'),)


@pytest.mark.slow
def test_single_track_refuses_what_is_commanded_and_names_the_rest():
    spring = (
        'vehicle.elements={spring_dampers: {rope: {i: {body: world}, j: {body: chassis, at: [2, 0, 1]}, spring: '
        '0, free_length: 1}}}'
    )
    with pytest.raises(
        MbdError, match="AdjustableDamper 'skyhook': its input 'skyhook' moves nothing that this level has"
    ):
        derive(scene(SKYHOOK, 'fidelity=single_track'))
    assert (
        "SpringDamper 'rope', which the vehicle carries" in derive(scene(spring, 'fidelity=single_track')).report.lost
    )


@pytest.mark.slow
def test_kc_keeps_what_is_on_the_chassis_and_refuses_the_rest_by_name():
    """A rope between world and chassis acts at kc as it does at full: such springs of the vehicle itself are in the
    maps of the bench."""
    rope = (
        'vehicle.elements={spring_dampers: {rope: {i: {body: world, position: [0, 0, 9]}, j: {body: chassis, at: '
        '[0, 0, 1]}, %s}}}'
    )
    pulled = {}
    for level in ('full', 'kc'):
        for stiffness in (0.0, 1e4):
            law = f'spring: {stiffness}, free_length: 7.95'
            model = scene(rope % law, f'fidelity={level}', 'start={kind: equilibrium}', 'maneuver={}')
            pulled[level, stiffness] = simulation_of(model).snapshot().tire[:, 2].sum()
    # 0.1 m and less of a rope of 1e4 N/m: the wheels carry up to 1 kN less, and both levels the same
    for level in ('full', 'kc'):
        assert 100.0 < pulled[level, 0.0] - pulled[level, 1e4] < 1000.0
    assert pulled['kc', 1e4] == pytest.approx(
        pulled['full', 1e4], abs=0.01 * (pulled['full', 0.0] - pulled['full', 1e4])
    )
    arm = (
        'vehicle.elements={spring_dampers: {extra: {i: {body: chassis}, j: {body: upright_front_left}, damper: 500, '
        'free_length: 1}}}'
    )
    with pytest.raises(
        MbdError,
        match="SpringDamper 'extra': acts on body 'upright_front_left', which this level does not have; use full",
    ):
        derive(scene(arm, 'fidelity=kc'))


@pytest.mark.parametrize(
    ('elements', 'refusal'),
    [
        ('{adjustable_dampers: {d: {terms: {travel_front_left: 1}, soft: 1, firm: 2, lag: 0, input: u}}}', 'lag'),
        (
            '{spring_dampers: {s: {i: {body: chassis}, j: {body: upright_front_lef}, damper: 500}}}',
            "no such body; did you mean 'upright_front_left'",
        ),
        ('{spring_damper: {}}', "unknown key; did you mean 'spring_dampers'"),
        ('{bodies: {chassis: {mass: 1, inertia: [1, 1, 1]}}}', "is used twice among the bodies; rename one"),
        ('{adjustable_dampers: {d: {terms: {travel: 1}, soft: 1, firm: 2, lag: 1, input: u}}}', "travel"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_with_its_place(elements, refusal):
    with pytest.raises(MbdError, match=refusal):
        simulation_of(scene(f'vehicle.elements={elements}'))


@pytest.mark.slow
def test_a_body_that_is_carried_loads_the_wheels():
    """A box of 100 kg on a roof rack that is fixed to the chassis: 981 N more on the road, at full, condensed and
    kc."""
    rack = 'joints: {roof_rack: {kind: fixed, i: chassis, j: box, at: [0, 0, 1.6]}}'
    box = f'bodies: {{box: {{mass: 100, inertia: [5, 5, 5], position: [0, 0, 1.6]}}}}, {rack}'
    for level in ('full', 'condensed', 'kc'):
        loads = [
            simulation_of(scene(*more, f'fidelity={level}', 'start={kind: equilibrium}', 'maneuver={}'))
            .snapshot()
            .tire[:, 2]
            .sum()
            for more in ((), (f'vehicle.elements={{{box}}}',))
        ]
        assert loads[1] - loads[0] == pytest.approx(981.0, rel=1e-6)
