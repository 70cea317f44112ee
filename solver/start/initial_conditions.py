"""The start of a scene: assembly, static equilibrium, velocities; what is particular to vehicles is in solver.start.rolling."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.portable import product
from solver.compiled.so3 import matrix_of_quaternion
from solver.elements.coupler import CouplerSpec
from solver.elements.registry import FORCES
from solver.model.evaluate import prepare
from solver.model.state import State, kinematics_of, update_angles
from solver.model.tables import Model
from solver.scene import Scene
from solver.start.newton import ConsistentState
from solver.start.rolling import held_body, roll_wheels, settle_rolling
from solver.step.work import Scheme, StepResult


class InitialConditions:
    """Finds the start of a scene for a simulation, in the first of its two state buffers.

    inputs (nu,) are those at the start; work is scratch; explain makes a sentence of a step that failed.
    """

    def __init__(
        self,
        scene: Scene,
        model: Model,
        states: list[Ref],
        method: Scheme,
        inputs: np.ndarray,
        *,
        chassis: int,
        work: Ref,
        explain: Callable[[StepResult], str],
    ) -> None:
        self.scene, self.model, self.states, self.method, self.inputs = scene, model, states, method, inputs
        self.chassis, self.work, self.explain = chassis, work, explain

    @property
    def state(self) -> State:
        """The state that becomes the start."""
        return cast(State, self.states[0].value)

    def find(self) -> None:
        """Assign the start of the scene to the state. Raises ConsistencyError."""
        start, u, method = self.scene.start, self.inputs, self.method
        calculation = ConsistentState(self.model)
        state = self.state
        update_angles(Ref(self.model.tables.coordinates), kinematics_of(state.q, state.v), state.angle)
        values = {n: c.value for n, c in start.coordinates.items() if c.value is not None}
        rates = {n: c.rate for n, c in start.coordinates.items() if c.rate is not None}
        if start.kind != 'as_placed' or values:
            self._with_rows(list(values), list(values.values())).assemble(state, u)
        if start.kind == 'equilibrium':
            calculation.equilibrium(state, self._without_loads(u), hold=held_body(self.model, self.chassis, u))
        self._start_moving(start.speed, rates, u)
        if start.kind == 'equilibrium' and start.speed:
            settle_rolling(
                self.model, self.states, self.method, self.scene.integrator.rho_inf, start.speed, u, self.chassis, self.work, self.explain
            )
            calculation.project_velocity(self.state, u)
        calculation.start_integrator(self.state, u, method.h, method.am, method.af)

    def _start_moving(self, speed: float, rates: dict[str, float], u: np.ndarray) -> None:
        """Give the current configuration its start velocity: wanted rates, speed of the chassis [m/s], wheels rolling."""
        self._place_velocities(speed)
        wanted = rates | (roll_wheels(self.model, self.state, speed, u) if speed else {})
        extended = self._with_rows(list(wanted), [0.0] * len(wanted))
        extra = np.zeros(extended.model.n_rows)
        extra[self.model.n_rows :] = [-rate for rate in wanted.values()]
        extended.project_velocity(self.state, u, extra, hold=100.0 if speed else 0.0)

    def _without_loads(self, u: np.ndarray) -> np.ndarray:
        """Inputs with those that are loads zero: static equilibrium is sought under gravity, without drive torque."""
        rest = u.copy()
        for kind in FORCES:
            if kind.supplies:
                rest[self.model.inputs_of(kind.name)] = 0.0
        return rest

    def _with_rows(self, names: list[str], offsets: list[float]) -> ConsistentState:
        """The start calculation of the model with extra rows coordinate = offset."""
        if not names:
            return ConsistentState(self.model)
        spec = self.model.spec
        rows = tuple(CouplerSpec(name=f'start of {n}', terms=((n, 1.0),), offset=o) for n, o in zip(names, offsets, strict=True))
        model = prepare(type(spec)(**{**spec.__dict__, 'couplers': spec.couplers + rows}))
        return ConsistentState(model)

    def _place_velocities(self, speed: float) -> None:
        """Velocities of the specification, plus a translation of everything along the chassis x axis."""
        v = self.state.v
        R = np.array(matrix_of_quaternion(tuple(self.state.q[self.chassis, 3:]))).reshape(3, 3)
        for b, body in enumerate(self.model.spec.bodies):
            R_b = np.array(matrix_of_quaternion(tuple(self.state.q[b, 3:]))).reshape(3, 3)
            w = np.array(body.angular_velocity)
            v[b, :3] = np.array(body.velocity) + product(R_b, np.cross(w, body.com)) + speed * R[:, 0]
            v[b, 3:] = w
