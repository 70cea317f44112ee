"""Executable `maneuver`: plays a maneuver onto the command topics in simulation time (see maneuver_node.py).

It answers the newest `cmd_applied` of the simulator (whose stamp is the simulation time) with the commands for that
time, in one stamped message on `lockstep_cmd`, at most `rate` times a second (a command costs the simulator more than a
step does), so it keeps pace in every mode; in lockstep the pair is deterministic. Exit code 0 when the maneuver or the
simulator ends.
"""

from __future__ import annotations

import sys

from mbd_sim_ros import beginning

beginning.hold('maneuver', 'mbd_sim_ros.node.maneuver_player')

from mbd_sim_ros import interrupts
from mbd_sim_ros.node.main import run

if __name__ == '__main__':
    interrupts.install(lambda text: interrupts.write(2, text), code=0)

from typing import Any

from mbd_sim_ros.node.companion import COMMON, accompany

PARAMETERS: dict[str, tuple[Any, str]] = {
    **COMMON,
    'maneuver': ('', 'maneuver to play, a file or a name in config/maneuvers'),
    'scene': ('', 'scene whose maneuver is played for its duration, instead'),
    'duration': (0.0, 'simulation time after which the maneuver ends [s]; 0: that of the scene, or no end'),
}


def _play() -> int:
    from mbd_sim_ros.node.maneuver_node import Player

    node = Player(PARAMETERS)
    return accompany(node, f'playing {node.what} to {node.value("simulator")}')


def main(args: list[str] | None = None) -> int:
    """Play a maneuver; returns the exit code."""
    return run(_play, args, 'maneuver')


if __name__ == '__main__':
    sys.exit(main())
