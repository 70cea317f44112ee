"""Recording a run beside the simulation without stopping it: the writing is done by a process of its own
(recording.py).

A thread would share the interpreter lock with the simulation: with one, 1 to 4 % of the steps of a 1 kHz loop came
late, without it almost none (docs/decisions/0005-recording-process.md).
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from mbd_sim_ros.bags.applied import Applied
from mbd_sim_ros.bags.delivery import deliver, deliver_steps
from mbd_sim_ros.bags.writer import FORMAT, RECORD
from mbd_sim_ros.messages.cdr import template
from mbd_sim_ros.messages.topics import INPUTS, STRING, Topic
from solver import stored
from solver.compiled.target import target
from solver.disk import sources
from solver.errors import BagError

if TYPE_CHECKING:
    from solver.model.spec import ModelSpec
    from solver.simulation import Simulation

POLL_SECONDS = 0.02  # between deliveries to the recording process
DELIVERY_STEPS = 256  # at most in one delivery
QUEUE_STEPS = 4096
PIPE_BYTES = 1 << 20
STEM_MOST = 60  # characters of the name of a scene in the names of files; one takes 4 bytes at most, a file name 255


def describe(
    *, scene: str, resolved_yaml: str, parameters: Mapping[str, Any] | None = None, seed: int = 0, **more: str
) -> dict[str, str]:
    """Return what a recording says about its run, as strings: scene, format, code and package versions, target,
    parameters, seed."""
    packages = {}
    for name in ('numpy', 'scipy', 'numba', 'mcap'):
        try:
            packages[name] = version(name)
        except PackageNotFoundError:  # installed by the distribution, without metadata
            packages[name] = 'unknown'
    return {
        'scene': scene,
        'scene_hash': hashlib.sha256(resolved_yaml.encode()).hexdigest(),
        'resolved_scene': resolved_yaml,
        'code_version': code_version(),
        'format': str(FORMAT),
        'source_hash': sources(),
        'packages': yaml.safe_dump(packages),
        'target': yaml.safe_dump(target()),
        'parameters': yaml.safe_dump(dict(parameters or {})),
        'seed': str(seed),
        'created': time.strftime('%Y-%m-%dT%H:%M:%S%z'),
        **more,
    }


def about(simulation: Simulation, *, reactions: bool) -> dict[str, str]:
    """Further entries of a description: what a reader needs to understand the channels of a simulation."""
    channels = simulation.channels
    joint_kinds = dict(zip(channels.joints, channels.joint_kinds, strict=True))
    not_unique = simulation.describe()['reactions_not_unique'] if reactions else []
    return {
        'joint_kinds': json.dumps(joint_kinds),
        'element_kinds': json.dumps(_element_kinds(simulation.scene.model, joint_kinds)),
        'reactions_not_unique': json.dumps(not_unique),
    }


def _element_kinds(model: ModelSpec, joint_kinds: Mapping[str, str]) -> dict[str, str]:
    """Element or constraint on joint coordinates -> 'rotation' or 'translation': what all of these are, else those with
    a factor of 1."""
    from solver.elements.registry import KINDS  # not where the recording process is started, which needs none of them

    found = {}
    for kind in KINDS:
        for element in getattr(model, kind.name):
            terms = [(joint_kinds.get(name, ''), factor) for name, factor in getattr(element, 'terms', ())]
            for kinds in ({one for one, _ in terms}, {one for one, factor in terms if abs(factor) == 1.0}):
                if len(kinds) == 1 and (only := kinds.pop()):
                    found[element.name] = only
                    break
    return found


def code_version() -> str:
    """Return the version of the package, with the git revision when it runs from a checkout."""
    try:
        release = version('mbd_sim_ros')
    except PackageNotFoundError:
        release = 'unknown'
    root = Path(__file__).parents[2]
    if not (root / '.git').exists():
        return release
    try:
        git = ['git', '-C', str(root), 'describe', '--always', '--dirty', '--abbrev=12']
        done = subprocess.run(git, capture_output=True, text=True, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return release
    return f'{release}+{done.stdout.strip()}' if done.returncode == 0 else release


def file_stem(name: str) -> str:
    """The name of a scene as the name of a file: nothing in it leads to another directory."""
    return re.sub(r'[^\w.+-]+', '_', name)[:STEM_MOST].strip('.') or 'scene'


def new_directory(scene: str, base: str | Path = 'bags') -> Path:
    """Make and return `base/<scene>-<YYYYmmdd-HHMMSS>`; a number is appended rather than anything overwritten.

    Raises BagError if the directory cannot be made.
    """
    stem = f'{file_stem(scene)}-{time.strftime("%Y%m%d-%H%M%S")}'
    for attempt in range(1, 1000):
        directory = Path(base) / (stem if attempt == 1 else f'{stem}-{attempt}')
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise BagError(f'cannot record into {directory}: {error.strerror}; choose another place') from error
        return directory
    raise BagError(f'cannot record: {base} already holds a thousand runs of this second')


class Recorder:
    """Records every step through a process of its own: `write` costs the simulation one queue operation.

    When the queue is full (the disk is too slow) a batch run waits (`wait=True`); a real-time run drops the step and
    counts it in `dropped`. A failure is kept: the next `write` and `close` raise it as BagError and the caller decides
    what to do. When the simulating process dies, the recording process finishes the bag with what was delivered.
    `metadata` is the record of `describe`; arrays that the scene in it names become attachments, and a
    `robot_description` in it is also written as the latched topic. namespace: put before topics that do not begin with
    `/`. Usable as a context manager. Raises BagError on construction when `directory` cannot be written or is not
    empty.
    """

    def __init__(
        self,
        directory: str | Path,
        topics: Sequence[Topic],
        metadata: Mapping[str, str],
        *,
        namespace: str = '',
        wait: bool = True,
    ) -> None:
        topics = list(topics)
        self._queue: deque[tuple[int, Sequence[bytes | None]]] = deque()
        description = metadata.get('robot_description', '')
        self._description = template(STRING, {'data': description}).data if description else b''
        if description:
            topics.append(Topic('robot_description', STRING, depth=1, latched=True))
        topics = [t if t.name.startswith('/') else t._replace(name=f'{namespace.rstrip("/")}/{t.name}') for t in topics]
        self.directory = Path(directory)
        self.dropped = 0
        self.error: BagError | None = None
        self._wait = wait
        self._closing = threading.Event()
        self._process = subprocess.Popen(
            [sys.executable, '-P', '-m', 'mbd_sim_ros.bags.process'],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, 'PYTHONPATH': os.pathsep.join(path or os.getcwd() for path in sys.path)},
            start_new_session=True,  # Ctrl-C in the terminal is for the simulation, which then closes the recording
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._pipe, self._replies = self._process.stdin, self._process.stdout
        enlarge(self._pipe.fileno())
        arrays = stored.named_in(metadata.get('resolved_scene', ''))
        sizes = {name: len(data) for name, data in arrays.items()}
        self._deliver(
            [str(self.directory), [tuple(topic) for topic in topics], {RECORD: dict(metadata)}, sizes],
            list(arrays.values()),
        )
        self._reply()
        if self.error is not None:
            raise self.error
        self._thread = threading.Thread(target=self._run, name='recorder', daemon=True)
        self._thread.start()

    @property
    def lag(self) -> int:
        """Steps that wait to be delivered."""
        return len(self._queue)

    @property
    def pid(self) -> int:
        """The number of the recording process."""
        return self._process.pid

    def write(self, t_ns: int, messages: Sequence[bytes | None]) -> bool:
        """Queue the messages of one step, one per topic as given at the start (None: no message); whether there was
        room for them.

        Raises BagError after a failure.
        """
        if self.error is not None:
            raise self.error
        while len(self._queue) >= QUEUE_STEPS:
            if not self._wait:
                self.dropped += 1
                return False
            time.sleep(0.001)
            if self.error is not None:
                raise self.error
        self._queue.append((t_ns, messages))
        return True

    def close(self, result: Mapping[str, str] | None = None) -> Path:
        """Write what is queued, finish the bag and return its directory. Raises BagError if the recording failed."""
        if self._process.returncode is None:
            self._closing.set()
            self._thread.join()
            if self.error is None:
                self._deliver({'dropped_steps': str(self.dropped), **(result or {})})
                self._reply()
            self._end()
        if self.error is not None:
            raise self.error
        return self.directory

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        while self.error is None:
            last = self._closing.is_set()
            while True:
                steps = [self._queue.popleft() for _ in range(min(len(self._queue), DELIVERY_STEPS))]
                if steps and self._description:
                    t_ns, messages = steps[0]
                    steps[0] = (t_ns, [*messages, self._description])
                    self._description = b''
                try:
                    deliver_steps(self._pipe.fileno(), steps)  # also none: it makes the other side look at its clock
                except OSError:
                    self._reply()
                if not self._queue or self.error is not None:
                    break
            if last:
                return
            self._closing.wait(POLL_SECONDS)

    def _deliver(self, content: Any, attachments: Sequence[bytes] = ()) -> None:
        """Send a start, with the attachments of the bag, or an end to the recording process."""
        try:
            deliver(self._pipe.fileno(), content, attachments)
        except OSError:  # it has ended, and has said why
            self._reply()

    def _reply(self) -> None:
        """Read the answer of the recording process; a failure becomes `error`."""
        if self.error is not None:
            return
        line = self._replies.readline()
        died = (
            f'recording to {self.directory} failed: the recording process died; `mbd recover {self.directory} NEW` '
            'saves what was written'
        )
        sentence = json.loads(line) if line else died
        if sentence:
            self._queue.clear()
            self.error = BagError(sentence)
            self._end()

    def _end(self) -> None:
        with suppress(OSError):  # what is still in the buffer has no reader any more
            self._pipe.close()
        self._process.wait()
        self._replies.close()


class StepRecorder(Recorder):
    """Records the steps of a simulation: messages at the instants it is given, and the inputs of every step between
    them.

    inputs: their names. first: the step it begins behind.
    """

    def __init__(
        self,
        directory: str | Path,
        topics: Sequence[Topic],
        inputs: Sequence[str],
        first: int,
        metadata: Mapping[str, str],
        *,
        namespace: str = '',
        wait: bool = True,
    ) -> None:
        self._applied = Applied(inputs, first)
        super().__init__(directory, (*topics, INPUTS), metadata, namespace=namespace, wait=wait)

    def note(self, last: int, rows: np.ndarray) -> None:
        """The inputs (n, nu) of the n steps that led to step `last`, none of which has been recorded yet."""
        self._applied.add(last, rows)

    def record(self, t_ns: int, messages: Sequence[bytes | None]) -> None:
        """Queue the messages of an instant and the inputs noted since the last. Raises BagError after a failure."""
        if self.write(t_ns, [*messages, self._applied.message()]):
            self._applied.taken()


def enlarge(pipe: int) -> None:
    """Let a pipe hold PIPE_BYTES, so that a delivery does not wait for the reader. Without effect where the system does
    not permit it."""
    try:
        import fcntl

        fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
    except (ImportError, AttributeError, OSError):
        return
