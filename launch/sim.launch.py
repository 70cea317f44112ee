"""ros2 launch mbd_sim_ros sim.launch.py scene:=NAME [play:=true] [record:=true] [rviz:=true] [foxglove:=true]
[namespace:=car1] ...

Arguments that are not given are as the parameter file has them (params:=FILE). Nodes of this launch talk to this
machine only, unless open:=true or ROS_AUTOMATIC_DISCOVERY_RANGE is set. The launch ends when the simulator ends, with
exit code 1 if that failed.
"""

import os

import yaml
from launch.actions import (
    DeclareLaunchArgument,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
    Shutdown,
)
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

FILE = 'empty: as in the parameter file'
ARGUMENTS = {
    'scene': (None, 'scene file, or the name of one in config/scenes'),
    'mode': ('', f'realtime, fast or lockstep; {FILE}'),
    'rate_factor': ('', f'simulated seconds per second in mode realtime; {FILE}'),
    'duration': ('', f'simulated seconds after which it ends; 0: none, -1: that of the scene; {FILE}'),
    'record': ('', f'true: record from the start; {FILE}'),
    'play': ('false', "also play the scene's maneuver over the command topics"),
    'rviz': ('false', 'show the car in RViz, when that is installed'),
    'foxglove': ('false', 'open a bridge for Foxglove on port 8765, when that is installed'),
    'open': ('false', 'talk to other machines too (docs/ros.md, Security)'),
    'namespace': ('', 'namespace of both nodes'),
    'params': (
        PathJoinSubstitution([FindPackageShare('mbd_sim_ros'), 'config', 'node.yaml']),
        'parameter file of the simulator',
    ),
}
# of those that are parameters too
TYPES = {'scene': str, 'mode': str, 'rate_factor': float, 'duration': float, 'record': bool}


def ended(event, _context):
    """End everything when the simulator has ended: nothing may go on waiting for it.

    Raises RuntimeError when it failed: an exception is what gives a launch an exit code.
    """
    if event.returncode:
        raise RuntimeError(f'the simulator ended with exit code {event.returncode}')
    return [Shutdown(reason='the simulator has ended')]


def in_lockstep(arguments):
    """True where the simulator waits for answers, by the argument or by the parameter file."""
    if arguments['mode']:
        return arguments['mode'] == 'lockstep'
    try:
        with open(arguments['params'], encoding='utf-8') as file:
            return 'lockstep' in modes(yaml.safe_load(file))
    except (OSError, ValueError, yaml.YAMLError):  # the simulator refuses it, and says why
        return False


def modes(tree):
    """Every `mode` among the parameters in a file, whatever the nodes are called: it is the simulator's."""
    if not isinstance(tree, dict):
        return []
    found = [value.get('mode') for key, value in tree.items() if key == 'ros__parameters' and isinstance(value, dict)]
    return found + [mode for value in tree.values() for mode in modes(value)]


def nodes(context):
    """The simulator, and the maneuver if wanted, with what is given as arguments; the default of one would hide what
    the file says."""
    given = {name: kind for name, kind in TYPES.items() if name == 'scene' or context.launch_configurations[name]}
    parameters = {name: ParameterValue(LaunchConfiguration(name), value_type=kind) for name, kind in given.items()}
    namespace = LaunchConfiguration('namespace')
    # every state is answered, or each waits for it
    rate = {'rate': 0.0} if in_lockstep(context.launch_configurations) else {}
    simulator = Node(
        package='mbd_sim_ros',
        executable='simulator',
        name='simulator',
        namespace=namespace,
        parameters=[LaunchConfiguration('params'), parameters],
        output='screen',
    )
    maneuver = Node(
        package='mbd_sim_ros',
        executable='maneuver',
        name='maneuver',
        namespace=namespace,
        parameters=[{'scene': parameters['scene'], 'timeout': 600.0, **rate}],  # the first start compiles
        condition=IfCondition(LaunchConfiguration('play')),
        output='screen',
    )
    return [simulator, maneuver, RegisterEventHandler(OnProcessExit(target_action=simulator, on_exit=ended))]


VIEWERS = {  # argument -> package, executable, what to say when it is missing
    'rviz': ('rviz2', 'rviz2', 'install ros-jazzy-rviz2, or look at the recording with `mbd view`'),
    'foxglove': (
        'foxglove_bridge',
        'foxglove_bridge',
        'install ros-jazzy-foxglove-bridge, or open the recording in Foxglove',
    ),
}
LAYOUT = PathJoinSubstitution([FindPackageShare('mbd_sim_ros'), 'config', 'layouts', 'car.rviz'])


def viewers(context):
    """The viewers that are wanted and installed, and a sentence for those that are not installed."""
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix

    entities = []
    for name, (package, executable, remedy) in VIEWERS.items():
        if context.launch_configurations[name].lower() not in ('true', '1'):
            continue
        try:
            get_package_prefix(package)
        except PackageNotFoundError:
            entities.append(LogInfo(msg=f'{name}:=true, but {package} is not installed: {remedy}'))
            continue
        namespace = context.launch_configurations['namespace']
        arguments = {'arguments': ['-d', LAYOUT]} if name == 'rviz' else {}
        # By the clock of the day a reset is data of the past: transforms are kept as they were until it has been caught
        # up.
        time = {'parameters': [{'use_sim_time': True}]}
        entities.append(
            Node(package=package, executable=executable, namespace=namespace, output='screen', **time, **arguments)
        )
    return entities


def discovery(context):
    """Keep the nodes to this machine, unless that is decided otherwise."""
    if context.launch_configurations['open'].lower() in ('true', '1') or 'ROS_AUTOMATIC_DISCOVERY_RANGE' in os.environ:
        return []
    return [SetEnvironmentVariable('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')]


def generate_launch_description() -> LaunchDescription:
    """The simulator and, if wanted, the maneuver that drives it."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, (default, text) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=discovery),  # before anything is started
            OpaqueFunction(function=nodes),
            OpaqueFunction(function=viewers),
        ]
    )
