"""simulation_interfaces over real services and an action, with stand-ins of the package; scenes loaded while the node
runs; placing."""

from __future__ import annotations

import math
import signal
import sys
import time

import numpy as np
import pytest
from client import client
from foreign import packages
from processes import start

from mbd_sim_ros.bags import reader as bag

pytestmark = pytest.mark.realtime

__all__ = ['client', 'start']  # fixtures


def calling(client, kind, name: str, **request):
    """Call a service of the simulator: a future."""
    service = client.node.create_client(kind, f'simulator/{name}')
    client.until(service.service_is_ready)
    return service.call_async(kind.Request(**request))


def caller(client):
    """A function that calls a service of the simulator and waits for its answer."""

    def call(kind, name: str, **request):
        future = calling(client, kind, name, **request)
        client.until(future.done)
        return future.result()

    return call


def put(client, **parameters: object) -> None:
    """Set parameters of the simulator."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    wanted = [Parameter(name, value=value).to_parameter_msg() for name, value in parameters.items()]
    assert all(
        result.successful for result in caller(client)(SetParameters, 'set_parameters', parameters=wanted).results
    )


def test_another_scene_is_loaded_without_a_restart(start, client, tmp_path):
    process = start({'record': True, 'out': 'first'})
    client.until(lambda: client.applied and client.applied[-1]['step'] > 100)
    put(client, scene='nothing')
    refused = client.call('load')
    assert not refused.success and refused.message == "scene 'nothing': no such file"
    put(client, scene='')
    assert client.call('load').message == 'parameter scene is empty: set it to the name or file of a scene'
    before = client.applied[-1]['step']
    client.until(lambda: client.applied[-1]['step'] > before)  # it goes on
    put(client, scene='second')
    assert client.call('load').message == 'second stands at its start'
    client.until(lambda: client.applied[-1]['step'] == 0)
    assert client.call('step').success
    client.until(lambda: client.applied[-1]['step'] == 1)
    client.ready()
    client.send(1, 40.0)
    assert client.call('resume').success
    client.until(lambda: client.applied[-1]['step'] > 100 and client.applied[-1]['drive_torque'] == 40.0)
    process.process.terminate()
    assert process.end() == 0, process.output
    assert 'Traceback' not in process.output
    assert bag.read(tmp_path / 'first').metadata['end'] == 'second was loaded'
    (second,) = (tmp_path / 'bags').glob('second-*')
    run = bag.read(second)
    assert run.metadata['scene'] == 'second'
    np.testing.assert_array_equal(run['cmd_applied/step'], np.arange(len(run.time_ns)))


def test_a_signal_while_another_scene_is_prepared_ends_in_order_at_once(start, client, tmp_path):
    process = start({'record': True, 'out': 'run'})
    client.until(lambda: client.applied)
    put(client, scene='slow')
    loaded = calling(client, client._trigger, 'load')
    client.until(lambda: process.output.count('PREPARING') == 2)
    step = client.applied[-1]['step']
    client.until(lambda: client.applied[-1]['step'] > step + 50)  # it goes on
    begin = time.monotonic()
    process.process.send_signal(signal.SIGINT)
    client.until(loaded.done)
    assert not loaded.result().success and loaded.result().message == 'interrupted while preparing slow'
    assert process.end() == 0, process.output
    assert time.monotonic() - begin < 1.5
    assert 'stopped by SIGINT: t = ' in process.output and 'Traceback' not in process.output
    assert bag.read(tmp_path / 'run').metadata['end'] == 'stopped by SIGINT'


def test_initialpose_places_the_car(start, client, tmp_path):
    from geometry_msgs.msg import PoseWithCovarianceStamped

    process = start({'record': True, 'out': 'run'})
    publisher = client.node.create_publisher(PoseWithCovarianceStamped, 'initialpose', 1)
    client.until(lambda: publisher.get_subscription_count() and client.odom)
    message = PoseWithCovarianceStamped()
    message.pose.pose.position.x, message.pose.pose.position.y = 50.0, -20.0
    message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(0.5), math.cos(0.5)
    publisher.publish(message)
    client.until(lambda: 'initialpose: placed at x = 50.000 m, y = -20.000 m, heading 57.30 deg' in process.output)
    message.pose.pose.orientation.w = message.pose.pose.orientation.z = 0.0
    publisher.publish(message)
    client.until(lambda: 'initialpose refused: orientation' in process.output)
    process.process.terminate()
    assert process.end() == 0, process.output
    assert bag.read(tmp_path / 'run').metadata['end'] == 'placed elsewhere'
    assert len(list((tmp_path / 'bags').glob('synthetic-*'))) == 1


def test_steps_are_made_when_their_call_is_answered_and_a_pause_is_answered_meanwhile(start, client):
    """What is asked for next finds them: here a state is saved."""
    start({'step_count': 1500})
    client.until(lambda: client.applied)
    k = int(client.call('pause').message.split('step ')[1])
    stepped = client.call('step')
    assert stepped.success and stepped.message == f'1500 steps from step {k}'
    assert f'-step{k + 1500}-' in client.call('save_state').message
    put(client, step_count=1_000_000)
    future = calling(client, client._trigger, 'step')
    client.until(lambda: client.applied[-1]['step'] > k + 1500)
    dropped = int(client.call('pause').message.split('; ')[1].split(' steps')[0])
    client.until(future.done)
    cut = f'1000000 steps from step {k + 1500}: {dropped} of them were dropped by a pause, a resumption or a reset'
    assert not future.result().success and future.result().message == cut


def test_the_simulation_is_controlled_by_simulation_interfaces(start, client):
    where = packages()
    sys.path.insert(0, str(where))
    from rclpy.action import ActionClient
    from simulation_interfaces.action import SimulateSteps
    from simulation_interfaces.msg import (
        EntityFilters,
        EntityState,
        Resource,
        Result,
        SimulationState,
        SimulatorFeatures,
    )
    from simulation_interfaces.srv import (
        GetEntities,
        GetEntityState,
        GetSimulationState,
        GetSimulatorFeatures,
        LoadWorld,
        ResetSimulation,
        SetEntityState,
        SetSimulationState,
        StepSimulation,
    )

    process = start(path=str(where))
    client.until(lambda: client.applied)  # services are found earlier than topics when the machine is busy
    call = caller(client)
    found = set(call(GetSimulatorFeatures, 'get_simulator_features').features.features)
    assert {
        SimulatorFeatures.SIMULATION_STATE_PAUSE,
        SimulatorFeatures.STEP_SIMULATION_ACTION,
        SimulatorFeatures.WORLD_LOADING,
    } <= found
    assert not found & {SimulatorFeatures.SPAWNING, SimulatorFeatures.ENTITY_TAGS}

    def state() -> int:
        return call(GetSimulationState, 'get_simulation_state').state.state

    def set_state(wanted: int) -> int:
        return call(SetSimulationState, 'set_simulation_state', state=SimulationState(state=wanted)).result.result

    assert state() == SimulationState.STATE_PLAYING
    assert set_state(SimulationState.STATE_PLAYING) == SetSimulationState.Response.ALREADY_IN_TARGET_STATE
    # it is not paused
    assert call(StepSimulation, 'step_simulation', steps=3).result.result == Result.RESULT_OPERATION_FAILED
    assert set_state(SimulationState.STATE_STOPPED) == Result.RESULT_OK
    assert state() == SimulationState.STATE_STOPPED
    client.until(lambda: client.applied and client.applied[-1]['step'] == 0)
    assert call(StepSimulation, 'step_simulation', steps=7).result.result == Result.RESULT_OK
    client.until(lambda: client.applied[-1]['step'] == 7)
    assert state() == SimulationState.STATE_PAUSED

    action = ActionClient(client.node, SimulateSteps, 'simulator/simulate_steps')
    client.until(action.server_is_ready)
    told: list[int] = []
    sent = action.send_goal_async(
        SimulateSteps.Goal(steps=2000), feedback_callback=lambda m: told.append(m.feedback.completed_steps)
    )
    client.until(sent.done)
    # before the result is asked for: with it the client stops listening
    client.until(lambda: told and told[-1] == 2000)
    assert told == sorted(told) and len(told) > 5
    result = sent.result().get_result_async()
    client.until(result.done)
    assert result.result().result.result.result == Result.RESULT_OK
    client.until(lambda: client.applied[-1]['step'] == 2007)
    sent = action.send_goal_async(SimulateSteps.Goal(steps=10**9))
    client.until(sent.done)
    client.until(lambda: client.applied[-1]['step'] > 2040)
    assert state() == SimulationState.STATE_PAUSED  # others are answered meanwhile
    cancelled = sent.result().cancel_goal_async()
    client.until(cancelled.done)
    assert len(cancelled.result().goals_canceling) == 1
    result = sent.result().get_result_async()
    client.until(result.done)
    step = client.applied[-1]['step']
    future = calling(client, StepSimulation, 'step_simulation', steps=10**9)
    client.until(lambda: client.applied[-1]['step'] > step)
    assert set_state(SimulationState.STATE_PAUSED) == Result.RESULT_OK  # it is answered while the steps are made
    client.until(future.done)
    assert 'the others were dropped by a pause' in future.result().result.error_message
    step = client.applied[-1]['step']

    assert call(GetEntities, 'get_entities', filters=EntityFilters()).entities == ['subframe', 'chassis', 'wheel']
    assert call(GetEntities, 'get_entities', filters=EntityFilters(filter='^wh')).entities == ['wheel']
    assert (
        call(GetEntities, 'get_entities', filters=EntityFilters(filter='(')).result.result
        == Result.RESULT_OPERATION_FAILED
    )
    got = call(GetEntityState, 'get_entity_state', entity='chassis').state
    client.until(lambda: client.odom)
    assert got.header.frame_id == 'odom' and np.isnan(got.acceleration.linear.x)
    assert got.pose.position.x > 0.0
    assert call(GetEntityState, 'get_entity_state', entity='nobody').result.result == Result.RESULT_NOT_FOUND
    place = EntityState()
    place.pose.position.x, place.pose.orientation.z, place.pose.orientation.w = 30.0, math.sqrt(0.5), math.sqrt(0.5)
    assert (
        call(SetEntityState, 'set_entity_state', entity='chassis', state=place, set_pose=True).result.result
        == Result.RESULT_OK
    )
    client.until(lambda: 'placed at x = 30.000 m, y = 0.000 m, heading 90.00 deg' in process.output)
    # their name of the frame that is meant where none is given
    for frame, code in (('base_link', 101), ('world', Result.RESULT_OK)):
        place.header.frame_id = frame
        assert (
            call(SetEntityState, 'set_entity_state', entity='chassis', state=place, set_pose=True).result.result == code
        )
    place.pose.orientation.z = place.pose.orientation.w = 0.0
    assert call(SetEntityState, 'set_entity_state', entity='chassis', state=place, set_pose=True).result.result == 101
    assert call(SetEntityState, 'set_entity_state', entity='chassis', state=place, set_twist=True).result.result == 0

    client.until(lambda: client.applied[-1]['step'] >= step)
    last = client.applied[-1]['step']
    client.applied.clear()
    assert (
        call(ResetSimulation, 'reset_simulation', scope=ResetSimulation.Request.SCOPE_STATE).result.result
        == Result.RESULT_OK
    )
    client.until(lambda: client.applied)
    assert client.applied[-1]['step'] >= last  # time went on
    assert call(ResetSimulation, 'reset_simulation').result.result == Result.RESULT_OK
    client.until(lambda: client.applied[-1]['step'] == 0)
    assert call(ResetSimulation, 'reset_simulation', scope=ResetSimulation.Request.SCOPE_SPAWNED).result.result == 0

    loaded = call(LoadWorld, 'load_world', world_resource=Resource(uri='second'))
    assert loaded.result.result == Result.RESULT_OK and loaded.world.name == 'second'
    assert state() == SimulationState.STATE_STOPPED
    assert call(LoadWorld, 'load_world').result.result == LoadWorld.Response.NO_RESOURCE
    assert (
        call(LoadWorld, 'load_world', world_resource=Resource(uri='nothing')).result.result
        == LoadWorld.Response.RESOURCE_PARSE_ERROR
    )
    set_state(SimulationState.STATE_QUITTING)
    assert process.end() == 0, process.output
    assert 'Traceback' not in process.output
