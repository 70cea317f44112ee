"""mbd plan: the cheapest way to simulate a scene that keeps the accuracy it requires, with a certificate."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.commands import Result, add_scene, declare, table
from solver.disk import alone

if TYPE_CHECKING:
    from solver.scene import Scene

RUNS = 'runs'  # directory of the runs of a plan that is not finished, in that of its results
BAR = '{percentage:3.0f}% |{bar:30}| {desc}'


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'plan',
        run,
        'find the cheapest way to simulate a scene that keeps the accuracy it requires',
        "mbd plan car_step_steer --set 'require.yaw_rate={rms: 2 %}' --out out/plan",
    )
    add_scene(parser)
    parser.add_argument('--out', metavar='DIR', type=Path, help='directory of scene, certificate and page (default: out/plan/SCENE)')
    parser.add_argument('--workers', metavar='N', type=int, help='runs at a time (default: as many as there are cores)')
    parser.add_argument('--time', metavar='SECONDS', type=float, help='most that the search may take (default: 170)')
    parser.add_argument('--unseen', metavar='N', type=int, help='maneuvers to check on that had no part in the choice (default: 24)')


def run(args: argparse.Namespace) -> Result:
    """Search, write what was found, keep it for `fidelity: auto`."""
    from mbd_sim_ros.bags.recorder import file_stem
    from solver.errors import SpecError
    from solver.files.scene import load_scene

    for name, value in (('workers', args.workers), ('time', args.time), ('unseen', args.unseen)):
        if value is not None and not value > 0:
            raise SpecError(f'--{name} = {value:g}: must be > 0')
    scene = load_scene(args.scene, args.overrides)
    out = args.out or Path('out') / 'plan' / file_stem(scene.name)
    with alone(out):  # what cannot be written is told before minutes of searching
        data = _planned(args, scene, out)
    return Result(data=data, text=describe(data), code=0 if data['status'] == 'ok' else 1)


def _planned(args: argparse.Namespace, scene: Scene, out: Path) -> dict[str, Any]:
    """The plan, kept and written."""
    from tqdm import tqdm

    from mbd_sim_ros import interrupts
    from mbd_sim_ros.analysis.pages import write_text
    from mbd_sim_ros.analysis.plan_page import write_page
    from solver.disk import location
    from solver.errors import BagError
    from solver.levels.auto import INCOMPLETE, OK, chosen, keep, plan_of
    from solver.trade.certificate import plan
    from solver.trade.search import LONGEST, UNSEEN, Search

    with tqdm(total=1.0, bar_format=BAR, disable=args.json or not sys.stderr.isatty(), leave=False) as bar:

        def progress(text: str, done: float) -> None:
            interrupts.now(f'planning {scene.name}: {text}; finished runs are kept in {out / RUNS}, and the same command goes on from them')
            interrupts.check()
            bar.set_description_str(text, refresh=False)
            bar.update(min(1.0, done) - bar.n)

        search = Search(
            scene, workers=args.workers, longest=args.time or LONGEST, unseen=args.unseen or UNSEEN, progress=progress,
            keep_in=out / RUNS,
        )  # fmt: skip
        data = plan(search)
    if search.kept.found:
        data['notes'].append(f'{search.kept.found} runs of an earlier, unfinished plan were taken from {out / RUNS}')
    if data['status'] == INCOMPLETE:
        data['notes'].append(f'the same command goes on where this plan ended: its runs are kept in {out / RUNS}')
    else:
        shutil.rmtree(out / RUNS, ignore_errors=True)
    if data['status'] == OK:
        _time(scene, data)
    data['out'] = str(out)
    before = plan_of(scene) if data['status'] == INCOMPLETE else None
    if before is not None and before['status'] == OK:
        data['notes'].append('the certified plan of this scene that is kept stays: fidelity: auto takes that')
    elif not keep(scene, data):
        data['notes'].append(
            f'the plan cannot be kept in {location()}, so fidelity: auto does not find it; simulate the scene.yaml that is written, or '
            'plan anew with MBD_CACHE_DIR set to a place that can be written'
        )
    try:
        if data['settings'] is not None and scene.resolved:
            write_text(out / 'scene.yaml', chosen(scene, data).resolved)
        else:
            (out / 'scene.yaml').unlink(missing_ok=True)  # of an earlier plan
        write_text(out / 'certificate.json', json.dumps(data, indent=1, allow_nan=False) + '\n')
        write_page(search, data, out / 'plan.html')
    except OSError as error:
        raise BagError(f'{error.filename or out}: cannot be written: {error.strerror}; choose another directory with --out') from None
    return data


def _time(scene: Scene, data: dict[str, Any]) -> None:
    """Add what `mbd run` shows of the scene that was found. One that is slower there than every run has to be is no plan: the run would be
    suspect."""
    from solver.levels.auto import chosen
    from solver.trade.certificate import NO

    run_ = data['cost']['run'] = as_run(chosen(scene, data))
    least = scene.require.limits.get('real_time_factor_min')
    if least is not None and max(run_.values()) < least:
        data['status'] = NO
        steps = data['cost']['real_time_factor']
        data['give'].append(
            f'mbd run shows {run_["recorded"]:.3g} times real time, {run_["unrecorded"]:.3g} with --no-record (steps alone: {steps:.3g}); '
            f'require.real_time_factor_min asks for {least:g}'
        )
    elif least is not None and run_['recorded'] < least:
        data['notes'].append(
            f'require.real_time_factor_min = {least:g} is kept with --no-record ({run_["unrecorded"]:.3g} times real time), not with the '
            f'recording ({run_["recorded"]:.3g})'
        )


def as_run(scene: Scene) -> dict[str, float]:
    """Measurements that `mbd run` shows of a scene, by the function that it calls: real-time factors with its recording
    and without (--no-record)."""
    from mbd_sim_ros.batch import simulate
    from solver import simulation_of

    found = {}
    with tempfile.TemporaryDirectory() as place:
        for name, directory in (('recorded', Path(place) / 'run'), ('unrecorded', None)):
            simulation = simulation_of(scene)
            found[name] = simulate(simulation, simulation.scene.steps, directory=directory)['real_time_factor']
    return found


def describe(data: dict[str, Any]) -> str:
    """A plan for people."""
    from mbd_sim_ros.analysis.plan_page import error_rows, shows

    rows = [('plan', data['status'])]
    if data['settings'] is not None:
        integrator = ', '.join(f'{name} {value}' for name, value in data['settings']['integrator'].items())
        off = ', '.join(data['settings']['switches']) or 'nothing'
        cost = data['cost']
        rows += [
            ('fidelity' if data['status'] == 'ok' else 'closest', data['fidelity']),
            ('switched off', off),
            ('integrator', integrator),
            ('cost', f'{data["cost_ratio"]:.3g} of the full vehicle at 1 ms; steps alone {cost["real_time_factor"]:.3g} times real time'),
        ]
        rows += [('mbd run', shows(data))] if 'run' in cost else []
    unseen = data['unseen']
    bound = '' if unseen['bound'] is None else f'; fewer than {100 * min(1.0, unseen["bound"]):.2g} % fail, with 95 % confidence'
    rows.append(('unseen maneuvers', f'{unseen["passed"]} passed, {unseen["failed"]} failed{bound}'))
    rows += [('what has to give', text) for text in data['give']]
    rows += [('note', text) for text in data['notes']]
    rows += [(f'level {level}', why) for level, why in data['levels'].items()]
    rows += [('results', data['out']), ('took', f'{data["took"]:.0f} s')]
    parts = error_rows(data)
    return table(rows) + ('\n\n' + table(parts) if len(parts) > 1 else '')
