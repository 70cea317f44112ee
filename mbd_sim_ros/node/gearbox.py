"""An engine with an automatic gearbox under the loop of the adapter: torques at the differential become accelerator and
lever.

    pedal u:  map(u, omega) = T / R        omega = R |v| / radius, at least where the engine idles; R: ratio between
              crankshaft and wheels

The adapter follows the gear by the law of the gearbox itself (solver.inputs.shifting) with the speed that it hears, so
what it sends depends on nothing but the states that it answers. The integral of the loop takes the rest of the effect
of map and clutch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbd_sim_ros.node.speed_control import NEUTRAL, PARK
from solver.elements.engine_map import EngineSpec
from solver.inputs.shifting import INPUTS, LOCK_UP, Shifter, Shifting
from solver.model.spec import ModelSpec
from solver.scene import Scene

SHAFT = 'gearbox_output'  # a propeller shaft at the gearbox, its axle behind this where there are several


@dataclass(frozen=True, kw_only=True)
class Gearbox:
    """Engine and gearbox of a car. ratios: between crankshaft and wheels, from the first gear on; reverse: of the
    reverse gear (0: none); radius of the wheels [m]; shifting: None for a gearbox that nobody works, which stays in
    neutral."""

    engine: EngineSpec
    ratios: tuple[float, ...]
    reverse: float
    radius: float
    shifting: Shifting | None

    @classmethod
    def of(cls, scene: Scene) -> Gearbox | None:
        """Gearbox of the vehicle of a scene; None where its torque acts at the differential alone."""
        model = scene.model
        engines = [e for e in model.engines if e.input == 'accelerator']
        boxes = [c for c in model.clutches if c.gear == 'gear']
        if not (engines and boxes):
            return None
        final = sum(share * _turns(model, output) for output, share in boxes[0].outputs)
        places = {b.name: b.position for b in model.bodies}
        return cls(
            engine=engines[0],
            ratios=tuple(ratio * final for ratio in boxes[0].ratios),
            reverse=(boxes[0].reverse or 0.0) * final,
            radius=float(np.mean([places[t.marker.body][2] for t in model.tires])),
            shifting=scene.assistance.shift,
        )

    def idle(self) -> float:
        """Speed at which the torque of the first pedal ends [rad/s]."""
        torques = np.array(self.engine.torques[0])
        return (
            float(self.engine.speeds[int(np.argmax(torques <= 0.0))])
            if (torques <= 0.0).any()
            else float(self.engine.speeds[-1])
        )

    def pedal(self, torque: float, ratio: float, speed: float) -> float:
        """Position of the accelerator (0 to 1) for a torque at the differential [N m] at a speed of the car [m/s]."""
        if torque <= 0.0 or ratio == 0.0:
            return 0.0
        engine = self.engine
        omega = max(ratio * abs(speed) / self.radius, self.idle())
        there = [float(np.interp(omega, engine.speeds, row)) for row in engine.torques]
        return float(np.interp(torque / ratio, np.maximum.accumulate(there), engine.pedals))


def gears_of(model: Any) -> tuple[int, int] | None:
    """(lowest, highest) gear of the gearboxes of a model that follow the input `gear`; None where there is none."""
    boxes = [clutch for clutch in getattr(model, 'clutches', ()) if clutch.gear == 'gear']
    if not boxes:
        return None
    return -1 if any(box.reverse is not None for box in boxes) else 0, max(len(box.ratios) for box in boxes)


def _turns(model: ModelSpec, output: str) -> float:
    """Turns of an output of a gearbox per turn of the wheels: of a propeller shaft by its final drive, of half shafts
    1."""
    axle = output.removeprefix(SHAFT)
    if axle == output:
        return 1.0
    final, pinion = f'final_drive{axle}', f'drive_pinion{axle}/angle'
    return next(
        -1.0 / factor
        for force in model.coordinate_forces
        if force.name == final
        for name, factor in force.terms
        if name == pinion
    )


class Worked:
    """A gearbox at work: state by state. h: seconds since the last one."""

    def __init__(self, box: Gearbox) -> None:
        self.box = box
        self._shifter = None if box.shifting is None else Shifter(box.shifting, (*INPUTS, LOCK_UP), 0.0)
        self._begun = False

    def reset(self) -> None:
        """As if it had just begun."""
        self._begun = False

    def commands(self, drive: float, direction: float, gear: str | None, speed: float, h: float) -> dict[str, float]:
        """Commands for a drive torque [N m], positive forwards, in a direction (1, -1), instead of that torque."""
        if self._shifter is None:
            return {'drive_torque': drive, 'gear': 0.0}
        lever = 0.0 if gear in (NEUTRAL, PARK) else direction
        if not self._begun:
            self._shifter.start(np.array([0.0, 0.0, lever, 0.0]), speed)
            self._begun = True
        ratio = self.box.reverse if lever < 0.0 else self.box.ratios[int(self._shifter.state[0]) - 1]
        accelerator = self.box.pedal(direction * drive, ratio, speed) if lever else 0.0
        self._shifter.h = h
        self._shifter.act(np.array([accelerator, 0.0, lever, 0.0]), speed)
        return {'drive_torque': 0.0, 'accelerator': accelerator, 'gear': lever}
