"""Where the bodies were is in the recording, at a rate of its own."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from synthetic import channels

from mbd_sim_ros.bags.poses import read_poses
from mbd_sim_ros.bags.writer import BagWriter
from mbd_sim_ros.batch import simulate
from mbd_sim_ros.messages.encode import Messages
from solver import load_scene, simulation_of
from solver.errors import BagError, SpecError
from solver.scene import Record


@pytest.mark.parametrize(
    ('scene', 'h', 'rate', 'every'),
    [('slider_crank', 0.002, 25.0, 3), ('light_car_straight', 0.001, 100.0, 1), ('four_bar', 0.005, 100.0, 1)],
)
def test_the_poses_in_a_recording_are_those_of_the_snapshots(scene, h, rate, every, tmp_path: Path):
    overrides = ['duration=0.1', f'integrator.h={h}', f'record.poses={rate}', f'record.every={every}']
    simulation = simulation_of(load_scene(scene, overrides))
    simulate(simulation, simulation.scene.steps, directory=tmp_path / 'run')
    found = read_poses(tmp_path / 'run')
    apart = simulation.scene.record.poses_every(h)
    assert apart % every == 0
    assert apart * h * rate >= 1.0 - 1e-9 > (apart - every) * h * rate
    assert found.time_ns.tolist() == [k * simulation.h_ns for k in range(0, simulation.scene.steps + 1, apart)]
    names = simulation.channels.bodies
    simulation.reset()
    for i in range(len(found.time_ns)):
        pose = simulation.snapshot().pose
        for b, name in enumerate(names):
            frame = 'base_link' if name == simulation.scene.model.chassis else name
            np.testing.assert_array_equal(found.pose[i, found.frames.index(frame)], pose[b])
        if i + 1 < len(found.time_ns):
            simulation.advance(apart)
    links = {link.attrib['name'] for link in ElementTree.fromstring(simulation.urdf()).findall('link')}
    contacts = {f'{wheel}_contact' for wheel in simulation.channels.wheels}
    assert links - {'odom', 'imu_link'} - {name for name in links if name.endswith('/axis')} <= set(
        found.frames
    )  # all that is shown is placed
    if simulation.scene.model.chassis is not None:
        assert set(found.frames) - contacts <= links
        assert 'imu_link' in links


def test_without_poses_the_reader_tells_what_there_is(tmp_path: Path):
    simulation = simulation_of(load_scene('four_bar', ['duration=0.01', 'record.poses=0']))
    simulate(simulation, simulation.scene.steps, directory=tmp_path / 'run')
    assert read_poses(tmp_path / 'run').frames == ('base_link',)  # the body that odom describes
    writer = BagWriter(tmp_path / 'none', Messages(channels(vehicle=False)).topics, {})
    writer.finish()
    with pytest.raises(BagError, match=r'/tf is missing.*record\.poses'):
        read_poses(tmp_path / 'none')


def test_a_rate_above_100_is_refused():
    with pytest.raises(SpecError, match='poses'):
        Record(poses=101.0)
