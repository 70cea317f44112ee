"""Damaged and crafted recordings: one sentence, in time, within memory; what can be saved is saved, and what is lost is
said."""

from __future__ import annotations

import json
import struct
import time
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType
from scalars import write_mcap, write_scalars

from mbd_sim_ros.analysis import runs
from mbd_sim_ros.bags import columns, records
from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.bags.inputs import content, inputs_of
from mbd_sim_ros.bags.recovery import recover
from mbd_sim_ros.bags.writer import RECORD
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.topics import JOINT_STATE
from solver.errors import BagError

MS = 1_000_000
OPCODE_CHUNK = 6


def good(directory: Path, n: int = 16_000) -> Path:
    t = np.arange(n) * MS
    return (
        write_scalars(directory, {'s': (t, {'v': np.sin(t * 1e-9), 'w': np.cos(t * 1e-9)})})
        / f'{directory.name}_0.mcap'
    )


def places(data: bytes) -> list[tuple[int, int]]:
    """(byte, opcode) of every record of a file."""
    at, found = len(records.MAGIC), []
    while at + 9 <= len(data) - len(records.MAGIC):
        opcode, length = struct.unpack_from('<BQ', data, at)
        found.append((at, opcode))
        at += 9 + length
    return found


def one_sentence(error: BaseException) -> str:
    text = str(error)
    assert '\n' not in text and len(text) < 500
    return text


def joint_state(k: int, names: list[str], values: list[float]) -> bytes:
    return cdr.encode(JOINT_STATE, cdr.schema_text(JOINT_STATE), {'name': names, 'position': values})[0]


@pytest.mark.parametrize('bit', range(8))
def test_a_flipped_bit_in_the_opcode_of_a_chunk_is_noticed_and_the_others_are_saved(bit: int, tmp_path: Path) -> None:
    file = good(tmp_path / 'good')
    whole = bag.read(file)
    data = bytearray(file.read_bytes())
    chunks = [at for at, opcode in places(data) if opcode == OPCODE_CHUNK]
    assert len(chunks) >= 3
    data[chunks[1]] ^= 1 << bit
    bad = tmp_path / 'bad.mcap'
    bad.write_bytes(data)
    with pytest.raises(BagError, match='cut off or damaged') as caught:
        bag.read(bad)
    one_sentence(caught.value)
    saved = recover(bad, tmp_path / 'saved')
    assert not saved.complete and saved.lost > 0
    assert saved.messages + saved.lost == whole.time_ns.size
    found = bag.read(tmp_path / 'saved')
    assert np.isin(found.time_ns, whole.time_ns).all() and found.time_ns[-1] == whole.time_ns[-1]
    np.testing.assert_array_equal(found['s/v'], whole['s/v'][np.isin(whole.time_ns, found.time_ns)])
    assert found.metadata['damage'] == '; '.join(saved.damage)


def test_what_is_lost_is_said_by_the_command(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = good(tmp_path / 'good')
    data = bytearray(file.read_bytes())
    data[next(at for at, opcode in places(data) if opcode == OPCODE_CHUNK)] = 7
    file.write_bytes(data)
    assert main(['recover', str(file), str(tmp_path / 'saved'), '--json']) == 0
    told = json.loads(capfd.readouterr().out)
    assert told['complete'] is False and told['lost'] > 0 and 'were found' in told['damage'][0]
    assert main(['recover', str(file), str(tmp_path / 'again')]) == 0
    assert 'cut off or damaged: it says that it holds 16000 messages' in capfd.readouterr().out


def test_every_byte_of_our_recordings_is_under_a_checksum(tmp_path: Path) -> None:
    """A flipped bit anywhere, in the description of the run as well, is noticed or the file is refused."""
    file = good(tmp_path / 'good', 300)
    data = file.read_bytes()
    rng = np.random.default_rng(3)
    bad = tmp_path / 'bad.mcap'
    edges = [at + k for at, _ in places(data) for k in range(9)]
    for at in (*edges, *range(len(data) - 60, len(data)), *rng.integers(len(data), size=300)):
        changed = bytearray(data)
        changed[at] ^= 1 << int(rng.integers(8))
        bad.write_bytes(changed)
        with pytest.raises(BagError) as caught:
            bag.read(bad)
        one_sentence(caught.value)


LINE = '=' * 80
DOUBLING = (
    'x/T1 a\nx/T1 b\n'
    + ''.join(f'{LINE}\nMSG: x/T{k}\nx/T{k + 1} a\nx/T{k + 1} b\n' for k in range(1, 31))
    + f'{LINE}\nMSG: x/T31\n'
)
CRAFTED = {
    'a type that contains itself': ('x/A a\n', 'x/msg/A', b'\0\1\0\0'),
    'types that double': (DOUBLING, 'x/msg/A', b'\0\1\0\0'),
    'a type that is not there': ('x/B b\n', 'x/msg/A', b'\0\1\0\0' + bytes(8)),
    'a definition that is not UTF-8': (b'\xff\xfe float64 x', 'x/msg/A', b'\0\1\0\0' + bytes(8)),
    'a count of 2^32-1 of messages': ('x/B[] b\n' + LINE + ('\nMSG: x/B\nfloat64 '
        'x\n'), 'x/msg/A', b'\0\1\0\0' + b'\xff' * 4),
    'a count of 2^32-1 of texts': ('string[] b\n', 'x/msg/A', b'\0\1\0\0' + b'\xff' * 4),
    'a count of 2^32-1 of numbers': ('float64[] b\n', 'x/msg/A', b'\0\1\0\0' + b'\xff' * 4),
    'a million numbers': ('float64[1000000] b\n', 'x/msg/A', b'\0\1\0\0' + bytes(8_000_004)),
    'a fixed array of nothing': ('x/B[999999999] b\n' + LINE + '\nMSG: x/B\n', 'x/msg/A', b'\0\1\0\0'),
    'a text that is not UTF-8': ('string a\nfloat64 x\n', 'x/msg/A', b'\0\1\0\0\3\0\0\0\xff\xff\0\0' + bytes(20)),
    'another JointState': ('float64 x\n', JOINT_STATE, b'\0\1\0\0' + bytes(12)),
    'a text of 16 bit': ('wstring a\nfloat64 x\n', 'x/msg/A', b'\0\1\0\0' + bytes(20)),
}  # fmt: skip


@pytest.mark.parametrize('name', CRAFTED)
def test_crafted_types_leave_one_topic_out(name: str, tmp_path: Path) -> None:
    schema, kind, message = CRAFTED[name]
    fine = ('/fine', JOINT_STATE, cdr.schema_text(JOINT_STATE), [(5, joint_state(5, ['v'], [1.0]))])
    file = write_mcap(tmp_path / 'a.mcap', [fine, ('/odd', kind, schema, [(1, message), (2, message)])])
    tracemalloc.start()
    begin = time.process_time()
    run = bag.read(file)
    assert time.process_time() - begin < 5.0
    assert tracemalloc.get_traced_memory()[1] < 1e8
    tracemalloc.stop()
    assert run['fine/v'].tolist() == [1.0]
    assert '\n' not in run.left_out['odd'] and len(run.left_out['odd']) < 200


@pytest.mark.parametrize(
    ('names', 'values', 'why'),
    [(['a', 'a'], [1.0, 2.0], "names 'a' twice"), (['a', 'b', 'c'], [1.0, 2.0], '3 names and 2 values of position')],
)
def test_no_value_is_dropped_for_want_of_a_name(
    names: list[str], values: list[float], why: str, tmp_path: Path
) -> None:
    file = write_mcap(
        tmp_path / 'a.mcap', [('/s', JOINT_STATE, cdr.schema_text(JOINT_STATE), [(1, joint_state(1, names, values))])]
    )
    with pytest.raises(BagError, match=why):
        bag.read(file)


def test_topics_that_others_encode_are_named(tmp_path: Path) -> None:
    from mcap.writer import Writer

    file = tmp_path / 'a.mcap'
    with file.open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='', library='test')
        schema = writer.register_schema('x', 'jsonschema', b'{}')
        channel = writer.register_channel('/json', 'json', schema)
        writer.add_message(channel, 1, b'{}', 1)
        writer.finish()
    with pytest.raises(BagError, match=r"topic json: its messages are encoded as 'json', not as cdr"):
        bag.read(file)
    with pytest.raises(BagError, match='nothing can be recovered: topic /json: its messages are encoded'):
        recover(file, tmp_path / 'saved')


def test_messages_of_a_channel_that_is_not_declared_are_named(tmp_path: Path) -> None:
    from mcap.writer import Writer

    file = tmp_path / 'a.mcap'
    with file.open('wb') as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile='ros2', library='test')
        schema = writer.register_schema(JOINT_STATE, 'ros2msg', cdr.schema_text(JOINT_STATE).encode())
        good, other = writer.register_channel('/s', 'cdr', schema), writer.register_channel('/json', 'json', schema)
        for channel in (good, other, 9):
            writer.add_message(channel, MS, joint_state(0, ['v'], [1.0]), MS)
        writer.finish()
    with pytest.raises(
        BagError, match=r'a\.mcap is damaged: it holds messages of channel 9, which it does not declare'
    ):
        content(file)
    assert recover(file, tmp_path / 'saved').left_out.keys() == {'/json', 'channel 9'}


def test_a_message_dated_beyond_63_bits_is_refused(tmp_path: Path) -> None:
    text = cdr.schema_text(JOINT_STATE)
    file = write_mcap(tmp_path / 'a.mcap', [('/s', JOINT_STATE, text, [(2**64 - 1, joint_state(0, ['v'], [1.0]))])])
    with pytest.raises(BagError, match=r'dated 18446744073709551615 ns'):
        bag.read(file)


def bomb(file: Path, size: int, *, chunks: int = 3, content: bytes = b'\0') -> Path:
    """A file whose few chunks of `content`, over and over, inflate to `size` bytes each."""
    inflated = (content * (size // len(content) + 1))[:size]
    packed = zstandard.compress(inflated)
    body = (
        struct.pack('<QQQII', 0, 1, size, zlib.crc32(inflated), 4) + b'zstd' + struct.pack('<Q', len(packed)) + packed
    )
    header = struct.pack('<BQ', 1, 8) + bytes(8)
    file.write_bytes(records.MAGIC + header + chunks * (struct.pack('<BQ', OPCODE_CHUNK, len(body)) + body))
    return file


def test_chunks_that_inflate_are_refused_before_they_do(tmp_path: Path) -> None:
    big = bomb(tmp_path / 'big.mcap', 1 << 28)
    assert big.stat().st_size < 1 << 17
    tracemalloc.start()
    with pytest.raises(BagError, match='claims to hold 268435456 bytes'):
        bag.read(big)
    with pytest.raises(BagError, match='nothing can be recovered'):
        recover(big, tmp_path / 'saved')
    assert tracemalloc.get_traced_memory()[1] < 1 << 24
    tracemalloc.stop()
    with pytest.raises(BagError, match='cannot be read'):
        bag.read(bomb(tmp_path / 'zeros.mcap', 1 << 22, chunks=50))


def test_the_number_of_messages_is_bounded_by_the_size_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(records, 'MESSAGES', (1000, 0.5))
    message = struct.pack('<BQHIQQ', 5, 22, 1, 0, 0, 0)
    with pytest.raises(BagError, match=r'it holds \d+ messages and more'):
        bag.read(bomb(tmp_path / 'many.mcap', 31 * 3000, content=message))


def test_what_is_announced_is_not_reserved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('mbd_sim_ros.bags.files.message_counts', lambda _: {1: 1 << 60})
    file = good(tmp_path / 'good', 50)
    assert bag.read(file).time_ns.size == 50
    assert columns.Room(0).take(1 << 60, 8) == 0


@pytest.mark.parametrize('text', ['{', '[1, 2]', '{"a": [1]}', '[' * 5000])
def test_metadata_that_are_not_ours_are_one_sentence(text: str, tmp_path: Path) -> None:
    channel = ('/joint_states', JOINT_STATE, cdr.schema_text(JOINT_STATE), [(1, joint_state(1, ['a'], [1.0]))])
    run = bag.read(write_mcap(tmp_path / 'a.mcap', [channel], {RECORD: {'joint_kinds': text}}))
    with pytest.raises(BagError, match='metadata say joint_kinds = ') as caught:
        runs.units(run)
    one_sentence(caught.value)


@pytest.mark.parametrize(
    ('key', 'value', 'why'),
    [
        ('start_step', '-1', 'not a number of steps'),
        ('start_step', '9' * 5000, 'not a number of steps'),
        ('parameters', '[' * 3000, 'not a mapping'),
        ('parameters', 'a: !!python/object/apply:os.system [ls]', 'not a mapping'),
        ('start_state', 'not base64!', 'not base64'),
    ],
)
def test_a_description_that_is_damaged_is_not_replayed(key: str, value: str, why: str, tmp_path: Path) -> None:
    channel = (
        '/cmd_applied',
        JOINT_STATE,
        cdr.schema_text(JOINT_STATE),
        [(0, joint_state(0, ['u', 'step'], [1.0, 0.0]))],
    )
    before = content(write_mcap(tmp_path / 'a.mcap', [channel], {RECORD: {key: value}}))
    with pytest.raises(BagError, match=why) as caught:
        _ = before.first_step, before.parameters, before.state
    one_sentence(caught.value)


@pytest.mark.parametrize('step', [1e18, -1.0, 0.5, np.nan, np.inf])
def test_numbers_of_steps_that_are_none_are_not_counted_to(step: float, tmp_path: Path) -> None:
    messages = [(k, joint_state(k, ['u', 'step'], [1.0, value])) for k, value in enumerate((0.0, 1.0, step))]
    file = write_mcap(tmp_path / 'a.mcap', [('/cmd_applied', JOINT_STATE, cdr.schema_text(JOINT_STATE), messages)])
    with pytest.raises(BagError, match=r'no whole number from 0 to below|do not follow its steps') as caught:
        inputs_of(content(file))
    one_sentence(caught.value)


def test_names_of_topics_are_names_of_files(tmp_path: Path) -> None:
    text, message = cdr.schema_text(JOINT_STATE), joint_state(1, ['v'], [1.0])
    topics = ['/a/b', '/a.b', '/a\0b', '/../../up', '/' + 'long' * 100]
    file = write_mcap(tmp_path / 'a.mcap', [(topic, JOINT_STATE, text, [(1, message)]) for topic in topics])
    written = runs.export(bag.read(file), tmp_path / 'csv')
    assert len(set(written)) == len(topics)
    assert all(path.parent == tmp_path / 'csv' and path.is_file() for path in written)


def test_lz4_and_frames_without_their_size_are_read(tmp_path: Path) -> None:
    text = cdr.schema_text(JOINT_STATE)
    messages = [(k, joint_state(k, ['v'], [float(k)])) for k in range(500)]
    for compression in (CompressionType.LZ4, CompressionType.ZSTD):
        file = write_mcap(
            tmp_path / f'{compression.name}.mcap', [('/s', JOINT_STATE, text, messages)], compression=compression
        )
        np.testing.assert_array_equal(bag.read(file)['s/v'], np.arange(500.0))
    data = bytes(range(256)) * 100
    stream = zstandard.ZstdCompressor(write_content_size=False).compressobj()
    packed = stream.compress(data) + stream.flush()
    assert records._inflate('zstd', packed, len(data)) == data
    with pytest.raises(ValueError, match='packed with'):
        records._inflate('brotli', b'', 0)


def test_chunks_of_elements_that_nobody_wants_are_not_unpacked_but_their_damage_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    t = np.arange(16_000) * MS
    series = {'s': (t, {'v': np.sin(t * 1e-9)}), 'element_states/springs': (t, {'spring/force': np.cos(t * 1e-9)})}
    file = write_scalars(tmp_path / 'good', series) / 'good_0.mcap'
    whole, data, unpacked = bag.read(file), bytearray(file.read_bytes()), []
    inflate = records._inflate

    def counted(*args: object) -> bytes:
        unpacked.append(args)
        return inflate(*args)

    monkeypatch.setattr(records, '_inflate', counted)
    some = bag.read(file, ['s/*'])
    chunks = [at for at, opcode in places(data) if opcode == OPCODE_CHUNK]
    assert len(unpacked) <= len(chunks) // 2 + 1  # of the first pair both: there the channels are declared
    np.testing.assert_array_equal(some['s/v'], whole['s/v'])
    assert some.names == whole.names
    data[chunks[-1] + 100] ^= 1
    bad = tmp_path / 'bad.mcap'
    bad.write_bytes(data)
    with pytest.raises(BagError, match='checksum of its data is wrong'):
        bag.read(bad, ['s/*'])
