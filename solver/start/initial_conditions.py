"""The start of a scene: assembly, static equilibrium, velocities, and the settling of a vehicle that starts at speed."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.dense import product
from solver.compiled.so3 import matrix_of_quaternion
from solver.elements.coupler import CouplerSpec
from solver.elements.tire_pacejka import TIRE_COLUMNS, rolling_radius
from solver.errors import ConsistencyError
from solver.model.evaluate import Outputs, evaluate_forces, prepare
from solver.model.state import State, kinematics_of, update_angles
from solver.model.tables import Model
from solver.output.collect import FIRST_TIRE_COLUMN, new_outputs
from solver.scene import Scene
from solver.start.newton import Start
from solver.step.augmented_lagrangian import advance
from solver.step.work import OK, Coefficients, StepResult, coefficients

SETTLE_TIME = 5.0  # s, some ten periods of a suspension mode
SETTLE_EVERY = 0.05  # s
SETTLE_PENALTY = 1e6
SETTLE_STEP = 5e-3  # s, whatever the step of the scene, so that a start does not depend on it; where it settles does not depend on the step


class Beginning:
    """Finds the start of a scene for a simulation, in the first of its two state buffers.

    inputs (nu,) are those at the start; outputs and work are scratch; explain makes a sentence of a step that failed.
    """

    def __init__(
        self,
        scene: Scene,
        model: Model,
        states: list[Ref],
        method: Coefficients,
        inputs: np.ndarray,
        *,
        chassis: int,
        outputs: Outputs,
        work: Ref,
        explain: Callable[[StepResult], str],
    ) -> None:
        self.scene, self.model, self.states, self.method, self.inputs = scene, model, states, method, inputs
        self.chassis, self.outputs, self.work, self.explain = chassis, outputs, work, explain

    @property
    def state(self) -> State:
        """The state that becomes the start."""
        return cast(State, self.states[0].value)

    def find(self) -> None:
        """Assign the start of the scene to the state. Raises ConsistencyError."""
        start, u, method = self.scene.start, self.inputs, self.method
        calculation = Start(self.model, self.outputs)
        state = self.state
        update_angles(Ref(self.model.tables.coordinates), kinematics_of(state.q, state.v), state.angle)
        values = {n: c.value for n, c in start.coordinates.items() if c.value is not None}
        rates = {n: c.rate for n, c in start.coordinates.items() if c.rate is not None}
        if start.kind != 'as_placed' or values:
            self._with_rows(list(values), list(values.values())).assemble(state, u)
        if start.kind == 'equilibrium':
            calculation.equilibrium(state, self._without_loads(u))
        self._start_moving(start.speed, rates, u)
        if start.kind == 'equilibrium' and start.speed:
            self._settle_rolling(start.speed, u)
            calculation.project_velocity(self.state, u)
        calculation.start_integrator(self.state, u, method.h, method.am, method.af)

    def _start_moving(self, speed: float, rates: dict[str, float], u: np.ndarray) -> None:
        """Give the current configuration its start velocity: wanted rates, speed of the chassis [m/s], wheels rolling."""
        self._place_velocities(speed)
        wanted = rates | (self._roll_wheels(speed, u) if speed else {})
        extended = self._with_rows(list(wanted), [0.0] * len(wanted))
        extra = np.zeros(extended.model.n_rows)
        extra[self.model.n_rows :] = [-rate for rate in wanted.values()]
        extended.project_velocity(self.state, u, extra, hold=100.0 if speed else 0.0)

    def _settle_rolling(self, speed: float, u: np.ndarray) -> None:
        """Let a vehicle that starts at speed come to rest in its suspension, on the spot and at its speed.

        Rolling tires grow and stiffen, drag and drive torque act: a car that stands in equilibrium does not roll in it. It begins without
        accelerations, with the constraint forces of that equilibrium; what this disturbs dies away with the rest. Every SETTLE_EVERY
        seconds it is put back to its place and its speed.
        """
        scheme = coefficients(SETTLE_STEP, self.scene.integrator.rho_inf)
        # with settings of its own: every method of a comparison starts from the same state
        rows = self.model.n_rows
        own = {'penalty': np.full(rows, SETTLE_PENALTY), 'factor': np.ones(rows), 'm_alf': 0, 'weigh': 0, 'coupled': 0, 'full': 0}
        settling = Ref(self.method._replace(fixed=1, iterations=2, **own, **scheme))  # type: ignore[arg-type]
        steps = round(SETTLE_EVERY / SETTLE_STEP)
        inputs = np.repeat(u[None, :], steps, axis=0)
        chassis = self.chassis
        place = self.state.q[chassis, :2].copy()
        wheels = [self.model.body_names.index(tire.marker.body) for tire in self.model.spec.tires]
        for _ in range(round(SETTLE_TIME / SETTLE_EVERY)):
            result, done = advance(self.model.tables, settling, *self.states, inputs, 0, steps, False, self.work)
            if done % 2 == 1:
                self.states.reverse()
            if result.status != OK:
                raise ConsistencyError(f'start: the vehicle does not settle at {speed:g} m/s: {self.explain(result)}')
            q, v = self.state.q, self.state.v
            forward = np.array(matrix_of_quaternion(tuple(q[chassis, 3:]))).reshape(3, 3)[:, 0]
            now = float(product(v[chassis, :3], forward))
            q[:-1, :2] += place - q[chassis, :2]
            v[:-1, :3] += (speed - now) * forward
            for wheel in wheels:
                v[wheel, 3:] *= speed / now

    def _without_loads(self, u: np.ndarray) -> np.ndarray:
        """Inputs with those of coordinate and applied forces zero: static equilibrium is sought under gravity, without drive torque."""
        spec = self.scene.model
        loads = {f.input for f in spec.coordinate_forces} | {f.input for f in spec.applied_forces}
        return np.array([0.0 if name in loads else value for name, value in zip(spec.inputs, u, strict=True)])

    def _with_rows(self, names: list[str], offsets: list[float]) -> Start:
        """The start calculation of the model with extra rows coordinate = offset."""
        if not names:
            return Start(self.model, self.outputs)
        spec = self.model.spec
        rows = tuple(CouplerSpec(name=f'start of {n}', terms=((n, 1.0),), offset=o) for n, o in zip(names, offsets, strict=True))
        model = prepare(type(spec)(**{**spec.__dict__, 'couplers': spec.couplers + rows}))
        return Start(model, new_outputs(model))

    def _place_velocities(self, speed: float) -> None:
        """Velocities of the specification, plus a translation of everything along the chassis x axis."""
        v = self.state.v
        R = np.array(matrix_of_quaternion(tuple(self.state.q[self.chassis, 3:]))).reshape(3, 3)
        for b, body in enumerate(self.model.spec.bodies):
            R_b = np.array(matrix_of_quaternion(tuple(self.state.q[b, 3:]))).reshape(3, 3)
            w = np.array(body.angular_velocity)
            v[b, :3] = np.array(body.velocity) + product(R_b, np.cross(w, body.com)) + speed * R[:, 0]
            v[b, 3:] = w

    def _roll_wheels(self, speed: float, u: np.ndarray) -> dict[str, float]:
        """Let the wheels roll; returns the rates of the revolute coordinates that carry them."""
        kin = kinematics_of(self.state.q, self.state.v)
        evaluate_forces(
            self.model.tables,
            kin,
            self.state.angle,
            self.state.z,
            0.0,
            u,
            False,
            self.work.f,
            self.work.Kq,
            self.work.Kv,
            self.work.z_s,
            Ref(self.outputs),
        )
        rates = {}
        for e, tire in enumerate(self.model.spec.tires):
            load = self.outputs.tires[e, FIRST_TIRE_COLUMN + TIRE_COLUMNS.index('fz')]
            rate = speed / rolling_radius(self.model.tables.tires, e, load, speed)
            spin = np.array(matrix_of_quaternion(tire.marker.orientation)).reshape(3, 3)[:, 1]
            # the wheel itself has to turn before velocities are projected, or the projection would turn what carries it
            self.state.v[self.model.body_names.index(tire.marker.body), 3:] += rate * spin
            for joint in self.model.spec.joints:
                if joint.kind == 'revolute' and tire.marker.body in (joint.i.body, joint.j.body):
                    side = 1.0 if joint.j.body == tire.marker.body else -1.0
                    own = joint.j if side > 0 else joint.i
                    axis = np.array(matrix_of_quaternion(own.orientation)).reshape(3, 3)[:, 2]
                    rates[joint.name] = side * float(np.sign(product(axis, spin))) * rate
                    break
        return rates
