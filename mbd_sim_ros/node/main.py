"""Executable `simulator`: runs a scene as a ROS 2 node (simulator.py), from the first import to the last file.

SIGINT and SIGTERM end the node at any moment, with one sentence, a finished recording, and exit code 0, as launch
expects of nodes. Any other error ends it with one sentence and the exit code of the error. Nothing heavy is imported
before the signal handlers are installed.
"""

from __future__ import annotations

import sys

from mbd_sim_ros import beginning

beginning.hold('simulator', 'mbd_sim_ros.node.main')

from mbd_sim_ros import interrupts
from mbd_sim_ros.node import PREPARING


def _say(text: str) -> None:
    """Print a sentence to stderr."""
    interrupts.write(2, text)


if __name__ == '__main__' or any(map(beginning.is_program, ('simulator', 'maneuver', 'adapter'))):
    interrupts.install(_say, code=0)

import gc
import signal
import threading
import warnings
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

# Interval [s] after which a Python thread must give up the interpreter. With ten times as much, one step in a second
# was late:
# the one beside the diagnostics.
SWITCH = 2e-5
# time [s] between two looks for signals and the end of the run; each takes the interpreter from the simulation
LOOK = 0.25


def prepare(scene: str, overrides: list[str]) -> tuple[Any, Any]:
    """(scene, simulation) of a scene by path or name: at its start, with all kernels compiled. Raises MbdError.

    The scene is the one that the simulation has, e.g. at its level of detail.
    """
    from mbd_sim_ros import compiling
    from mbd_sim_ros.bags.published import load_published
    from solver import simulation_of
    from solver.engine.stepping import KINDS
    from solver.errors import SpecError
    from solver.files.overrides import overtaken

    if (lost := overtaken(overrides)) is not None:
        raise SpecError(
            f'parameter overrides: {lost[0]} has no effect, because {lost[1]} comes later and replaces all of it; give '
            f'{lost[1]} first'
        )
    loaded = load_published(scene, overrides)
    kind = loaded.integrator.kind
    if kind not in KINDS:
        raise SpecError(
            f'integrator: kind = {kind!r}: a node steps with {" or ".join(KINDS)}; run this one with mbd run'
        )
    compiling.tell(True, loaded.model)
    simulation = simulation_of(loaded)
    simulation.advance(1, inputs=simulation.snapshot().inputs)  # compiles what a step needs before pacing starts
    if simulation.sources.drives:
        simulation.advance(2)  # and what the driver of a maneuver needs in several steps at once
    simulation.reset()
    return simulation.scene, simulation


def run(body: Callable[[], int], args: list[str] | None, name: str) -> int:
    """Run `body` between rclpy.init and shutdown; returns its exit code.

    An error is printed as one sentence, and its exit code returned. name: of the executable. args: None: those of the
    process.
    """
    interrupts.install(_say, code=0)
    interrupts.now(f'starting {name}')
    from solver.errors import MbdError, missing, refused

    try:
        import rclpy
        from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
        from rclpy.exceptions import (
            InvalidParameterTypeException,
            InvalidParameterValueException,
            NameValidationException,
        )
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        print(f'{name}: {missing(error)}', file=sys.stderr)
        return 2
    # This warning of rclpy only repeats an error that is printed anyway.
    warnings.filterwarnings('ignore', 'Failed to fini', RuntimeWarning)
    try:
        given = sys.argv[1:] if args is None else args
        for word in _beside(given):
            if word in ('-h', '--help'):
                print(f'{name}: parameters are given as --ros-args -p NAME:=VALUE; docs/ros.md lists them')
                return 0
            print(
                f'{name}: {word!r} is not understood: parameters are given as --ros-args -p NAME:=VALUE',
                file=sys.stderr,
            )
            return 2
        for file in _parameter_files(given):
            if not file.is_file():
                print(f'{name}: the parameter file {file} is not there; see --params-file', file=sys.stderr)
                return 2
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        return body()
    except (MbdError, InvalidParameterValueException) as error:
        print(error, file=sys.stderr)
        return getattr(error, 'exit_code', 2)
    except InvalidParameterTypeException as error:
        remedies = (
            ("of type 'INTEGER', expecting type 'DOUBLE'", 'with a point, e.g. 5.0'),
            ("of type 'DOUBLE', expecting type 'INTEGER'", 'without a point, e.g. 5'),
            ("of type 'STRING', expecting type 'INTEGER'", 'as a number, e.g. 5'),
            ("of type 'STRING', expecting type 'DOUBLE'", 'as a number, e.g. 5.0'),
            ("type 'STRING_ARRAY'", "as a list, e.g. ['a', 'b']"),
        )
        remedy = next((f'; write it {how}' for what, how in remedies if what in str(error)), '')
        print(f'{error}{remedy}', file=sys.stderr)
        return 2
    except UnknownROSArgsError as error:
        print(f'{name}: {error} is not understood: parameters are given as --ros-args -p NAME:=VALUE', file=sys.stderr)
        return 2
    except NameValidationException as error:  # three lines: what is wrong, the name, an arrow to the place in it
        print(f'{name}: {" ".join(str(error).split()[:-1])}', file=sys.stderr)
        return 2
    except RCLError as error:
        # of rclpy.init: arguments and parameter files; the place in its source follows the reason
        print(f'{name}: {" ".join(str(error).split(", at ")[0].split())}', file=sys.stderr)
        return 2
    except ImportError as error:
        if not (text := missing(error)):
            raise
        print(f'{name}: {text}', file=sys.stderr)
        return 2
    except OSError as error:
        print(f'{name}: {refused(error)}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        with interrupts.saying() as mine:
            if mine:
                print(interrupts.sentence(), file=sys.stderr, flush=True)
        return 0
    finally:
        with interrupts.held():
            rclpy.try_shutdown()
        interrupts.leave()


def _beside(arguments: list[str]) -> list[str]:
    """Command-line words outside of --ros-args ... --: ROS would ignore them, or take them for remapping rules."""
    found, inside = [], False
    for word in arguments:
        if word == ('--' if inside else '--ros-args'):
            inside = not inside
        elif not inside:
            found.append(word)
    return found


def _parameter_files(arguments: list[str]) -> list[Path]:
    """Files that --params-file gives."""
    return [Path(after) for before, after in pairwise(arguments) if before == '--params-file']


def _simulate() -> int:
    """Run the simulator node until its end or a signal; returns the exit code."""
    from rclpy.executors import SingleThreadedExecutor

    from mbd_sim_ros.node.publish import leave_sending_to_the_middleware
    from mbd_sim_ros.node.simulator import Simulator
    from mbd_sim_ros.node.spinning import spin_once
    from solver.errors import SceneError
    from solver.files.scene import known_names

    leave_sending_to_the_middleware()
    node = Simulator(prepare)
    name = node.value('scene')
    if not name:
        raise SceneError(
            'parameter scene is empty: give one with --ros-args -p scene:=NAME; known: ' + ', '.join(known_names())
        )
    interrupts.now(f'preparing {name}')
    node.get_logger().info(f'preparing {name} (the first time this compiles, which takes a minute or two)')
    scene, simulation = prepare(name, [text for text in node.value('overrides') if text])
    # All threads share the lock of the interpreter. The simulation gives it up a dozen times a step (compiled code,
    # publishing), and waits up to SWITCH to get it back while the executor or the recorder computes. gc.freeze() keeps
    # the garbage collector from looking at the objects that are here now, which stay.
    sys.setswitchinterval(SWITCH)
    gc.collect()
    gc.freeze()
    executor = SingleThreadedExecutor()
    try:
        node.open(scene, simulation)
    except BaseException:
        node.close('not started')
        raise
    with interrupts.held():
        code = 0
        try:
            node.get_logger().info(
                f'running {scene.name}: step {simulation.h_ns * 1e-6:g} ms, mode {node.value("mode")}'
            )
            executor.add_node(node)
            while not interrupts.event.is_set() and not node.loop.done.is_set():
                spin_once(executor, node, LOOK)
        finally:
            number = interrupts.received()
            if number:
                interrupts.claim()  # the node prints a sentence of its own when it closes
            code = node.close(f'stopped by {signal.Signals(number).name}' if number else 'stopped')
            executor.shutdown()
            node.destroy_node()
    return code


def main(args: list[str] | None = None) -> int:
    """Run the simulator node; returns the exit code."""
    code = run(_simulate, args, 'simulator')
    if any(thread.name == PREPARING for thread in threading.enumerate()):
        interrupts.end(code)  # the interpreter must not be finalized while a thread compiles
    return code


if __name__ == '__main__':
    sys.exit(main())
