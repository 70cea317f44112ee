"""A unit of co-simulation in its modes: calls in another order are errors with a sentence; its end tells findings."""

from __future__ import annotations

import pytest
from fmi_unit import Unit
from fmpy.fmi1 import FMICallException

from mbd_sim_ros.native.fmu import write
from mbd_sim_ros.native.kernels import target
from solver import load_scene, simulation_of

SCENE, SHOWN = 'light_car_step_steer', ['odom/pose/x', 'odom/twist/wz', 'tire/front_left/force/fy', 'steps']


@pytest.fixture(scope='module')
def units(tmp_path_factory) -> dict[int, Unit]:
    """A light car whose scene requires more than a step can give, by version."""
    there = tmp_path_factory.mktemp('units')
    simulation, made = simulation_of(load_scene(SCENE, ['require.energy_error_max=1e-12'])), {}
    for version in (2, 3):
        write(simulation, there / f'{version}.fmu', target('v3'), version=version)
        made[version] = Unit(there / f'{version}.fmu', version)
    return made


def refused(unit: Unit, call, *arguments, **values) -> str:
    """The sentence of a call that is an error; it changes nothing of the outputs."""
    said = len(unit.said)
    with pytest.raises(FMICallException):
        call(*arguments, **values)
    assert len(unit.said) == said + 1
    return unit.said[-1]


@pytest.mark.parametrize('version', [2, 3])
def test_calls_in_another_order_are_errors_and_change_nothing(units, version):
    unit = units[version]
    slave = unit.instance()
    unit.instantiate(slave)
    unit.set(slave, steering=0.1)  # a start value
    before = 'is for a unit between steps, and this one is before its initialization'
    assert refused(unit, slave.doStep, 0.0, 0.001) == f'a step {before}'
    assert refused(unit, slave.terminate) == f'terminate {before}'
    assert refused(unit, slave.exitInitializationMode).endswith('and this one is before its initialization')
    if version == 2:
        slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    assert refused(unit, slave.enterInitializationMode).endswith('and this one is in its initialization')
    assert refused(unit, slave.doStep, 0.0, 0.001).endswith('and this one is in its initialization')
    slave.exitInitializationMode()
    slave.doStep(0.0, 0.01)
    shown = unit.get(slave, SHOWN)
    for step in (-0.001, 1e12, float('inf')):
        assert refused(unit, slave.doStep, 0.01, step) == (
            'time and step of a communication must be finite and below 9e9 s, and no step is negative'
        )
    slave.terminate()
    assert refused(unit, unit.set, slave, steering=0.2).startswith('nothing can be set: the run has ended')
    assert refused(unit, slave.doStep, 0.01, 0.001).endswith('and this one is at its end')
    assert refused(unit, slave.terminate).endswith('and this one is at its end')
    assert unit.get(slave, SHOWN) == shown
    slave.reset()
    assert unit.get(slave, ['steps', 'time']) == [0.0, 0.0]
    if version == 2:
        slave.setupExperiment(startTime=5.0)
    slave.enterInitializationMode(**({} if version == 2 else {'startTime': 5.0}))
    slave.exitInitializationMode()
    assert refused(unit, slave.doStep, 0.0, 0.01) == 'the communication begins at 0 s, and the unit is at 5 s'
    unit.set(slave, steering=0.1)
    slave.doStep(5.0, 0.01)
    assert unit.get(slave, [*SHOWN, 'time']) == [*shown, 5.01]
    slave.freeInstance()


@pytest.mark.parametrize('version', [2, 3])
def test_the_end_of_a_run_tells_its_findings(units, version):
    unit, slave = units[version], units[version].begun()
    assert unit.get(slave, ['findings']) == [0.0]
    slave.doStep(0.0, 0.1)
    assert unit.get(slave, ['findings']) == [1.0]
    said = len(unit.said)
    slave.terminate()
    (finding,) = unit.said[said:]
    assert finding.startswith('The energy account misses some') and 'required 1e-12 J' in finding
    slave.freeInstance()


@pytest.mark.parametrize('version', [2, 3])
def test_no_output_depends_on_an_input_at_the_same_instant(units, version):
    unit, slave = units[version], units[version].begun()
    outputs = [v.name for v in unit.description.modelVariables if v.causality == 'output']
    assert [one.dependencies for one in unit.description.outputs] == [[]] * len(outputs)
    assert [one.dependencies for one in unit.description.initialUnknowns] == [[]] * len(outputs)
    assert not (unit.description.coSimulation.providesDirectionalDerivative)
    for k in range(3):
        before = unit.get(slave, outputs)
        unit.set(slave, steering=0.3 * k, drive_torque=100.0, brake_torque=10.0 * k)
        assert unit.get(slave, outputs) == before
        slave.doStep(k * 0.005, 0.005)
        assert unit.get(slave, outputs) != before
    slave.freeInstance()
