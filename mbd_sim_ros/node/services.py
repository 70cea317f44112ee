"""The services of a node: each call is done by the simulation thread between two steps, answered with one sentence, and
logged."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Generator
from typing import Any, Protocol

from rclpy.callback_groups import CallbackGroup, ReentrantCallbackGroup
from rclpy.executors import Executor
from rclpy.node import Node
from std_srvs.srv import Trigger

from mbd_sim_ros import interrupts
from mbd_sim_ros.node.loop import ENDED
from mbd_sim_ros.node.running import Running
from solver.errors import BagError, MbdError, SpecError

REPLY_SECONDS = 30.0
TURN, LONGEST_TURN = 2e-4, 5e-3  # s between looks at steps that are being made: at first, and once it takes long


class Host(Protocol):
    """The node that has the services. stopped: it was told to stop, or has loaded another scene, and has not been
    started since."""

    running: Running
    stopped: bool

    def value(self, name: str) -> Any: ...
    def load(self, name: str, overrides: list[str]) -> str: ...


def pause(running: Running) -> str:
    """hold the simulation; steps that ~/step asked for and that are not made yet are dropped"""
    rest = _unmade(running.loop.pause())
    return f'paused at t = {running.simulation.t_ns * 1e-9:.6f} s, step {running.simulation.k}{rest}'


def resume(running: Running) -> str:
    """go on, at the pace of the mode; steps that ~/step asked for and that are not made yet are dropped"""
    return 'running' + _unmade(running.loop.resume())


def _unmade(steps: int) -> str:
    return f'; {steps} steps that were asked for are not made' if steps else ''


def reset(running: Running) -> str:
    """back to the start, bit for bit; a recording goes on in a new directory"""
    return running.reset()


def step(running: Running) -> str:
    """do `step_count` steps while paused or in lockstep; answered when they are made"""
    if not running.loop.paused and running.loop.pace.mode != 'lockstep':
        raise SpecError(
            f'the simulation is running (mode {running.loop.pace.mode}): call ~/pause before ~/step, or use mode '
            'lockstep'
        )
    count = running.value('step_count')
    running.loop.step(count)
    return f'{count} steps from step {running.simulation.k}'


def save_state(running: Running) -> str:
    """write the state into a file in the current directory, for the parameter `restore`"""
    return str(running.driving.save())


def start_recording(running: Running) -> str:
    """record into a new directory"""
    if running.recording.recorder is not None:
        raise BagError(f'already recording into {running.recording.recorder.directory}')
    return str(running.begin_recording())


def stop_recording(running: Running) -> str:
    """finish the recording"""
    directory = running.recording.end(running.loop, 'stopped by request')
    if directory is None:
        raise BagError('nothing is being recorded')
    return str(directory)


ACTIONS: tuple[Callable[[Running], str], ...] = (
    pause,
    resume,
    reset,
    step,
    save_state,
    start_recording,
    stop_recording,
)
LOAD = 'load the scene that the parameters `scene` and `overrides` name now; it stands at its start, paused'
SERVICES = {**{action.__name__: action.__doc__ or '' for action in ACTIONS}, 'load': LOAD}


class _Turn:
    """To await it gives the executor a turn."""

    def __init__(self, executor: Executor | None, seconds: float) -> None:
        self.executor, self.seconds = executor, seconds

    def __await__(self) -> Generator[None, None, None]:
        time.sleep(self.seconds)
        if self.executor is not None:
            self.executor.wake()  # or it would wait for a message before it comes back here
        yield


async def made(node: Node, host: Host, running: Running) -> str:
    """Give the executor turns until the steps that were asked for are made, or dropped; why they never will be, or
    ''."""
    seconds = TURN
    while running.loop.stepping:
        if running.loop.done.is_set() or running is not host.running or interrupts.event.is_set():
            return str(running.loop.error or ENDED)
        await _Turn(node.executor, seconds)
        seconds = min(1.5 * seconds, LONGEST_TURN)  # a look costs the steps some of the interpreter lock
    return ''


def beside() -> CallbackGroup:
    """The group of a service that waits: those of the group of a node would wait with it."""
    return ReentrantCallbackGroup()


def serve(node: Node, host: Host) -> None:
    """Offer ACTIONS as services of type std_srvs/Trigger."""
    for action in ACTIONS:
        waits = action is step
        call = _service(node, action.__name__, _stepped(node, host) if waits else _on(host, action))
        node.create_service(Trigger, f'~/{action.__name__}', call, callback_group=beside() if waits else None)
    node.create_service(Trigger, '~/load', _service(node, 'load', lambda: _load(host)))


def _on(host: Host, action: Callable[[Running], str]) -> Callable[[], tuple[bool, str]]:
    def done() -> tuple[bool, str]:
        found = asked(host.running, action)
        host.stopped &= not (found[0] and action in (resume, step))
        return found

    return done


def _stepped(node: Node, host: Host) -> Callable[[], Awaitable[tuple[bool, str]]]:
    async def done() -> tuple[bool, str]:
        running = host.running
        dropped = running.loop.dropped
        found = _on(host, step)()
        if not found[0]:
            return found
        lost = await made(node, host, running)
        if not lost and running.loop.dropped > dropped:
            lost = f'{running.loop.dropped - dropped} of them were dropped by a pause, a resumption or a reset'
        return not lost, found[1] + (f': {lost}' if lost else '')

    return done


def _load(host: Host) -> tuple[bool, str]:
    if not host.value('scene'):
        return False, 'parameter scene is empty: set it to the name or file of a scene'
    try:
        return True, host.load(host.value('scene'), [text for text in host.value('overrides') if text])
    except MbdError as error:
        return False, str(error)


def _service(
    node: Node, name: str, do: Callable[[], tuple[bool, str] | Awaitable[tuple[bool, str]]]
) -> Callable[[Any, Any], Any]:
    async def call(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        done = do()
        response.success, response.message = done if isinstance(done, tuple) else await done
        tell(node, name, response.success, response.message)
        return response

    return call


def tell(node: Node, name: str, done: bool, text: str) -> None:
    """Log what became of a call; of steps, which may be asked for at any rate, for those alone who look for faults."""
    log = node.get_logger()
    if not done:
        log.warning(f'{name} refused: {text}')
    elif 'step' in name:
        log.debug(f'{name}: {text}')
    else:
        log.info(f'{name}: {text}')


def asked(running: Running, action: Callable[[Running], str]) -> tuple[bool, str]:
    """Have an action done between two steps: whether it was, and its sentence."""
    try:
        return True, running.loop.ask(lambda: action(running)).result(REPLY_SECONDS)
    except TimeoutError:
        return False, f'no answer from the simulation within {REPLY_SECONDS:g} s'
    except (MbdError, RuntimeError, OSError) as error:
        return False, str(error)
