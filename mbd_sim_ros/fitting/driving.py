"""A window of a recording, driven: the steering is a prescribed motion, the speed is followed or torques act."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from mbd_sim_ros.fitting.car import begin
from mbd_sim_ros.fitting.file import Drive
from mbd_sim_ros.fitting.recordings import Data, Track, Window
from mbd_sim_ros.fitting.sensors import CORNERS
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.errors import SpecError, StepError
from solver.inputs.signals import Jet, smooth_step
from solver.output.snapshot import Snapshot
from solver.simulation import Simulation

CHUNK = 10  # steps between samples; with ten times as many a yaw rate of 2 Hz is not seen any more
# 1/s of the speed control of a passenger car. With a third of it a car that corners is 0.02 m/s from its speed, 8 ms
# late; ten times as much oscillates with the samples
FOLLOW = 12.0
INTEGRAL = 18.0  # 1/s^2 of the same; ten times as much swings
# s, of a passenger car: half width of the mean that smooths the steering; ten times as much loses the quick turns of
# the wheel
SMOOTHER = 0.04
# the same of the speed, whose slope is what the car is driven by: noise of 0.02 m/s in samples of 10 ms becomes
# 0.1 m/s^2 of drive and braking, with a fifth of the width 0.5, which takes lateral force from the driven tires; ten
# times as much drives off two seconds early
SPEED_SMOOTHER = 0.2
# m/s^2 over which driving turns into braking. Both act on different axles, and a sudden change is a kink in
# derivatives. In between both act, with half of it each at no torque; ten times as much drives with 0.5 m/s^2 against
# the brakes
TURNOVER = 0.1
EASE = (
    0.8  # s in which the steering comes from straight ahead into the recording, of a passenger car: a third of a run-in
)
COLUMNS = 12 + 7 + 4  # imu, twist, pose of the chassis, spins of the wheels


@dataclass(frozen=True)
class Steering:
    """Nuisances of the measured inputs: the car steers gain (channel(t + delay) + offset), lag [s] behind, and follows
    the speed at t + speed_delay."""

    delay: float = 0.0
    gain: float = 1.0
    offset: float = 0.0
    lag: float = 0.0
    speed_delay: float = 0.0


class Inputs:
    """The inputs of a window, on the steps and samples of the simulation. car: the vehicle, or what moves in its
    place."""

    def __init__(self, data: Data, drive: Drive, window: Window, car: Any) -> None:
        self.window, self.car, self.h = window, car, car.h
        self.dt = CHUNK * car.h
        self.chunks = int((window.last - window.begin) / self.dt)
        self.t = self.dt * np.arange(self.chunks + 1)  # from the begin of the window
        half = SMOOTHER * car.size.time
        names = drive.road_wheel or (drive.steering_wheel,)
        given = [_straight(data.tracks[name], half) for name in names]
        tracks = [_smoothed(Track(one.t, drive.angle(one.y)), half) for one in given]
        grid = tracks[0].t
        angle = np.mean([np.interp(grid, one.t, one.y) for one in tracks], axis=0)
        self._steering = _spline(grid, angle)
        self._ends = float(grid[0]), float(grid[-1])
        half = SPEED_SMOOTHER * car.size.time
        # twice, for the slope of a mean is the difference of two samples, and has all of their noise
        speed = _smoothed(_smoothed(data.tracks[drive.speed], half), half)
        self._speed = _spline(speed.t, speed.y)
        self.followed = not drive.torques
        self._steered: tuple[Steering, np.ndarray] | None = None
        self._followed: tuple[float, tuple[np.ndarray, np.ndarray]] | None = None
        self._middle = window.begin + self.h * (np.arange(self.chunks * CHUNK) + 0.5)
        self.torques = [
            np.interp(self._middle, data.tracks[name].t, data.tracks[name].y) if name else np.zeros(self._middle.size)
            for name in (drive.drive_torque, drive.brake_torque)
        ]

    def speed(self, known: Steering) -> tuple[np.ndarray, np.ndarray]:
        """(speed [m/s] at all samples, its slope [m/s^2] in the middle of all steps); beyond the recording that of its
        end. The last one is kept, as that of the steering."""
        if self._followed is None or self._followed[0] != known.speed_delay:
            self._followed = known.speed_delay, self._speed_of(known)
        return self._followed[1]

    def _speed_of(self, known: Steering) -> tuple[np.ndarray, np.ndarray]:
        first, last = self._speed.x[[0, -1]]
        samples, middle = (
            np.clip(t + known.speed_delay, first, last) for t in (self.window.begin + self.t, self._middle)
        )
        return self._speed(samples), self._speed(middle, 1)

    def steering(self, known: Steering) -> np.ndarray:
        """(steps, 3) angle, rate and acceleration of the steering wheel at the ends of all steps. The last one is kept:
        vehicles with other numbers steer alike."""
        if self._steered is None or self._steered[0] != known:
            self._steered = known, self._steering_of(known)
        return self._steered[1]

    def _steering_of(self, known: Steering) -> np.ndarray:
        ends = self.window.begin + self.h * np.arange(1, self.chunks * CHUNK + 1)
        wanted = ends + known.delay
        at = np.clip(wanted, *self._ends)
        angle, rate, acceleration = (self._steering(at, k) for k in range(3))
        # beyond the recording straight on, as the natural spline ends: a rate that jumped there would make the
        # derivative by the delay one of its step
        angle = angle + rate * (wanted - at) + known.offset
        if known.lag > 0.0:
            angle, rate, acceleration = _lagged(angle, rate, self.h, known.lag)
        angle, rate, acceleration = (known.gain * one for one in (angle, rate, acceleration))
        if self.car.road_map is not None:
            x, y = np.array(self.car.road_map.points).T
            most = float(np.abs(angle).max())
            if not x[0] <= angle.min() <= angle.max() <= x[-1]:
                raise SpecError(
                    f'recording {self.window.recording!r}: the road wheels turn by {most:.3g} rad, beyond the '
                    f'{x[-1]:.3g} rad of the vehicle; is the unit of the channel right?'
                )
            jet = CubicSpline(x, y)
            first, second = jet(angle, 1), jet(angle, 2)
            angle, rate, acceleration = jet(angle), first * rate, first * acceleration + second * rate * rate
        lock = self.car.lock or 20.0
        if np.abs(angle).max() > 1.001 * lock:
            raise SpecError(
                f'recording {self.window.recording!r}: the steering wheel turns by {np.abs(angle).max():.3g} rad, '
                f'beyond its {lock:.3g} rad; is the unit of the channel right, or is it the angle of the road wheels?'
            )
        begin_ = smooth_step(ends - self.window.begin, 0.0, EASE * self.car.size.time)
        eased = begin_.times(Jet(angle, rate, acceleration))
        return np.column_stack(eased)


def drive(simulation: Simulation, inputs: Inputs, known: Steering) -> np.ndarray:
    """(samples, COLUMNS) motion of the chassis and spins of the wheels in a window. Raises StepError."""
    names = simulation.model.spec.inputs if hasattr(simulation.model, 'spec') else simulation.channels.inputs
    columns = [names.index(n) for n in ('steering', 'steering_rate', 'steering_acceleration')]
    power, brake = names.index('drive_torque'), names.index('brake_torque')
    u = np.zeros((inputs.chunks * CHUNK, len(names)))
    u[:, columns] = inputs.steering(known)
    u[:, power], u[:, brake] = inputs.torques
    chassis = simulation.channels.chassis or 0
    mass = sum(body.mass for body in simulation.scene.model.bodies)
    time = inputs.car.size.time
    follow, integral = FOLLOW / time, INTEGRAL / time**2
    wanted, slope = inputs.speed(known)
    first = max(float(wanted[0]), 0.05 * inputs.car.speed)
    begin(simulation, first)
    rows = np.empty((inputs.chunks + 1, COLUMNS))
    kept = 0.0
    shot = simulation.snapshot()
    wheels = _wheels(simulation)
    # torque at the wheels per acceleration [N m s^2/m]: of the start, where they roll, so that no window has that in
    # which another one ended, and a car of a kilogram no wheels of a passenger car
    lever = mass * abs(shot.twist[chassis, 0] / wheels(shot).mean())
    for k in range(inputs.chunks + 1):
        row = rows[k]
        row[:6], row[6:12], row[12:19] = shot.imu, shot.twist[chassis], shot.pose[chassis]
        row[19:] = wheels(shot)
        if k == 0:  # what is shown is still the start
            row[19:] *= first / row[6]
            row[6] = first
        if k == inputs.chunks:
            break
        if inputs.followed:
            error = wanted[k] - row[6]
            kept += integral * inputs.dt * error
            steps = slice(k * CHUNK, (k + 1) * CHUNK)
            torque = lever * (slope[steps] + follow * error + kept)
            both = np.hypot(torque, lever * TURNOVER)
            u[steps, power], u[steps, brake] = 0.5 * (both + torque), 0.5 * (both - torque)
        shot = simulation.advance(CHUNK, u[k * CHUNK : (k + 1) * CHUNK], audit=False)
    if not np.isfinite(rows).all() or np.abs(rows[:, 9:12]).max() > 50.0 / time:
        raise StepError(f'recording {inputs.window.recording!r}: the vehicle turns over or spins without end')
    return rows


def _wheels(simulation: Simulation) -> Callable[[Snapshot], np.ndarray]:
    """Spins of the four wheels [rad/s] out of a snapshot: of its tires, or of its joints at a level without tires."""
    if simulation.snapshot().tire.shape[0] == len(CORNERS):
        spin = TIRE_COLUMNS.index('spin')
        return lambda shot: shot.tire[:, spin]
    names = simulation.channels.joints
    joints = [names.index(f'wheel_{corner}') for corner in CORNERS]
    return lambda shot: shot.joint_velocity[joints]


def _straight(track: Track, half: float) -> Track:
    """A signal that was held between its own samples as straight lines between these, at every half of `half` [s]: a
    wheel that is turned moves between them too. Another one stays."""
    if not track.held:
        return track
    t = np.arange(float(track.t[0]), float(track.t[-1]), 0.5 * half)
    return Track(t, np.interp(t, track.t, track.y))


def _smoothed(track: Track, half: float) -> Track:
    """A signal as means over 2 `half` around each of its samples, and what that took from it once more: slow motions
    stay to fourth order (twicing, [Tukey1977]); one sampled so coarsely stays."""
    once = _means(track, half)
    again = _means(once, half)
    return Track(once.t, 2.0 * once.y - again.y)


def _means(track: Track, half: float) -> Track:
    keep = np.concatenate([[True], np.diff(track.t) > 1e-6])
    t, y = track.t[keep], track.y[keep]
    low, high = np.searchsorted(t, t - half), np.searchsorted(t, t + half, side='right')
    even = np.minimum(np.arange(t.size) - low, high - 1 - np.arange(t.size))  # as many on either side
    at = np.arange(t.size)
    total = np.concatenate([[0.0], np.cumsum(y - y.mean())])
    return Track(t, (total[at + even + 1] - total[at - even]) / (2 * even + 1) + y.mean())


def _spline(t: np.ndarray, y: np.ndarray) -> CubicSpline:
    """Cubic spline; of samples that lie closer than 5 ms together every one of these."""
    keep = [0]
    for k in range(1, t.size):
        if t[k] - t[keep[-1]] > 1e-4:
            keep.append(k)
    return CubicSpline(t[keep], y[keep], bc_type='natural')


def _lagged(angle: np.ndarray, rate: np.ndarray, h: float, lag: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle that follows another one with a lag of first order: exact for steps in which it is linear."""
    from scipy.signal import lfilter

    decay = np.exp(-h / lag)
    # x_{k+1} = decay x_k + (1 - decay) u_k + (h - lag (1 - decay)) rate_k, u linear in the step
    forced = (1.0 - decay) * (angle - h * rate) + (h - lag * (1.0 - decay)) * rate
    found = lfilter([1.0], [1.0, -decay], forced, zi=np.array([decay * angle[0]]))[0]
    speed = (angle - found) / lag
    return found, speed, (rate - speed) / lag
