"""Executable `adapter`: drives a simulator by what others publish: Ackermann commands, cmd_vel, Autoware (see
demand_messages.py).

It looks at every `odom` that it gets, at most `rate` times a second, and answers with steering, drive and brake torque
for the newest demand, in one stamped message on `lockstep_cmd`. Interfaces whose package is not installed are left out,
and the log says so once. Exit code 0 when the simulator ends.
"""

from __future__ import annotations

import sys

from mbd_sim_ros import beginning

beginning.hold('adapter', 'mbd_sim_ros.node.adapter')

from mbd_sim_ros import interrupts
from mbd_sim_ros.node.main import run

if __name__ == '__main__':
    interrupts.install(lambda text: interrupts.write(2, text), code=0)

from typing import Any

from mbd_sim_ros.node.companion import COMMON, accompany

PARAMETERS: dict[str, tuple[Any, str]] = {
    **COMMON,
    'scene': ('', 'scene whose car is driven, for its steering, wheelbase and mass; empty: that of the simulator'),
    'steering_ratio': (0.0, 'steering wheel over road wheels [-]; 0: the map of the steering, measured on the bench'),
    'max_road_wheel': (0.55, 'largest angle of the road wheels [rad]'),
    'bandwidth': (0.5, 'of the speed loop [Hz]'),
    'max_drive_torque': (2000.0, 'of the speed loop, at the differential [N m]'),
    'max_engine_braking': (300.0, 'torque with which the engine brakes before the brakes do [N m]'),
    'max_brake_torque': (6000.0, 'all wheels together [N m]'),
    'command_timeout': (
        0.5,
        'simulation time after which a demand counts no more and the car is braked to rest [s]; 0: never',
    ),
}


def _adapt() -> int:
    from mbd_sim_ros.node.adapter_node import Adapter

    node = Adapter(PARAMETERS)
    return accompany(node, f'adapting commands for {node.value("simulator")}')


def main(args: list[str] | None = None) -> int:
    """Adapt commands; returns the exit code."""
    return run(_adapt, args, 'adapter')


if __name__ == '__main__':
    sys.exit(main())
