"""Real vehicles of the study of reality: where recordings of them are to be had, what they measure, and which part of
them is fitted. The recordings are those of others and no part of this project.

A Ferrari 250 LM [Leanza2021] and a car of 1:10 [Lyons2024]. Of a BMW M8 [Drechsler2024] full acceleration and braking
straight ahead are public, one drive, in which a single track has nothing to predict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from solver.errors import BagError


@dataclass(frozen=True)
class Cut:
    """A part of a recording: file, first and last instant [s] from its first stamp."""

    file: str
    start: float = 0.0
    end: float | None = None


@dataclass(frozen=True)
class Real:
    """A real vehicle. folder: of its recordings. source: key of docs/references.md. where: the place of the recordings,
    and made: how a file comes about. mass [kg], wheelbase [m], share of the weight in front: as the source has them.
    height [m], friction, stiffness of the tires over that of a passenger car: ours, with which fits begin. mapping,
    drive, channels: as in the file of a fit; known: of its parameters, where it is other than of all; places of
    sensors: behind the front axle and to the left [m]. window [s], run_in [s], slowest [m/s]. fitted, held_out, parts:
    of recordings."""

    folder: str
    title: str
    source: str
    where: str
    made: str
    mass: float
    wheelbase: float
    front_share: float
    height: float
    friction: float
    stiffness: float
    driven: str
    mapping: dict[str, Any]
    drive: dict[str, Any]
    channels: dict[str, dict[str, Any]]
    known: dict[str, dict[str, Any]] = field(default_factory=dict)
    places: dict[str, tuple[float, float]] = field(default_factory=dict)
    window: float = 10.0
    run_in: float = 2.0
    slowest: float | None = None
    fitted: tuple[Cut, ...] = ()
    held_out: tuple[Cut, ...] = ()
    parts: tuple[tuple[Cut, ...], ...] = ()

    @property
    def files(self) -> list[str]:
        """Names of all recordings that are needed."""
        cuts = [*self.fitted, *self.held_out, *(cut for part in self.parts for cut in part)]
        return list(dict.fromkeys(cut.file for cut in cuts))

    def require(self, data: Path) -> None:
        """Refuse a directory without the recordings. Raises BagError."""
        for name in self.files:
            if not (data / self.folder / name).is_file():
                raise BagError(
                    f'--data {data}: {self.folder}/{name} is missing; it is {self.made} of {self.where}, see '
                    'docs/reality.md'
                )


# Gains of calibrated sensors are exact: a gain that is free takes over what the vehicle that a fit begins with lacks
TRUE: dict[str, Any] = {'gain': {'sd': 'none'}}
EXACT: dict[str, Any] = {**TRUE, 'delay': {'sd': 'none'}}
DRIVE = 'drive.csv'
FIFTH = 70.0  # s, of the 350 s of the 250 LM; ten times as long is more than there is
SOME = 26.0  # s, of each of the first three fifths that is fitted: two windows; ten times as long is more than there is
PART = 46.0  # s, of each fifth that is a part: four windows; ten times as long is more than there is

FERRARI = Real(
    folder='ferrari_250lm',
    title='Ferrari 250 LM (1963) on a circuit',
    source='Leanza2021',
    where='github.com/MBDS/sideslip-angle-vehicle-estimation, datasets/20140222_01_01_03_250lm',
    made='the columns t, vx, vy, axCG, ayCG, yawRate, beta_true, deltaFL, deltaFR',
    mass=982.0, wheelbase=2.40, front_share=1.07 / 2.40, height=0.45, friction=1.3, stiffness=1.0, driven='rear',
    mapping={'channels': {
        'odom/twist/vx': {'channel': 'vx', 'unit': 'm/s'},
        'imu/ay': {'channel': 'ayCG', 'unit': 'm/s^2'},
        'imu/wz': {'channel': 'yawRate', 'unit': 'rad/s'},
        'odom/sideslip': {'channel': 'beta_true', 'unit': 'rad'},
        'wheel/left': {'channel': 'deltaFL', 'unit': 'rad'},
        'wheel/right': {'channel': 'deltaFR', 'unit': 'rad'},
    }},
    drive={'road_wheel': ['wheel/left', 'wheel/right'], 'speed': 'odom/twist/vx', **TRUE},
    channels={
        # over 350 s it is 1.02 times v r + dvy/dt: what roll adds to a sensor on the body is not in it
        'lateral_acceleration': {'channel': 'imu/ay', 'horizontal': True, **TRUE},
        'yaw_rate': {'channel': 'imu/wz', **TRUE},
        'sideslip': {'channel': 'odom/sideslip', **TRUE},
    },
    fitted=tuple(Cut(DRIVE, k * FIFTH, k * FIFTH + SOME) for k in range(3)),
    held_out=(Cut(DRIVE, 3 * FIFTH),),
    parts=tuple((Cut(DRIVE, k * FIFTH, k * FIFTH + PART),) for k in range(5)),
)  # fmt: skip

SLOW_FREE, FAST_FREE = (f'91_free_driving_16_sept_2024__09_16_2024_10_{end}.csv' for end in ('01_01', '12_05'))
RAMP = '81_throttle_ramps__09_09_2024_16_05_28steer015_ramp.csv'
BASE = 0.1735  # m, wheelbase
# rad of the road wheels over the command of the servo: the two hyperbolic tangents that the source fits to circles. A
# straight line would be 20 % too flat in the middle, and 14 % too steep at one end
SERVO = [
    [-1.0, -0.403], [-0.8, -0.355], [-0.6, -0.291], [-0.4, -0.212], [-0.2, -0.117], [0.0, -0.014], [0.2, 0.086],
    [0.4, 0.175], [0.6, 0.242], [0.8, 0.290], [1.0, 0.320],
]  # fmt: skip

DART = Real(
    folder='dart',
    title='DART, a car of 1:10 with motion capture',
    source='Lyons2024',
    where='github.com/Lorenzo-Lyons/DART, System_identification/Data',
    made='a file',
    mass=1.580, wheelbase=BASE, front_share=0.847 / 1.580, height=0.04, friction=0.8, stiffness=0.5, driven='rear',
    mapping={
        'time': {'column': 'vicon time'},
        'channels': {
            'imu/ay': {'channel': 'acc y (IMU)', 'unit': 'm/s^2'},
            'servo/command': {'channel': 'steering', 'unit': 'rad', 'hold': True},
            'pose/x': {'channel': 'vicon x', 'unit': 'm'},
            'pose/y': {'channel': 'vicon y', 'unit': 'm'},
            'pose/yaw': {'channel': 'vicon yaw', 'unit': 'rad'},
        },
    },
    drive={
        'road_wheel': ['servo/command'], 'speed': 'pose/vx', 'curve': SERVO,
        'gain': {'sd': '5 %'}, 'delay': {'sd': '0.1 s'}, 'offset': {'sd': 0.05}, 'lag': {'value': 0.1, 'sd': '0.05 s'},
    },
    channels={
        'lateral_acceleration': {'channel': 'imu/ay', 'delay': {'sd': '0.1 s'}, 'gain': {'sd': '10 %'}, 'noise': 3.0},
        # out of the pose, as the speed that is followed: none of them comes after another, and none has an offset
        'yaw_rate': {'channel': 'pose/yaw_rate', **EXACT, 'offset': {'sd': 'none'}},
        'lateral_velocity': {'channel': 'pose/vy', **EXACT, 'offset': {'sd': 'none'}, 'mounting': {'sd': 0.02}},
    },
    # masses lie near the middle of a car without overhangs: half of the yaw inertia of a similar passenger car
    known={'yaw_inertia': {'sd': '60 %'}},
    places={'lateral_velocity': (BASE - 0.115, -0.01)},
    window=5.0, run_in=1.0, slowest=0.4,
    # slow bends tell the steering, and fast ones the tires: of fast ones alone a fit takes either for the other
    fitted=(Cut(FAST_FREE, end=50.0), Cut(SLOW_FREE, end=38.0)),
    held_out=(Cut(FAST_FREE, 50.0), Cut(SLOW_FREE, 38.0), Cut(RAMP)),
)  # fmt: skip

VEHICLES: Sequence[Real] = (FERRARI, DART)
