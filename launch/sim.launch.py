"""ros2 launch mbd_sim_ros sim.launch.py scene:=NAME [play:=true] [record:=true] [rviz:=true] [foxglove:=true] [namespace:=car1] ...

Nodes of this launch talk to this machine only, unless open:=true or ROS_AUTOMATIC_DISCOVERY_RANGE is set. The launch ends when the
simulator ends, with exit code 1 if that failed.
"""

import os

from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, RegisterEventHandler, SetEnvironmentVariable, Shutdown
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

ARGUMENTS = {
    'scene': (None, 'scene file, or the name of one in config/scenes'),
    'mode': ('realtime', 'realtime, fast or lockstep'),
    'rate_factor': ('1.0', 'simulated seconds per second in mode realtime'),
    'duration': ('0.0', 'simulated seconds after which it ends; 0: none, -1: that of the scene'),
    'record': ('false', 'record from the start'),
    'play': ('false', "also play the scene's maneuver over the command topics"),
    'rviz': ('false', 'show the car in RViz, when that is installed'),
    'foxglove': ('false', 'open a bridge for Foxglove on port 8765, when that is installed'),
    'open': ('false', 'talk to other machines too (docs/ros.md, Security)'),
    'namespace': ('', 'namespace of both nodes'),
    'params': (PathJoinSubstitution([FindPackageShare('mbd_sim_ros'), 'config', 'node.yaml']), 'parameter file'),
}


def ended(event, _context):
    """What happens when the simulator has ended: nothing may go on waiting for it.

    Raises RuntimeError when it failed: an exception is what gives a launch an exit code.
    """
    if event.returncode:
        raise RuntimeError(f'the simulator ended with exit code {event.returncode}')
    return [Shutdown(reason='the simulator has ended')]


VIEWERS = {  # argument -> package, executable, what to say when it is missing
    'rviz': ('rviz2', 'rviz2', 'install ros-jazzy-rviz2, or look at the recording with `mbd view`'),
    'foxglove': ('foxglove_bridge', 'foxglove_bridge', 'install ros-jazzy-foxglove-bridge, or open the recording in Foxglove'),
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
        # By the clock of the day a reset is data of the past: transforms are kept as they were until it has been caught up.
        time = {'parameters': [{'use_sim_time': True}]}
        entities.append(Node(package=package, executable=executable, namespace=namespace, output='screen', **time, **arguments))
    return entities


def discovery(context):
    """Keep the nodes to this machine, unless that is decided otherwise."""
    if context.launch_configurations['open'].lower() in ('true', '1') or 'ROS_AUTOMATIC_DISCOVERY_RANGE' in os.environ:
        return []
    return [SetEnvironmentVariable('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')]


def generate_launch_description() -> LaunchDescription:
    """The simulator and, if wanted, the maneuver that drives it."""
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    types = {'scene': str, 'mode': str, 'rate_factor': float, 'duration': float, 'record': bool}
    parameters = {name: ParameterValue(value[name], value_type=kind) for name, kind in types.items()}
    simulator = Node(
        package='mbd_sim_ros',
        executable='simulator',
        name='simulator',
        namespace=value['namespace'],
        parameters=[value['params'], parameters],
        output='screen',
    )
    maneuver = Node(
        package='mbd_sim_ros',
        executable='maneuver',
        name='maneuver',
        namespace=value['namespace'],
        parameters=[{'scene': parameters['scene'], 'timeout': 600.0}],  # the first start compiles
        condition=IfCondition(value['play']),
        output='screen',
    )
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(name, default_value=default, description=text) for name, (default, text) in ARGUMENTS.items()),
            OpaqueFunction(function=discovery),  # before anything is started
            simulator,
            maneuver,
            OpaqueFunction(function=viewers),
            RegisterEventHandler(OnProcessExit(target_action=simulator, on_exit=ended)),
        ]
    )
