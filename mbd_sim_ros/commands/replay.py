"""mbd replay: run the scene in a recording again with the inputs as they were applied.

Unchanged, every message must come out the same. With other settings or another vehicle the channels of both runs are
compared.

The file is long by its sentences: everything that may differ between a recording and its repetition is told apart.
"""

from __future__ import annotations

import argparse
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.commands import SET_HELP, Result, add_settings, declare, names_of, offer, table
from mbd_sim_ros.commands.scene_keys import add_keys, overrides_of
from solver.errors import BagError, SpecError

if TYPE_CHECKING:
    from mbd_sim_ros.bags.inputs import Content, Inputs
    from mbd_sim_ros.messages.encode import Messages
    from solver.output.snapshot import Snapshot

SHOWN = 20  # channels in the table for people
SHARED = ('joint_states', 'tf')  # topics that others publish too
SCENE_HELP = 'the scene that the node ran, for a bag of its topics without ~/scene: a path, or a name in config/scenes'


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'replay',
        run,
        'simulate a recording again from the inputs in it; exit code 1 when the result is not the same bits',
        'mbd replay bags/first\n  mbd replay bags/first --set integrator.iterations=4 --out bags/closer',
    )
    parser.add_argument('bag', metavar='BAG', type=Path, help='bag directory or .mcap file')
    add_settings(parser, SET_HELP + '; compares channels')
    add_keys(parser, 'vehicle', 'fidelity', does='; compares channels')
    offer(parser.add_argument('--scene', metavar='SCENE', help=SCENE_HELP), names_of('scenes'), files=True)
    parser.add_argument('--out', metavar='DIR', type=Path, help='keep the new recording here')


def run(args: argparse.Namespace) -> Result:
    """Read, simulate, compare."""
    from mbd_sim_ros import interrupts
    from mbd_sim_ros.bags.inputs import content, inputs_of
    from mbd_sim_ros.bags.published import load_published

    interrupts.now(f'reading {args.bag}')
    before = content(args.bag)
    if args.scene is not None:
        if before.metadata.get('resolved_scene', '') or not before.published:
            raise BagError(
                f'--scene {args.scene}: {args.bag} holds its own scene; leave it out, or change it with --set'
            )
        before.metadata['resolved_scene'] = load_published(args.scene).resolved
    applied = inputs_of(before)
    if not before.metadata.get('resolved_scene', ''):
        more = ': record the topic ~/scene too, or name the scene with --scene' if before.published else ''
        raise BagError(f'{args.bag} cannot be replayed: it does not hold its scene{more}')
    if applied.first and before.state is None:
        more = (
            '; start `ros2 bag record` while the node is paused at its start, or record with ~/start_recording'
            if before.published
            else ''
        )
        raise BagError(
            f'{args.bag} cannot be replayed: it begins with step {applied.first + 1} and does not hold the state '
            f'there{more}'
        )
    changed = bool(args.overrides or args.vehicle or args.fidelity)
    with ExitStack() as stack:
        directory = args.out or stack.enter_context(interrupts.scratch('mbd-replay-')) / 'replay'
        if changed:
            return _changed(args, before, applied, directory)
        if before.published:
            return _of_topics(args, before, applied)
        return _again(args, before, applied, directory)


def _again(args: argparse.Namespace, before: Content, applied: Inputs, directory: Path) -> Result:
    """The same once more: every message must be the same bytes."""
    from mbd_sim_ros import compiling, interrupts
    from mbd_sim_ros.analysis.comparison import compare
    from mbd_sim_ros.bags import reader as bag
    from mbd_sim_ros.bags.inputs import content
    from mbd_sim_ros.batch import simulate
    from mbd_sim_ros.commands.compare import report
    from solver import simulation_of
    from solver.compiled.target import differences, target
    from solver.disk import sources
    from solver.engine.stepping import KINDS
    from solver.files.scene import load_scene_text

    scene = load_scene_text(
        before.metadata['resolved_scene'], f'scene in {args.bag}', _own_start(args.bag, before, applied)
    )
    compiling.tell(not args.json, scene.model)
    simulation = simulation_of(scene)
    own = scene.integrator.kind in KINDS  # the others follow the maneuver of the scene at any time they like
    if applied.first and not own:
        raise BagError(
            f'{args.bag} cannot be replayed bit by bit: integrator {scene.integrator.kind} does not go on from a saved '
            'state so'
        )
    prefix = str(before.parameters.get('frame_prefix', ''))
    source = applied.source(simulation.channels.inputs) if own else None
    simulate(
        simulation, applied.last, directory=directory, source=source, progress=not args.json, state=before.state,
        from_start=applied.from_start, frame_prefix=prefix, parameters={'frame_prefix': prefix} if prefix else None,
    )  # fmt: skip
    interrupts.now(f'comparing {args.bag} with its replay')
    after = content(directory)
    lost = before.dropped_steps > 0 or 'damage' in before.metadata  # it was recovered, not whole
    unequal = different_topics(before, after, lost=lost)
    same_code = before.metadata.get('source_hash', '') == sources()
    recorded_on = before.target
    elsewhere = differences(recorded_on, target())
    data: dict[str, Any] = {
        'status': 'different' if unequal else 'identical',
        'steps': applied.last - applied.first,
        'first_step': applied.first,
        'messages': sum(map(len, before.outputs.values())),
        'same_code': same_code,
        'target': recorded_on,
        'target_differences': elsewhere,
        'out': None if args.out is None else str(args.out),
        'outside': unequal,
        'channels': {},
    }
    if not unequal:
        steps = f'{data["steps"]} steps' + (f' from step {applied.first} on' if applied.first else '')
        return Result(
            data=data, text=f'identical: {steps}, {data["messages"]} messages of {len(before.outputs)} topics'
        )
    found = compare(bag.read(directory), bag.read(args.bag), exact=True)
    result = report(found)
    data |= {'outside': result.data['outside'] or unequal, 'channels': result.data['channels']}
    hint = '' if same_code else '\nthe recording was made by another version of the solver'
    if elsewhere:
        hint += (
            '\nthe same bits cannot be expected, because the recording was made on another target: '
            f'{"; ".join(elsewhere)}'
        )
    topics = f'topics that differ: {", ".join(unequal)}\n'
    return Result(data=data, text=topics + result.text + hint, code=1)


def _of_topics(args: argparse.Namespace, before: Content, applied: Inputs) -> Result:
    """A recording of the topics of the node: every message must be the bytes that its step has, of whichever topics
    were recorded."""
    from mbd_sim_ros import compiling, interrupts
    from mbd_sim_ros.batch import simulate, warm_up
    from mbd_sim_ros.messages.encode import Messages
    from solver import simulation_of
    from solver.compiled.target import differences, target
    from solver.disk import sources
    from solver.files.scene import load_scene_text

    name = f'scene in {args.bag}' if args.scene is None else str(args.scene)
    scene = load_scene_text(before.metadata['resolved_scene'], name, _own_start(args.bag, before, applied))
    if applied.last and scene.integrator.h_ns != applied.h_ns:
        raise SpecError(
            f'{args.bag} was recorded with a step of {applied.h_ns * 1e-9:g} s, and that of {name} is '
            f'{scene.integrator.h_ns * 1e-9:g} s: it is another scene, or had overrides'
        )
    compiling.tell(not args.json, scene.model)
    simulation = simulation_of(scene)
    if {*applied.rows} != {*simulation.channels.inputs}:
        raise SpecError(
            f'{args.bag} has the inputs {", ".join(applied.rows)}, and {name} has '
            f'{", ".join(simulation.channels.inputs)}'
        )
    source = applied.source(simulation.channels.inputs)
    prefix = str(before.parameters.get('frame_prefix', ''))
    if args.out is not None:
        simulate(
            simulation, applied.last, directory=args.out, source=source, progress=not args.json, state=before.state,
            from_start=applied.from_start, frame_prefix=prefix, parameters={'frame_prefix': prefix} if prefix else None,
        )  # fmt: skip
    warm_up(simulation)
    if before.state is not None:
        simulation.restore(before.state)
    interrupts.now(f'comparing {args.bag} with its replay')
    messages = Messages.of(scene, simulation, prefix)
    found = Compared(before)
    first = simulation.snapshot()
    if applied.from_start:
        found.take(first, messages)
    while simulation.k < applied.last:
        interrupts.check()
        found.take(simulation.advance(1, source.table(simulation.k, 1)), messages)
    unequal, told = found.unequal(), found.told()
    elsewhere = differences(before.target, target()) if before.target else []
    same_code = before.metadata.get('source_hash', '') == sources()
    data: dict[str, Any] = {
        'status': 'different' if unequal else 'identical',
        'steps': applied.last - applied.first,
        'first_step': applied.first,
        'messages': sum(found.equal.values()),
        'same_code': same_code,
        'target': before.target,
        'target_differences': elsewhere,
        'out': None if args.out is None else str(args.out),
        'outside': list(unequal),
        'channels': {},
        'told': told,
    }
    if not unequal:
        steps = f'{data["steps"]} steps' + (f' from step {applied.first} on' if applied.first else '')
        lines = [f'identical: {steps}, {data["messages"]} messages of {len(found.equal)} topics', *told]
        return Result(data=data, text='\n'.join(lines))
    lines = [f'topic {topic}: {text}' for topic, text in unequal.items()] + told
    if args.scene is not None:
        lines.append(f'the bag does not say its scene: it may be another one than {args.scene}, or have had overrides')
    elif not same_code:
        lines.append('the recording was made by another version of the solver')
    if elsewhere:
        lines.append(
            'the same bits cannot be expected, because the recording was made on another target: '
            f'{"; ".join(elsewhere)}'
        )
    if found.later(first.t_ns):
        lines.append(
            'a car that was placed meanwhile (initialpose) goes on elsewhere: such a run is replayed from '
            '~/start_recording'
        )
    return Result(data=data, text='\n'.join(lines), code=1)


class Compared:
    """Messages of a recording of topics beside those that a replay makes of the same steps.

    equal: topic -> messages that are the same bytes. A paused node publishes its state again, all topics and bodies,
    whatever is due: a message may be that too. Messages that belong to no step of the replay are counted.
    """

    def __init__(self, before: Content) -> None:
        self.equal: Counter[str] = Counter()
        self._left: dict[str, dict[int, list[bytes]]] = {}
        for topic, messages in before.topics.items():
            at = self._left[topic] = {t_ns: [data] for t_ns, data in messages.items()}
            for t_ns, data in before.further.get(topic, ()):
                at[t_ns].append(data)
        self._differs: dict[str, list[int]] = {}
        self._others: Counter[str] = Counter()
        self._known: set[str] = set()

    def take(self, snapshot: Snapshot, messages: Messages) -> None:
        """Compare the messages of a step of the replay."""
        wanted = [self._left.get(topic.name.strip('/'), {}).pop(snapshot.t_ns, []) for topic in messages.topics]
        if not any(wanted):
            return
        made, again = messages.encode(snapshot), messages.encode(snapshot, whole=True)
        for topic, recorded, *ours in zip(messages.topics, wanted, made, again, strict=True):
            name = topic.name.strip('/')
            self._known.add(name)
            for data in recorded:
                if data in ours:
                    self.equal[name] += 1
                elif name in SHARED and len(data) not in [len(one) for one in ours if one is not None]:
                    self._others[name] += 1  # other frames or joints
                else:
                    self._differs.setdefault(name, []).append(snapshot.t_ns)

    def later(self, first: int) -> bool:
        """True where the messages that differ were equal at instant `first` [ns]."""
        return all(times[0] > first for times in self._differs.values())

    def unequal(self) -> dict[str, str]:
        """Topic -> in what it differs."""
        found = {}
        for topic, left in self._left.items():
            if times := self._differs.get(topic):
                count = len(times) + self.equal[topic]
                found[topic] = f'{len(times)} of {count} messages differ, the first at {times[0] * 1e-9:.9g} s'
            elif not self.equal[topic] and (left or self._others[topic]):
                found[topic] = 'no message is one of the replay' + (
                    '' if topic in self._known else ', which has no such topic at these instants'
                )
        return found

    def told(self) -> list[str]:
        """Parts that were not compared, a sentence each."""
        rest = {topic: sum(map(len, left.values())) for topic, left in self._left.items() if left}
        texts = [
            f'topic {topic}: {count} messages of another publisher are not compared'
            for topic, count in self._others.items()
        ]
        texts += [
            f'topic {topic}: {count} messages at instants of no step in the replay are not compared'
            for topic, count in rest.items()
        ]
        return texts


def _own_start(where: Path, before: Content, applied: Inputs) -> list[str]:
    """Overrides so that the scene starts with what was applied at its start, where its own maneuver is a recording that
    may be gone."""
    from solver.files.scene import load_scene_text

    scene = load_scene_text(before.metadata['resolved_scene'], f'scene in {where}')
    if not scene.maneuver.bag:
        return []
    return _maneuver(where, applied) if applied.start and applied.last > applied.first else ['maneuver={}']


def _maneuver(where: Path, applied: Inputs) -> list[str]:
    """Overrides that let the inputs in a recording drive, for as long as it lasts."""
    seconds = (applied.last - applied.first) * applied.h_ns * 1e-9
    place = str(where.resolve()).replace("'", "''")  # as YAML quotes it
    return [f"maneuver={{bag: '{place}'}}", f'duration={seconds!r}']


def different_topics(before: Content, after: Content, *, lost: bool = False) -> list[str]:
    """Topics whose messages are not the same bytes at the same instants. lost: the recording may lack instants of the
    replay."""
    found = []
    for name in sorted(before.outputs.keys() | after.outputs.keys()):
        ours, theirs = before.outputs.get(name, {}), after.outputs.get(name, {})
        instants = ours.keys() <= theirs.keys() if lost else ours.keys() == theirs.keys()
        if not instants or any(theirs[t] != data for t, data in ours.items()):
            found.append(name)
    return found


def _changed(args: argparse.Namespace, before: Content, applied: Inputs, directory: Path) -> Result:
    """With other settings or another vehicle, driven by the same inputs: the channels side by side."""
    from mbd_sim_ros import compiling
    from mbd_sim_ros.analysis import runs
    from mbd_sim_ros.analysis.comparison import compare
    from mbd_sim_ros.analysis.pairing import with_doubts_of
    from mbd_sim_ros.bags import reader as bag
    from mbd_sim_ros.batch import simulate
    from mbd_sim_ros.commands.compare import about
    from solver import simulation_of
    from solver.files.scene import load_scene_text

    overrides = overrides_of(args)
    if applied.last == applied.first:
        raise BagError(f'{args.bag} cannot be replayed: it holds no step')
    for given in args.overrides:
        section = given.partition('=')[0].partition('.')[0].strip()
        if section in ('duration', 'maneuver'):
            raise SpecError(
                f'--set {given}: a replay keeps the inputs and the duration of its recording; change them with mbd run'
            )
        if section == 'start' and before.state is not None:
            raise SpecError(
                f'--set {given}: {args.bag} begins with a saved state, so start has no effect; replay a recording that '
                'begins at the start'
            )
    text, name = before.metadata['resolved_scene'], f'scene in {args.bag}'
    first = load_scene_text(text, name, overrides)
    h_ns = first.integrator.h_ns
    steps = (applied.last - applied.first) * applied.h_ns // h_ns
    drive = _maneuver(args.bag, applied)[:1]
    scene = load_scene_text(text, name, [*overrides, *drive, f'duration={steps * h_ns * 1e-9!r}'])
    compiling.tell(not args.json, scene.model)
    simulation = simulation_of(scene)
    if before.state is None:
        figures = simulate(simulation, steps, directory=directory, progress=not args.json)
    else:
        if h_ns != applied.h_ns or args.vehicle or args.fidelity:
            raise SpecError(
                f'{args.bag} begins before step {applied.first + 1} with a saved state, which fits a step of '
                f'{applied.h_ns * 1e-9:g} s, its vehicle and its level only; keep all three, or replay a recording '
                'that begins at the start'
            )
        figures = simulate(
            simulation, applied.last, directory=directory, progress=not args.json, state=before.state,
            from_start=applied.from_start, source=applied.source(simulation.channels.inputs),
        )  # fmt: skip
    again, recorded = bag.read(directory), bag.read(args.bag, namespace=before.metadata.get('namespace', ''))
    found = compare(again, recorded, rated=False)
    compared = set(again.names) & set(recorded.names)
    both = ('replay', again), (str(args.bag), recorded)
    doubts = {name: list(told) for name, one in both if (told := runs.suspicion(with_doubts_of(one, compared)))}
    data = {
        'status': 'compared',
        'steps': steps,
        'first_step': applied.first,
        'real_time_factor': figures['real_time_factor'],
        'interpolated': found.interpolated,
        'instants': found.instants,
        'channels': {
            d.channel: {'max': d.max, 'rms': d.rms, 'time_of_max': d.time, 'scale': d.scale} for d in found.differences
        },
        'left_out': list(found.left_out),
        'doubts': doubts,
        'out': None if args.out is None else str(args.out),
    }
    rows = [('channel', 'unit', 'max', 'at [s]', 'rms', 'scale')]
    rows += [
        (d.channel, d.unit, f'{d.max:.3g}', f'{d.time:.6g}', f'{d.rms:.3g}', f'{d.scale:.3g}')
        for d in found.differences[:SHOWN]
    ]
    more = len(found.differences) - SHOWN
    lines = about(found, ['replay', str(args.bag)], {}, doubts=doubts)
    lines += [table(rows)] + ([f'... and {more} channels that differ less'] if more > 0 else [])
    lines.append(
        f'differences from {args.bag} at {found.instants} instants' + (' (interpolated)' if found.interpolated else '')
    )
    return Result(data=data, text='\n'.join(lines))
