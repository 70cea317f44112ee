"""mbd info: what a scene consists of."""

from __future__ import annotations

import argparse
from typing import Any

from mbd_sim_ros.commands import Result, add_scene, declare, table


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(parsers, 'info', run, 'show what a scene consists of', 'mbd info slider_crank')
    add_scene(parser)
    parser.add_argument('--resolved', action='store_true', help='print the scene as one YAML text, with every include and --set in place')


def run(args: argparse.Namespace) -> Result:
    """Load, compile and count."""
    from solver.scene import load_scene
    from solver.simulation import simulation_of

    scene = load_scene(args.scene, args.overrides)
    if args.resolved:
        return Result(data={'status': 'ok', 'scene': scene.name, 'resolved': scene.resolved}, text=scene.resolved.rstrip())
    simulation = simulation_of(scene)
    counts = simulation.describe()
    data = {
        'status': 'ok',
        'scene': scene.name,
        'title': scene.title,
        'hash': scene.hash,
        **counts,
        'coordinates': list(simulation.channels.joints),
        'inputs': list(simulation.channels.inputs),
        'maneuver': scene.maneuver.name,
        'integrator': scene.integrator.kind,
        'h': scene.integrator.h,
        'duration': scene.duration,
        'steps': scene.steps,
    }
    rows = [(key.replace('_', ' '), _text(value)) for key, value in data.items() if key != 'status' and value not in ('', [], {})]
    return Result(data=data, text=table(rows))


def _text(value: object) -> str:
    if isinstance(value, dict):
        return ', '.join(f'{k} {v}' for k, v in value.items())
    if isinstance(value, list):
        return ', '.join(map(str, value))
    return f'{value:.6g}' if isinstance(value, float) else str(value)
