"""Energy and momentum of the moving cars, element kind by element kind."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mbd_sim_ros.commands.main import main
from solver.analysis.balance import Balance
from solver.files.scene import load_scene
from solver.simulation import Simulation

INTERNAL = ('spring_dampers', 'bushings', 'coordinate_forces', 'brakes', 'constraints')


def followed(scene: str, h: float, seconds: float, *overrides: str) -> Balance:
    """The balance of the sweep from 0.3 s on, while the drive torque rises and the car is steered."""
    simulation = Simulation(load_scene(scene, [f'integrator.h={h}', *overrides]))
    simulation.advance(round(0.3 / h))
    balance = Balance(simulation)
    for _ in range(round(seconds / h)):
        simulation.advance(1)
        balance.update()
    return balance


@pytest.mark.slow
@pytest.mark.parametrize(('scene', 'seconds'), [('car_swept_steer', 1.5), ('light_car_swept_steer', 1.5)])
def test_balances_close_with_second_order(scene: str, seconds: float) -> None:
    coarse, fine = (followed(scene, h, seconds) for h in (1e-3, 5e-4))
    a, b = (balance.report()['energy_by_kind'] for balance in (coarse, fine))
    throughput = b['coordinate_forces']['supplied']
    assert throughput > 2e4
    for kind in b:
        assert abs(b[kind]['error']) < 1e-7 * throughput + 1e-9
        if abs(b[kind]['error']) > 1e-8 * throughput and kind != 'bushings':
            assert 3.0 < a[kind]['error'] / b[kind]['error'] < 5.5
    assert abs(a['bodies']['error']) > 3.0 * abs(b['bodies']['error']) > 0.0
    assert np.all(np.abs(coarse.momentum_error) > 2.5 * np.abs(fine.momentum_error))
    impulse = np.abs(fine.total[:, 3:]).max(axis=0)
    assert np.all(np.abs(fine.momentum_error) < 1e-6 * impulse.max())


@pytest.mark.slow
def test_balance_of_the_bushings_reaches_second_order() -> None:
    """Light parts on them decay at 3e3 1/s and faster, so the order shows late: from 2 ms on errors fall by 2.8, 3.5,
    3.9."""
    coarse, fine = (followed('car_swept_steer', h, 0.6).report()['energy_by_kind']['bushings'] for h in (5e-4, 2.5e-4))
    assert 3.5 < coarse['error'] / fine['error'] < 4.5


@pytest.mark.slow
@pytest.mark.parametrize('scene', ['car_swept_steer', 'light_car_swept_steer', 'light_car_brake'])
def test_audit_is_of_second_order_while_torques_ramp(scene: str) -> None:
    """Drive or brake torque rises within the time: the error of the running balance falls by four."""
    errors = []
    for h in (2e-3, 1e-3):
        simulation = Simulation(load_scene(scene, [f'integrator.h={h}']))
        simulation.advance(round(2.5 / h))
        errors.append(simulation.totals()['energy_error_max'])
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.3)


def test_forces_between_bodies_have_no_resultant() -> None:
    balance = followed('car_swept_steer', 2e-3, 0.5)
    inside = [row for row, kind in enumerate(balance.rows) if kind in INTERNAL]
    assert np.abs(balance.total[inside, 3:]).max() < 1e-13 * np.abs(balance.total[:, 3:]).max()


def test_braking_shows_where_the_energy_goes() -> None:
    """The light car from 72 km/h: brakes and tires take the kinetic energy, the brakes by far the most, and nothing is
    supplied."""
    balance = followed('light_car_brake', 1e-3, 2.0, 'start={kind: equilibrium, speed: 20}')
    table = balance.report()['energy_by_kind']
    lost = -table['bodies']['stored']
    assert lost > 1e5
    assert table['brakes']['dissipated'] > 0.85 * lost
    assert table['brakes']['dissipated'] + table['tires']['dissipated'] + table['aero_drags'][
        'dissipated'
    ] == pytest.approx(lost, rel=0.01)
    assert table['coordinate_forces']['supplied'] == 0.0


def test_a_step_left_out_is_refused() -> None:
    simulation = Simulation(load_scene('light_car_straight'))
    balance = Balance(simulation)
    simulation.advance(2)
    with pytest.raises(ValueError, match='after every step'):
        balance.update()


def test_run_shows_the_balance(capsys: pytest.CaptureFixture[str]) -> None:
    argv = ['run', 'light_car_step_steer', '--duration', '0.2', '--no-record', '--balance', '--json']
    assert main(argv) == 0
    data = json.loads(capsys.readouterr().out)
    kinds = data['energy_by_kind']
    assert {'tires', 'spring_dampers', 'gravity', 'constraints', 'bodies'} <= set(kinds)
    assert kinds['bodies']['error'] == pytest.approx(kinds['bodies']['work'] + kinds['bodies']['stored'], abs=1e-9)
    assert len(data['momentum_error']) == 6
