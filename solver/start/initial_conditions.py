"""The start of a scene: assembly, static equilibrium, velocities; what is particular to vehicles is in
solver.start.rolling."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import cast

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.portable import product
from solver.compiled.so3 import matrix_of_quaternion
from solver.elements.coupler import CouplerSpec
from solver.elements.registry import FORCES
from solver.elements.tire_limits import oddest
from solver.errors import ConsistencyError
from solver.model.evaluate import constraint_input_rates, prepare
from solver.model.state import State, copy_state, kinematics_of, new_state, update_angles
from solver.model.tables import Model
from solver.scene import StartSettings
from solver.start.equilibrium import Equilibrium
from solver.start.newton import ConsistentState
from solver.start.obstacle import edge_at_wheels
from solver.start.placement import (
    Changes,
    changes,
    refuse_flat_discs,
    refuse_links_without_length,
    refuse_open_joints,
    refuse_overturned,
    refuse_points_without_distance,
    refuse_turned_over,
    refuse_undirected,
    refuse_unloaded_wheels,
)
from solver.start.reach import beyond_reach
from solver.start.rolling import SETTLE_EVERY, held_body, lay_on_road, roll_wheels, settle_rolling, without_brakes
from solver.step.work import Scheme, StepResult
from solver.vehicle.size import size_of

# s: what dampers dissipate in this time counts as much as kinetic energy (ConsistentState.project_velocity). Ten times
# as long moves the velocities at which the full car starts by 1e-6 rad/s of 230, a tenth of it by 1e-5.
HELD = 100.0
GRIP = 0.1  # friction of a road on which equilibrium is found from the placement on


class InitialConditions:
    """Finds the start of a scene for a simulation, in the first of its two state buffers.

    wanted: what the scene asks of its start. The search sees nothing else of a scene, for what it depends on is what a
    start is known by (solver.start.known).
    inputs (nu,) are those at the start; work is scratch; explain makes a sentence of a step that failed.
    """

    def __init__(
        self,
        wanted: StartSettings,
        model: Model,
        states: list[Ref],
        method: Scheme,
        inputs: np.ndarray,
        *,
        chassis: int,
        work: Ref,
        explain: Callable[[StepResult], str],
    ) -> None:
        self.wanted, self.model, self.states, self.method, self.inputs = wanted, model, states, method, inputs
        self.chassis, self.work, self.explain = chassis, work, explain
        # what find() found, before the integrator's part of it, which belongs to its step
        self.consistent = new_state(model)

    @property
    def state(self) -> State:
        """The state that becomes the start."""
        return cast(State, self.states[0].value)

    def find(self) -> Changes:
        """Assign the start of the scene to the state; returns what was changed of what is given. Raises
        ConsistencyError."""
        placed, speed = self.state.q.copy(), self.wanted.speed
        try:
            return dataclasses.replace(
                self._find(), obstacle=edge_at_wheels(self.model, self.state.q, self.chassis, 0.0)
            )
        except ConsistencyError as error:
            rolled = (
                abs(speed) * SETTLE_EVERY * size_of(self.model.spec).time if self.wanted.kind == 'equilibrium' else 0.0
            )
            edge = edge_at_wheels(self.model, placed, self.chassis, rolled)
            if not edge:
                odd = list(
                    dict.fromkeys(filter(None, (oddest(tire.data, tire.pressure) for tire in self.model.spec.tires)))
                )
                if not odd:
                    raise
                raise ConsistencyError(f'{error}; the tires are unusual, which may be why: {odd[0]}') from error
            raise ConsistencyError(f'start: {edge} ({str(error).removeprefix("start: ").partition(";")[0]})') from error

    def _find(self) -> Changes:
        """As find(), with the sentence of whatever fails."""
        start, u, method = self.wanted, self.inputs, self.method
        calculation = Equilibrium(self.model)
        state = self.state
        placed = state.q.copy()
        as_placed = new_state(self.model)
        update_angles(Ref(self.model.tables.coordinates), kinematics_of(state.q, state.v), state.angle)
        copy_state(state, as_placed)
        values = {n: c.value for n, c in start.coordinates.items() if c.value is not None}
        rates = {n: c.rate for n, c in start.coordinates.items() if c.rate is not None}
        if start.kind == 'equilibrium' and start.speed and rates:
            raise ConsistencyError(
                f'start.coordinates.{next(iter(rates))}.rate: has no effect: a vehicle that starts from its '
                'equilibrium at start.speed has settled, with rates of its own; remove it, or set start.kind: assemble'
            )
        refuse_points_without_distance(self.model, state)
        refuse_flat_discs(self.model, state)
        try:
            if start.kind == 'as_placed' and not values:
                refuse_open_joints(self.model, state, u)
            # what digits leave open the first step would close at once: by a force that grows as the step falls
            self._with_rows(list(values), list(values.values())).assemble(state, u)
        except ConsistencyError as error:
            why = beyond_reach(self.model, as_placed, u)
            if not why:
                raise
            raise ConsistencyError(f'start: {why}') from error
        refuse_turned_over(self.model, state)
        refuse_links_without_length(self.model, state)
        if start.kind == 'equilibrium':
            self._rest(calculation, state, self._without_loads(u))
        refuse_undirected(self.model, state, u)
        given = self._start_moving(start.speed, rates, u)
        if start.kind == 'equilibrium' and start.speed:
            self._settle(start.speed, u)
            refuse_overturned(self.model, self.state, self.chassis, start.speed)
            moves = self._moves(u)
            calculation.project_velocity(
                self.state, without_brakes(self.model, u) if moves else u, hold=HELD if moves else 0.0
            )
        changed = changes(self.model, start.kind, placed, given, self.state, wanted=bool(rates), speed=start.speed)
        copy_state(self.state, self.consistent)
        calculation.start_integrator(self.state, u, method.h, method.am, method.af)
        return changed

    def _settle(self, speed: float, u: np.ndarray) -> None:
        """Settle at a speed [m/s]; a drive that leaves nothing steady acts from the first step on."""
        coasting = self._without_loads(u)
        before = new_state(self.model)
        copy_state(self.state, before)
        settle = partial(settle_rolling, self.model, self.states, self.method, speed)
        driven = not np.array_equal(u, coasting)
        if not settle(u, self.chassis, self.work, self.explain, driven=driven):
            copy_state(before, self.state)
            settle(coasting, self.chassis, self.work, self.explain, driven=False)

    def _start_moving(self, speed: float, rates: dict[str, float], u: np.ndarray) -> np.ndarray:
        """Give the current configuration its start velocity: wanted rates, speed of the chassis [m/s], wheels rolling.

        Returns the velocities (nb + 1, 6) that were given.
        """
        self._place_velocities(speed)
        given = self.state.v.copy()
        wanted = rates | (roll_wheels(self.model, self.state, speed, u, rates) if speed else {})
        extended = self._with_rows(list(wanted), [0.0] * len(wanted))
        extra = np.zeros(extended.model.n_rows)
        extra[self.model.n_rows :] = [-rate for rate in wanted.values()]
        # brakes hold the wheels to their carriers, which do not turn with them
        held = speed or self._moves(u)
        extended.project_velocity(
            self.state, without_brakes(self.model, u) if held else u, extra, hold=HELD if held else 0.0
        )
        return given

    def _moves(self, u: np.ndarray) -> bool:
        """True where the inputs move a part of a vehicle at the start, as a steering wheel that turns already. Parts
        that hang on it by rubber, by shafts that twist, or by the guide of an axle then start in motion too: at rest
        they would be torn along in the first step, and vibrate."""
        rates = np.zeros(self.model.n_rows)
        constraint_input_rates(self.model.tables, u, rates, np.zeros_like(rates))
        return bool(self.model.spec.tires) and bool(rates.any())

    def _rest(self, calculation: Equilibrium, state: State, u: np.ndarray) -> None:
        """Static equilibrium, of a braked vehicle from where it rests with its brakes released: locked wheels that
        settle from the placement on roll with what carries them, and jack a car up that stands on a slope.
        """
        lay_on_road(self.model, state, self.chassis)
        held = held_body(self.model, self.chassis, u)
        if held is None and self.model.spec.tires:
            before = new_state(self.model)
            copy_state(state, before)
            try:
                calculation.equilibrium(state, without_brakes(self.model, u), hold=self.chassis)
            except ConsistencyError:  # far from rest only what is free to roll finds it
                copy_state(before, state)
        placed = new_state(self.model)
        copy_state(state, placed)
        try:
            calculation.equilibrium(state, u, hold=held, stable=self.wanted.stable)
        except ConsistencyError:
            rougher = self._rougher()
            if rougher is None:
                raise
            copy_state(placed, state)
            with suppress(ConsistencyError):
                rougher.equilibrium(state, u, hold=held)
            calculation.equilibrium(state, u, hold=held, stable=self.wanted.stable)
        refuse_unloaded_wheels(self.model, state, u)

    def _rougher(self) -> Equilibrium | None:
        """The model on a road of at least GRIP; None on a road that is. On ice tires slide from where they are placed
        to where they rest, and the search seldom ends; from where they rest with friction it is not far.
        """
        spec = self.model.spec
        road = spec.road
        patches = tuple(dataclasses.replace(patch, factor=max(patch.factor, GRIP)) for patch in road.patches)
        other = dataclasses.replace(road, friction=max(road.friction, GRIP), patches=patches)
        return None if other == road or not spec.tires else Equilibrium(prepare(dataclasses.replace(spec, road=other)))

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
        rows = tuple(
            CouplerSpec(name=f'start of {n}', terms=((n, 1.0),), offset=o) for n, o in zip(names, offsets, strict=True)
        )
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
