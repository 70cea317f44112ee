"""`make demo`: the real node, driven over real topics in real time, recorded, and the recording simulated again bit for
bit.

Exit code 0 only if at most 1 % of the steps missed their deadline and the replay gives the same bits.
"""

from __future__ import annotations

from mbd_sim_ros import interrupts

if __name__ == '__main__':
    interrupts.install(lambda text: interrupts.write(2, f'demo: {text}'))

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.bags.recorder import new_directory
from solver.errors import MbdError
from solver.files.scene import load_scene

SCENE = 'light_car_step_steer'
SHORTEST = 12.0  # s
OVERRUNS_ALLOWED = 0.01
DOMAIN = '77'  # of its own, so that nothing else on the machine steers the car


def drive(scene: str, directory: Path, duration: float) -> None:
    """Run simulator and maneuver as processes until the simulator ends. Raises MbdError with its exit code if it
    fails."""
    # nobody else listens
    environment = {'ROS_DOMAIN_ID': DOMAIN, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', **os.environ}
    parameters = {
        'scene': scene,
        'duration': duration,
        'record': True,
        'out': str(directory),
        'mode': 'realtime',
        'rate_factor': 1.0,
    }
    arguments = [text for name, value in parameters.items() for text in ('-p', f'{name}:={json.dumps(value)}')]
    simulator = subprocess.Popen(
        [sys.executable, '-m', 'mbd_sim_ros.node.main', '--ros-args', *arguments], env=environment
    )
    player = [
        sys.executable,
        '-m',
        'mbd_sim_ros.node.maneuver_player',
        '--ros-args',
        '-p',
        f'scene:={scene}',
        '-p',
        'timeout:=1200.0',
        '-p',
        f'duration:={duration}',
    ]
    maneuver = subprocess.Popen(player, env=environment)
    try:
        while simulator.poll() is None:
            if maneuver.poll():  # or the car would go on without a driver
                raise MbdError(f'the maneuver ended with exit code {maneuver.returncode}')
            time.sleep(0.1)
        if code := simulator.wait():
            raise MbdError(f'the simulator ended with exit code {code}')
        if code := maneuver.wait(30.0):
            raise MbdError(f'the maneuver ended with exit code {code}')
    except subprocess.TimeoutExpired:
        raise MbdError('the maneuver did not notice that the simulator has ended') from None
    finally:
        for process in (maneuver, simulator):
            if process.poll() is None:
                process.terminate()
                process.wait(30.0)


def draw(run: bag.Run, file: Path) -> None:
    """Draw trajectory, yaw rate, steering and tire forces, or the joint positions of a mechanism without tires."""
    import matplotlib as mpl

    mpl.use('Agg')
    from matplotlib import pyplot

    wheels = [name.split('/')[1] for name in run.columns if name.startswith('tire/') and name.endswith('/fy')]
    if not wheels:
        figure, axes = pyplot.subplots(figsize=(9, 5), layout='constrained')
        for name in [name for name in run.columns if name.startswith('joint_states/') and name.endswith('/position')]:
            axes.plot(run.time, run[name], label=name.split('/')[1])
        axes.set(xlabel='time [s]', ylabel='joint position [rad or m]')
        axes.legend()
    else:
        figure, grid = pyplot.subplots(2, 2, figsize=(12, 8), layout='constrained')
        grid[0, 0].plot(run['odom/pose/x'], run['odom/pose/y'])
        grid[0, 0].set(xlabel='x [m]', ylabel='y [m]', title='trajectory of base_link', aspect='equal')
        grid[0, 1].plot(run.time, run['odom/twist/wz'], label='yaw rate [rad/s]')
        if 'cmd_applied/steering' in run.columns:
            grid[0, 1].plot(run.time, run['cmd_applied/steering'], label='steering wheel [rad]')
        grid[0, 1].set(xlabel='time [s]', title='yaw rate and steering')
        grid[0, 1].legend()
        for axes, force, title in ((grid[1, 0], 'fy', 'lateral'), (grid[1, 1], 'fz', 'vertical')):
            for wheel in wheels:
                axes.plot(run.time, run[f'tire/{wheel}/force/{force}'], label=wheel.replace('_', ' '))
            axes.set(xlabel='time [s]', ylabel=f'{force} [N]', title=f'{title} tire force, contact frame')
            axes.legend()
    for axes in figure.axes:
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=110)
    pyplot.close(figure)


def demo(scene: str, duration: float | None) -> int:
    """Run the demonstration and print what came of it; returns the exit code."""
    loaded = load_scene(scene)
    duration = duration or float(max(loaded.duration, SHORTEST))
    directory = new_directory(f'demo-{loaded.name}')
    interrupts.now(f'driving {scene}')
    print(
        f'demo: {scene}, {duration:g} s in real time; the first start compiles, which takes about a minute', flush=True
    )
    drive(scene, directory, duration)
    run = bag.read(directory)
    steps, overruns = int(run.metadata['steps']), int(run.metadata['overruns'])
    wall = float(run.metadata['wall_time'])
    picture = directory / 'demo.png'
    draw(run, picture)
    print(
        f'real time:  {run.time[-1]:.3f} s simulated in {wall:.3f} s, {overruns} of {steps} steps late '
        f'({100.0 * overruns / steps:.2f} %)'
    )
    print(f'recording:  {directory} ({len(run.columns)} columns, {run.time_ns.size} instants)')
    print(f'picture:    {picture}')
    print('replay:     ', end='', flush=True)
    same = (
        subprocess.run(
            [sys.executable, '-m', 'mbd_sim_ros.commands.main', 'replay', str(directory)], check=False
        ).returncode
        == 0
    )
    late = overruns > OVERRUNS_ALLOWED * steps
    if late:
        print(f'FAILED: more than {OVERRUNS_ALLOWED:.0%} of the steps were late: the machine is too slow or too busy')
    if not same:
        print('FAILED: the replay does not give the same bits')
    return int(late or not same)


def main() -> int:
    """Read the arguments and run; returns the exit code."""
    parser = argparse.ArgumentParser(prog='python -m mbd_sim_ros.commands.demo', description=__doc__)
    parser.add_argument('scene', nargs='?', default=SCENE, help='scene file or name (%(default)s)')
    parser.add_argument(
        '--duration', type=float, help=f'simulated seconds (default: that of the scene, at least {SHORTEST:g})'
    )
    arguments = parser.parse_args()
    try:
        return demo(arguments.scene, arguments.duration)
    except MbdError as error:
        print(f'demo: {error}', file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        with interrupts.saying() as mine:
            if mine:
                print(f'demo: {interrupts.sentence()}', file=sys.stderr, flush=True)
        return interrupts.EXIT + interrupts.received()


if __name__ == '__main__':
    sys.exit(main())
