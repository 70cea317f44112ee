"""ros2 launch mbd_sim_ros sim.launch.py scene:=NAME [play:=true] [record:=true] [namespace:=car1] [params:=FILE] ...

The launch ends when the simulator ends, with exit code 1 if that failed.
"""

from launch.actions import DeclareLaunchArgument, RegisterEventHandler, Shutdown
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
            simulator,
            maneuver,
            RegisterEventHandler(OnProcessExit(target_action=simulator, on_exit=ended)),
        ]
    )
