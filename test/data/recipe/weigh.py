"""mbd weigh: a toy command of the recipe in docs/contributing.md."""

from __future__ import annotations

import argparse
from typing import Any

from mbd_sim_ros.commands import Result, add_scene, declare


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(parsers, 'weigh', run, 'add up the masses of a scene', 'mbd weigh car_step_steer')
    add_scene(parser)


def run(args: argparse.Namespace) -> Result:
    """Load and add up."""
    from solver import load_scene

    mass = sum(body.mass for body in load_scene(args.scene, args.overrides).model.bodies)
    return Result(data={'status': 'ok', 'mass': mass}, text=f'{mass:g} kg')
