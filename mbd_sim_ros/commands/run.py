"""mbd run: simulate a scene as fast as it goes and record it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.commands import Result, add_scene, declare, table
from mbd_sim_ros.commands.scene_keys import KEYS, add_keys, overrides_of
from solver.errors import SpecError

if TYPE_CHECKING:
    from solver.scene import Scene

FIGURES = {
    'steps': 'd',
    'wall_time': '.3f s',
    'real_time_factor': '.2f',
    'cpu_per_step_us': '.1f us',
    'iterations_per_step': '.2f',
    'events': 'd',
    'energy_error_max': '.3g J',
    'residual_max': '.3g',
    'position_drift_max': '.3g',
    'velocity_drift_max': '.3g',
    'branch_switches': 'd',
}


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'run',
        run,
        'simulate a scene and record it',
        'mbd run slider_crank --set integrator.h=0.002 --out bags/coarse',
    )
    add_scene(parser)
    add_keys(parser, *KEYS)
    parser.add_argument(
        '--balance', action='store_true', help='also give the energy balance of every kind of element, and of momentum'
    )
    error = parser.add_mutually_exclusive_group()
    error.add_argument(
        '--no-error',
        action='store_true',
        help='do not measure the numerical error, which takes half the steps again; the verdict says so',
    )
    error.add_argument(
        '--accuracy',
        action='store_true',
        help='also measure errors by their origin (model, step, iteration) against a converged reference',
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        '--out', metavar='DIR', type=Path, help='new directory for the recording (default: bags/<scene>-<date>)'
    )
    where.add_argument('--no-record', action='store_true', help='record nothing')
    parser.add_argument(
        '--html', metavar='FILE', type=Path, help='page of the run: verdict, path, all channels to pick from'
    )


def run(args: argparse.Namespace) -> Result:
    """Load, simulate, judge."""
    from mbd_sim_ros import compiling
    from mbd_sim_ros.bags.recorder import new_directory
    from mbd_sim_ros.batch import simulate
    from solver import simulation_of
    from solver.analysis.kept_errors import keep
    from solver.files.scene import load_scene
    from solver.files.tire_receipt import told_of_tires
    from solver.vehicle.wheel_end import told_of_fit

    if args.html is not None and args.no_record:
        raise SpecError('--html draws what is recorded; leave --no-record out')
    scene = load_scene(args.scene, overrides_of(args))
    compiling.tell(not args.json, scene.model)
    simulation = simulation_of(scene)
    directory = None if args.no_record else args.out or new_directory(scene.name)
    options: dict[str, Any] = {'progress': not args.json, 'balance': args.balance, 'error': not args.no_error}
    data = simulate(simulation, simulation.scene.steps, directory=directory, **options)
    covered = data.pop('covered')
    if data['errors']:
        keep(simulation.scene, data['error_text'])
    data = {'scene': scene.name, **data, 'start': simulation.start.report()}
    if told := told_of_tires(scene.model.tires) + told_of_fit(scene.model):
        data['tires'] = told
    data['require'] = scene.require.limits
    if scene.require.accuracy:
        from solver.levels.auto import certificate_of

        certificate = certificate_of(scene)
        data['accuracy'] = {
            'required': [*scene.require.accuracy],
            'certificate': None if certificate is None else certificate.hash,
        }
    by_origin = ''
    if args.accuracy:
        data['origins'], by_origin = _origins(scene)
    violations = [f'{f["quantity"]}: {f["text"]}' for f in data['findings'] if f['required']]
    if violations:
        data['violations'] = violations
    described = rows_of(data, str(simulation.start), covered)
    text = table(described) + by_origin
    if args.html is not None and directory is not None:
        from mbd_sim_ros.analysis.run_page import write_page

        write_page([directory], args.html, f'verdict: {data["status"]}', described[1:])
        data['html'] = str(args.html)
        text += f'\npage: {args.html}'
    return Result(data=data, text=text, code=0 if data['passed'] else 1)


def _origins(scene: Scene) -> tuple[dict[str, Any], str]:
    """(errors of the run by origin as objects for JSON, as a table); a signal ends their measurement."""
    from mbd_sim_ros import interrupts
    from solver.trade.origins import origins_of, report, rows
    from solver.trade.runs import Stopped

    interrupts.now(f'measuring the errors of {scene.name} by origin; its run is done')
    try:
        found = origins_of(scene, stop=lambda: bool(interrupts.received()))
        return report(found), f'\n\n{table(rows(found))}'
    except Stopped:
        interrupts.check()
        raise


def rows_of(data: dict[str, Any], start: str, covered: Sequence[Mapping[str, Any]] = ()) -> list[tuple[str, str]]:
    """Name and text of the figures of a run. start: what it changed of what is given. covered: findings that the
    certificate of a plan covers."""
    rows = [('verdict', data['status']), ('start', start)]
    rows.append(('error', data['error_text']))
    if data['reactions_text']:
        rows.append(('reactions', data['reactions_text']))
    rows += [
        (key.removesuffix('_us').replace('_', ' '), _shown(data[key], form))  # the value has its unit
        for key, form in FIGURES.items()
        if key in data
    ]
    if data['rejected']:
        tried = f'{data["rejected"]} attempts at a step failed or were too inaccurate'
        rows.append(('rescue', f'{tried}; the smallest step was {data["smallest_step"]:.3g} s'))
    if data['out']:
        rows.append(('recorded in', data['out']))
    for kind, energies in data.get('energy_by_kind', {}).items():
        rows.append(
            (
                f'energy of {kind.replace("_", " ")}',
                ', '.join(f'{name} {value:.4g} J' for name, value in energies.items()),
            )
        )
    if 'accuracy' in data:
        from solver.findings import Finding

        required, certificate = ', '.join(data['accuracy']['required']), data['accuracy']['certificate']
        proof = (
            f'certified by plan {certificate}'
            if certificate
            else (
                'a run checks its numerical error alone, not that of the model, and no plan certifies these settings '
                '(mbd plan)'
            )
        )
        rows.append(('accuracy', f'required of {required}: {proof}'))
        rows += [('note', Finding(**found).covered_for(required)) for found in covered]
    rows += [('tire', sentence) for sentence in data.get('tires', ())]
    rows += [('REQUIREMENT' if found['required'] else 'SUSPECT', found['text']) for found in data['findings']]
    return [*rows, *_explained(data)]


def _explained(data: dict[str, Any]) -> list[tuple[str, str]]:
    """Rows on findings in whose place the measured error decides."""
    from solver.checks.error import NUMERICAL_ERROR
    from solver.findings import Finding

    if any(found['quantity'] == NUMERICAL_ERROR.name for found in data['findings']):
        return [('because', found['text']) for found in data['explaining']]
    return [
        ('note', f'{Finding(**found).fact}: the numerical error is small all the same') for found in data['explaining']
    ]


def _shown(value: float, form: str) -> str:
    number, _, unit = form.partition(' ')
    return f'{value:{number}} {unit}'.rstrip()
