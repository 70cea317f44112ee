"""The parameters of the node `simulator`: one table of defaults, descriptions with units, ranges, and what may change
at run time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from mbd_sim_ros.node.pace import MODES
from solver.errors import SpecError, suggestion
from solver.inputs.command_filter import COMMANDS, POWERTRAIN


class Spec(NamedTuple):
    """Default, description with unit, range, and whether it may change while the node runs."""

    default: Any
    text: str
    low: float = 0.0
    high: float = 0.0
    live: bool = False


RATES = {  # rates of topics, by their names in parameters: default [Hz], what is meant
    'cmd_applied': (0.0, 'of cmd_applied'),
    'odom': (0.0, 'of odom'),
    'imu': (0.0, 'of imu'),
    'joint_states': (0.0, 'of joint_states'),
    'tire_force': (0.0, 'of tire/<wheel>/force'),
    'tire_states': (0.0, 'of tire_states'),
    'tf': (100.0, 'of /tf; all bodies at record.poses of the scene'),
    'element_states': (100.0, 'of element_states/<kind>, at most record.elements_rate of the scene'),
    'reactions': (100.0, 'of reactions'),
    'body_motions': (100.0, 'of body_motions, at most record.motions of the scene'),
    'energies': (100.0, 'of energies, at most record.energies of the scene'),
}
PACING = ('mode', 'rate_factor', 'command_timeout', 'lockstep_every')  # fields of mbd_sim_ros.node.pace.Pace
RATE = 'largest rate in simulation time [Hz], 0: every published step,'

PARAMETERS = {
    'scene': Spec('', 'scene file, or the name of one in config/scenes; another one is taken by ~/load', live=True),
    'overrides': Spec([''], "changes to the scene, e.g. ['integrator.h=0.001']; others are taken by ~/load", live=True),
    'commands': Spec('topics', 'who drives: topics, or the maneuver of the scene'),
    'mode': Spec(
        'realtime', 'realtime, fast (no waiting) or lockstep (a step only for newer commands or ~/step)', live=True
    ),
    'rate_factor': Spec(1.0, 'simulated seconds per second in mode realtime [-]', 0.001, 1000.0, live=True),
    'realtime_priority': Spec(
        10, 'SCHED_FIFO priority in mode realtime, where the system permits it [-]; 0: none', 0, 99
    ),
    'duration': Spec(
        0.0, 'simulated time after which the node ends with exit code 0 [s]; 0: none, -1: that of the scene', -1.0, 1e6
    ),
    'publish_every': Spec(1, 'publish every n-th step [-]', 1, 100000, live=True),
    'publish_budget': Spec(
        0.0,
        'time that publishing a step may take in mode realtime [ms]; topics that do not fit are dropped, and named; 0: '
        'no limit',
        0.0,
        1000.0,
        live=True,
    ),
    **{f'rate_{name}': Spec(rate, f'{RATE} {text}', 0.0, 1e6, live=True) for name, (rate, text) in RATES.items()},
    'publish_clock': Spec(True, 'publish /clock'),
    'frame_prefix': Spec('', 'put before every frame name'),
    'publish_elements': Spec(
        False, 'publish element_states/<kind> and reactions too, as far as the scene has them recorded'
    ),
    'robot_description': Spec(
        '', 'URDF, published latched on robot_description and recorded; empty: the spanning tree of the model'
    ),
    'record': Spec(False, 'record from the start'),
    'out': Spec('', 'directory of the recording; empty: bags/<scene>-<date>-<time>'),
    'restore': Spec('', 'state file of ~/save_state to start from'),
    'max_steering': Spec(
        100.0,
        'limit of the steering wheel command, both ways; the end stops of the vehicle hold too [rad]',
        0.0,
        100.0,
        live=True,
    ),
    'max_drive_torque': Spec(2000.0, 'limit of the drive torque command, both ways [N m]', 0.0, 1e5, live=True),
    'max_brake_torque': Spec(10000.0, 'limit of the brake command [N m]', 0.0, 1e6, live=True),
    'max_steering_torque': Spec(50.0, 'limit of the steering torque command, both ways [N m]', 0.0, 1e3, live=True),
    'max_road_wheel': Spec(
        0.7,
        'limit of the road wheel command, both ways; that of the map of the steering holds too [rad]',
        0.0,
        1.5,
        live=True,
    ),
    'command_timeout': Spec(
        0.5,
        'age in simulation time after which drive torque and accelerator count as zero [s]; 0: never',
        0.0,
        1e3,
        live=True,
    ),
    'steering_bandwidth': Spec(5.0, 'bandwidth of the filter behind the steering command [Hz]', 0.1, 100.0),
    'steering_rate_limit': Spec(20.0, 'largest rate of the steering wheel [rad/s]', 0.1, 1000.0),
    'step_count': Spec(1, 'steps that one call of ~/step does [-]', 1, 1000000, live=True),
    'lockstep_every': Spec(
        1,
        'steps that one answer makes in mode lockstep [-]; the states between are not waited for',
        1,
        100000,
        live=True,
    ),
    'lockstep_commands': Spec(
        list(COMMANDS),
        'the plain commands, pedals and gear too, that must all be newer for a lockstep step; steering: whichever '
        'steers',
    ),
}
CHOICES = {'commands': ('topics', 'maneuver'), 'mode': MODES}


def declare(node: Node) -> None:
    """Declare all parameters. Raises SpecError for a value that no range can express; rclpy refuses the others
    itself."""
    for name, spec in PARAMETERS.items():
        descriptor = ParameterDescriptor(description=spec.text)
        if isinstance(spec.default, float):
            descriptor.floating_point_range = [FloatingPointRange(from_value=spec.low, to_value=spec.high)]
        elif isinstance(spec.default, int) and not isinstance(spec.default, bool):
            descriptor.integer_range = [IntegerRange(from_value=int(spec.low), to_value=int(spec.high), step=1)]
        if name in CHOICES:
            descriptor.additional_constraints = 'one of: ' + ', '.join(CHOICES[name])
        _declare(node, name, spec.default, descriptor)
    wrong = _wrong_choice([node.get_parameter(name) for name in CHOICES])
    if wrong:
        raise SpecError(wrong)
    for name in node.get_parameter('lockstep_commands').value:
        if name not in (*COMMANDS, *POWERTRAIN):
            raise SpecError(
                f'parameter lockstep_commands: {name!r} is no command' + suggestion(name, (*COMMANDS, *POWERTRAIN))
            )


def _declare(node: Node, name: str, default: Any, descriptor: ParameterDescriptor) -> None:
    """Declare a parameter. A list without elements has no type in ROS, and comes as a parameter without value: nothing
    where the default says nothing too, else a SpecError.
    """
    if node.declare_parameter(name, default, descriptor).type_ != Parameter.Type.NOT_SET:
        return
    if default != ['']:
        raise SpecError(
            f'parameter {name} is an empty list, which has no type in ROS; leave it out, or give a value such as '
            f'{default!r}'
        )
    node.set_parameters([Parameter(name, value=default)])


def declare_described(node: Node, parameters: Mapping[str, tuple[Any, str]]) -> None:
    """Declare parameters, name -> (default, description), and warn of those that are given and unknown."""
    for name, (default, text) in parameters.items():
        _declare(node, name, default, ParameterDescriptor(description=text))
    for sentence in unknown(node):
        node.get_logger().warning(sentence)


def unknown(node: Node) -> list[str]:
    """One sentence for every parameter that was given to the node and that it does not have."""
    declared = [name for name in node._parameters if not name.startswith('qos_overrides')]
    given = [name for name in node._parameter_overrides if not name.startswith('start_type_description')]
    return [
        f'parameter {name!r} is unknown and ignored{suggestion(name, declared)}'
        for name in given
        if name not in node._parameters
    ]


def refusal(parameters: list[Parameter]) -> str:
    """Return why the running node does not accept a change, or ''."""
    for parameter in parameters:
        if parameter.name in PARAMETERS and not PARAMETERS[parameter.name].live:
            return f'{parameter.name} is fixed while the node runs: start it anew'
        if parameter.name == 'use_sim_time' and parameter.value:
            return (
                'use_sim_time: this node makes the time that others use, and stamps its diagnostics with that of '
                'the day'
            )
    return _wrong_choice(parameters)


def _wrong_choice(parameters: list[Parameter]) -> str:
    for parameter in parameters:
        allowed = CHOICES.get(parameter.name)
        if allowed and parameter.value not in allowed:
            return f'parameter {parameter.name} = {parameter.value!r}: must be one of {", ".join(allowed)}'
    return ''
