"""A recording as a measured car gives it, made from a simulation: other names, rates, units and axes, stamps with the
time of day, noise.

    python bags/real_car.py bags/real_car --seed 7

The full car is driven through the step steer of the scene car_step_steer, recorded at every step, and sensors read it:

| topic | type | rate | what | |---|---|---|---| | vehicle/imu | sensor_msgs/Imu | 100 Hz, stamps scatter by 0.2 ms | x
forward, y right, z down; its lateral axis reads 2 % too much | | can/steering_wheel_angle | std_msgs/Float64 | 100 Hz |
deg | | can/yaw_rate | std_msgs/Float64 | 50 Hz | deg/s | | can/speed | std_msgs/Float64 | 20 Hz | km/h |

The recorder was switched on 0.137 s after the simulation begins. Everything random follows from the seed.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from mbd_sim_ros.bags import reader
from mbd_sim_ros.bags.writer import BagWriter
from mbd_sim_ros.batch import simulate
from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.topics import IMU, Topic
from solver import load_scene, simulation_of
from solver.errors import BagError

FLOAT = 'std_msgs/msg/Float64'
FLOAT_TEXT = 'float64 data\n'
SWITCHED_ON = 1_763_000_000 * 10**9  # ns, a stamp with the time of day
LATE = 0.137  # s that the recorder was switched on after the simulation began
DURATION = 5.0  # s of the simulation
GAIN = 1.02  # of the accelerometer's lateral axis, which should be 1
SCATTER = 2e-4  # s, of the stamps of the IMU
GYROSCOPE, ACCELEROMETER = np.radians(0.05), 0.02  # noise, rad/s and m/s^2
# topic: channel of the simulation, factor to its unit, rate [Hz], noise in its unit
CAN = {
    'can/steering_wheel_angle': ('joint_states/steering_wheel/position', 180.0 / np.pi, 100.0, 0.1),
    'can/yaw_rate': ('odom/twist/wz', 180.0 / np.pi, 50.0, 0.05),
    'can/speed': ('odom/twist/vx', 3.6, 20.0, 0.05),
}


def driven() -> reader.Run:
    """The drive, every millisecond."""
    simulation = simulation_of(
        load_scene('car_step_steer', (f'duration={DURATION}', 'record.every=1', 'record.elements=false'))
    )
    with tempfile.TemporaryDirectory() as place:
        simulate(simulation, simulation.scene.steps, directory=Path(place) / 'drive')
        return reader.read(Path(place) / 'drive', ['imu/*', *(channel for channel, *_ in CAN.values())])


def measure(run: reader.Run, directory: Path, seed: int) -> Path:
    """Write what the sensors read. Raises BagError when the directory cannot be written."""
    rng = np.random.default_rng(seed)

    def read(channel: str, t: np.ndarray, noise: float, factor: float = 1.0) -> np.ndarray:
        one = next(series for series in run.series.values() if channel in series.columns)
        return factor * np.interp(t + LATE, one.time_ns * 1e-9, one.columns[channel]) + noise * rng.standard_normal(
            t.size
        )

    t = np.arange(0.0, DURATION - LATE, 0.01)
    t[1:] += SCATTER * rng.standard_normal(t.size - 1)
    down = {'x': 1.0, 'y': -1.0, 'z': -1.0}  # our axes, x forward, y left, z up, turned by 180 deg about x
    gain = {'x': 1.0, 'y': GAIN, 'z': 1.0}
    rates = {axis: read(f'imu/w{axis}', t, GYROSCOPE, sign) for axis, sign in down.items()}
    forces = {axis: read(f'imu/a{axis}', t, ACCELEROMETER, sign * gain[axis]) for axis, sign in down.items()}
    text = cdr.schema_text(IMU)
    unknown = [-1.0, *[0.0] * 8]  # this IMU gives no orientation
    messages = []
    for k, stamp in enumerate(_stamps(t)):
        value = {
            'header': {'stamp': {'sec': stamp // 10**9, 'nanosec': stamp % 10**9}, 'frame_id': 'imu_ned'},
            'orientation_covariance': unknown,
            'angular_velocity': {axis: float(rates[axis][k]) for axis in 'xyz'},
            'linear_acceleration': {axis: float(forces[axis][k]) for axis in 'xyz'},
        }
        messages.append((stamp, 0, cdr.encode(IMU, text, value)[0]))
    for i, (channel, factor, rate, noise) in enumerate(CAN.values(), 1):
        t = np.arange(0.0, DURATION - LATE, 1.0 / rate)
        for stamp, value in zip(_stamps(t), read(channel, t, noise, factor), strict=True):
            messages.append((stamp, i, cdr.encode(FLOAT, FLOAT_TEXT, {'data': float(value)})[0]))
    topics = [Topic('vehicle/imu', IMU), *(Topic(name, FLOAT) for name in CAN)]
    writer = BagWriter(directory, topics, {}, schemas={FLOAT: FLOAT_TEXT})
    for stamp, i, message in sorted(messages):
        writer.write(stamp, [(i, message)])
    return writer.finish()


def _stamps(t: np.ndarray) -> list[int]:
    return [SWITCHED_ON + round(float(s) * 1e9) for s in t]


def main() -> None:
    """Drive, measure, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').partition('\n')[0])
    parser.add_argument('directory', type=Path, help='where the recording goes; it must not exist')
    parser.add_argument('--seed', type=int, required=True)
    args = parser.parse_args()
    try:
        print(measure(driven(), args.directory, args.seed))
    except BagError as error:
        raise SystemExit(str(error)) from None


if __name__ == '__main__':
    main()
