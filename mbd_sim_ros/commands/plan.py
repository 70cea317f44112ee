"""mbd plan: the cheapest way to simulate a scene that keeps the accuracy it requires, with a certificate."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.commands import Result, add_scene, declare, table
from solver.disk import alone

if TYPE_CHECKING:
    from solver.scene import Scene
    from solver.trade.first import Answer

RUNS, KNOWLEDGE = 'runs', 'vehicles'  # stores beside the kernels: runs of plans, and what they have learned
BAR = '{percentage:3.0f}% |{bar:30}| {desc}'
# s between two lines of progress where no terminal shows a bar; ten times as much looks as if nothing went on
EVERY = 5.0


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
    parser.add_argument(
        '--out', metavar='DIR', type=Path, help='directory of scene, certificate and page (default: out/plan/SCENE)'
    )
    parser.add_argument('--workers', metavar='N', type=int, help='runs at a time (default: as many as there are cores)')
    parser.add_argument(
        '--time',
        metavar='SECONDS',
        type=float,
        help='most that the plan may take, whatever it costs (default: ten times the CPU time of the full run, 170 s '
        'at most)',
    )
    parser.add_argument(
        '--unseen',
        metavar='N',
        type=int,
        help='maneuvers to check on that had no part in the choice (default: 24, and up to 59 where they cost little)',
    )


def run(args: argparse.Namespace) -> Result:
    """Search, write what was found, keep it for `fidelity: auto`."""
    begin = time.monotonic()
    with _told(args) as told:
        told.say(f'planning {args.scene}: loading', 0.0)
        from mbd_sim_ros import interrupts
        from mbd_sim_ros.bags.recorder import file_stem
        from solver.errors import SpecError
        from solver.files.scene import load_scene

        for name, value in (('workers', args.workers), ('time', args.time), ('unseen', args.unseen)):
            if value is not None and not value > 0:
                raise SpecError(f'--{name} = {value:g}: must be > 0')
        scene = load_scene(args.scene, args.overrides)
        out = args.out or Path('out') / 'plan' / file_stem(scene.name)
        with alone(out):  # what cannot be written is told before minutes of searching
            data = _planned(args, scene, out, told, begin)
        signal = interrupts.received()
        code = interrupts.EXIT + signal if signal else 0 if data['status'] == 'ok' else 1
    return Result(data=data, text=describe(data), code=code)


class _Told:
    """Progress: a bar on a terminal, else a line now and then; nothing with --json. First answers are lines in any
    case.

    begun: the scene is loaded; what is refused before that is one sentence alone.
    """

    def __init__(self, bar: Any, quiet: bool) -> None:
        self._bar, self._quiet, self._last, self.begun = bar, quiet, -EVERY, False
        self._lines = bar.disable and not quiet

    def say(self, text: str, done: float) -> None:
        """Show what is being done; done: share of the whole."""
        self._bar.set_description_str(text, refresh=False)
        self._bar.update(max(0.0, min(1.0, done) - self._bar.n))
        self._bar.refresh()
        if self._lines and self.begun and time.monotonic() - self._last >= EVERY:
            self._last = time.monotonic()
            self.line(text)

    def line(self, text: str) -> None:
        """A line that stays."""
        if not self._quiet:
            self._bar.write(text, file=sys.stderr)
            sys.stderr.flush()


@contextmanager
def _told(args: argparse.Namespace) -> Iterator[_Told]:
    from tqdm import tqdm

    with tqdm(total=1.0, bar_format=BAR, disable=args.json or not sys.stderr.isatty(), leave=False) as bar:
        yield _Told(bar, args.json)


def _planned(args: argparse.Namespace, scene: Scene, out: Path, told: _Told, begin: float) -> dict[str, Any]:
    """The plan, kept and written. begin: when the command began (time.monotonic)."""
    from mbd_sim_ros import interrupts
    from mbd_sim_ros.analysis.pages import write_text
    from mbd_sim_ros.analysis.plan_page import write_page
    from solver.disk import location, plain
    from solver.errors import BagError
    from solver.levels.auto import INCOMPLETE, OK, chosen, keep, plan_of
    from solver.trade.allowance import LONGEST, TIMES
    from solver.trade.certificate import plan
    from solver.trade.certificate import price as price_of
    from solver.trade.search import Search

    def answered(answer: Answer) -> None:
        used = f'; its errors take about {100.0 * answer.used:.2g} % of a limit' if answer.used == answer.used else ''
        about = f'{answer.setting}, about {answer.cost:.2g} of the cost of the full vehicle at 1 ms'
        told.line(
            f'after {time.monotonic() - begin:.1f} s, from the {answer.basis}, not checked: {about} '
            f'({answer.why}{used})'
        )

    interrupts.now(f'planning {scene.name}')
    with interrupts.held():  # a signal ends the runs, and what is known by then is told
        search = Search(
            scene, workers=args.workers,
            longest=LONGEST if args.time is None else max(0.0, args.time - (time.monotonic() - begin)),
            times=float('inf') if args.time else TIMES, startup=time.process_time(), unseen=args.unseen,
            progress=told.say, answer=answered,
            ended=lambda: bool(interrupts.received()), keep_in=location() / RUNS, knowledge=location() / KNOWLEDGE,
        )  # fmt: skip
        told.begun = True
        data = plan(search)
        search.learn()
        if search.kept.found:
            data['notes'].append(
                f'{search.kept.found} runs of earlier plans of this scene were taken from {location() / RUNS}'
            )
        if data['status'] == INCOMPLETE:
            data['notes'].append(
                f'the same command goes on where this plan ended: its runs are kept in {location() / RUNS}'
            )
        found = search.result
        fits = found is not None and search.allowance.fits(search.running(found.setting))
        if data['status'] == OK and not interrupts.received() and fits:
            _time(scene, data)
            data['price'] |= plain(price_of(search, search.result.setting if search.result else None))  # with that time
        data['out'] = str(out)
        before = plan_of(scene) if data['status'] == INCOMPLETE else None
        if before is not None and before['status'] == OK:
            data['notes'].append('the certified plan of this scene that is kept stays: fidelity: auto takes that')
        elif not keep(scene, data):
            data['notes'].append(
                f'the plan cannot be kept in {location()}, so fidelity: auto does not find it; simulate the '
                f'scene.yaml that is written, or plan anew with MBD_CACHE_DIR set to a place that can be written'
            )
        try:
            if data['settings'] is not None and scene.resolved:
                write_text(out / 'scene.yaml', chosen(scene, data).resolved)
            else:
                (out / 'scene.yaml').unlink(missing_ok=True)  # of an earlier plan
            write_text(out / 'certificate.json', json.dumps(data, indent=1, allow_nan=False) + '\n')
            write_page(search, data, out / 'plan.html', scene)
        except OSError as error:
            raise BagError(
                f'{error.filename or out}: cannot be written: {error.strerror}; choose another directory with --out'
            ) from None
    return data


def _time(scene: Scene, data: dict[str, Any]) -> None:
    """Add what `mbd run` shows of the scene that was found. One that is slower there than every run has to be is no
    plan: the run would be suspect."""
    from solver.levels.auto import chosen
    from solver.trade.certificate import NO

    run_ = data['cost']['run'] = as_run(chosen(scene, data))
    least = scene.require.limits.get('real_time_factor_min')
    if least is not None and max(run_.values()) < least:
        data['status'] = NO
        steps = data['cost']['real_time_factor']
        data['give'].append(
            f'mbd run shows {run_["recorded"]:.3g} times real time, {run_["unrecorded"]:.3g} with --no-record (steps '
            f'alone: {steps:.3g}); require.real_time_factor_min asks for {least:g}'
        )
    elif least is not None and run_['recorded'] < least:
        data['notes'].append(
            f'require.real_time_factor_min = {least:g} is kept with --no-record ({run_["unrecorded"]:.3g} times real '
            f'time), not with the recording ({run_["recorded"]:.3g})'
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
    from mbd_sim_ros.analysis.plan_page import elsewhere, error_rows, shows

    rows = [('plan', data['status'] + (' (interrupted)' if data.get('interrupted') else ''))]
    if data['settings'] is not None:
        integrator = ', '.join(f'{name} {value}' for name, value in data['settings']['integrator'].items())
        off = ', '.join(data['settings']['switches']) or 'nothing'
        cost = data.get('cost')
        speed = f'; steps alone {cost["real_time_factor"]:.3g} times real time' if cost else ''
        rows += [
            ('fidelity' if data['status'] == 'ok' else 'closest' if cost else 'unchecked answer', data['fidelity']),
            ('switched off', off),
            ('integrator', integrator),
            ('cost', f'{data["cost_ratio"]:.3g} of the full vehicle at 1 ms{speed}'),
        ]
        rows += [('mbd run', shows(data))] if cost and 'run' in cost else []
    rows.append(('other maneuvers', elsewhere(data['unseen'])))
    rows += [('first answer', first) for first in first_answers(data)]
    if data.get('price'):
        rows.append(('price', price(data['price'])))
    rows += [('what has to give', text) for text in data['give']]
    rows += [('note', text) for text in data['notes']]
    rows += [(f'level {level}', why) for level, why in data['levels'].items()]
    rows += [('results', data['out']), ('took', f'{data["took"]:.0f} s')]
    parts = error_rows(data)
    return table(rows) + ('\n\n' + table(parts) if len(parts) > 1 else '')


def first_answers(data: dict[str, Any]) -> list[str]:
    """First answers, when they came, and whether the last one is the same."""
    words = {True: 'the same level and step', False: 'another level or step', None: 'not checked'}
    return [
        f'{one["setting"]} after {one["after"]:.1f} s ({one["basis"]}): {words[one["agrees"]]}'
        for one in data.get('first', ())
    ]


def price(found: dict[str, Any]) -> str:
    """Price of a plan, and the number of runs from which on it pays."""
    text = f'{found["cpu"]:.3g} s of CPU time'
    text += f' (and {found["once"]:.2g} s for levels, once for the vehicle)' if found['once'] else ''
    if found['full_run'] is None:
        return text
    text += f', {found["full_runs"]:.2g} times the full run ({found["full_run"]:.3g} s as a command)'
    if found['pays_from'] is not None:
        return f'{text}; it pays from {found["pays_from"]} runs on, each of which saves {found["saves"]:.2g} s'
    return f'{text}; it saves no time: what was found buys accuracy' if found['saves'] else text
