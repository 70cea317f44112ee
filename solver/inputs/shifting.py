"""Automatic gearbox: chooses the gear by speed and accelerator, and works the clutch.

Lever. The input `gear` is the lever: 0 is neutral, below 0 the reverse gear, from 1 on the gearbox drives and chooses.
Gear. It shifts up above the speed in `up` and down below the speed in `down`. Both speeds depend on the position of the
accelerator. After a shift the next one waits for `duration`. At the start, and when the lever leaves neutral, the gear
is the one to which the gearbox would have shifted up at that speed and accelerator. Shift. The clutch is open during
the first half of `duration` and closes over the second half. The accelerator is released as far as the clutch is open.
Launch. Below the speed `launch`, in the first or the reverse gear, the clutch is open without accelerator. With
accelerator it is closed by the fraction bite + (1 - bite) v / launch at the speed v. Converter. With launch = 0 a
torque converter starts the car, and the clutch stays closed. The lock-up clutch of the converter closes above the speed
`lock_up` and opens below 0.9 `lock_up`. In a shift it opens together with the clutch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.dimensions import Speed, Time
from solver.errors import SpecError
from solver.validate import finite, require, require_positions, require_rising

INPUTS = ('accelerator', 'clutch', 'gear')  # inputs of a vehicle that the gearbox reads and changes
LOCK_UP = 'lock_up'  # input of a vehicle whose torque converter has a lock-up clutch
DRIVES = 0.5  # position of the lever from which on the gearbox drives forward; below -0.5 it is in reverse


@dataclass(frozen=True, kw_only=True)
class Shifting:
    """An automatic gearbox; see the module for its rules.

    pedals: positions of the accelerator (0 to 1), rising. up: a row for each shift, first to second gear first, with
    the speed at each of `pedals` above which the gearbox shifts up [m/s]. down: rows likewise, with the speed below
    which it shifts back [m/s]; smaller than in `up`. duration: of a shift [s]. launch: speed up to which the clutch
    slips [m/s]; 0 with a torque converter. bite: fraction by which the clutch is closed at rest (0 to 1). lock_up:
    speed above which the lock-up clutch of a torque converter closes [m/s]; None: never.
    """

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
        require(
            len(self.down) == len(self.up),
            'shift',
            'down',
            len(self.down),
            f'must have one row for each of the {len(self.up)} shifts',
        )
        for field, rows in (('up', self.up), ('down', self.down)):
            remedy = f'must have {len(self.pedals)} speeds, one for each of `pedals`'
            for k, row in enumerate(rows):
                require(len(row) == len(self.pedals), 'shift', f'{field}[{k}]', len(row), remedy)
        for k, (high, low) in enumerate(zip(self.up, self.down, strict=True)):
            for m, (a, b) in enumerate(zip(high, low, strict=True)):
                remedy = f'must be at least 0 and below up[{k}][{m}] = {a:g}'
                require(0.0 <= b < a, 'shift', f'down[{k}][{m}]', b, remedy)
        finite('shift', 'duration', self.duration, low=0.0, strict=True)
        finite('shift', 'launch', self.launch, low=0.0)
        if self.lock_up is not None:
            finite('shift', 'lock_up', self.lock_up, low=0.0, strict=True)
        finite('shift', 'bite', self.bite, low=0.0, high=1.0)


class Shifter:
    """The automatic gearbox of one simulation, which has inputs of these names and steps of h [s].

    state: (2,) gear, time since the last shift [s]; with a lock-up clutch (3,): 1 where it is closed. A state that is
    assigned restores the gearbox. Raises SpecError for a model without the inputs.
    """

    def __init__(self, shifting: Shifting, input_names: Sequence[str], h: float) -> None:
        self.shifting, self.h = shifting, h
        names = list(input_names)
        for name in INPUTS:
            if name not in names:
                raise SpecError(
                    f'assistance: shift: the model has no input {name}: give the engine of the vehicle a `power`'
                )
        self._accelerator, self._clutch, self._gear = (names.index(name) for name in INPUTS)
        if shifting.lock_up is not None and LOCK_UP not in names:
            raise SpecError(
                f'assistance: shift: lock_up = {shifting.lock_up:g}: the vehicle has no converter with a lock_up'
            )
        self._lock_up = None if shifting.lock_up is None else names.index(LOCK_UP)
        self._in_gear(1)

    def _in_gear(self, gear: int) -> None:
        """Set the state to a gear, with its last shift complete."""
        self.state = np.array([gear, self.shifting.duration, 0.0][: 2 if self._lock_up is None else 3])

    def start(self, row: np.ndarray, speed: float) -> None:
        """Begin at t = 0, in the gear that fits the speed along the car [m/s]; changes the inputs row (nu,) there, as
        act() does."""
        self._in_gear(
            self._fitting(abs(speed), float(row[self._accelerator])) if float(row[self._gear]) >= DRIVES else 1
        )
        self.act(row, speed)

    def _fitting(self, speed: float, pedal: float) -> int:
        """Gear to which the gearbox would have shifted up at a speed [m/s] and a position of the accelerator (0 to
        1)."""
        gear = 1
        for up in self.shifting.up:
            if speed <= np.interp(pedal, self.shifting.pedals, up):
                break
            gear += 1
        return gear

    def begin(self, inputs: np.ndarray) -> None:
        """Begin in the middle of a motion, in the gear of the inputs (nu,), kept within the gears that the gearbox
        has."""
        self._in_gear(min(max(round(float(inputs[self._gear])), 1), len(self.shifting.up) + 1))

    def act(self, row: np.ndarray, speed: float) -> None:
        """Change accelerator, clutch, gear and lock-up in the inputs row (nu,) of a step; the gearbox moves on by that
        step.

        speed: along the car at the beginning of the step [m/s].
        """
        box, lever, pedal = self.shifting, float(row[self._gear]), float(row[self._accelerator])
        gear, since = int(self.state[0]), float(self.state[1])
        v = abs(speed)
        # there is one reverse gear; in neutral the gear follows the speed, for when the lever leaves it
        if lever < DRIVES:
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
