"""mbd replay: run the scene in a recording again with the inputs as they were applied, and compare bit by bit."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from mbd_sim_ros.commands import Result, declare
from solver.errors import BagError

if TYPE_CHECKING:
    from mbd_sim_ros.bags.reader import Run
    from solver.inputs.maneuver import ReplaySource

STEP = 'cmd_applied/step'


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'replay',
        run,
        'simulate a recording again from the inputs in it; exit code 1 when the result is not the same bits',
        'mbd replay bags/first',
    )
    parser.add_argument('bag', metavar='BAG', type=Path, help='bag directory or .mcap file')
    parser.add_argument('--out', metavar='DIR', type=Path, help='keep the new recording here')


def run(args: argparse.Namespace) -> Result:
    """Read, simulate, compare."""
    from mbd_sim_ros.analysis.comparison import compare
    from mbd_sim_ros.bags import reader as bag
    from mbd_sim_ros.bags.recorder import source_hash
    from mbd_sim_ros.batch import simulate
    from mbd_sim_ros.commands.compare import report
    from solver.compiled.target import differences, target
    from solver.files.scene import load_scene_text
    from solver.simulation import Simulation

    before = bag.read(args.bag)
    text = before.metadata.get('resolved_scene', '')
    if not text:
        raise BagError(f'{args.bag} cannot be replayed: it does not hold its scene')
    simulation = Simulation(load_scene_text(text, f'scene in {args.bag}'))
    source = recorded_inputs(before, simulation.channels.inputs)
    steps = source.first + len(source.values)
    with tempfile.TemporaryDirectory(prefix='mbd-replay-') as scratch:
        directory = args.out or Path(scratch) / 'replay'
        simulate(simulation, steps, directory=directory, source=source, progress=not args.json)
        found = compare(bag.read(directory), before, exact=True)
    result = report(found)
    recorded_on = yaml.safe_load(before.metadata.get('target', '{}'))
    elsewhere = differences(recorded_on, target())
    same_code = before.metadata.get('source_hash', '') == source_hash()
    data = {
        'status': 'identical' if found.ok else 'different',
        'steps': steps,
        'same_code': same_code,
        'target': recorded_on,
        'target_differences': elsewhere,
        'out': None if args.out is None else str(args.out),
        'outside': result.data['outside'],
        'channels': result.data['channels'],
    }
    if found.ok:
        return Result(data=data, text=f'identical: {steps} steps, {len(found.differences)} channels')
    hint = '' if same_code else '\nthe recording was made by another version of the solver'
    if elsewhere:
        hint += f'\nthe same bits cannot be expected, because the recording was made on another target: {"; ".join(elsewhere)}'
    return Result(data=data, text=result.text + hint, code=1)


def recorded_inputs(run_: Run, names: tuple[str, ...]) -> ReplaySource:
    """The inputs in a recording as a source. Row k of a recording holds what was applied in the step that led to it.

    Raises BagError for a recording that does not hold every step from the first on.
    """
    from solver.inputs.maneuver import ReplaySource

    steps = run_[STEP]
    rows = steps >= 1.0  # NaN where a topic has no message; step 0 is the start
    applied = steps[rows].astype('int64') - 1
    if len(applied) == 0 or applied[0] != 0:
        first = f'begins with step {applied[0] + 1}' if len(applied) else 'holds no step'
        raise BagError(f'the recording cannot be replayed: it {first}; it must hold every step from the start on (record.every: 1)')
    return ReplaySource(names, {n: run_[f'cmd_applied/{n}'][rows] for n in names}, applied)
