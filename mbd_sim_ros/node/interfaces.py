"""Services and the action of simulation_interfaces 2.1, where that package is installed
(github.com/ros-simulation/simulation_interfaces).

They do what the services of type std_srvs/Trigger do, which are there in any case. Entities are the bodies of the
model, by their names; the chassis can be placed. A world is a scene, by name or file. Types that an older version lacks
are left out, and the log says which.
"""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from rclpy.node import Node

from mbd_sim_ros.node.running import Running
from mbd_sim_ros.node.services import REPLY_SECONDS, Host, asked, beside, made, pause, resume, tell
from solver.errors import MbdError
from solver.model.frames import matrix

PACKAGE = 'simulation_interfaces'
UNSUPPORTED, OK, NOT_FOUND, INCORRECT_STATE, FAILED = range(5)  # Result
# further ones of SetSimulationState, SetEntityState, LoadWorld
ALREADY, INVALID_POSE, NO_RESOURCE, PARSE_ERROR = 101, 101, 102, 103
STOPPED, PLAYING, PAUSED, QUITTING = range(4)  # SimulationState
SCOPE_TIME, SCOPE_STATE, SCOPE_ALL = 1, 2, 255  # ResetSimulation
OFFERED = {
    'GetSimulatorFeatures': 'what of the following there is',
    'GetSimulationState': 'stopped, playing or paused',
    'SetSimulationState': 'stop: pause and reset; play, pause, quit',
    'ResetSimulation': 'time, state or both; nothing is ever spawned',
    'StepSimulation': 'so many steps while paused, answered when they are made',
    'SimulateSteps': 'the same as an action, with feedback after each step, and to be cancelled',
    'GetEntities': 'the bodies of the model, by a regular expression for their names',
    'GetEntityState': 'pose and twist of a body in `odom`; accelerations are NaN',
    'SetEntityState': 'place the chassis, as `initialpose` does',
    'LoadWorld': '`uri`: name or file of another scene; it stands at its start, stopped',
}
FEATURES = {
    'GetEntityState': (10,),
    'SetEntityState': (11,),
    'ResetSimulation': (20, 21, 22),
    'GetSimulationState': (24,),
    'SetSimulationState': (25, 26),
    'StepSimulation': (31, 32),
    'SimulateSteps': (33,),
    'LoadWorld': (40,),
}


class Interfaces:
    """Offers what there is of the package on a node."""

    def __init__(self, node: Node, host: Host) -> None:
        self.node, self.host = node, host
        self.offered: list[str] = []
        try:
            importlib.import_module(f'{PACKAGE}.srv')
        except ImportError:
            return
        calls: dict[str, Callable[[Any, Any], Any]] = {
            'GetSimulatorFeatures': self._features,
            'GetSimulationState': self._get_state,
            'SetSimulationState': self._set_state,
            'ResetSimulation': self._reset,
            'StepSimulation': self._step,
            'GetEntities': self._entities,
            'GetEntityState': self._get_entity,
            'SetEntityState': self._set_entity,
            'LoadWorld': self._load,
        }
        missing = []
        for name, call in calls.items():
            kind = getattr(importlib.import_module(f'{PACKAGE}.srv'), name, None)
            if kind is None:
                missing.append(name)
                continue
            node.create_service(
                kind, f'~/{snake(name)}', call, callback_group=beside() if name == 'StepSimulation' else None
            )
            self.offered.append(name)
        try:
            from rclpy.action import ActionServer

            action = importlib.import_module(f'{PACKAGE}.action').SimulateSteps
            self._server = ActionServer(
                node, action, '~/simulate_steps', self._simulate, cancel_callback=lambda _: _accept_cancel()
            )
            self._action = action
            self.offered.append('SimulateSteps')
        except (ImportError, AttributeError):
            missing.append('SimulateSteps')
        if missing:
            node.get_logger().info(f'{PACKAGE} lacks {", ".join(missing)}: left out')

    @property
    def _running(self) -> Running:
        return self.host.running

    def _features(self, _: Any, response: Any) -> Any:
        response.features.features = sorted(number for name in self.offered for number in FEATURES.get(name, ()))
        response.features.custom_info = (
            'mbd_sim_ros: entities are the bodies of the model; accelerations are NaN; see docs/ros.md'
        )
        return response

    def _state(self) -> int:
        if self.host.stopped:
            return STOPPED
        return PAUSED if self._running.loop.paused else PLAYING

    def _get_state(self, _: Any, response: Any) -> Any:
        response.state.state = self._state()
        response.result.result = OK
        return response

    def _set_state(self, request: Any, response: Any) -> Any:
        wanted, result = request.state.state, response.result
        if wanted == self._state() and not self._running.loop.stepping:  # either ends steps that were asked for
            return _answer(response, result, ALREADY, 'already in this state')
        if wanted == QUITTING:
            self._running.loop.finish('asked to quit')
            return _answer(response, result, OK)
        if wanted not in (STOPPED, PLAYING, PAUSED):
            return _answer(response, result, UNSUPPORTED, f'state {wanted} cannot be set')
        done, text = asked(self._running, {STOPPED: _stop, PLAYING: resume, PAUSED: pause}[wanted])
        if done:
            self.host.stopped = wanted == STOPPED
        return self._said('set_simulation_state', response, result, done, text)

    def _reset(self, request: Any, response: Any) -> Any:
        scope = request.scope or SCOPE_ALL
        both = bool(scope & SCOPE_TIME), bool(scope & SCOPE_STATE)
        if not any(both):
            return _answer(
                response, response.result, UNSUPPORTED, 'nothing is ever spawned: give SCOPE_TIME, SCOPE_STATE or both'
            )
        done, text = asked(self._running, lambda running: running.reset(time=both[0], state=both[1]))
        return self._said('reset_simulation', response, response.result, done, text)

    async def _step(self, request: Any, response: Any) -> Any:
        done, text = await self._steps(request.steps, lambda k: None)
        return self._said('step_simulation', response, response.result, done, text)

    async def _simulate(self, goal: Any) -> Any:
        wanted, result = goal.request.steps, self._action.Result()

        def tell(completed: int) -> bool:
            feedback = self._action.Feedback(completed_steps=completed, remaining_steps=wanted - completed)
            goal.publish_feedback(feedback)
            return goal.is_cancel_requested

        done, text = await self._steps(wanted, tell, one_by_one=True)
        if goal.is_cancel_requested:
            goal.canceled()
        elif done:
            goal.succeed()
        else:
            goal.abort()
        return self._said('simulate_steps', result, result.result, done, text)

    async def _steps(
        self, count: int, tell: Callable[[int], bool | None], *, one_by_one: bool = False
    ) -> tuple[bool, str]:
        """Make steps while paused; tell(number so far) after each, or after all, and stop where it says so."""
        running = self._running
        if not running.loop.paused:
            return False, 'the simulation is not paused: pause it first'
        self.host.stopped = False
        completed = 0
        while completed < count:
            if not running.loop.paused:
                return False, f'{completed} of {count} steps: the simulation is running again'
            portion = 1 if one_by_one else count
            dropped = running.loop.dropped
            done, text = asked(running, partial(_make, portion))
            if not done:
                return False, text
            ended = await made(self.node, self.host, running)
            if ended:
                return False, ended
            lost = running.loop.dropped - dropped
            completed += portion - min(lost, portion)
            if lost:
                return (
                    False,
                    f'{completed} of {count} steps: the others were dropped by a pause, a resumption or a reset',
                )
            if tell(completed):
                break
        return True, f'{completed} steps, at t = {running.simulation.t_ns * 1e-9:.6f} s'

    def _entities(self, request: Any, response: Any) -> Any:
        filters = request.filters
        if filters.categories or filters.tags.tags or filters.bounds.type:
            return _answer(
                response, response.result, UNSUPPORTED, 'entities have names only: no categories, tags or bounds'
            )
        try:
            pattern = re.compile(filters.filter)
        except re.error as error:
            return _answer(
                response, response.result, FAILED, f'filter {filters.filter!r} is no regular expression: {error}'
            )
        response.entities = [name for name in self._running.simulation.channels.bodies if pattern.search(name)]
        return _answer(response, response.result, OK)

    def _get_entity(self, request: Any, response: Any) -> Any:
        bodies = self._running.simulation.channels.bodies
        if request.entity not in bodies:
            return _answer(response, response.result, NOT_FOUND, f'no body {request.entity!r}; see get_entities')
        try:
            now = self._running.loop.ask(self._running.simulation.snapshot).result(REPLY_SECONDS)
        except (RuntimeError, TimeoutError) as error:  # it has ended
            return _answer(response, response.result, FAILED, str(error))
        body = bodies.index(request.entity)
        pose, twist, state = now.pose[body], now.twist[body], response.state
        R = matrix(tuple(pose[3:]))
        state.header.frame_id = self._running.value('frame_prefix') + 'odom'
        state.header.stamp.sec, state.header.stamp.nanosec = divmod(now.t_ns, 1_000_000_000)
        _fill(state.pose.position, 'xyz', pose[:3])
        _fill(state.pose.orientation, 'xyzw', pose[3:])
        _fill(state.twist.linear, 'xyz', R @ twist[:3])
        _fill(state.twist.angular, 'xyz', R @ twist[3:])
        for part in (state.acceleration.linear, state.acceleration.angular):
            _fill(part, 'xyz', np.full(3, math.nan))  # nobody has them
        return _answer(response, response.result, OK)

    def _set_entity(self, request: Any, response: Any) -> Any:
        channels, result, pose = self._running.simulation.channels, response.result, request.state.pose
        chassis = None if channels.chassis is None else channels.bodies[channels.chassis]
        if request.entity not in channels.bodies:
            return _answer(response, result, NOT_FOUND, f'no body {request.entity!r}; see get_entities')
        if request.entity != chassis or request.set_twist or request.set_acceleration or not request.set_pose:
            return _answer(response, result, UNSUPPORTED, f'only the pose of the chassis ({chassis}) can be set')
        q = pose.orientation
        frame = request.state.header.frame_id
        frame = '' if frame == 'world' else frame  # their name of the one that is meant where none is given
        done, text = asked(
            self._running, lambda running: running.place(pose.position.x, pose.position.y, (q.x, q.y, q.z, q.w), frame)
        )
        return self._said('set_entity_state', response, result, done, text, refused=INVALID_POSE)

    def _load(self, request: Any, response: Any) -> Any:
        name = request.world_resource.uri
        if not name:
            return _answer(response, response.result, NO_RESOURCE, 'uri is empty: give the name or the file of a scene')
        try:
            text = self.host.load(name, [])
        except MbdError as error:
            return self._said('load_world', response, response.result, False, str(error), refused=PARSE_ERROR)
        response.world.name = self._running.scene.name
        response.world.world_resource.uri = name
        return self._said('load_world', response, response.result, True, text)

    def _said(self, name: str, response: Any, result: Any, done: bool, text: str, *, refused: int = FAILED) -> Any:
        tell(self.node, name, done, text)
        return _answer(response, result, OK if done else refused, '' if done else text)


def _accept_cancel() -> Any:
    from rclpy.action import CancelResponse

    return CancelResponse.ACCEPT


def _make(count: int, running: Running) -> str:
    running.loop.step(count)
    return f'{count} steps'


def _stop(running: Running) -> str:
    running.loop.pause()
    running.reset()
    return 'stopped, back at t = 0'


def _answer(response: Any, result: Any, code: int, text: str = '') -> Any:
    result.result, result.error_message = code, text
    return response


def _fill(message: Any, names: str, values: np.ndarray) -> None:
    for name, value in zip(names, values.tolist(), strict=True):
        setattr(message, name, value)


def snake(name: str) -> str:
    """GetEntityState -> get_entity_state."""
    return re.sub(r'(?<!^)(?=[A-Z])', '_', name).lower()
