"""mbd info: what a scene consists of."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.commands import Result, add_scene, declare, table
from solver.errors import MbdError

if TYPE_CHECKING:
    from solver.levels.derived import LevelReport
    from solver.scene import Scene


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(parsers, 'info', run, 'show what a scene consists of', 'mbd info slider_crank')
    add_scene(parser)
    parser.add_argument(
        '--brief', action='store_true', help='leave out the figures of a vehicle and the errors of its level, which take seconds'
    )
    parser.add_argument('--urdf', metavar='FILE', type=Path, help='write the spanning tree as URDF, as the node publishes it')
    parser.add_argument('--resolved', action='store_true', help='print the scene as one YAML text, with every include and --set in place')


def run(args: argparse.Namespace) -> Result:
    """Load, compile and count."""
    from solver import simulation_of
    from solver.analysis.figures import is_vehicle
    from solver.errors import BagError
    from solver.files.scene import load_scene

    scene = load_scene(args.scene, args.overrides)
    if args.resolved:
        return Result(data={'status': 'ok', 'scene': scene.name, 'resolved': scene.resolved}, text=scene.resolved.rstrip())
    simulation = simulation_of(scene)
    if args.urdf is not None:
        try:
            args.urdf.write_text(simulation.urdf(), encoding='utf-8')
        except OSError as error:
            raise BagError(f'{args.urdf}: cannot be written: {error.strerror}') from None
        return Result(data={'status': 'ok', 'scene': scene.name, 'urdf': str(args.urdf)}, text=f'wrote {args.urdf}')
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
        'h': simulation.scene.integrator.h,
        'duration': scene.duration,
        'steps': simulation.scene.steps,
        'start': simulation.start.report(),
    }
    text = ''
    if simulation.level is not None:
        data['fidelity'] = scene.fidelity
        level = simulation.level if args.brief else _with_errors(simulation.level, scene)
        data['level'], text = dataclasses.asdict(level), _level(level)
    if not args.brief and is_vehicle(simulation.scene.model):
        data['figures'], figures = _figures(simulation.scene)
        text += figures
    rows = [
        (key.replace('_', ' '), _text(value))
        for key, value in data.items()
        if key not in ('status', 'figures', 'level', 'start') and value not in ('', [], {})
    ]
    rows.append(('start', str(simulation.start)))
    return Result(data=data, text=table(rows) + text)


def _with_errors(level: LevelReport, scene: Scene) -> LevelReport:
    """The report with the error sheet, which is measured once for a vehicle and takes some seconds then."""
    from solver.levels.error_sheet import error_sheet

    if scene.fidelity in ('full', 'auto') or level.errors is not None:
        return level
    return dataclasses.replace(level, errors=error_sheet(scene.model, scene.fidelity, scene.switches))


def _level(level: LevelReport) -> str:
    """What a level leaves out, where it holds, and how far it is from the full vehicle, as tables."""
    parts: list[list[tuple[str, ...]]] = [
        [('subsystem', '', 'why'), *((s.subsystem, 'on' if s.on else 'off', s.why) for s in level.switched)],
        [('lost',), *((text,) for text in level.lost)],
        [('valid for',), *((str(limit),) for limit in level.validity)],
        [('not published',), *((name,) for name in level.absent)],
    ]
    found = level.errors or ()
    errors = [(e.maneuver, e.quantity, f'{100.0 * e.rms:.2g} %', f'{100.0 * e.largest:.2g} %', f'{e.peak:.4g} {e.unit}') for e in found]
    parts.append([('maneuver', 'quantity', 'RMS error', 'largest', 'of the peak'), *errors])
    return ''.join('\n\n' + table(rows) for rows in parts if len(rows) > 1)


def _figures(scene: Scene) -> tuple[dict[str, Any], str]:
    """The figures of the vehicle of a scene, standing on a flat road: (an object for JSON in SI units, a table)."""
    from solver.analysis.figures import USUAL, figures, standing

    try:
        found = figures(standing(scene))
    except MbdError as error:
        return {'error': str(error)}, f'\n\nno figures of the vehicle: {error}'
    data = {}
    rows: list[tuple[str, ...]] = [('figure', 'value', 'passenger cars', '', 'source')]
    for name, usual in USUAL.items():
        if name not in found:
            continue
        within = usual.low <= found[name] <= usual.high
        data[name] = {'value': found[name], 'low': usual.low, 'high': usual.high, 'within': within, 'source': usual.source}
        value, low, high = (f'{x * usual.factor:.4g}' for x in (found[name], usual.low, usual.high))
        rows.append((usual.text, f'{value} {usual.unit}', f'{low} to {high}', '' if within else 'OUTSIDE', usual.source))
    others = {name: {'value': value} for name, value in found.items() if name not in USUAL}
    return data | others, '\n\n' + table(rows)


def _text(value: object) -> str:
    if isinstance(value, dict):
        return ', '.join(f'{k} {v}' for k, v in value.items())
    if isinstance(value, list):
        return ', '.join(map(str, value))
    return f'{value:.6g}' if isinstance(value, float) else str(value)
