"""The launch file, read with stand-ins for the launch packages (which come with ROS only): nodes, parameters and
arguments exist."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from mbd_sim_ros.node.maneuver_player import PARAMETERS as MANEUVER

ROOT = Path(__file__).resolve().parents[2]


def stand_in(kind: str):
    return lambda *args, **kwargs: SimpleNamespace(kind=kind, args=args, **kwargs)


MODULES = {
    'launch': ('LaunchDescription',),
    'launch.actions': (
        'DeclareLaunchArgument',
        'LogInfo',
        'OpaqueFunction',
        'RegisterEventHandler',
        'SetEnvironmentVariable',
        'Shutdown',
    ),
    'launch.conditions': ('IfCondition',),
    'launch.event_handlers': ('OnProcessExit',),
    'launch.substitutions': ('LaunchConfiguration', 'PathJoinSubstitution'),
    'launch_ros': (),
    'launch_ros.actions': ('Node',),
    'launch_ros.parameter_descriptions': ('ParameterValue',),
    'launch_ros.substitutions': ('FindPackageShare',),
}


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Packages that ROS finds -> where."""
    found: dict[str, str] = {}
    module = ModuleType('ament_index_python.packages')
    module.PackageNotFoundError, module.get_package_prefix = KeyError, found.__getitem__  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    return found


@pytest.fixture
def description(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    for name, members in MODULES.items():
        module = ModuleType(name)
        for member in members:
            setattr(module, member, stand_in(member))
        monkeypatch.setitem(sys.modules, name, module)
    return runpy.run_path(str(ROOT / 'launch' / 'sim.launch.py'))['generate_launch_description']()


def of_function(description: SimpleNamespace, name: str, **arguments: str) -> list:
    """What a function of the launch adds for these arguments."""
    functions = {e.function.__name__: e.function for e in description.args[0] if e.kind == 'OpaqueFunction'}
    defaults = {e.args[0]: e.default_value for e in description.args[0] if e.kind == 'DeclareLaunchArgument'}
    defaults['params'] = str(ROOT.joinpath(*defaults['params'].args[0][1:]))
    return functions[name](SimpleNamespace(launch_configurations={**defaults, **arguments}))


def test_launch_file_starts_what_is_installed(description: SimpleNamespace) -> None:
    setup = (ROOT / 'setup.py').read_text()
    nodes = [entity for entity in of_function(description, 'nodes') if entity.kind == 'Node']
    assert [node.executable for node in nodes] == ['simulator', 'maneuver']
    for node in nodes:
        assert node.package == 'mbd_sim_ros'
        assert f'{node.executable} = {{NAME}}.' in setup


def test_arguments_are_declared_with_defaults_and_reach_parameters_that_exist(description: SimpleNamespace) -> None:
    parameters = pytest.importorskip(
        'mbd_sim_ros.node.parameters', reason='needs ROS: source Jazzy, or pip install .[ros]'
    )
    declared = {entity.args[0]: entity for entity in description.args[0] if entity.kind == 'DeclareLaunchArgument'}
    everything = {'scene': 'x', 'mode': 'fast', 'rate_factor': '2.0', 'duration': '1.0', 'record': 'true'}
    simulator, player, _ = of_function(description, 'nodes', **everything)
    file, values = simulator.parameters
    assert file.kind == 'LaunchConfiguration' and file.args == ('params',)
    assert values.keys() == everything.keys()
    for name, value in values.items():
        assert name in parameters.PARAMETERS
        assert value.args[0].args == (name,) and name in declared
    share = declared['params'].default_value.args[0]
    assert share[0].args == ('mbd_sim_ros',)
    assert ROOT.joinpath(*share[1:]).is_file()
    assert player.parameters[0].keys() <= MANEUVER.keys()
    assert player.condition.args[0].args == ('play',)


def test_what_no_argument_says_is_as_in_the_parameter_file(description: SimpleNamespace) -> None:
    """Parameters behind a file go before it: a default among them would undo `record: true` of the user's own file
    unsaid."""
    assert of_function(description, 'nodes', scene='x', params='mine.yaml')[0].parameters[1].keys() == {'scene'}
    assert of_function(description, 'nodes', scene='x', record='false')[0].parameters[1].keys() == {'scene', 'record'}


@pytest.mark.parametrize(
    ('arguments', 'file', 'every'),
    [
        ({'mode': 'lockstep'}, '', True),
        ({}, '', False),
        ({}, '/**: {ros__parameters: {mode: lockstep}}', True),
        ({}, '/car1: {simulator: {ros__parameters: {mode: lockstep}}}', True),
        ({'mode': 'fast'}, '/**: {ros__parameters: {mode: lockstep}}', False),
        ({}, '/**: {ros__parameters: {mode: realtime}}', False),
        ({}, ': [', False),
    ],
)
def test_in_lockstep_the_maneuver_answers_every_state(
    arguments: dict[str, str], file: str, every: bool, description: SimpleNamespace, tmp_path: Path
) -> None:
    """At most 100 answers a second, which are enough in real time, would be the pace of the simulation."""
    if file:
        (tmp_path / 'mine.yaml').write_text(file)
        arguments = {**arguments, 'params': str(tmp_path / 'mine.yaml')}
    parameters = of_function(description, 'nodes', scene='x', **arguments)[1].parameters[0]
    assert parameters.get('rate') == (0.0 if every else None)


def test_the_launch_ends_when_the_simulator_has_ended(description: SimpleNamespace) -> None:
    simulator, _, registered = of_function(description, 'nodes')
    handler = registered.args[0]
    assert handler.kind == 'OnProcessExit' and handler.target_action is simulator
    assert [action.kind for action in handler.on_exit(SimpleNamespace(returncode=0), None)] == ['Shutdown']


@pytest.mark.parametrize('code', [1, 4, -9])
def test_the_launch_fails_when_the_simulator_has_failed(description: SimpleNamespace, code: int) -> None:
    """An exception in a handler is what launch turns into a shutdown with exit code 1."""
    handler = of_function(description, 'nodes')[-1].args[0]
    with pytest.raises(RuntimeError, match=f'ended with exit code {code}'):
        handler.on_exit(SimpleNamespace(returncode=code), None)


def test_viewers_are_started_when_they_are_wanted_and_installed(
    description: SimpleNamespace, installed: dict[str, str]
) -> None:
    assert of_function(description, 'viewers', rviz='false') == []
    (said,) = of_function(description, 'viewers', rviz='true')
    assert said.kind == 'LogInfo' and said.msg.startswith('rviz:=true, but rviz2 is not installed: install')
    installed |= {'rviz2': '/opt/ros', 'foxglove_bridge': '/opt/ros'}
    rviz, bridge = of_function(description, 'viewers', rviz='true', foxglove='True', namespace='car1')
    assert (rviz.executable, bridge.executable) == ('rviz2', 'foxglove_bridge')
    assert rviz.namespace == bridge.namespace == 'car1'
    # or a reset would be shown once it has been caught up
    assert rviz.parameters == bridge.parameters == [{'use_sim_time': True}]
    assert ROOT.joinpath(*rviz.arguments[1].args[0][1:]).is_file()


def test_nodes_keep_to_this_machine_unless_it_is_decided_otherwise(
    description: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv('ROS_AUTOMATIC_DISCOVERY_RANGE', raising=False)
    (setting,) = of_function(description, 'discovery')
    assert setting.args == ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    functions = [entity.function.__name__ for entity in description.args[0] if entity.kind == 'OpaqueFunction']
    assert functions.index('discovery') < functions.index('nodes')
    assert of_function(description, 'discovery', open='true') == []
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
    assert of_function(description, 'discovery') == []
