"""Verdicts on what an energy account does not see: motions that no step resolves, and steps that were advanced without
an account."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mbd_sim_ros.lab.mechanisms.families import draw
from solver.analysis.verdict import findings
from solver.checks.resolution import late_by
from solver.errors import SpecError
from solver.files.scene import load_scene, load_scene_text
from solver.simulation import Simulation

H = 1e-3


def oscillator(steps_a_period: float, damping: float = 0.0, rho_inf: float = 1.0) -> Simulation:
    """1 kg that slides about its rest with 1 m/s at most; rho_inf = 1 keeps its energy whatever the step. With damping
    [N s/m] a force that balances it keeps the motion going."""
    w = 2.0 * np.pi / (steps_a_period * H)
    mechanism = {
        'gravity': [0, 0, 0],
        'bodies': {'b': {'mass': 1, 'inertia': [1, 1, 1], 'velocity': [1, 0, 0]}},
        'joints': {'g': {'kind': 'prismatic', 'i': 'world', 'j': 'b', 'at': [0, 0, 0], 'axis': [1, 0, 0]}},
        'coordinate_forces': {
            's': {'terms': [['g', 1]], 'spring': w**2, 'input': 'push'},
            'd': {'terms': [['g', 1]], 'damper': damping},
        },
    }
    push = {'kind': 'sine', 'amplitude': damping, 'frequency': w / (2.0 * np.pi), 'phase': 0.5 * np.pi}
    scene = {
        'mechanism': mechanism,
        'integrator': {'h': H, 'rho_inf': rho_inf},
        'duration': 1,
        'maneuver': {'signals': {'push': push}},
    }
    return Simulation(load_scene_text(json.dumps(scene)))


@pytest.mark.parametrize(('steps_a_period', 'told'), [(8, True), (9, True), (12, False), (20, False)])
def test_fewer_than_ten_steps_a_period_are_told(steps_a_period: float, told: bool) -> None:
    """Between stages, which lie in the middle of steps, an acceleration w sin(w t) sampled N times a period changes by
    2 sin(pi / N) cos(pi / N) w. Energy is kept, the phase is not."""
    s = oscillator(steps_a_period)
    s.advance(7)
    # of which ten steps of them lose as much as is allowed
    found = [finding for finding in findings(s) if finding.quantity != 'phase']
    assert [finding.quantity for finding in found] == ['resolution'] * told
    if told:
        exact = 2.0 * np.pi / steps_a_period * np.sin(2.0 * np.pi / steps_a_period)
        assert found[0].value == pytest.approx(exact, rel=0.1)  # the frequency of the step is lower by (w h)^2 / 12
        assert "body 'b'" in found[0].text and found[0].text.endswith('Reduce integrator.h')


def test_a_phase_that_is_lost_is_told() -> None:
    """A step costs (w h)^3 / 12 of phase; the account adds up what each acceleration changes, squared beside its
    amplitude: the mean of sin^2 is one half."""
    s = oscillator(20)
    s.advance(60)
    assert not findings(s)
    s.advance(1940)
    (found,) = findings(s)
    lost = 2000 * (2.0 * np.pi / 20) ** 3 / 12.0
    assert found.quantity == 'phase'
    assert found.value == pytest.approx(0.5 * lost, rel=0.1)
    t, w = s.t_ns * 1e-9, 2.0 * np.pi / (20 * H)
    x, v = s.snapshot().joint_position[0] * w, s.snapshot().joint_velocity[0]
    behind = (w * t - np.arctan2(x, v)) % (2.0 * np.pi)
    assert behind == pytest.approx(lost % (2.0 * np.pi), rel=0.1)


@pytest.mark.parametrize('rho_inf', [0.0, 0.5, 0.8, 1.0])
def test_numerical_damping_loses_more_phase_and_is_told_by_that(rho_inf: float) -> None:
    """What the principal root of the scheme loses, to leading order; the next one is (w h)^2 of it, a hundredth here,
    and the start, which excites the others, costs some (w h)^3 once. Of that the account finds one half, and twice as
    much in the first period, in which the swing grows. Damping takes (1 - rho_inf)^3 / (1 + rho_inf)^3 (w h)^4 / 2 of
    the amplitude in a step, which is the affair of the energy."""
    s = oscillator(60, rho_inf=rho_inf)
    w, late, damping = 2.0 * np.pi / (60 * H), late_by(rho_inf), (1.0 - rho_inf) / (1.0 + rho_inf)
    n = round(0.11 / (late * (w * H) ** 3 / 12.0))
    behind = []
    for told in (False, True):
        shown = s.advance(n)
        assert ('phase' in [finding.quantity for finding in findings(s)]) == told
        x, v = shown.joint_position[0] * w, shown.joint_velocity[0]
        behind.append((w * s.t_ns * 1e-9 - np.arctan2(x, v)) % (2.0 * np.pi))
    assert behind[0] == pytest.approx(0.11, abs=5.0 * (w * H) ** 3)
    assert behind[1] - behind[0] == pytest.approx(0.11, rel=0.03)
    assert np.hypot(x, v) == pytest.approx(np.exp(-n * damping**3 * (w * H) ** 4), rel=0.01)


@pytest.mark.parametrize(('steps_a_period', 'told'), [(22, True), (26, False)])
def test_full_numerical_damping_needs_more_steps_a_period(steps_a_period: float, told: bool) -> None:
    """(w h)^2 11 / 24 is what (w h)^2 / 12 is for ten steps: 23.5 of them."""
    s = oscillator(steps_a_period, rho_inf=0.0)
    s.advance(13)  # half a period, which is all its swing
    found = [finding for finding in findings(s) if finding.quantity == 'resolution']
    assert bool(found) == told
    assert all('larger integrator.rho_inf' in finding.text for finding in found)


def test_a_motion_that_is_damped_forgets_the_phase_it_lost() -> None:
    """What is left of a free one after the time t is exp(-c t / 2 m): no more than 2 m / c of the present loss in a
    second adds up."""
    free, driven = oscillator(40), oscillator(40, damping=20.0)
    lost = []
    for s in (free, driven):
        for _ in range(3):
            s.advance(400)
            lost.append(s.last_step.account.phase[0])
    rate = (lost[1] - lost[0]) / (400 * H)
    assert lost[2] - lost[1] == pytest.approx(lost[1] - lost[0], rel=0.01)
    assert lost[4:] == pytest.approx([rate * 2.0 / 20.0] * 2, rel=0.05)
    assert [[finding.quantity == 'phase' for finding in findings(s)] for s in (free, driven)] == [[True], []]


def test_a_transient_that_sets_a_delicate_motion_going_is_told() -> None:
    """A torsion spring of 309 N m/rad turns a body of 7e-4 kg m2 in 4 ms, and dampers of 516 N s/m take up almost all
    of its 88 J. The account misses 0.6 % of them at 1 ms, less than the limit, and what goes on with 0.01 J was off by
    0.13 m or rad without a word.
    """
    mechanism = draw('springs', 2026000002)
    for h, quantities in ((1e-3, {'resolution'}), (1e-4, set())):
        s = Simulation(mechanism.at(0.5, h=h))
        s.advance(round(0.5 / h))
        assert {finding.quantity for finding in findings(s)} == quantities


def discs(h: float, spin: float, amplitude: float) -> Simulation:
    """Two discs of 1 kg m2 that turn about one axis, with a spring in it: against each other with 50 Hz and +-amplitude
    [rad/s], together with a spin [rad/s]."""
    revolute = {'kind': 'revolute', 'i': 'world', 'axis': [0, 0, 1]}
    mechanism = {
        'gravity': [0, 0, 0],
        'bodies': {
            name: {'mass': 1, 'inertia': [1, 1, 1], 'position': [0, 0, z], 'angular_velocity': [0, 0, spin + relative]}
            for name, z, relative in (('a', 0, amplitude), ('b', 1, -amplitude))
        },
        'joints': {'a': {**revolute, 'j': 'a', 'at': [0, 0, 0]}, 'b': {**revolute, 'j': 'b', 'at': [0, 0, 1]}},
        'coordinate_forces': {'s': {'terms': [['a', 1], ['b', -1]], 'spring': 0.5 * (100.0 * np.pi) ** 2}},
    }
    scene = {'mechanism': mechanism, 'integrator': {'h': h, 'rho_inf': 1}, 'duration': 1}
    return Simulation(load_scene_text(json.dumps(scene)))


@pytest.mark.parametrize('spin', [0.0, 1.0, 30.0, 300.0])
def test_what_vibrates_is_told_whatever_spin_all_have_in_common(spin: float) -> None:
    """Of 50 Hz in 8 steps a period nothing was said beside a spin of 10 rad/s, and half a turn of phase was lost in
    half a second."""
    told = []
    for h in (2.5e-3, 1e-3, 1e-4):
        s = discs(h, spin, 1.0)
        s.advance(round(0.5 / h))
        told.append({finding.quantity: finding.value for finding in findings(s)})
    assert [set(found) for found in told] == [{'resolution', 'phase'}, {'phase'}, set()]
    alone = discs(1e-3, 0.0, 1.0)
    alone.advance(500)
    assert told[1]['phase'] == pytest.approx(findings(alone)[0].value, rel=1e-6)


def test_what_vibrates_along_a_flight_is_told() -> None:
    """Two bodies of 1 kg that fly with 100 m/s, a spring between them that shakes them along the flight with 50 Hz: 1
    m/s of 100."""
    bodies = {
        n: {'mass': 1, 'inertia': [1, 1, 1], 'position': [x, 0, 0], 'velocity': [v, 0, 0]}
        for n, x, v in (('a', 0, 101), ('b', 1, 99))
    }
    guide = {'kind': 'prismatic', 'i': 'a', 'j': 'b', 'at': [0, 0, 0], 'axis': [1, 0, 0]}
    spring = {'terms': [['g', 1]], 'spring': 0.5 * (100.0 * np.pi) ** 2}
    mechanism = {'gravity': [0, 0, 0], 'bodies': bodies, 'joints': {'g': guide}, 'coordinate_forces': {'s': spring}}
    for h, told in ((2.5e-3, True), (1e-4, False)):
        s = Simulation(load_scene_text(json.dumps({'mechanism': mechanism, 'integrator': {'h': h}, 'duration': 1})))
        s.advance(round(0.1 / h))
        assert ('resolution' in {finding.quantity for finding in findings(s)}) == told


@pytest.mark.parametrize(
    ('spin', 'h', 'told'), [(100.0, 2e-3, False), (100.0, 5e-3, True), (300.0, 1e-3, True), (300.0, 1e-4, False)]
)
def test_a_disc_that_nutates_is_told_by_what_its_steps_solve(spin: float, h: float, told: bool) -> None:
    """In its own axes the angular velocity of a free disc turns with (1.8 - 1) spin, in those of the world with 1.8
    spin: Euler's equations are of the former. In 0.5 s (0.8 spin h)^3 / 12 a step makes 0.085, 0.53, 0.58 and 0.006
    rad."""
    disc = {'mass': 1, 'inertia': [0.01, 0.01, 0.018], 'angular_velocity': [1, 0, spin]}
    scene = {'mechanism': {'gravity': [0, 0, 0], 'bodies': {'disc': disc}}, 'integrator': {'h': h}, 'duration': 1}
    s = Simulation(load_scene_text(json.dumps(scene)))
    s.advance(round(0.5 / h))
    assert ('phase' in {finding.quantity for finding in findings(s)}) == told
    assert s.last_step.account.phase[1] == pytest.approx((0.8 * spin * h) ** 3 / 12.0 * 0.5 / h, rel=0.15)


def test_a_spinning_wheel_that_yaws_steadily_does_not_vibrate() -> None:
    """100 rad/s about its axle, which turns with 0.5 rad/s about the vertical: in the axes of the wheel that turns with
    its spin, which would be 3000 (100 h)^3 / 12 = 0.25 rad in 3 s; in those of the world hardly anything changes."""
    bodies = {
        'fork': {'mass': 1, 'inertia': [1, 1, 1], 'angular_velocity': [0, 0, 0.5]},
        'wheel': {'mass': 1, 'inertia': [0.5, 1, 0.5], 'angular_velocity': [0, 100, 0.5]},
    }
    joints = {
        'steering': {'kind': 'revolute', 'i': 'world', 'j': 'fork', 'at': [0, 0, 0], 'axis': [0, 0, 1]},
        'axle': {'kind': 'revolute', 'i': 'fork', 'j': 'wheel', 'at': [0, 0, 0], 'axis': [0, 1, 0]},
    }
    scene = {
        'mechanism': {'gravity': [0, 0, 0], 'bodies': bodies, 'joints': joints},
        'integrator': {'h': H},
        'duration': 3,
    }
    s = Simulation(load_scene_text(json.dumps(scene)))
    s.advance(3000)
    assert not findings(s)
    assert s.last_step.account.phase[1] < 1e-3


@pytest.mark.parametrize('h', [1e-2, 1e-3])
def test_a_smooth_start_from_rest_is_no_vibration(h: float) -> None:
    """Along a constant jerk the acceleration changes in the n-th step by 4 / n^2 of the swing so far, whatever the
    step: what that adds to the phase becomes less of it as the motion grows."""
    mechanism = {
        'gravity': [0, 0, 0],
        'bodies': {'b': {'mass': 1, 'inertia': [1, 1, 1]}},
        'joints': {'g': {'kind': 'prismatic', 'i': 'world', 'j': 'b', 'at': [0, 0, 0], 'axis': [1, 0, 0]}},
        'coordinate_forces': {'s': {'terms': [['g', 1]], 'input': 'push'}},
    }
    ramp = {'kind': 'table', 'points': [[0, 0], [1, 1]]}
    scene = {'mechanism': mechanism, 'integrator': {'h': h}, 'duration': 1, 'maneuver': {'signals': {'push': ramp}}}
    s = Simulation(load_scene_text(json.dumps(scene)))
    for n in (6, 20, 70):
        s.reset()
        s.advance(n)
        assert not {finding.quantity for finding in findings(s)} & {'resolution', 'phase'}


@pytest.mark.parametrize(('ratio', 'told'), [(1e-8, False), (1e-10, True), (1e10, True), (0.0, False)])
def test_bodies_that_penalties_hide_are_told(ratio: float, told: bool) -> None:
    """Two pendulums below each other, 1 kg and `ratio` kg: from 1e-10 on the light one was off by 0.03 m, and ok at one
    step of ten."""
    arm = {'kind': 'revolute', 'axis': [0, 1, 0]}
    mechanism = {
        'bodies': {
            'a': {'mass': 1, 'inertia': [1, 1, 1], 'position': [1, 0, 0]},
            'b': {'mass': ratio, 'inertia': [0.1 * ratio] * 3, 'position': [2, 0, 0]},
        },
        'joints': {
            'one': {**arm, 'i': 'world', 'j': 'a', 'at': [0, 0, 0]},
            'two': {**arm, 'i': 'a', 'j': 'b', 'at': [1, 0, 0]},
        },
    }
    if ratio == 0.0:
        mechanism['joints']['two']['kind'] = 'fixed'
    s = Simulation(load_scene_text(json.dumps({'mechanism': mechanism, 'duration': 1})))
    s.advance(2)
    assert ('light_body' in {finding.quantity for finding in findings(s)}) == told


def test_steps_without_an_account_are_told() -> None:
    s = oscillator(50)
    s.advance(100)
    assert not findings(s)
    s.advance(50, audit=False)
    (found,) = findings(s)
    assert (found.quantity, found.value) == ('unseen', pytest.approx(50 * H))
    restored = Simulation(s.scene)
    restored.restore(s.save())
    assert [finding.quantity for finding in findings(restored)] == ['unseen']


@pytest.mark.slow
@pytest.mark.parametrize(('settings', 'told'), [('penalty: 1.0e8', True), ('penalty: 1.0e8, form: block', False)])
def test_penalties_that_rounding_spoils_are_told(settings: str, told: bool) -> None:
    """The car was 1.2 mm off after 2 s with 1e8, 500 times as much as half the step leaves, with 14 J missing of 44 kJ,
    and ok."""
    s = Simulation(load_scene('car_step_steer', [f'integrator={{{settings}}}', 'require={}']))
    s.advance(1000)
    assert ('penalty' in {finding.quantity for finding in findings(s)}) == told


def test_rounding_of_places_far_from_the_origin_is_told() -> None:
    """At 1e9 m places are multiples of 1.2e-7 m."""
    for distance, told in ((1e5, False), (1e9, True)):
        text = (
            f'{{mechanism: {{bodies: {{b: {{mass: 1, inertia: [1, 1, 1], position: [{distance}, 0, 0]}}}}}}, '
            f'duration: 1}}'
        )
        s = Simulation(load_scene_text(text))
        s.advance(200)
        assert [finding.quantity for finding in findings(s)] == ['distance'] * told


def test_order_four_is_refused_where_bushings_would_make_it_grow() -> None:
    """The links of the car turn by 8.5 rad of their vibration in 1 ms, and by 2.1 rad in 0.25 ms, where it is right."""
    settings = 'order: 4, rho_inf: 1'
    with pytest.raises(
        SpecError,
        match=r"order = 4: body 'toe_link_.*' vibrates on its bushings with 8.47e\+03 rad/s, .* take integrator.order: "
        r'2',
    ):
        Simulation(load_scene('car_step_steer', [f'integrator={{h: 0.001, {settings}}}', 'require={}']))
    Simulation(load_scene('car_step_steer', [f'integrator={{h: 0.00025, {settings}}}', 'require={}']))
    light = Simulation(
        load_scene('light_car_lane_change', [f'integrator={{h: 0.004, {settings}, iterations: 1}}', 'require={}'])
    )
    light.advance(250)
    assert not findings(light)


@pytest.mark.parametrize('iterations', [1, 2])
def test_order_four_takes_the_iterations_that_it_needs(iterations: int) -> None:
    """With one its order falls to two, with two to 2.5: it takes three, whatever is asked for."""
    ends = []
    for given in (iterations, 3):
        s = Simulation(
            load_scene(
                'double_pendulum', [f'integrator={{h: 0.01, order: 4, rho_inf: 1, iterations: {given}}}', 'require={}']
            )
        )
        s.advance(30)
        ends.append(s.state.q.tobytes())
    assert ends[0] == ends[1]


def test_prestressed_parts_at_rest_are_ok_without_gravity() -> None:
    """38 kJ in two springs leave 1.5e-11 J of rounding, and nothing else is exchanged: it was suspect."""
    springs = {
        name: {'i': {'body': 'world', 'position': place}, 'j': 'b', 'free_length': 0.5, 'spring': 1e5}
        for name, place in (('left', [-1, 0.2, 0]), ('right', [1.2, -0.2, 0]))
    }
    body = {'mass': 1, 'inertia': [0.1, 0.1, 0.1], 'position': [0.1, 0, 0]}
    s = Simulation(
        load_scene_text(
            json.dumps({'mechanism': {'gravity': [0, 0, 0], 'bodies': {'b': body}, 'spring_dampers': springs}})
        )
    )
    s.advance(100)
    assert not findings(s)


@pytest.mark.parametrize(('turning', 'told'), [(0.0, False), (1e-3, True)])
def test_bushings_that_do_not_resist_turning_may_turn(turning: float, told: bool) -> None:
    """A ball joint that gives: its torque is that of its damping, which does not jump at pi."""
    bushing = {
        'i': 'world',
        'j': 'b',
        'stiffness': [1e4, 1e4, 1e4, turning, 0, 0],
        'damping': [0, 0, 0, 1e-3, 1e-3, 1e-3],
    }
    body = {'mass': 1, 'inertia': [1, 1, 1], 'angular_velocity': [10, 0, 0]}
    s = Simulation(
        load_scene_text(
            json.dumps({'mechanism': {'gravity': [0, 0, 0], 'bodies': {'b': body}, 'bushings': {'c': bushing}}})
        )
    )
    s.advance(500)
    assert [found.quantity for found in findings(s)] == ['rotation'] * told
