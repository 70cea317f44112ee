"""Ctrl-C at any moment: one sentence, its exit code, at once, and every recording complete.

`MBD_FAULTS=500 pytest test/faults` makes 500 trials; MBD_FAULTS_SEED chooses other times.
"""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from faults import COUNT, UNWANTED, Ended, Victim, finished, mbd, simulator, times, trials
from processes import DOMAIN, SCRIPT

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.interrupts import GRACE
from mbd_sim_ros.lab.studies import STUDIES
from solver import load_scene, simulation_of
from solver.simulation import Simulation

pytestmark = pytest.mark.realtime

ANSWER, WHILE_COMPILING = 1.0, 3.0  # s
BUSY = 0.5  # s more that other processes on the machine may cost
COMMANDS = {  # command -> seconds from its start within which the signal comes, half as many where each has one trial
    'run': 4.0,
    'run_long_steps': 4.0,
    'run_unrecorded': 3.0,
    'replay': 5.0,
    'export': 3.0,
    'compare': 3.0,
    'recover': 2.0,
    'info': 4.0,
    'study': 8.0,
    'bench': 6.0,
    'compile': 20.0,
    'simulator': 4.0,
    'maneuver': 2.0,
    'plan': 8.0,
    'sweep': 8.0,
    'drive': 6.0,
    'view': 4.0,
    'evaluate': 3.0,
    'trade': 6.0,
}
FOUND = 'the plan was interrupted after'
# that are interrupted in what others are interrupted in
ALIKE = ('run_unrecorded', 'compare', 'recover', 'info', 'evaluate', 'trade')


@pytest.fixture(scope='module')
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp('bags') / 'first'
    assert (
        main(
            [
                'run',
                'light_car_lane_change',
                '--duration',
                '4',
                '--set',
                'record.every=1',
                '--out',
                str(directory),
                '--json',
            ]
        )
        == 0
    )
    return directory


def command(name: str, recording: Path, study: str = 'slider_crank') -> list[object]:
    """Arguments of the Python interpreter."""
    car = ('light_car_lane_change', '--set', 'duration=100000')
    return {
        'run': mbd('run', *car, '--out', 'out'),
        'run_long_steps': mbd('run', *car, '--set', 'record.every=10000', '--out', 'out'),
        'run_unrecorded': mbd('run', *car, '--no-record'),
        'replay': mbd('replay', recording, '--out', 'out'),
        'export': mbd('export', recording, '--csv', 'csv'),
        'compare': mbd('compare', recording, recording, '--plot', 'p.png'),
        'recover': mbd('recover', recording, 'out'),
        'info': mbd('info', 'light_car_lane_change'),
        'study': mbd('study', study, '--quick', '--out', 'study'),
        'bench': mbd('bench', '--cases', 'slider_crank', '--quick'),
        'compile': mbd('compile', 'slider_crank'),
        'simulator': simulator(SCRIPT, '{}', '0.5', record=True, out='out'),
        'maneuver': ['-m', 'mbd_sim_ros.node.maneuver_player', '--ros-args', '-p', 'maneuver:=step_steer'],
        'plan': mbd(
            'plan',
            'light_car_lane_change',
            '--set',
            'require={yaw_rate: {rms: 2 %}}',
            '--out',
            'plan',
            '--workers',
            '1',
        ),
        'sweep': mbd('sweep', 'step_steer_mass', '--out', 'sweep', '--workers', '1'),
        'drive': mbd('maneuver', 'iso4138', 'light_car', '--out', 'drive'),
        'view': mbd('view', recording, '--out', 'film.gif'),
        'evaluate': mbd('evaluate', recording, '--as', 'iso2631', '--html', 'page.html'),
        'trade': mbd('study', 'trade', 'light_car_lane_change', '--quick', '--out', 'trade', '--workers', '1'),
    }[name]


def judge(ended: Ended, number: int, limit: float, *, as_json: bool, node: bool) -> None:
    """One sentence, the exit code of the signal, in time. A command that had done its work before is as well, and
    a plan that says what it has found by then."""
    said = ended.out + ended.err
    assert not UNWANTED.search(said), said
    assert ended.code >= 0, f'ended by signal {-ended.code}: {said}'
    if ended.code == 0 and not node:
        return
    assert ended.code == (0 if node else 128 + number), said
    assert ended.seconds < limit + BUSY, f'{ended.seconds:.2f} s: {said}'
    if as_json:
        assert json.loads(ended.out)['status'] in (('ok', 'incomplete') if FOUND in ended.out else ('error',))
        assert ended.lines == []
    elif node:
        assert ('interrupted while' in said) != ('stopped by SIG' in said), said
    elif FOUND not in ended.out:
        assert ended.out == ''
        assert len(ended.lines) == 1 and 'interrupted' in ended.lines[0], said


@pytest.mark.slow
@pytest.mark.parametrize(
    'trial',
    trials(len(COMMANDS))
    if COUNT
    else [pytest.param(k, marks=pytest.mark.long if name in ALIKE else ()) for k, name in enumerate(COMMANDS)],
)
def test_an_interrupted_command_says_one_sentence_and_ends(trial: int, recording: Path, tmp_path: Path) -> None:
    name = list(COMMANDS)[trial % len(COMMANDS)]
    node = name in ('simulator', 'maneuver')
    if node:
        pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    random = times('interrupts', trial)
    delay = (1.0 if COUNT else 0.5) * COMMANDS[name] * random.random()
    number = signal.SIGINT if random.random() < 0.8 else signal.SIGTERM
    as_json = not node and random.random() < 0.3
    environment = {'ROS_DOMAIN_ID': DOMAIN, 'ROS_LOG_DIR': str(tmp_path / 'log')} if node else {}
    if name == 'compile':
        environment['MBD_CACHE_DIR'] = str(tmp_path / 'cache')  # so that it does compile
    study = str(random.choice([name for name in STUDIES if name != 'trade']))
    victim = Victim(tmp_path, [*command(name, recording, study), *(['--json'] if as_json else [])], **environment)
    try:
        if victim.ready():
            time.sleep(delay)
        clock = victim.strike(number, group=random.random() < 0.5)
        ended = victim.end(clock)
    finally:
        victim.kill()
    judge(ended, number, WHILE_COMPILING if name == 'compile' else ANSWER, as_json=as_json, node=node)
    run = finished(tmp_path / 'out') if name != 'recover' else None
    if run is not None and ended.code:
        steps = run['cmd_applied/step']
        assert np.all(np.diff(steps) > 0.0)
        # interrupted while it compared
        whole = name == 'replay' and steps[-1] == bag.read(recording)['cmd_applied/step'][-1]
        ended_as = {key: run.metadata.get(key) for key in ('status', 'reason', 'error', 'findings', 'end')}
        assert run.metadata.get('status') == ('ok' if whole else 'interrupted') or 'end' in run.metadata, (
            ended_as,
            ended.lines,
        )


@pytest.mark.parametrize('name', ['run', 'simulator'])
def test_a_second_signal_ends_the_process_at_once_and_the_recording_is_complete(
    name: str, recording: Path, tmp_path: Path
) -> None:
    """The first one finds a simulation whose step takes longer than anybody waits."""
    if name == 'simulator':
        pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    slow = 'import time\nimport solver.simulation\n'
    if name == 'run':
        script = slow + (
            'advance = solver.simulation.Simulation.advance\ndef deaf(self, n=1, inputs=None, **more):\n    if self.k '
            '>= 500:\n        print("DEAF", flush=True)\n        time.sleep(30.0)\n    return advance(self, n, '
            'inputs, **more)\nsolver.simulation.Simulation.advance = deaf\nimport sys\nfrom mbd_sim_ros.commands.main '
            'import main\nsys.exit(main(sys.argv[1:]))\n'
        )
        arguments: list[object] = ['-c', script, 'run', 'light_car_lane_change', '--out', 'out']
    else:
        script = SCRIPT.replace(
            'node.prepare = prepare',
            'advance = synthetic.Synthetic.advance\ndef deaf(self, n=1, inputs=None):\n    if self.k >= 500:\n        '
            'print("DEAF", flush=True)\n        time.sleep(30.0)\n    return advance(self, n, inputs)\n'
            'synthetic.Synthetic.advance = deaf\nnode.prepare = prepare',
        )
        arguments = simulator(script, '{}', '0', record=True, out='out')
    victim = Victim(tmp_path, arguments, ROS_DOMAIN_ID=DOMAIN, ROS_LOG_DIR=str(tmp_path / 'log'))
    try:
        assert victim.ready('DEAF')
        time.sleep(0.5)  # what was written is delivered
        victim.strike(signal.SIGINT)
        time.sleep(0.6)
        assert victim.process.poll() is None  # it would finish in order
        clock = victim.strike(signal.SIGINT)
        ended = victim.end(clock)
    finally:
        victim.kill()
    assert ended.code == 130, ended.err
    assert ended.seconds < 0.5
    assert not UNWANTED.search(ended.err)
    run = finished(tmp_path / 'out')
    assert run is not None and run['cmd_applied/step'][-1] == 500.0
    assert run.metadata['end'] == 'the simulating process died'


def test_a_sentence_that_is_being_said_is_finished(tmp_path: Path) -> None:
    """Whoever has begun to say why the work ends is not cut off by the thread that ends the process when its time is
    up."""
    script = (
        'import sys, time\nfrom mbd_sim_ros import interrupts\ninterrupts.install(lambda text: interrupts.write(2, '
        'text))\ninterrupts.now("waiting")\nprint("READY", flush=True)\ninterrupts.event.wait()\nwith '
        'interrupts.saying() as mine:\n    time.sleep(1.5 * interrupts.GRACE)\n    interrupts.write(2, f"{mine}: '
        '{interrupts.sentence()}")\ntime.sleep(30.0)\n'
    )
    victim = Victim(tmp_path, ['-c', script])
    try:
        assert victim.ready('READY')
        ended = victim.end(victim.strike(signal.SIGTERM))
    finally:
        victim.kill()
    assert (ended.code, ended.lines) == (128 + signal.SIGTERM, ['True: interrupted while waiting'])
    assert ended.seconds < 2.5 * GRACE + BUSY


def test_a_call_of_many_long_steps_is_divided(monkeypatch: pytest.MonkeyPatch) -> None:
    """No call lasts longer than twice what is allowed, whatever record.every says, once the first steps have been
    measured."""
    from mbd_sim_ros import batch

    spent: list[int] = []
    warm_up, advance = batch.warm_up, Simulation.advance

    def warm(simulation: Simulation) -> None:
        warm_up(simulation)
        spent.clear()

    def slow(self: Simulation, n: int = 1, *given: Any, **named: Any) -> Any:
        """Steps of 20 ms."""
        time.sleep(0.02 * n)
        spent.append(n)
        return advance(self, n, *given, **named)

    monkeypatch.setattr(batch, 'warm_up', warm)
    monkeypatch.setattr(Simulation, 'advance', slow)
    batch.simulate(simulation_of(load_scene('pendulum', ['record.every=100', 'duration=1'])), 60, error=False)
    assert sum(spent) == 60
    assert max(spent) in (4, 5)


STRUCK = (  # as `main` of console scripts is called, but that a signal comes in the middle of the first imports
    'import os, signal, sys\nclass Strike:\n    def find_spec(self, name, path=None, target=None):\n        if name '
    '== "{imported}":\n            os.kill(os.getpid(), signal.SIGINT)\nsys.meta_path.insert(0, Strike())\n'
    'sys.argv[0] = "/somewhere/bin/{name}"\nfrom {module} import main\nsys.exit(main())\n'
)


@pytest.mark.parametrize(
    ('imported', 'as_json'), [('argparse', False), ('tempfile', True), ('mbd_sim_ros.commands.bench', False)]
)
def test_a_signal_while_a_command_imports_its_first_modules_is_answered_by_one_sentence(
    imported: str, as_json: bool, tmp_path: Path
) -> None:
    script = STRUCK.format(imported=imported, name='mbd', module='mbd_sim_ros.commands.main')
    victim = Victim(tmp_path, ['-c', script, 'info', 'slider_crank', *(['--json'] if as_json else [])])
    try:
        ended = victim.end(time.monotonic())
    finally:
        victim.kill()
    judge(ended, signal.SIGINT, GRACE + 5.0, as_json=as_json, node=False)
    assert ended.code == 130


@pytest.mark.parametrize(
    ('name', 'module'), [('simulator', 'main'), ('maneuver', 'maneuver_player'), ('adapter', 'adapter')]
)
def test_a_signal_while_a_node_imports_its_first_modules_is_answered_by_one_sentence(
    name: str, module: str, tmp_path: Path
) -> None:
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    script = STRUCK.format(imported='tempfile', name=name, module=f'mbd_sim_ros.node.{module}')
    victim = Victim(tmp_path, ['-c', script], ROS_DOMAIN_ID=DOMAIN, ROS_LOG_DIR=str(tmp_path / 'log'))
    try:
        ended = victim.end(time.monotonic())
    finally:
        victim.kill()
    judge(ended, signal.SIGINT, GRACE + 5.0, as_json=False, node=True)
    assert ended.code == 0 and ended.lines
