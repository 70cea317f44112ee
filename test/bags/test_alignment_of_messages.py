"""Messages of writers that align from the start of the buffer, encapsulation included, where CDR counts from behind
it."""

from __future__ import annotations

import struct
from pathlib import Path

import foreign_bags as others
import pytest
from foreign_bags import DAY, FLOAT, MS, VECTOR, Message

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.topics import JOINT_STATE
from solver.errors import BagError

TOLD = 'its messages are aligned from the start of the buffer, against CDR, and are read so'


def by_hand(stamp: int, x: float, z: float, surplus: bytes = b'') -> bytes:
    """A Vector3Stamped with an empty frame: 4 bytes encapsulation, stamp at 4, length of the text at 12, its end at 16,
    numbers at 24."""
    return b'\0\1\0\0' + struct.pack('<iIIx7xddd', stamp // 10**9, stamp % 10**9, 1, x, 0.0, z) + surplus


@pytest.mark.parametrize('surplus', [0, 3])
def test_they_are_read_as_they_were_written_and_told_once(surplus: int, tmp_path: Path) -> None:
    messages = [
        Message('/yaw', VECTOR, DAY + k * MS, 0, by_hand(DAY + k * MS, 0.0, 0.0 if k < 2 else 0.2 * k, bytes(surplus)))
        for k in range(50)
    ]
    run = bag.read(others.write(tmp_path / 'bag', messages))
    assert run['yaw/vector/z'].tolist() == [0.0, 0.0, *(0.2 * k for k in range(2, 50))]
    assert run.time_ns.tolist() == [DAY + k * MS for k in range(50)]
    assert run.doubts == (f'topic yaw: {TOLD}',)


@pytest.mark.parametrize(
    ('kind', 'value', 'column'),
    [
        (FLOAT, lambda k: {'data': 0.1 + k}, 'data'),
        (JOINT_STATE, lambda k: {'header': others.stamped(DAY + k * MS), 'name': ['a', 'bcd'], 'position': [7.0,
        0.1 + k]}, 'bcd'),
        ('geometry_msgs/msg/Twist', lambda k: {'linear': {'x': 3.3}, 'angular': {'z': 0.1 + k}}, 'angular/z'),
        # one of which CDR needs more bytes than its writer spent:
        (
            'geometry_msgs/msg/QuaternionStamped',
            lambda k: {'header': others.stamped(DAY + k * MS, 'map'), 'quaternion': {'w': 0.1 + k}},
            'quaternion/w',
        ),
    ],
)  # fmt: skip
def test_so_are_those_of_other_types(
    kind: str, value, column: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(cdr, 'BEHIND_IT', 0)
        data = [cdr.encode(kind, others.definition(kind), value(k))[0] for k in range(30)]
    right = cdr.encode(kind, others.definition(kind), value(0))[0]
    assert abs(len(right) - len(data[0])) == 4
    run = bag.read(
        others.write(tmp_path / 'bag', [Message('/t', kind, DAY + k * MS, 0, one) for k, one in enumerate(data)])
    )
    assert run[f't/{column}'].tolist() == [0.1 + k for k in range(30)]
    assert run.doubts == (f'topic t: {TOLD}',)


def test_zeros_at_their_end_do_not_hide_them(tmp_path: Path) -> None:
    messages = [Message('/v', VECTOR, DAY + k, 0, by_hand(DAY + k, 0.25 * k, 0.0)) for k in range(9)]
    run = bag.read(others.write(tmp_path / 'bag', messages))
    assert run['v/vector/x'].tolist() == [0.25 * k for k in range(9)] and run.doubts == (f'topic v: {TOLD}',)


@pytest.mark.parametrize('surplus', range(4))
def test_surplus_of_three_bytes_is_padding(surplus: int, tmp_path: Path) -> None:
    messages = [
        m._replace(data=m.data + b'\7' * surplus)
        for m in (others.vector('/v', DAY + k, 0, DAY + k, 0.1 * k) for k in range(9))
    ]
    run = bag.read(others.write(tmp_path / 'bag', messages))
    assert run['v/vector/z'].tolist() == [0.1 * k for k in range(9)] and not run.doubts


@pytest.mark.parametrize(
    ('surplus', 'text'),
    [(bytes(4), 'or zeros follow their data'), (bytes(5), 'or zeros follow their data'), (bytes(8), '8 longer than')],
)
def test_more_that_fits_neither_way_is_left_out_and_counted(surplus: bytes, text: str, tmp_path: Path) -> None:
    messages = [
        m._replace(data=m.data + surplus) for m in (others.vector('/v', DAY + k, 0, DAY + k, 0.5 * k) for k in range(9))
    ]
    run = bag.read(others.write(tmp_path / 'bag', [*messages, others.scalar('/s', DAY, 0, 1.0)]))
    assert text in run.left_out['v'] and run.passed == {'v': 9} and 'v' not in run.series


def test_numbers_are_never_taken_for_padding(tmp_path: Path) -> None:
    """A definition that lacks a last field of 4 bytes: alignment from the start would fit, and skip half of the first
    number."""
    value = {'header': others.stamped(DAY), 'vector': {'x': 0.1, 'y': 0.2, 'z': 0.3}}
    data = cdr.encode(VECTOR, others.definition(VECTOR), value)[0] + b'\1\2\3\4'
    with pytest.raises(BagError, match='4 longer than its schema asks for'):
        bag.read(others.write(tmp_path / 'bag', [Message('/v', VECTOR, DAY, 0, data)]))


def test_a_topic_is_read_in_one_way(tmp_path: Path) -> None:
    messages = [others.vector('/v', DAY + k, 0, DAY + k, 0.1) for k in range(5)]
    messages.append(Message('/v', VECTOR, DAY + 5, 0, by_hand(DAY + 5, 0.1, 0.2)))
    with pytest.raises(BagError, match='one of its messages cannot be read: a message of 48 bytes'):
        bag.read(others.write(tmp_path / 'bag', messages))
