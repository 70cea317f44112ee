"""The engine of the level `single_track`.

The file is long because the engine, its tables and its start stand together; its steps are in track_step.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np

from solver.compiled.by_reference import Ref, nbytes
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.road import CurvedGrid, HeightGrid, RandomRoad, RasterGrid, compile_road, surface_at
from solver.elements.tread import give_of
from solver.engine import Kept, Moved, instant
from solver.engine.stepping import KINDS
from solver.errors import ConsistencyError, SpecError
from solver.files.urdf import robot_description
from solver.inputs.driver import Sight
from solver.inputs.driving import Driven
from solver.inputs.maneuver import ACCELERATION, RATE
from solver.levels.track_friction import LOOK, note, varies
from solver.levels.track_step import advance, advance_driven, advance_seen, start
from solver.levels.track_tables import (
    AXLE_COLUMNS,
    GIVE,
    LONG,
    REACHED,
    ROLL,
    SHIFT,
    SIZE,
    SPIN,
    TOLD,
    TURN_F,
    TURN_R,
    VX,
    VY,
    YAW,
    YAW_RATE,
    Body,
    Mounting,
    SingleTrackTables,
    SingleTrackWork,
    TrackAxle,
    X,
    Y,
)
from solver.model.evaluate import prepare
from solver.model.frames import matrix
from solver.model.state import fitting
from solver.output.account import Account, new_account, require_account
from solver.output.energy import show_energies
from solver.output.seen import Seen
from solver.output.snapshot import (
    ENERGIES,
    NO_STEPS,
    Channels,
    Counters,
    OutputArrays,
    layout_of,
    new_numbers,
    output_arrays,
)
from solver.scene import Scene
from solver.start.displacement import require_near, require_uniform
from solver.start.placement import Changes
from solver.start.rolling import SETTLE_EVERY, SETTLE_TIME, SPINNING, STOPPED, UNSTEADY
from solver.step.work import LastStep

LONGEST = 2.5e-3  # s: longer steps are divided into equal parts
COMMANDS = ('steering', 'steering' + RATE, 'steering' + ACCELERATION, 'drive_torque', 'brake_torque')
AXLES = ('front', 'rear')
WHEELS = tuple(f'wheel_{axle}_{side}' for axle in AXLES for side in ('left', 'right'))
ELEMENTS = (*(f'axle_{axle}/{column}' for axle in AXLES for column in AXLE_COLUMNS), 'drag/force')

Parameters = Mapping[str, Mapping[str, float]]  # of the NamedTuples mounting, body, front and rear


def tables_of(
    parameters: Parameters, scene: Scene, yaw: float = 0.0, x: float = 0.0, y: float = 0.0
) -> SingleTrackTables:
    """The parameters as the step takes them, on the road of a scene, as high as that is at the start; yaw [rad], x, y
    [m]: there."""
    p, road = parameters, compile_road(scene.model.road)
    height = p['mounting']['height'] + float(surface_at(Ref(road), x, y)[0])
    gives = {
        axle: dict(zip(('give', 'give_damping'), give_of(p[axle]['radius'], p[axle]['resistance']), strict=True))
        for axle in AXLES
    }
    front, rear = (TrackAxle(**p[axle], **gives[axle]) for axle in AXLES)
    mounting = Mounting(**{**p['mounting'], 'yaw': yaw, 'height': height})
    return SingleTrackTables(mounting=mounting, body=Body(**p['body']), front=front, rear=rear, road=road)


def _heights(grid: HeightGrid | RasterGrid | CurvedGrid | RandomRoad) -> tuple[float, float]:
    """(lowest, highest) point of a grid [m]."""
    height = (grid.expand() if isinstance(grid, RandomRoad) else grid).heights.height
    return float(height.min()), float(height.max())


def channels_of(inputs: tuple[str, ...], chassis: str, *, energies: bool = False) -> Channels:
    """Names of everything a Snapshot of this level holds."""
    return Channels(
        joints=('steering_wheel', *WHEELS), joint_kinds=('rotation',) * 5, bodies=(chassis,), wheels=(), inputs=inputs,
        elements=ELEMENTS,
        reactions=(), chassis=0, energies=ENERGIES if energies else (),
    )  # fmt: skip


def new_frame(n_inputs: int) -> OutputArrays:
    """Arrays for what a state shows."""
    layout = layout_of(channels_of(('',) * n_inputs, ''))
    return output_arrays(new_numbers(layout), layout)


def new_scratch(*, energies: bool = False) -> Ref:
    """Scratch of a step, by reference. energies: its account is one that shows them."""
    row = lambda: np.zeros(SIZE)  # noqa: E731
    work = SingleTrackWork(
        rates=row(), start=row(), k1=row(), k2=row(), between=row(), stiff=np.zeros((2, 8)), stiff_2=np.zeros((2, 8)),
        told=np.zeros(TOLD), reached=np.zeros((len(REACHED), 2)), steered=np.zeros(2),
        account=new_account(0, 0, flow=energies),
    )  # fmt: skip
    return Ref(work)


def rolling(t: SingleTrackTables, speed: float, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    """(SIZE,) state straight on at a speed [m/s], wheels rolling against their resistance; centre of mass at x, y
    [m]."""
    state = np.zeros(SIZE)
    state[X], state[Y], state[YAW], state[VX] = x, y, yaw, speed
    for i, axle in enumerate((t.front, t.rear)):
        slip = -math.copysign(axle.resistance * axle.load / axle.stiffness_x, speed) if speed else 0.0
        state[LONG + i] = slip * axle.length_x
        state[SPIN + i] = speed * (1.0 - abs(slip)) / axle.rolling_radius
        state[GIVE + i] = math.copysign(axle.give, speed) if speed else 0.0
        state[SHIFT] += t.body.height * axle.stiffness_x * slip  # which slows it down
    return state


def settled(tables: Ref, straight: np.ndarray, speed: float, u: np.ndarray, index: np.ndarray) -> np.ndarray | None:
    """(SIZE,) state in which what rolled `straight` (SIZE,) at a speed [m/s] settles under the inputs u (nu,), its
    steering wheel held.

    As solver.start.rolling does with a vehicle of bodies: every SETTLE_EVERY seconds it is put back to its speed and
    heading, and the centre of mass of its chassis to its place. In steps of its own, so that a start does not depend on
    those of the scene. tables and index: of the step. None where its drive leaves nothing steady. Raises
    ConsistencyError.
    """
    t, w, frame = tables.value, new_scratch(), Ref(new_frame(len(u)))
    held = u.copy()
    held[index[1:3]] = 0.0
    rows, driven = held[None, :].copy(), held[index[3]] != 0.0
    c, s, arm = math.cos(straight[YAW]), math.sin(straight[YAW]), t.mounting.com_z - t.mounting.axis
    y, spins = straight.copy(), slice(SPIN, SPIN + 2)
    for _ in range(round(SETTLE_TIME / SETTLE_EVERY)):
        if advance(tables, y, rows, index, held, 0, round(SETTLE_EVERY / LONGEST), False, LONGEST, 1, w, frame)[0]:
            wheel = f'with the steering wheel at {u[index[0]]:g} rad'
            raise ConsistencyError(
                f'start: the vehicle does not settle at {speed:g} m/s {wheel}: reduce the speed or the steering angle '
                'at t = 0'
            )
        side = arm * y[ROLL]  # which the centre of mass of the chassis has moved to the right
        now = y[VX] + y[YAW_RATE] * (side - t.mounting.com_y)
        most = SPINNING * math.hypot(y[VX], y[VY]) / abs(speed)
        if driven and (
            np.any(np.abs(y[spins]) > most * np.abs(straight[spins])) or abs(now - speed) > UNSTEADY * abs(speed)
        ):
            return None
        y[VX] += speed - now
        if now / speed > STOPPED:
            y[spins] *= speed / now
        y[X], y[Y], y[YAW] = straight[X] - s * side, straight[Y] + c * side, straight[YAW]
    y[[TURN_F, TURN_R]] = 0.0
    return y


class SingleTrack:
    """See solver.engine.Engine: what solver.levels.single_track shows of a vehicle, with the parameters that level
    found.

    noted: friction changes along its road, so advance() notes where it went (solver.levels.track_friction).

    Only h of the integrator means something here: the step is that of solver.levels.track_step, in parts of LONGEST at
    most. Nothing iterates, and there are no constraints. Raises SpecError or ConsistencyError.
    """

    stage = 0.5  # torques are held over the step: the mean is what matters
    follows = False

    def __init__(self, scene: Scene, parameters: Parameters) -> None:
        if scene.integrator.kind not in KINDS:
            raise SpecError(
                f'integrator: kind = {scene.integrator.kind!r}: the level single_track has a step of its own; use alf'
            )
        self.scene, self.model = scene, prepare(scene.model)
        self.h = scene.integrator.h_ns * 1e-9
        names = scene.model.inputs
        self.index = np.array([names.index(name) for name in COMMANDS])
        energies = scene.record.energies > 0.0
        self.channels = channels_of(names, scene.model.chassis or 'chassis', energies=energies)
        self.layout = layout_of(self.channels)
        self.numbers = new_numbers(self.layout)
        self.frame = Ref(output_arrays(self.numbers, self.layout))
        self.scratch = new_scratch(energies=energies)
        x, y, yaw = self._place()
        self.tables = Ref(tables_of(parameters, scene, yaw, x, y))
        self.parts = max(1, math.ceil(self.h / LONGEST - 1e-9))
        behind = self.tables.mounting.x
        self._straight = rolling(
            self.tables.value, scene.start.speed, x - math.cos(yaw) * behind, y - math.sin(yaw) * behind, yaw
        )
        road = scene.model.road
        heights = [height for grid in road.grids for height in _heights(grid)]
        self._uneven = max(heights, default=0.0) - min(heights, default=0.0)
        self._slope = math.hypot(*road.normal[:2]) / road.normal[2]
        self._dropped = (
            0.0
            if scene.start.kind == 'equilibrium'
            else abs(self._chassis_spec.position[2] - self.tables.mounting.height)
        )
        self._slippery, self.noted = np.zeros(2), varies(road)

    @property
    def shown(self) -> SingleTrack:
        """Itself."""
        return self

    @property
    def account(self) -> Account:
        """The running account."""
        return cast(Account, self.scratch.account)

    @property
    def _chassis_spec(self) -> RigidBodySpec:
        return next(b for b in self.scene.model.bodies if b.name == self.channels.bodies[0])

    def _place(self) -> tuple[float, float, float]:
        """x, y [m] and yaw [rad] of the chassis at the start. Raises SpecError where more is asked for than a place and
        a speed."""
        scene = self.scene
        for name in scene.start.coordinates:
            raise SpecError(
                f'start.coordinates = {name!r}: the level single_track has no joints that could start there; remove it'
            )
        chassis = self._chassis_spec
        if any(chassis.velocity) or any(chassis.angular_velocity):
            raise SpecError(
                f'{chassis.where}: velocity is given, but the level single_track starts with start.speed; take another '
                'level'
            )
        R = matrix(chassis.orientation)
        return chassis.position[0], chassis.position[1], math.atan2(R[1, 0], R[0, 0])

    def start(self, u: np.ndarray) -> Changes:
        """The state at t = 0. Raises ConsistencyError."""
        self._at_start = self._settled(self._straight, u)
        self.y = self._at_start.copy()
        return Changes(kind=self.scene.start.kind)

    def start_like(self, other: SingleTrack, u: np.ndarray) -> None:
        """See Engine.start_like()."""
        self._at_start = other._at_start.copy()
        self.y = self._at_start.copy()

    def _settled(self, straight: np.ndarray, given: np.ndarray) -> np.ndarray:
        """(SIZE,) state at the start of what rolls `straight` (SIZE,): that, or where it is steered by the inputs
        `given` (nu,) from t = 0 on, already in its bend.

        As with bodies, a drive that leaves nothing steady acts from the first step on. Raises ConsistencyError.
        """
        start, u = self.scene.start, given.copy()
        if start.kind != 'equilibrium' or not start.speed or not u[self.index[0]]:
            return straight
        found = settled(self.tables, straight, start.speed, u, self.index)
        if found is None:
            u[self.index[3]] = 0.0
            found = settled(self.tables, straight, start.speed, u, self.index)
            assert found is not None  # without a drive
        return found

    def reset(self, u: np.ndarray) -> None:
        """Back to the start, bit for bit."""
        self.y[:] = self._at_start
        self._slippery[:] = 0.0
        self.begin(0, u)

    def begin(self, k: int, u: np.ndarray) -> None:
        """Show the present state, begin the account and what is reached."""
        start(self.tables, self.y, u, self.index, self.scratch, self.frame)

    def show(self, k: int, u: np.ndarray) -> None:
        """Nothing to do: the state is shown after every step."""

    def advance(
        self,
        k: int,
        inputs: np.ndarray,
        n: int,
        audit: bool,
        last: np.ndarray,
        seen: Seen | None = None,
        driven: Driven | None = None,
    ) -> Moved:
        """See Engine.advance(). On a road of varying friction the motion is looked at every LOOK."""
        # what is not finite is refused before anything is advanced
        looks = audit and self.noted and bool(np.isfinite(inputs).all())
        piece = (max(1, LOOK // self.scene.integrator.h_ns) if driven is None else 1) if looks else n
        status = done = 0
        for first in range(0, n, piece):
            steps_of = self.tables, self.y, inputs, self.index, last, first, min(piece, n - first)
            if driven is not None:
                every, rows = (0, self.numbers[None]) if seen is None else (seen.every, seen.free)
                status, steps, taken = advance_driven(
                    *steps_of[:2], *driven, *steps_of[2:], k + first, audit, self.h, self.parts, every, self.numbers,
                    rows, self.scratch, self.frame,
                )  # fmt: skip
                if seen is not None:
                    seen.took(k + first, taken)
            elif seen is None:
                status, steps = advance(*steps_of, audit, self.h, self.parts, self.scratch, self.frame)
            else:
                status, steps, taken = advance_seen(
                    *steps_of, k + first, audit, self.h, self.parts, seen.every, self.numbers, seen.free, self.scratch,
                    self.frame,
                )  # fmt: skip
                seen.took(k + first, taken)
            if status == 1:
                name = self.channels.inputs[steps]
                return Moved(
                    done, NO_STEPS, f'{instant(self.scene, k)}: input {name!r} is not finite; nothing was advanced'
                )
            done += steps
            if status:
                break
            if looks:
                note(self.tables.value, self.scratch.value, self.y, (k + done) * self.h, self._slippery)
        late = (
            f'{instant(self.scene, k + done)}: the motion is no longer finite; reduce integrator.h or check the torques'
        )
        return Moved(done, self.counters_of(done), late if status == 2 else '')

    def counters_of(self, steps: int) -> Counters:
        """Counters of so many steps."""
        return Counters(steps * self.parts, 0, steps * (2 * self.parts + 1), 0, 0.0, 0.0, 0.0)

    @property
    def alone(self) -> str:
        """See Engine.alone."""
        return 'friction changes along its road, which this level looks at every 10 ms' if self.noted else ''

    def current(self) -> None:
        """Nothing to do: the state is shown after every step."""

    def sight(self) -> Sight:
        """Motion of the vehicle that a driver sees now."""
        pose = self.frame.pose[0]
        side = self.tables.mounting.axis * self.y[ROLL]
        return Sight(float(pose[0]), float(pose[1]), float(self.y[YAW]), float(self.y[VX] - self.y[YAW_RATE] * side))

    def place(self, x: float, y: float, heading: float) -> None:
        """Move the vehicle. Raises SpecError on a road that is not the same everywhere, and for a place too far off."""
        require_uniform(self.scene.model.road)
        require_near(x, y)
        now = self.sight()
        turn = heading - now.heading
        c, s = math.cos(turn), math.sin(turn)
        dx, dy = self.y[X] - now.x, self.y[Y] - now.y
        self.y[X], self.y[Y] = x + c * dx - s * dy, y + s * dx + c * dy
        self.y[YAW] += turn

    def arrays(self) -> dict[str, np.ndarray]:
        """State, and what has been reached."""
        w = self.scratch
        return {'single_track': self.y, 'reached': w.reached, 'steered': w.steered, 'slippery': self._slippery}

    def fit(self, saved: Mapping[str, np.ndarray], k: int) -> Callable[[np.ndarray, Kept], None]:
        """See Engine.fit()."""
        if 'single_track' not in saved or saved['single_track'].shape != self.y.shape:
            raise SpecError('restore: the saved state is of another model than this one of level single_track')
        w = self.scratch
        require_account(saved.get('audit'), w.account)
        for name, array in (('reached', w.reached), ('steered', w.steered)):
            fitting(name, saved.get(name), array)
        slippery = fitting('slippery', saved.get('slippery'), self._slippery)

        def take_up(u: np.ndarray, _: Kept) -> None:
            self.y[:] = saved['single_track']
            self.begin(k, u)
            self.y[:] = saved['single_track']  # what was lost so far is part of it
            w.account.numbers[:], w.reached[:], w.steered[:] = saved['audit'], saved['reached'], saved['steered']
            show_energies.py_func(w.account, self.frame.value)
            self._slippery[:] = slippery

        return take_up

    def last_step(self) -> LastStep:
        """The account; there are no constraints."""
        none = np.zeros(0)
        return LastStep(none, np.zeros((1, 6, 6)), np.zeros((1, 6, 6)), none, none, none, self.account)

    def reached(self) -> dict[str, tuple[float, float | None]]:
        """Quantities that the level limits: the largest value of each so far, and its time [s] where it has one.

        frequency: root of the ratio of the mean squares of rate and angle of the steering wheel.
        """
        w = self.scratch
        found: dict[str, tuple[float, float | None]] = {
            name: (float(value), float(time)) for name, (value, time) in zip(REACHED, w.reached, strict=True)
        }
        angle, rate = w.steered.tolist()
        found['frequency'] = (math.sqrt(rate / angle) / (2.0 * math.pi) if angle > 0.0 else 0.0, None)
        found['road height'], found['road slope'] = (self._uneven, None), (self._slope, None)
        found['height over the road at the start'] = (self._dropped, None)
        below, time = self._slippery.tolist()
        everywhere = max(0.0, 1.0 - self.scene.model.road.friction)
        found['friction below 1'] = (below, time) if below > everywhere else (everywhere, None)
        return found

    def nbytes(self) -> int:
        """Memory of parameters, scratch and state."""
        return nbytes((self.tables.value.road, self.scratch.value, self.y))

    def totals(self, k: int) -> dict[str, Any]:
        """Nothing adapts."""
        return {'substeps': k * self.parts, 'rejected': 0, 'smallest_step': self.h / self.parts, 'events': 0}

    def urdf(self, joints: Mapping[str, float], pose: np.ndarray) -> str:
        """Chassis, wheels and steering wheel, as the vehicle was given."""
        poses = np.array([(*b.position, *b.orientation) for b in self.scene.model.bodies])
        return robot_description(self.scene.model, poses, dict.fromkeys(joints, 0.0), self.scene.name)

    def describe(self, u: np.ndarray) -> dict[str, Any]:
        """Counts: degrees of freedom are those of plane, roll and the spins of both axles."""
        return {
            'bodies': 1,
            'dof': 6,
            'internal_states': SIZE - 14,
            'mass': float(self.tables.body.mass),
            'inputs': list(self.scene.model.inputs),
        }
