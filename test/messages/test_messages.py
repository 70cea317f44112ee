"""Encoded messages: the same bytes as ROS makes, and every number of a snapshot in its place and frame."""

from __future__ import annotations

import struct
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from synthetic import INPUTS, WHEELS, channels, snapshot

from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.composition import TIRE_STATES
from mbd_sim_ros.messages.encode import PARTS, Messages, kinds_of
from mbd_sim_ros.messages.topics import IMU, ODOMETRY, TF, TYPE_HASHES, WRENCH
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.errors import BagError, StepError
from solver.files.scene import load_scene
from solver.model.evaluate import prepare
from solver.output.collect import channels_of
from solver.output.sensors import ImuSensor, OdomSensor, Sensors

COLUMN = {name: i for i, name in enumerate(TIRE_COLUMNS)}


@pytest.fixture
def decoded():
    """One asymmetric snapshot, its messages decoded by topic name."""
    names = channels()
    messages = Messages(names, element_states=True, reactions=True, frame_prefix='car/')
    shot = snapshot(names, k=700)
    encoded = messages.encode(shot)
    return shot, {
        t.name: cdr.decode(t.type, cdr.schema_text(t.type), data)[0]
        for t, data in zip(messages.topics, encoded, strict=True)
    }


def vector(value: dict, *names: str) -> np.ndarray:
    return np.array([value[name] for name in names])


def test_stamp_is_simulation_time(decoded):
    _, messages = decoded
    for name, message in messages.items():
        header = message['transforms'][0]['header'] if name == '/tf' else message['header']
        assert (header['stamp']['sec'], header['stamp']['nanosec']) == (1, 400_000_000)


@pytest.mark.parametrize(
    'sensors', [None, Sensors(odom=OdomSensor(position=0.5), imu=ImuSensor(rate=0.1), noise=True, seed=3)]
)
@pytest.mark.parametrize('vehicle', [True, False])
def test_topics_that_are_encoded_alone_have_the_same_bytes(vehicle: bool, sensors: Sensors | None) -> None:
    """In any order of selections and steps: those with all bodies and with elements are not at every one."""
    names = channels(vehicle=vehicle)
    both = [
        Messages(
            names,
            element_states=True,
            reactions=True,
            elements_every=2,
            poses_every=3,
            links=['a', 'base_link', 'c'],
            sensors=sensors,
        )
        for _ in range(2)
    ]
    topics, random = len(both[0].topics), np.random.default_rng(1)
    for k in range(200):
        only = tuple(np.flatnonzero(random.random(topics) < random.choice([0.1, 0.9])).tolist())
        whole = bool(random.random() < 0.2)
        expected = both[0].encode(snapshot(names, k), whole=whole)
        found = both[1].encode(snapshot(names, k), whole=whole, only=only)
        assert found == [data if i in only else None for i, data in enumerate(expected)]
    assert len(both[1]._parts) <= PARTS


def test_odometry_is_the_chassis_with_twist_in_base_link(decoded):
    shot, messages = decoded
    odom = messages['odom']
    assert odom['header']['frame_id'] == 'car/odom'
    assert odom['child_frame_id'] == 'car/base_link'
    pose = odom['pose']['pose']
    np.testing.assert_array_equal(vector(pose['position'], 'x', 'y', 'z'), shot.pose[1, :3])
    np.testing.assert_array_equal(vector(pose['orientation'], 'x', 'y', 'z', 'w'), shot.pose[1, 3:])
    twist = odom['twist']['twist']
    np.testing.assert_array_equal(vector(twist['linear'], 'x', 'y', 'z'), shot.twist[1, :3])
    np.testing.assert_array_equal(vector(twist['angular'], 'x', 'y', 'z'), shot.twist[1, 3:])


def test_imu_separates_specific_force_and_rate(decoded):
    shot, messages = decoded
    imu = messages['imu']
    assert imu['header']['frame_id'] == 'car/imu_link'
    np.testing.assert_array_equal(vector(imu['linear_acceleration'], 'x', 'y', 'z'), shot.imu[:3])
    np.testing.assert_array_equal(vector(imu['angular_velocity'], 'x', 'y', 'z'), shot.imu[3:])
    np.testing.assert_array_equal(vector(imu['orientation'], 'x', 'y', 'z', 'w'), shot.pose[1, 3:])


@pytest.mark.parametrize('i', range(4))
def test_tire_wrench_and_states_belong_to_their_wheel(decoded, i):
    shot, messages = decoded
    wheel = WHEELS[i]
    wrench = messages[f'tire/{wheel}/force']
    assert wrench['header']['frame_id'] == f'car/{wheel}_contact'
    np.testing.assert_array_equal(vector(wrench['wrench']['force'], 'x', 'y', 'z'), shot.tire[i, :3])
    np.testing.assert_array_equal(vector(wrench['wrench']['torque'], 'x', 'y', 'z'), shot.tire[i, 3:6])
    states = dict(zip(messages['tire_states']['name'], messages['tire_states']['position'], strict=True))
    for name in TIRE_STATES:
        assert states[f'{wheel}/{name}'] == shot.tire[i, COLUMN[name]]


def test_transforms_place_base_link_and_contact_frames_in_odom(decoded):
    shot, messages = decoded
    transforms = {t['child_frame_id']: t for t in messages['/tf']['transforms']}
    assert set(transforms) == {'car/base_link', *(f'car/{wheel}_contact' for wheel in WHEELS)}
    expected = {'car/base_link': shot.pose[1]} | {
        f'car/{w}_contact': shot.tire[i, COLUMN['px'] :] for i, w in enumerate(WHEELS)
    }
    for frame, pose in expected.items():
        assert transforms[frame]['header']['frame_id'] == 'car/odom'
        value = transforms[frame]['transform']
        np.testing.assert_array_equal(vector(value['translation'], 'x', 'y', 'z'), pose[:3])
        np.testing.assert_array_equal(vector(value['rotation'], 'x', 'y', 'z', 'w'), pose[3:])


def test_every_so_many_steps_all_bodies_are_placed_as_links_beside_the_sensor():
    names = channels()
    messages = Messages(names, poses_every=20, imu_at=(0.1, 0.0, 0.6), frame_prefix='car/')
    plain = Messages(names, frame_prefix='car/')
    for k in (0, 19, 20, 21, 40):
        shot = snapshot(names, k)
        *others, tf = messages.encode(shot)
        *before, short = plain.encode(shot)
        assert others == before
        if k % 20:
            assert tf == short
            continue
        value = cdr.decode(messages.topics[-1].type, cdr.schema_text(messages.topics[-1].type), tf)[0]
        transforms = {t['child_frame_id']: t for t in value['transforms']}
        bodies = {'car/base_link' if i == names.chassis else f'car/{name}': i for i, name in enumerate(names.bodies)}
        assert set(transforms) == {*bodies, *(f'car/{wheel}_contact' for wheel in WHEELS), 'car/imu_link'}
        for frame, i in bodies.items():
            assert transforms[frame]['header']['frame_id'] == 'car/odom'
            pose = transforms[frame]['transform']
            np.testing.assert_array_equal(vector(pose['translation'], 'x', 'y', 'z'), shot.pose[i, :3])
            np.testing.assert_array_equal(vector(pose['rotation'], 'x', 'y', 'z', 'w'), shot.pose[i, 3:])
        sensor = transforms['car/imu_link']
        assert sensor['header']['frame_id'] == 'car/base_link'
        np.testing.assert_array_equal(vector(sensor['transform']['translation'], 'x', 'y', 'z'), [0.1, 0.0, 0.6])
    assert messages.encode(snapshot(names, 1), whole=True)[-1] != plain.encode(snapshot(names, 1))[-1]


def test_elements_of_a_kind_have_a_topic_of_their_own():
    names = channels()
    messages, shot = (
        Messages(names, element_states=True, kinds={'spring': 'springs', 'damper': 'dampers'}),
        snapshot(names, 3),
    )
    found = {
        t.name: cdr.decode(t.type, cdr.schema_text(t.type), data)[0]
        for t, data in zip(messages.topics, messages.encode(shot))
    }
    told = {
        name: dict(zip(one['name'], one['position']))
        for name, one in found.items()
        if name.startswith('element_states')
    }
    spring = {'spring/energy': shot.elements[0], 'spring/force': shot.elements[1]}
    assert told == {'element_states/springs': spring, 'element_states/dampers': {'damper/force': shot.elements[2]}}


def test_every_element_of_a_scene_has_its_kind():
    """Springs and brakes of the car are apart, and nothing is left over."""
    model = load_scene('light_car_straight').model
    kinds = kinds_of(model)
    assert {s.name for s in model.spring_dampers} == {name for name, kind in kinds.items() if kind == 'spring_dampers'}
    assert {b.name for b in model.brakes} == {name for name, kind in kinds.items() if kind == 'brakes'}
    assert kinds.keys() == {name.rpartition('/')[0] for name in channels_of(prepare(model)).elements}


def test_joints_inputs_and_scalars_go_by_name(decoded):
    shot, messages = decoded
    for part, values in (
        ('position', shot.joint_position),
        ('velocity', shot.joint_velocity),
        ('effort', shot.joint_effort),
    ):
        np.testing.assert_array_equal(messages['joint_states'][part], values)
    assert messages['cmd_applied']['name'] == [*INPUTS, 'step']
    np.testing.assert_array_equal(messages['cmd_applied']['position'], [*shot.inputs, 700.0])
    np.testing.assert_array_equal(messages['element_states']['position'], shot.elements)
    np.testing.assert_array_equal(messages['reactions']['position'], shot.reactions)


def test_mechanism_without_chassis_has_no_vehicle_topics():
    names = channels(vehicle=False)
    messages = Messages(names)
    assert [topic.name for topic in messages.topics] == ['joint_states', 'cmd_applied']
    assert len(messages.encode(snapshot(names))) == 2
    placing = Messages(names, poses_every=3)
    assert [topic.name for topic in placing.topics] == ['joint_states', 'cmd_applied', '/tf']
    for k in range(4):
        assert (placing.encode(snapshot(names, k))[-1] is None) == (k % 3 != 0)


def test_bytes_are_independent_of_what_was_encoded_before():
    names = channels()
    used = Messages(names)
    used.encode(snapshot(names, 1))
    assert used.encode(snapshot(names, 2)) == Messages(names).encode(snapshot(names, 2))


@pytest.mark.parametrize(
    ('attribute', 'index', 'name'),
    [
        ('pose', (2, 0), 'wheel'),
        ('joint_velocity', 3, 'joint_3'),
        ('tire', (1, 4), 'front_right'),
        ('inputs', 4, 'brake_torque'),
    ],
)
@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_a_state_that_is_not_finite_is_refused_by_name_and_time(attribute, index, name, value):
    names = channels()
    shot = snapshot(names, 250)
    getattr(shot, attribute)[index] = value
    with pytest.raises(StepError, match=rf"'{name}'.*t = 0\.500000 s \(step 250\)"):
        Messages(names).encode(shot)


def test_huge_but_finite_states_pass():
    names = channels()
    shot = snapshot(names)
    shot.joint_effort[:] = 1e200  # its square overflows
    value = cdr.decode(
        'sensor_msgs/msg/JointState', cdr.schema_text('sensor_msgs/msg/JointState'), Messages(names).encode(shot)[0]
    )[0]
    np.testing.assert_array_equal(value['effort'], shot.joint_effort)


def test_decoding_inverts_encoding_for_strings_of_any_length():
    text = cdr.schema_text(TF)
    for length in range(9):
        value = {
            'transforms': [
                {'header': {'frame_id': 'a' * length}, 'child_frame_id': 'b', 'transform': {'rotation': {'w': 2.5}}}
            ]
            * 2
        }
        back, places = cdr.decode(TF, text, cdr.encode(TF, text, value)[0])
        assert back['transforms'][1]['header']['frame_id'] == 'a' * length
        assert back['transforms'][1]['transform']['rotation']['w'] == 2.5
        assert (places['transforms[1].transform.rotation.w'].offset - 4) % 8 == 0


def test_bounds_and_default_values_are_no_constants():
    schema = (
        'string<=10 name\nint32 MOST = 3  # x=1\nstring KEY="a=b"\nfloat64[<=3] x\nstring unit "k=v"\nfloat64 y '
        '0.5 # in m, y=0\n'
    )
    # a text of 3 bytes with its end, up to 8; 2 numbers from 16 to 32; a text of 2 up to 38; a number from 40 on
    text = struct.pack('<I3sxI4xddI2s2xd', 3, b'ab', 2, 1.0, 2.0, 2, b'm', 3.0)
    value, places = cdr.decode('a/msg/B', schema, cdr.ENCAPSULATION + text)
    assert list(value) == ['name', 'x', 'unit', 'y']
    assert (value['name'], value['x'].tolist(), value['unit'], value['y']) == ('ab', [1.0, 2.0], 'm', 3.0)
    assert places['y'].offset == 4 + 40


def test_short_or_foreign_messages_are_refused():
    text = cdr.schema_text(IMU)
    data, _ = cdr.encode(IMU, text, {})
    with pytest.raises(BagError, match='shorter than its schema'):
        cdr.decode(IMU, text, data[:-8])
    with pytest.raises(BagError, match='longer than its schema'):
        cdr.decode(IMU, text, data + bytes(9))
    with pytest.raises(BagError, match='not plain little-endian CDR'):
        cdr.decode(IMU, text, b'\x00\x00' + data[2:])


@pytest.mark.parametrize('name', TYPE_HASHES)
def test_the_schema_of_a_recording_has_the_type_hash_beside_it(name):
    """A reader that knows nothing but the bag finds the type that the channel names (REP-2016)."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    for part in cdr.schema_text(name).split('=' * 80 + '\n'):
        head, _, rest = part.partition('\n')
        kind, text = (head.removeprefix('MSG: '), rest) if head.startswith('MSG: ') else (name, part)
        store.register(get_types_from_msg(text, kind.replace('/msg/', '/').replace('/', '/msg/')))
    assert store.hash_rihs01(name) == TYPE_HASHES[name]


class TestAgainstRos:
    """Only where rclpy is installed."""

    @pytest.fixture(autouse=True)
    def ros(self):
        pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')

    def test_bytes_equal_those_of_ros_except_padding(self, monkeypatch):
        from rclpy.serialization import deserialize_message, serialize_message

        from mbd_sim_ros.node.publish import message_class

        names = channels()
        messages = Messages(names, element_states=True, reactions=True)
        encoded = messages.encode(snapshot(names, 3))
        # Which bytes are padding shows when the same messages are made with other filling; ROS leaves garbage there.
        monkeypatch.setattr(cdr._Encode, 'align', _align_with_ones)
        filled = Messages(names, element_states=True, reactions=True).encode(snapshot(names, 3))
        for topic, data, other in zip(messages.topics, encoded, filled, strict=True):
            if topic.type == TF:
                continue  # tf2_msgs is not in the wheels; its parts are tested below
            kind = message_class(topic.type)
            theirs = np.frombuffer(serialize_message(deserialize_message(data, kind)), np.uint8)
            ours, real = np.frombuffer(data, np.uint8), np.frombuffer(data, np.uint8) == np.frombuffer(other, np.uint8)
            # ROS sizes its buffer by an estimate, which may leave up to 8 bytes per empty sequence behind the message.
            assert 0 <= theirs.size - ours.size <= 16, topic
            np.testing.assert_array_equal(ours[real], theirs[: ours.size][real], err_msg=topic.name)
            assert np.count_nonzero(~real) < 0.25 * ours.size  # most of a message is not padding

    def test_ros_reads_the_same_numbers(self):
        from rclpy.serialization import deserialize_message

        from mbd_sim_ros.node.publish import assign, message_class

        names = channels()
        messages = Messages(names)
        for topic, data in zip(messages.topics, messages.encode(snapshot(names, 3)), strict=True):
            if topic.type != TF:
                kind = message_class(topic.type)
                assert deserialize_message(data, kind) == assign(
                    kind(), cdr.decode(topic.type, cdr.schema_text(topic.type), data)[0]
                )

    def test_every_field_kind_of_a_diagnostic_array_survives(self):
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
        from rclpy.serialization import serialize_message

        from mbd_sim_ros.node.publish import assign

        share = _share('diagnostic_msgs')
        line = '=' * 80 + '\n'
        parts = [(share / f'{name}.msg').read_text() for name in ('DiagnosticArray', 'DiagnosticStatus', 'KeyValue')]
        header = cdr.schema_text(WRENCH).split(line)  # holds Header and Time
        header = [part for part in header if part.startswith(('MSG: std_msgs/Header', 'MSG: builtin_interfaces/Time'))]
        text = line.join(
            [
                parts[0],
                f'MSG: diagnostic_msgs/DiagnosticStatus\n{parts[1]}',
                f'MSG: diagnostic_msgs/KeyValue\n{parts[2]}',
                *header,
            ]
        )
        status = DiagnosticStatus(
            level=b'\x02', name='n', message='mm', values=[KeyValue(key='k', value='vv'), KeyValue(key='', value='x')]
        )
        sent = DiagnosticArray(status=[status, DiagnosticStatus(name='other')])
        value, _ = cdr.decode('diagnostic_msgs/msg/DiagnosticArray', text, serialize_message(sent))
        for one in value['status']:
            one['level'] = bytes([one['level']])
        assert assign(DiagnosticArray(), value) == sent

    def test_shipped_definitions_and_hashes_are_those_of_the_installation(self):
        import json

        root = Path(cdr.__file__).parent / 'schemas'
        compared = 0
        for path in sorted(root.glob('*/*.msg')):
            if path.parent.name == 'tf2_msgs':
                continue
            assert _lines(path) == _lines(_share(path.parent.name) / path.name), path
            compared += 1
        assert compared >= 15
        for name, type_hash in TYPE_HASHES.items():
            package, kind = name.split('/msg/')
            if package != 'tf2_msgs':
                hashes = json.loads((_share(package) / f'{kind}.json').read_text())['type_hashes']
                assert {h['type_name']: h['hash_string'] for h in hashes}[name] == type_hash

    def test_transform_hash_follows_from_its_definition(self):
        """REP-2016: the hash is that of the type description; it is made here for TFMessage, which the wheels do not
        have."""
        import json

        generator = pytest.importorskip(
            'rosidl_generator_type_description', reason='not among the packages of this ROS'
        )
        stamped = json.loads((_share('geometry_msgs') / 'TransformStamped.json').read_text())['type_description_msg']
        kind = {
            'type_id': 145,
            'capacity': 0,
            'string_capacity': 0,
            'nested_type_name': 'geometry_msgs/msg/TransformStamped',
        }
        description = {
            'type_description': {
                'type_name': TF,
                'fields': [{'name': 'transforms', 'type': kind, 'default_value': ''}],
            },
            'referenced_type_descriptions': sorted(
                [*stamped['referenced_type_descriptions'], stamped['type_description']],
                key=lambda one: one['type_name'],
            ),
        }
        assert generator.calculate_type_hash(description) == TYPE_HASHES[TF]


def _align_with_ones(self, size: int) -> None:
    self.data += b'\xff' * (-(len(self.data) - 4) % size)


def _lines(path: Path) -> list[list[str]]:
    """Words of each line of a definition without its comments: types, names, order and default values."""
    return [words for line in path.read_text().splitlines() if (words := line.split('#')[0].split())]


def _share(package: str) -> Path:
    # lib/pythonX.Y/site-packages/<package>/__init__.py and share/<package> have one prefix, in /opt/ros as in the
    # wheels.
    return Path(import_module(package).__file__).parents[4] / 'share' / package / 'msg'


def test_odometry_type_has_the_fields_the_reader_names():
    _, places = cdr.encode(ODOMETRY, cdr.schema_text(ODOMETRY), {})
    start = list(places).index('twist.twist.linear.x')
    assert [path.rsplit('.', 2)[1:] for path in list(places)[start : start + 6]] == [
        [part, axis] for part in ('linear', 'angular') for axis in 'xyz'
    ]
