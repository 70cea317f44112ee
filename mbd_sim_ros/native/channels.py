"""Names and units of the numbers of a scene, as recordings and topics name them (bags/README.md)."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

from mbd_sim_ros.analysis.runs import units
from mbd_sim_ros.bags.recorder import about
from solver.output.snapshot import layout_of
from solver.quantities import POSE, columns
from solver.simulation import Simulation

# Fields of the account that are variables, and their units; of a noted row its value.
ACCOUNT_UNITS = {
    'energy': 'J', 'work': 'J', 'worst': 'J', 'worst_at': 's', 'time': 's', 'gross': 'J', 'turning': 'J',
    'residual': '1', 'position': 'm or rad', 'velocity': 'm/s or rad/s', 'unsettled': '1', 'contradiction': 'J',
}  # fmt: skip


class Channel(NamedTuple):
    """A number that goes in or out. place: its index in the inputs, or in the numbers of a snapshot. start: its value
    at the start of the scene."""

    name: str
    unit: str
    input: bool
    place: int
    start: float


class _Recorded(NamedTuple):
    """Names and kinds in a recording, as units() takes them."""

    joint_kinds: dict[str, str]
    element_kinds: dict[str, str]
    stated: dict[str, str]
    names: list[str]


def channels_of(simulation: Simulation) -> list[Channel]:
    """Inputs under their own names, then all that is recorded and published after a step, under the names of columns;
    of every body its pose too, as `tf/<body>/x` and so on."""
    shown = simulation.channels
    numbers, layout = simulation.snapshot().numbers, layout_of(shown)
    names = [f'cmd_applied/{name}' for name in shown.inputs] + [name for name, *_ in columns(shown)]
    kinds = about(simulation, reactions=False)
    as_recorded: Any = _Recorded(json.loads(kinds['joint_kinds']), json.loads(kinds['element_kinds']), {}, names)
    unit = units(as_recorded)
    found = [
        Channel(name, unit(f'cmd_applied/{name}'), True, k, float(simulation.inputs[k]))
        for k, name in enumerate(shown.inputs)
    ]
    for name, given, place in columns(shown):
        found.append(Channel(name, unit(name) or given, False, place, float(numbers[place])))
    first = layout['pose'][0].start
    for b, body in enumerate(shown.bodies):
        for k, part in enumerate(POSE):
            place = first + 7 * b + k
            found.append(Channel(f'tf/{body}/{part}', 'm' if k < 3 else '1', False, place, float(numbers[place])))
    return found
