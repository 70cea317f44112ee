"""Arrays of a scene in a recording: attachments by their hash, found again where nothing else has them."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.bags import reader
from mbd_sim_ros.bags.recorder import Recorder, describe
from mbd_sim_ros.bags.recovery import recover
from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.topics import JOINT_STATE, Topic
from solver import stored
from solver.errors import BagError

HEIGHTS = np.random.default_rng(6).normal(size=(300, 7)).astype(np.float32)


@pytest.fixture
def recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, str]:
    """A bag whose scene names arrays, and their hash."""
    monkeypatch.setenv('MBD_CACHE_DIR', str(tmp_path / 'cache'))
    digest = stored.keep({'height': HEIGHTS, 'v': np.arange(7.0)})
    header = {'stamp': {'sec': 0, 'nanosec': 0}, 'frame_id': ''}
    data = cdr.encode(JOINT_STATE, cdr.schema_text(JOINT_STATE), {'header': header, 'name': ['a'], 'position': [1.0]})[
        0
    ]
    with Recorder(
        tmp_path / 'run', [Topic('a', JOINT_STATE)], describe(scene='s', resolved_yaml=f"sha256: '{digest}'\n")
    ) as recorder:
        recorder.write(0, [data])
    return tmp_path / 'run', digest


def forget(tmp_path: Path) -> None:
    """Leave no trace of arrays, as on another machine."""
    stored._known.clear()
    for file in (tmp_path / 'cache' / 'arrays').glob('*'):
        file.unlink()


def test_a_recording_brings_its_arrays(tmp_path: Path, recorded: tuple[Path, str]) -> None:
    bag, digest = recorded
    forget(tmp_path)
    assert stored.find(digest) is None
    reader.read(bag)
    found = stored.find(digest)
    assert found is not None
    np.testing.assert_array_equal(found['height'], HEIGHTS)
    assert found['height'].dtype == np.float32
    stored._known.clear()  # another process on this machine
    assert stored.find(digest) is not None


def test_a_recovered_recording_brings_them_too(tmp_path: Path, recorded: tuple[Path, str]) -> None:
    bag, digest = recorded
    (file,) = bag.glob('*.mcap')
    file.write_bytes(file.read_bytes()[:-200])  # cut off in its summary
    forget(tmp_path)
    recover(bag, tmp_path / 'saved')
    forget(tmp_path)
    reader.read(tmp_path / 'saved')
    assert stored.find(digest) is not None


def test_damaged_arrays_are_told(tmp_path: Path, recorded: tuple[Path, str]) -> None:
    bag, digest = recorded
    (file,) = bag.glob('*.mcap')
    data = bytearray(file.read_bytes())
    data[data.index(b'mbd arrays 1') + 200] ^= 1
    file.write_bytes(data)
    forget(tmp_path)
    with pytest.raises(BagError, match=r'is cut off or damaged \(the attachment at byte \d+ cannot be read'):
        reader.read(bag)
    assert stored.find(digest) is None


def test_attachments_of_others_are_passed_over(tmp_path: Path, recorded: tuple[Path, str]) -> None:
    """One with another media type, a short one, and one that claims to be longer than it is."""
    bag, _ = recorded
    (file,) = bag.glob('*.mcap')
    data = file.read_bytes()
    for media, body, size in (
        ('image/png', b'x' * 300, 300),
        ('text/plain', b'', 0),
        ('application/x-mbd-arrays', b'y' * 50, 1 << 40),
    ):
        words = [b'f' * 64, media.encode()]
        record = (
            bytes(16) + b''.join(struct.pack('<I', len(word)) + word for word in words) + struct.pack('<Q', size) + body
        )
        record += struct.pack('<I', zlib.crc32(record))
        inserted = data[:8] + _begin(data) + struct.pack('<BQ', 9, len(record)) + record + data[8 + len(_begin(data)) :]
        other = tmp_path / f'{len(media)}.mcap'
        other.write_bytes(_without_end(inserted))
        recover(other, tmp_path / f'saved{len(media)}')


def _begin(data: bytes) -> bytes:
    """The header record of a file."""
    return data[8 : 8 + 9 + struct.unpack_from('<Q', data, 9)[0]]


def _without_end(data: bytes) -> bytes:
    """A file that was cut off before its footer, so that no offsets are wrong."""
    return data[:-100]
