"""An automatic gearbox: it chooses the gear by speed and pedal, and works the clutch, as a driver or a robot on a manual gearbox does.

The input gear is its lever: 0 neutral, below 0 the reverse gear, from 1 on it drives. Then it shifts up above the speed of `up` and down
below that of `down`, both over the position of the accelerator, never twice within `duration`. It begins in the gear that it would have
shifted up to at its speed and accelerator, and so it does where the lever comes out of neutral. During a shift the clutch is open for half
of that time and closes over the other half, and the accelerator is taken back as far as the clutch is open. Below the speed `launch` in
the first or the reverse gear the clutch is open without accelerator, and with it closed as far as

    bite + (1 - bite) v / launch

With launch = 0 a torque converter starts the car: the clutch stays closed. The lock-up clutch of that closes above the speed `lock_up`, and
opens below 0.9 of it and in shifts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.dimensions import Speed, Time
from solver.errors import SpecError
from solver.validate import finite, require, require_positions, require_rising

INPUTS = ('accelerator', 'clutch', 'gear')
LOCK_UP = 'lock_up'
DRIVES = 0.5  # from there on the lever lets it choose a forward gear


@dataclass(frozen=True, kw_only=True)
class Shifting:
    """An automatic gearbox; see the module. pedals: positions of the accelerator (0 to 1), rising; up: for each shift, from that out of the
    first gear on, the speeds at these above which it is made; down: those below which it is taken back, smaller [m/s]. duration of a shift
    [s]; launch: speed up to which the clutch slips, 0 with a torque converter [m/s]; bite: how far it closes at rest (0 to 1). lock_up:
    speed above which the lock-up clutch of a torque converter closes [m/s]; None: never."""

    pedals: tuple[float, ...]
    up: tuple[tuple[Speed, ...], ...]
    down: tuple[tuple[Speed, ...], ...]
    duration: Time = 0.4
    launch: Speed = 3.0
    bite: float = 0.3
    lock_up: Speed | None = None

    def __post_init__(self) -> None:
        require_rising('shift', 'pedals', self.pedals)
        require_positions('shift', self.pedals)
        require(len(self.up) >= 1, 'shift', 'up', self.up, 'needs at least one shift')
        require(len(self.down) == len(self.up), 'shift', 'down', len(self.down), f'must have one row for each of the {len(self.up)} shifts')
        for field, rows in (('up', self.up), ('down', self.down)):
            for k, row in enumerate(rows):
                require(len(row) == len(self.pedals), 'shift', f'{field}[{k}]', len(row), f'must have {len(self.pedals)} speeds, as pedals')
        for k, (high, low) in enumerate(zip(self.up, self.down, strict=True)):
            for m, (a, b) in enumerate(zip(high, low, strict=True)):
                require(0.0 <= b < a, 'shift', f'down[{k}][{m}]', b, f'must be at least 0 and below {a:g}, where it shifts up')
        finite('shift', 'duration', self.duration, low=0.0, strict=True)
        finite('shift', 'launch', self.launch, low=0.0)
        if self.lock_up is not None:
            finite('shift', 'lock_up', self.lock_up, low=0.0, strict=True)
        finite('shift', 'bite', self.bite, low=0.0, high=1.0)


class Shifter:
    """The automatic gearbox of a simulation with inputs of these names, in steps of h [s].

    state: (2,) gear, time since the last shift [s]; with a lock-up clutch (3,), 1 where that is closed; assign it to restore. Raises
    SpecError for a model without the inputs.
    """

    def __init__(self, shifting: Shifting, input_names: Sequence[str], h: float) -> None:
        self.shifting, self.h = shifting, h
        names = list(input_names)
        for name in INPUTS:
            if name not in names:
                raise SpecError(f'assistance: shift: the model has no input {name}: give the engine of the vehicle a `power`')
        self._accelerator, self._clutch, self._gear = (names.index(name) for name in INPUTS)
        if shifting.lock_up is not None and LOCK_UP not in names:
            raise SpecError(f'assistance: shift: lock_up = {shifting.lock_up:g}: the vehicle has no converter with a lock_up')
        self._lock_up = None if shifting.lock_up is None else names.index(LOCK_UP)
        self._in_gear(1)

    def _in_gear(self, gear: int) -> None:
        self.state = np.array([gear, self.shifting.duration, 0.0][: 2 if self._lock_up is None else 3])

    def start(self, row: np.ndarray, speed: float) -> None:
        """Back to t = 0, in the gear of a speed along the car [m/s]; changes the inputs there, row (nu,), as act() does."""
        self._in_gear(self._fitting(abs(speed), float(row[self._accelerator])) if float(row[self._gear]) >= DRIVES else 1)
        self.act(row, speed)

    def _fitting(self, speed: float, pedal: float) -> int:
        """The gear that it would have shifted up to at a speed [m/s] and an accelerator."""
        gear = 1
        for up in self.shifting.up:
            if speed <= np.interp(pedal, self.shifting.pedals, up):
                break
            gear += 1
        return gear

    def begin(self, inputs: np.ndarray) -> None:
        """Begin in the middle of a motion, in the gear that is in by inputs (nu,), as far as the gearbox shifts."""
        self._in_gear(min(max(round(float(inputs[self._gear])), 1), len(self.shifting.up) + 1))

    def act(self, row: np.ndarray, speed: float) -> None:
        """Change the inputs of a step, row (nu,), at a speed along the car [m/s]; advances by that step."""
        box, lever, pedal = self.shifting, float(row[self._gear]), float(row[self._accelerator])
        gear, since = int(self.state[0]), float(self.state[1])
        v = abs(speed)
        if lever < DRIVES:  # reverse has one gear; what neutral is left to is that of the speed
            gear, since = 1 if lever < -DRIVES else self._fitting(v, pedal), box.duration
        elif since >= box.duration:
            if gear <= len(box.up) and v > np.interp(pedal, box.pedals, box.up[gear - 1]):
                gear, since = gear + 1, 0.0
            elif gear > 1 and v < np.interp(pedal, box.pedals, box.down[gear - 2]):
                gear, since = gear - 1, 0.0
        opened = min(max(2.0 - 2.0 * since / box.duration, 0.0), 1.0)
        row[self._accelerator] = pedal * (1.0 - opened)
        if gear == 1 and v < box.launch:
            opened = max(opened, (1.0 - box.bite) * (1.0 - v / box.launch) if pedal > 0.0 else 1.0)
        if lever >= DRIVES:
            row[self._gear] = gear
        row[self._clutch] = max(float(row[self._clutch]), opened)
        if self._lock_up is not None and box.lock_up is not None:
            locked = float(v > (0.9 * box.lock_up if self.state[2] else box.lock_up))
            row[self._lock_up] = max(float(row[self._lock_up]), locked)
            self.state = np.array([gear, min(since + self.h, box.duration), locked])
        else:
            self.state = np.array([gear, min(since + self.h, box.duration)])
