"""A simulation that is driven from a page: paced by the clock, recorded as every run is.

Keys enter between steps, and the inputs of every step are recorded by its number: how fast pages and machine were, no
replay needs to know. The simulation waits for nobody who looks.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from mbd_sim_ros.analysis.view.motion import RecordedMotion
from mbd_sim_ros.bags.recorder import new_directory
from mbd_sim_ros.batch import record
from mbd_sim_ros.drive.frame import Around, Head, filled_page, page_data, picture
from mbd_sim_ros.drive.hands import NOTHING, Hands, Held, in_force
from mbd_sim_ros.messages.encode import require_finite
from mbd_sim_ros.node.driving import Driving
from mbd_sim_ros.node.latch import Latch, Latched
from mbd_sim_ros.node.loop import Loop
from mbd_sim_ros.node.pace import Pace
from mbd_sim_ros.node.periods import before_next, due
from solver.analysis.certificate_coverage import weighed
from solver.analysis.envelope import Envelope
from solver.analysis.verdict import report, status_of
from solver.errors import BagError
from solver.output.snapshot import TIRE_COLUMNS, Snapshot
from solver.simulation import Simulation

RATE = 60.0  # Hz of pictures; ten times as many no screen shows
AT_ONCE = 0.004  # s of steps that are made together: keys wait for no longer
JUDGED = 0.4  # s over which it is judged how real time is kept
FORCE, CONTACT = TIRE_COLUMNS.index('fx'), slice(len(TIRE_COLUMNS) - 7, None)
PARAMETERS: dict[str, Any] = {
    'commands': 'topics', 'restore': '', 'steering_bandwidth': 5.0, 'steering_rate_limit': 40.0,
}  # fmt: skip  # of node.driving; hands are slower than its limit


class Session:
    """A scene that is driven. hands: of the one who drives. out: directory of the recordings, one a run (None: below
    bags); recording: whether there are any. ghost: an earlier run. duration: s of simulated time, 0 for no end. rate:
    simulated per elapsed time.

    show(bytes): takes a picture. Raises MbdError.
    """

    def __init__(
        self,
        simulation: Simulation,
        names: tuple[str, ...],
        hands: Hands,
        *,
        title: str,
        out: Path | None = None,
        recording: bool = True,
        ghost: RecordedMotion | None = None,
        duration: float = 0.0,
        rate: float = 1.0,
    ) -> None:
        self.simulation, self.hands = simulation, hands
        self.show: Callable[[bytes], None] = lambda picture: None
        self.runs: list[Path] = []
        self.run, self.failed = 1, ''
        self.unrecorded = 0  # instants that a slow disk left no time for; the inputs of their steps are recorded
        self.verdict: dict[str, Any] = {}
        self._held: tuple[Held, float] | None = None  # what a page holds, and when it said so
        self._asked: dict[str, Future] = {}  # what pages asked for last, by name
        self._out, self._records = out, recording
        self._begun = False  # somebody has started to drive
        self._drawing, self._page = page_data(simulation.scene, title, hands.seat.lock, ghost)
        self._around = Around(simulation.scene.model.road)
        self._place = (0.0, 0.0)  # where the car is [m]
        channels = simulation.channels
        self._order = [channels.bodies.index(name) for name in self._drawing.bodies]
        self.latch = Latch(simulation, Pace(rate_factor=rate), names)
        self.driving = Driving(simulation.scene, simulation, self.latch, PARAMETERS.__getitem__)
        self.envelope = Envelope(simulation)
        self._every = max(1, math.floor(rate / (RATE * simulation.h)))
        self._at_once = max(0, round(AT_ONCE * rate / simulation.h) - 1)
        self._record_every = simulation.scene.record.every if recording else 0
        self._moved, self._number, self._speed = simulation.k, 0, 0.0  # of the hands; of the keys in force; m/s
        # when and in which run it was asked how real time is kept, and the answer
        self._judged, self._judged_run, self._kept = 0.0, 0, 1.0
        self._written = -1  # step that was recorded last
        self._writing: Any = None
        self._begin_recording()
        self.loop = Loop(
            simulation, self.latch, inputs=self.driving.inputs, emit=self._emit, poll=self._poll, hidden=self._hidden,
            passed=self._passed, repeat=self._repeat, end_ns=round(duration * 1e9) if duration else None,
        )  # fmt: skip
        self.driving.hold()
        self._set(hands.advance(NOTHING, 0.0, 0.0))
        self.loop.paused = True  # until somebody drives

    # -- for pages, on their thread -----------------------------------------------------------------------------------

    def page(self) -> str:
        """The page as HTML."""
        return filled_page(self._page)

    def hold(self, held: Held | None) -> None:
        """Take what is held at the wheel."""
        self._held = None if held is None else (held, time.monotonic())
        if not self._begun and held is not None and (held.gas or held.brake or held.left or held.right):
            self._begun = True
            self._ask('resume', self.loop.resume)

    def act(self, action: str, value: int) -> None:
        """Pause, resume, reset, or move the lever."""
        self._begun = self._begun or action == 'resume'
        actions = {'pause': self.loop.pause, 'resume': self.loop.resume, 'reset': self._reset}
        self._ask(action, actions.get(action) or (lambda: self.hands.shift(value)))

    def _ask(self, name: str, action: Callable[[], Any]) -> None:
        """Have something done between two steps, unless the same is still to be done."""
        before = self._asked.get(name)
        if before is None or before.done():
            future = self._asked[name] = self.loop.ask(action)
            future.add_done_callback(self._note_failure)

    def _note_failure(self, done: Future) -> None:
        if (error := done.exception()) is not None and not self.loop.done.is_set():
            self.failed = str(error)

    def status(self) -> dict[str, Any]:
        """Account of how it goes, for pages."""
        now = time.monotonic()
        if now - self._judged > JUDGED:
            rate = self.loop.health().rate / self.latch.pace.rate_factor
            self._kept = rate if self.run == self._judged_run else 1.0  # a reset takes time, and none passes
            self._judged, self._judged_run = now, self.run
        return {
            'rate': 1.0 if self.loop.paused else self._kept,
            'paused': self.loop.paused,
            'begun': self._begun,
            'run': self.run,
            'gears': [*self.hands.seat.levers, self.hands.seat.gears is None or self.hands.seat.automatic],
            'recording': str(self.runs[-1]) if self.runs and not self.failed else '',
            'notice': self.loop.outcome if self.loop.done.is_set() else self.failed,
        }

    def ground(self) -> str:
        """The road around, for pages."""
        return self._around.at(*self._place)

    # -- on the thread of the simulation ------------------------------------------------------------------------------

    def _poll(self) -> None:
        """Move hands and feet up to now."""
        simulation = self.simulation
        held = in_force(self._held)
        h = (simulation.k - self._moved) * simulation.h
        self._moved = simulation.k
        self._number = held.number
        self._set(self.hands.advance(held, self._speed, h))

    def _set(self, commands: Mapping[str, float]) -> None:
        newest = self.latch.newest
        values = tuple([commands.get(name, old) for name, old in zip(self.latch.commands, newest.values, strict=True)])
        if values != newest.values:
            now = self.simulation.t_ns
            self.latch.newest = Latched(values, (now,) * len(values), tuple([count + 1 for count in newest.counts]))

    def _hidden(self, most: int) -> int:
        if self.driving.assistant is not None:
            return 0
        periods = (self._every, self._record_every) if self._writing is not None else (self._every,)
        return before_next(self.simulation.k, min(most, self._at_once), periods)

    def _passed(self) -> None:
        applied = self.simulation.applied
        if self._writing is not None and applied is not None:
            self._writing[1].note(self.simulation.k, applied)

    def _emit(self, snapshot: Snapshot) -> None:
        self.envelope.look(snapshot)
        chassis = self.simulation.channels.chassis
        assert chassis is not None
        self._speed = float(snapshot.twist[chassis, 0])
        if self._writing is not None and due(snapshot.k, (self._record_every,)):
            self._record(snapshot)
        else:
            require_finite(snapshot, self.simulation.channels)
        if due(snapshot.k, (self._every,)):
            self._draw(snapshot)

    def _repeat(self) -> None:
        self._draw(self.simulation.snapshot())

    def _draw(self, snapshot: Snapshot) -> None:
        inputs = dict(zip(self.simulation.channels.inputs, snapshot.inputs.tolist(), strict=True))
        pedals, imu = self.hands.pedals, snapshot.imu
        head = Head(
            t=snapshot.t_ns * 1e-9, number=self._number, paused=float(self.loop.paused), speed=self._speed,
            ax=float(imu[0]), ay=float(imu[1]), yaw_rate=float(imu[5]), steering=inputs.get('steering', 0.0),
            gas=pedals['gas'], brake=pedals['brake'], hand=pedals['hand'],
            gear=inputs.get('gear', float(self.hands.gear)),
        )  # fmt: skip
        tire = snapshot.tire
        x, y = snapshot.pose[self.simulation.channels.chassis, :2].tolist()
        self._place = (x, y)
        self.show(picture(head, snapshot.pose[self._order], tire[:, CONTACT], tire[:, FORCE : FORCE + 3]))

    def _begin_recording(self) -> None:
        """Begin the recording of a run. Raises BagError."""
        if not self._records:
            return
        out = self._out
        if out is not None and self.run > 1:
            out = out.with_name(f'{out.name}-{self.run}')
        directory = out or new_directory(self.simulation.scene.name)
        self._writing = record(
            self.simulation, directory, parameters={'rate_factor': self.latch.pace.rate_factor}, wait=False
        )
        self.runs.append(directory)
        self._written = -1
        if self.simulation.k == 0:
            self._record(self.simulation.snapshot())

    def _record(self, snapshot: Snapshot) -> None:
        messages, recorder = self._writing
        self._written = snapshot.k
        try:
            recorder.record(snapshot.t_ns, messages.encode(snapshot))
        except BagError as error:  # the drive goes on, and its end tells
            self.failed, self._writing = str(error), None

    def _end_recording(self, outcome: str) -> None:
        """Finish the recording with its verdict."""
        simulation, loop = self.simulation, self.loop
        found = weighed(simulation, self.envelope, ended=True).suspect
        self.verdict = {'status': status_of(found, failed=bool(loop.error)), 'findings': report(found)}
        if self._writing is None:
            return
        if loop.error is None and self._written != simulation.k:
            self._record(simulation.snapshot())
        if self._writing is None:
            return
        recorder, self._writing = self._writing[1], None
        self.unrecorded += recorder.dropped
        figures = {
            'steps': loop.steps, 'overruns': loop.overruns, 'schedule_slips': loop.slips,
            'wall_time': f'{loop.wall_time:.3f}',
        }  # fmt: skip
        events = json.dumps([event._asdict() for event in simulation.events])
        verdict = {'end': outcome, 'status': self.verdict['status'], 'findings': json.dumps(self.verdict['findings'])}
        try:
            recorder.close({**verdict, **{key: str(value) for key, value in figures.items()}, 'event_list': events})
        except BagError as error:
            self.failed = str(error)

    def _reset(self) -> None:
        """Back to the start, bit for bit; the recording goes on in a new directory."""
        simulation = self.simulation
        if simulation.k == 0:
            return
        self._end_recording('reset')
        simulation.reset()
        self.run += 1
        self.driving.begin_anew()
        self.hands.begin()
        self.envelope.restart()
        self._speed, self._moved = 0.0, 0
        try:
            self._begin_recording()
        except BagError as error:
            self.failed = str(error)
        self.driving.go_on(moving=False)
        self.loop.restart()
        self.driving.hold()
        self._set(self.hands.advance(NOTHING, 0.0, 0.0))

    # -- on the main thread -------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the thread of the simulation."""
        self.loop.start()

    def close(self, outcome: str) -> None:
        """End the thread and finish the recording. Raises what ended the simulation."""
        self.loop.stop(outcome)
        self._end_recording(self.loop.outcome)
        if isinstance(self.loop.error, Exception):
            raise self.loop.error
