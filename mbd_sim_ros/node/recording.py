"""The recordings of a node: one after the other, each from the state in which it begins to its verdict."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rclpy.node import Node

from mbd_sim_ros.bags.applied import begin_of
from mbd_sim_ros.bags.recorder import StepRecorder, about, describe, new_directory
from mbd_sim_ros.messages.encode import Messages
from mbd_sim_ros.node.diagnostics import judged
from mbd_sim_ros.node.loop import Loop
from mbd_sim_ros.node.parameters import PARAMETERS
from solver.analysis.envelope import Envelope
from solver.analysis.reactions import undetermined
from solver.analysis.verdict import report, status_of
from solver.errors import BagError
from solver.findings import Finding
from solver.output.snapshot import Snapshot
from solver.scene import Scene
from solver.simulation import Simulation


class Recording:
    """Records the steps of a simulation while `recorder` is there.

    failed: why a recording that is wanted is not there now (None: nothing is wrong). first_failure: the first of these,
    which stays: what it should hold is not recorded, whatever came afterwards.
    """

    def __init__(self, node: Node, scene: Scene, simulation, messages: Messages, envelope: Envelope, urdf: str) -> None:
        self.recorder: StepRecorder | None = None
        self.failed: BagError | None = None
        self.first_failure: BagError | None = None
        self._node, self._scene, self._simulation = node, scene, simulation
        self._messages, self._envelope, self._urdf = messages, envelope, urdf
        self._every = scene.record.every
        self._written = -1  # step whose messages were recorded last

    def begin(self, out: str = '') -> Path:
        """Begin with the state of now; for the simulation thread, or before there is one. Raises BagError, which
        `failed` is then."""
        try:
            self.recorder = self._new_recorder(out)
        except BagError as error:
            self._fail(error)
            raise
        self.failed = None
        self._node.get_logger().info(f'recording into {self.recorder.directory}')
        return self.recorder.directory

    def _new_recorder(self, out: str) -> StepRecorder:
        node, simulation = self._node, self._simulation
        directory = Path(out) if out else new_directory(self._scene.name)
        metadata = describe(
            scene=self._scene.name,
            resolved_yaml=self._scene.resolved,
            seed=self._scene.seed,
            parameters={name: node.get_parameter(name).value for name in PARAMETERS if name != 'robot_description'},
            namespace=node.get_namespace(),
            robot_description=self._urdf,
        )
        metadata |= about(simulation, reactions=self._scene.record.reactions) | begin_of(simulation)
        return StepRecorder(
            directory, self._messages.topics, simulation.channels.inputs, simulation.k, metadata,
            namespace=node.get_namespace(), wait=False,
        )  # fmt: skip

    def _fail(self, error: BagError) -> None:
        """The simulation goes on; diagnostics and exit code tell."""
        self.failed, self.first_failure = error, self.first_failure or error

    @property
    def periods(self) -> tuple[int, ...]:
        """The messages of a step are recorded whose number is a multiple of one of these."""
        return () if self.recorder is None else (self._every,)

    def note(self, last: int, inputs: np.ndarray) -> None:
        """Note the inputs (n, nu) of the n steps that led to step `last`: those of every step, or the run could not be
        replayed."""
        if self.recorder is not None:
            self.recorder.note(last, inputs)

    def take(self, snapshot: Snapshot, messages: Sequence[bytes | None] | None = None) -> None:
        """Record the messages of a step."""
        assert self.recorder is not None
        self._written = snapshot.k
        try:
            self.recorder.record(snapshot.t_ns, messages or self._messages.encode(snapshot))
        except BagError as error:
            self._node.get_logger().error(str(error))
            self._fail(error)
            self.recorder = None

    def take_last(self, last: Snapshot | None = None) -> None:
        """Record the last state, unless that is done; None: it is the present one."""
        last = last or self._simulation.snapshot()
        if self.recorder is not None and self._written != last.k:
            self.take(last)

    def found(self) -> list[Finding]:
        """Findings on the run if it ends here."""
        return judged(self._simulation, self._envelope, ended=True)

    def end(
        self, loop: Loop, outcome: str, found: list[Finding] | None = None, last: Snapshot | None = None
    ) -> Path | None:
        """Finish the recording; returns its directory, or None where there is none. Raises BagError, which `failed` is
        then.

        loop: its figures stand in the verdict. found, last: what made the recording suspect, and its last state, where
        the simulation is elsewhere by now. That state is recorded whatever its step, or the inputs of the steps behind
        the last instant of record.every would be lost.
        """
        recorder = self.recorder
        if recorder is None:
            return None
        if loop.error is None:
            self.take_last(last)
        self.recorder = None
        figures = {
            'steps': loop.steps,
            'overruns': loop.overruns,
            'schedule_slips': loop.slips,
            'wall_time': f'{loop.wall_time:.3f}',
        }
        events = json.dumps([event._asdict() for event in self._simulation.events])
        found = self.found() if found is None else found
        verdict = {
            'end': outcome,
            'status': status_of(found, failed=bool(loop.error)),
            'findings': json.dumps(report(found)),
        }
        if isinstance(self._simulation, Simulation) and (told := undetermined(self._simulation)):
            verdict['reactions_text'] = told
        try:
            return recorder.close(
                {**verdict, **{key: str(value) for key, value in figures.items()}, 'event_list': events}
            )
        except BagError as error:
            self._fail(error)
            raise
