"""Energies over time, on request (`record.energies`): each is what it says, and they balance within the error of the
method."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.analysis.run_page import write_page
from mbd_sim_ros.analysis.runs import units
from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.batch import simulate
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.messages.encode import Messages
from solver import Simulation, simulation_of
from solver.elements.registry import FORCES
from solver.ensemble import Ensemble
from solver.errors import SpecError
from solver.files.scene import load_scene, load_scene_text
from solver.output.snapshot import ENERGIES
from solver.quantities import columns

ASKED = 'record.energies=1000'
KINETIC, POTENTIAL, DISSIPATED, EXCHANGED, ERROR = range(len(ENERGIES))
# A pendulum of 1 kg at 1 m on a damper of 0.3 N m s/rad, driven by a torque of 3 sin(2 t) N m, which at times holds it
# back.
DRIVEN = """
title: driven pendulum
mechanism:
  gravity: [0, -9.81, 0]
  bodies:
    bob: {mass: 1, inertia: [0.01, 0.01, 0.01], com: [0, -1, 0]}
  joints:
    pivot: {kind: revolute, i: world, j: bob}
  coordinate_forces:
    damper: {terms: [[pivot, 1]], damper: 0.3}
    motor: {terms: [[pivot, 1]], input: torque}
maneuver: {signals: {torque: {kind: sine, amplitude: 3, frequency: 0.3183098861837907}}}
integrator: {h: H, rho_inf: 1, mode: tolerance, order: ORDER}
duration: 4
record: {energies: 1000}
"""


def histories(simulation: Simulation, steps: int) -> np.ndarray:
    """(steps + 1, numbers) of a run."""
    seen = simulation.seen(1, steps)
    first = simulation.snapshot().numbers[None, :]
    simulation.advance(steps, seen=seen)
    return np.concatenate([first, seen.numbers])


def energies(simulation: Simulation, rows: np.ndarray) -> np.ndarray:
    """(n, 5) energies in rows of numbers."""
    return rows[:, simulation.snapshot().layout['energies'][0]]


def require_balance(e: np.ndarray) -> None:
    """Kinetic + potential + dissipated - exchanged changes by `error` alone, to the rounding of the sums."""
    sums = e[:, KINETIC] + e[:, POTENTIAL] + e[:, DISSIPATED] - e[:, EXCHANGED]
    rounding = 1e-14 * np.abs(e).max() * len(e)
    np.testing.assert_allclose(sums - sums[0], e[:, ERROR], rtol=0.0, atol=rounding)


def test_of_a_pendulum_they_are_those_of_its_motion() -> None:
    """Nothing is lost or exchanged; the energy of motion is that which its weight gave, to second order: the relative
    error of the midpoint rule is (w h)^2 / 12 a swing, and 1e-6 here at most."""
    s = simulation_of(load_scene('pendulum', [ASKED]))
    e = energies(s, rows := histories(s, 2000))
    require_balance(e)
    angle = rows[:, s.snapshot().layout['joint_position'][0]][:, 0]
    rate = rows[:, s.snapshot().layout['joint_velocity'][0]][:, 0]
    np.testing.assert_allclose(e[:, POTENTIAL], -9.81 * np.sin(angle), atol=1e-12)
    np.testing.assert_allclose(e[:, KINETIC], 0.5 * rate**2, atol=1e-12)
    assert not e[:, [DISSIPATED, EXCHANGED]].any()
    assert np.abs(e[:, ERROR]).max() == s.totals()['energy_error_max'] < 1e-6 * 9.81


def test_of_a_damped_vibration_they_are_those_of_the_closed_form() -> None:
    """x = g/w^2 exp(-d t) (cos + d/w_d sin) about rest; the phase of the midpoint rule is late by (w h)^2 w t / 12."""
    s = simulation_of(load_scene('spring_mass', [ASKED]))
    n, h, w, d = 2000, s.h, 10.0, 1.0
    e = energies(s, histories(s, n))
    require_balance(e)
    t = h * np.arange(n + 1)
    wd, a = np.sqrt(w * w - d * d), 9.81 / w**2
    v = -a * np.exp(-d * t) * w * w / wd * np.sin(wd * t)  # of the mass, downwards from its free length
    lost = np.concatenate([[0.0], np.cumsum(0.5 * h * 2.0 * (v[1:] ** 2 + v[:-1] ** 2))])
    late = (w * h) ** 2 * w * t[-1] / 12.0
    most = 0.5 * (a * w) ** 2
    np.testing.assert_allclose(e[:, KINETIC], 0.5 * v * v, atol=4.0 * late * most)
    np.testing.assert_allclose(e[:, DISSIPATED], lost, atol=4.0 * late * most)
    assert not e[:, EXCHANGED].any()


@pytest.mark.parametrize('order', [2, 4])
def test_an_input_exchanges_its_own_work_and_a_damper_loses_the_rest(order: int) -> None:
    """Compared with integrals of torque x rate by the trapezoidal rule on the run itself, whose error is h^2/12 times
    the change of the slope of the power; the errors of the balance fall with the square of the step."""
    worst = []
    for h in (4e-3, 2e-3):
        s = simulation_of(load_scene_text(DRIVEN.replace('H', str(h)).replace('ORDER', str(order))))
        rows = histories(s, n := round(3.0 / h))
        e, layout = energies(s, rows), s.snapshot().layout
        require_balance(e)
        rate = rows[:, layout['joint_velocity'][0]][:, 0]
        work = lambda power: np.concatenate([[0.0], np.cumsum(0.5 * h * (power[1:] + power[:-1]))])  # noqa: B023, E731
        torque = 3.0 * np.sin(2.0 * h * np.arange(n + 1))
        assert (torque * rate).min() < -0.5  # it holds back at times
        np.testing.assert_allclose(e[:, EXCHANGED], work(torque * rate), atol=20.0 * h * h)
        np.testing.assert_allclose(e[:, DISSIPATED], work(0.3 * rate * rate), atol=20.0 * h * h)
        worst.append(np.abs(e[:, ERROR]).max())
    assert worst[1] < 0.3 * worst[0]


def test_an_imposed_motion_exchanges_what_its_driver_does() -> None:
    """A crank that a coupler turns: the work of the reaction of the row that drives it."""
    drive = '  couplers:\n    drive: {terms: [[pivot, 1]], input: turn}\n'
    text = DRIVEN.replace('    motor: {terms: [[pivot, 1]], input: torque}\n', drive)
    text = (
        text.replace('duration: 4', 'duration: 4\nstart: {kind: assemble}')
        .replace('torque: {kind: sine', 'turn: {kind: sine')
        .replace('ORDER', '2')
        .replace('H', '0.002')
    )
    s = simulation_of(load_scene_text(text))
    rows = histories(s, 1500)
    e, layout = energies(s, rows), s.snapshot().layout
    require_balance(e)
    rate, effort = (rows[:, layout[f'joint_{name}'][0]][:, 0] for name in ('velocity', 'effort'))
    power = effort * rate
    work = np.concatenate([[0.0], np.cumsum(0.5 * s.h * (power[1:] + power[:-1]))])
    lost = np.concatenate([[0.0], np.cumsum(0.5 * s.h * 0.3 * (rate[1:] ** 2 + rate[:-1] ** 2))])
    np.testing.assert_allclose(e[:, EXCHANGED], work, atol=1e-3 * np.ptp(work))
    np.testing.assert_allclose(e[:, DISSIPATED], lost, atol=1e-3 * lost[-1])


def test_of_the_slider_crank_motion_and_height_are_added_up_by_hand() -> None:
    s = simulation_of(load_scene('slider_crank', [ASKED]))
    e = energies(s, rows := histories(s, 800))
    require_balance(e)
    shot = s.snapshot()
    bodies, kin = s.model.tables.bodies, s.kinematics
    kinetic = 0.5 * sum(
        m * v[:3] @ v[:3] + v[3:] @ J @ v[3:] for m, J, v in zip(bodies.mass, bodies.inertia, kin.v, strict=False)
    )
    assert shot.energies[KINETIC] == pytest.approx(kinetic, rel=1e-12)
    assert shot.energies[POTENTIAL] == pytest.approx(9.81 * bodies.mass @ kin.p[:-1, 1], rel=1e-12)
    assert not e[:, [DISSIPATED, EXCHANGED]].any() and len(rows) == 801
    assert np.abs(e[:, ERROR]).max() == s.totals()['energy_error_max']


@pytest.mark.slow
@pytest.mark.parametrize('level', ['full', 'single_track'])
def test_a_car_that_brakes_loses_what_it_had(level: str) -> None:
    """To rest: its energy of motion becomes loss. Of bodies the loss is that of all elements, by the trapezoidal rule
    on the run itself."""
    s = simulation_of(load_scene('light_car_brake', [ASKED, f'fidelity={level}']))
    e = energies(s, rows := histories(s, 5000))
    require_balance(e)
    had = e[0, KINETIC]
    assert e[-1, KINETIC] < 1e-3 * had < 1e-3 * e[-1, DISSIPATED] * 1.1
    assert e[-1, DISSIPATED] == pytest.approx(had + e[-1, EXCHANGED], rel=0.02)
    assert np.abs(e[:, EXCHANGED]).max() < 0.02 * had  # a wheel that is held and a drive that is off
    assert np.abs(e[:, ERROR]).max() == pytest.approx(s.totals()['energy_error_max'], rel=1e-9)
    if level == 'full':
        loss = np.zeros(len(rows))
        place = {name: k for name, _, k in columns(s.channels)}
        for kind in FORCES:
            for one in getattr(s.model.spec, kind.name):
                if not kind.wheels and not kind.feeds(one):
                    loss += rows[:, place[f'element_states/{one.name}/dissipation']]
        assert np.trapezoid(loss, dx=s.h) < e[-1, DISSIPATED]  # tires are shown without theirs, and lose the rest


def test_they_go_on_from_a_saved_state_with_the_same_bits() -> None:
    """Kept by restore(), in the run that saved it and in another; begun anew by reset()."""
    scene = load_scene_text(DRIVEN.replace('H', '0.002').replace('ORDER', '2'))
    s, other = simulation_of(scene), simulation_of(scene)
    start = s.snapshot().energies.copy()
    then = s.advance(300).energies.copy()
    saved = s.save()
    later = s.advance(200).energies.copy()
    assert then[EXCHANGED] != later[EXCHANGED]
    for one in (s, other):
        one.restore(saved)
        assert (one.snapshot().energies == then).all()
        assert (one.advance(200).energies == later).all()
    s.reset()
    assert (s.snapshot().energies == start).all()


def test_the_account_is_kept_wherever_they_are_asked_for_and_changes_nothing_else() -> None:
    """Also where a caller does without (audit=False), and in an ensemble; the numbers of the others have the same
    bits."""
    text = DRIVEN.replace('H', '0.002').replace('ORDER', '2')
    s, plain = (simulation_of(load_scene_text(t)) for t in (text, text.replace('energies: 1000', 'energies: 0')))
    with_, without = s.advance(250, audit=False), plain.advance(250)
    n = with_.layout['energies'][0]
    assert (with_.numbers[: n.start] == without.numbers).all() and n.stop == with_.numbers.size
    assert without.energies.size == 0 and with_.energies[EXCHANGED] != 0.0
    ensemble = Ensemble([s.scene] * 2)
    ensemble.advance(250, audit=False)
    assert (ensemble.field('energies') == with_.energies).all()
    assert (ensemble.quantity('energies/exchanged') == with_.energies[EXCHANGED]).all()


def test_a_state_that_was_saved_without_them_is_refused_by_name() -> None:
    text = DRIVEN.replace('H', '0.002').replace('ORDER', '2')
    s, plain = (simulation_of(load_scene_text(t)) for t in (text, text.replace('energies: 1000', 'energies: 0')))
    with pytest.raises(SpecError, match=r'was saved without record\.energies, and this scene is with'):
        s.restore(plain.save())
    with pytest.raises(SpecError, match=r'was saved with record\.energies, and this scene is without'):
        plain.restore(s.save())


def test_they_are_recorded_at_their_rate_with_units(tmp_path: Path) -> None:
    scene = load_scene('pendulum', ['record.energies=100', 'duration=0.1'])
    s = simulation_of(scene)
    simulate(s, 100, directory=tmp_path / 'r')
    run = bag.read(tmp_path / 'r')
    series = run.series['energies']
    assert list(series.time_ns) == [k * 10_000_000 for k in range(11)]
    assert list(series.columns) == [f'energies/{name}' for name in ENERGIES]
    assert [series.columns[f'energies/{name}'][-1] for name in ENERGIES] == s.snapshot().energies.tolist()
    assert {units(run)(f'energies/{name}') for name in ENERGIES} == {'J'}
    write_page([tmp_path / 'r'], tmp_path / 'page.html')
    assert all(f'"energies/{name}"' in (tmp_path / 'page.html').read_text(encoding='utf-8') for name in ENERGIES)
    plain = load_scene('pendulum')
    assert 'energies' not in [topic.name for topic in Messages.of(plain, simulation_of(plain)).topics]


@pytest.mark.slow
@pytest.mark.parametrize(
    'settings',
    [
        ['integrator.step_policy=error', 'integrator.error_tolerance=1e-5'],
        ['integrator.step_policy=rescue', 'integrator.penalty_policy=adaptive'],
        ['integrator.kind=reference_bdf'],
    ],
)
def test_they_balance_whatever_makes_the_steps(settings: list[str]) -> None:
    """Steps that are divided, refused and made again, and those of another integrator: the energies are the account's,
    whose error is that of the run."""
    s = simulation_of(load_scene('double_pendulum', [ASKED, *settings]))
    e = energies(s, histories(s, 400))
    require_balance(e)
    assert np.abs(e[:, ERROR]).max() <= s.totals()['energy_error_max'] < 1e-3 * np.ptp(e[:, KINETIC])
    assert not e[:, [DISSIPATED, EXCHANGED]].any()


@pytest.mark.slow
def test_in_lanes_each_car_has_those_of_its_single_run() -> None:
    """Four single-track cars with different torques, and one more by itself."""
    scene = load_scene('light_car_step_steer', [ASKED, 'fidelity=single_track'])
    ensemble, alone = Ensemble([scene] * 4), simulation_of(scene)
    assert ensemble.in_lanes
    rows = np.repeat(alone.source.table(0, 600)[None], 4, axis=0)
    rows[:, :, alone.channels.inputs.index('drive_torque')] *= np.array([0.0, 0.5, 1.0, 2.0])[:, None]
    ensemble.advance(600, rows)
    for k in range(4):
        alone.reset()
        assert (alone.advance(600, rows[k]).numbers == ensemble.simulations[k].snapshot().numbers).all()
    exchanged = ensemble.quantity('energies/exchanged')
    assert (np.diff(exchanged) > 0.0).all() and exchanged[-1] > 100.0


@pytest.mark.slow
def test_a_recording_with_them_replays_to_the_bit_and_is_exported_with_units(tmp_path: Path) -> None:
    recorded = str(tmp_path / 'r')
    assert main(['run', 'four_bar', '--set', 'record.energies=100', '--set', 'duration=0.5', '--out', recorded]) in (
        0,
        1,
    )
    assert main(['replay', recorded]) == 0
    assert main(['export', recorded, '--csv', str(tmp_path / 'csv')]) == 0
    (file,) = (tmp_path / 'csv').rglob('energies.csv')
    head = file.read_text(encoding='utf-8').splitlines()[0].split(',')
    assert head[1:] == [f'{name} [J]' for name in ENERGIES]
