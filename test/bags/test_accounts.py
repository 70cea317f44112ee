"""Nothing vanishes in reading: every message of a recording is a row of a table, or it is told what became of it."""

from __future__ import annotations

import json
from pathlib import Path

import foreign_bags as others
import numpy as np
import pytest
from foreign_bags import DAY, FLOAT, MS

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.bags import rosbag2
from mbd_sim_ros.bags.recovery import recover
from mbd_sim_ros.commands.main import main
from solver.errors import BagError


def exported(place: Path, out: Path, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[dict, dict[str, int]]:
    """What `mbd export` says of a recording, and the rows in its tables; {} where it refuses the recording in one
    sentence."""
    code = main(['export', str(place), '--csv', str(out), '--json', *options])
    told = json.loads(capsys.readouterr().out)
    if code:
        assert '\n' not in told['error'] and 'internal' not in told['error']
        return {}, {}
    return told, {Path(file).stem: len(Path(file).read_text().splitlines()) - 1 for file in told['files']}


@pytest.mark.parametrize('kind', others.KINDS)
def test_rows_written_and_messages_told_are_the_messages_in_the_file(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    read = 0
    for seed in range(12):
        rng = np.random.default_rng([seed, others.KINDS.index(kind)])
        messages = others.random_messages(rng)
        place = others.write(tmp_path / f'bag{seed}', messages, kind)
        options = ['--log-times'] if seed % 4 == 3 else []
        told, rows = exported(place, tmp_path / f'csv{seed}', capsys, *options)
        if not told:
            continue
        read += 1
        assert told['messages'] == len(messages), f'seed {seed}'
        assert {topic.replace('/', '.'): one['rows'] for topic, one in told['topics'].items()} == rows
        beside = sum(one['beside'] + one['left_out'] for one in told['topics'].values())
        assert sum(rows.values()) + beside + sum(told['passed_over'].values()) == len(messages), f'seed {seed}'
        assert told['not_read'].keys() <= told['passed_over'].keys()
        for topic, one in told['topics'].items():
            assert one['messages'] == one['rows'] + one['left_out'] + one['beside']
            assert not one['left_out'] or any(
                f'topic {topic}: {one["left_out"]} of' in doubt for doubt in told['doubts']
            )
    assert read >= 8


def test_times_of_publication_count_where_there_is_no_header(tmp_path: Path) -> None:
    """A recorder that writes twice a second: 400 messages of 100 Hz have 8 log times."""
    published = DAY + np.arange(400) * 10 * MS
    log = (published // (500 * MS) + 1) * 500 * MS
    messages = [others.scalar('/steer', int(a), int(b), float(k)) for k, (a, b) in enumerate(zip(log, published))]
    run = bag.read(others.write(tmp_path / 'bag', messages))
    np.testing.assert_array_equal(run.time_ns, published)
    assert run['steer/data'].tolist() == [*range(400)] and not run.doubts
    coarse = bag.read(tmp_path / 'bag', log_times=True)
    assert len(coarse.time_ns) == 8
    assert coarse.doubts == (
        'topic steer: 392 of 400 messages are left out, because a later one has the same log time; they were recorded '
        'in bursts',
    )


@pytest.mark.parametrize('published', [0, DAY])
def test_times_of_publication_that_are_not_set_do_not_count(published: int, tmp_path: Path) -> None:
    messages = [others.scalar('/s', DAY + k * MS, published, float(k)) for k in range(10)]
    run = bag.read(others.write(tmp_path / 'bag', messages))
    assert run.accounts['s'].clock == 'log time' and run.time_ns.tolist() == [DAY + k * MS for k in range(10)]


def test_a_recorder_in_simulated_time_has_log_times_that_meet_the_headers(tmp_path: Path) -> None:
    """ros2 bag record --use-sim-time: log times are simulated, times of publication those of day."""
    messages = [others.vector('/yaw', k * 10 * MS, DAY + k * 10 * MS, k * 10 * MS, float(k)) for k in range(1, 50)]
    messages += [others.scalar('/steer', k * 10 * MS, DAY + k * 10 * MS, float(k)) for k in range(1, 50)]
    run = bag.read(others.write(tmp_path / 'bag', messages))
    assert run.accounts['steer'].clock == 'log time' and not run.doubts
    assert len(run.time_ns) == 49


def test_clocks_that_do_not_meet_are_named_topic_by_topic(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    messages = []
    for k in range(400):
        at = DAY + k * 10 * MS
        messages += [others.scalar('/steer', at, at, float(k)), others.vector('/yaw', at, at, k * 10 * MS, float(k))]
    place = others.write(tmp_path / 'bag', messages)
    told, _ = exported(place, tmp_path / 'csv', capsys)
    clocks = 'yaw (header stamp) from 0 to 3.99 s; steer (publish time) from 1700000000 to 1700000003.99 s'
    assert told['doubts'] == [f'its clocks do not meet: {clocks}; take the log times of all (--log-times)']
    told, _ = exported(place, tmp_path / 'csv', capsys, '--log-times')
    assert told['doubts'] == []
    mapping = [f'--map={theirs}={ours}' for theirs, ours in (
        ('yaw/vector/z', 'yaw_rate'), ('steer/data', 'steering'), ('yaw/vector/x', 'lateral_acceleration'),
        ('yaw/vector/y', 'speed'),
    )]  # fmt: skip
    assert main(['evaluate', str(place), '--as', 'iso7401_step', *mapping]) == 5
    assert f'its clocks do not meet: {clocks}' in capsys.readouterr().err
    assert main(['evaluate', str(place), '--as', 'iso7401_step', *mapping, '--log-times']) == 5
    assert 'the car does not move' in capsys.readouterr().err


def test_topics_that_follow_each_other_have_one_clock(tmp_path: Path) -> None:
    first = [others.scalar('/a', DAY + k * 10 * MS, DAY + k * 10 * MS, 0.0) for k in range(100)]
    later = [others.scalar('/b', DAY + (500 + k) * 10 * MS, DAY + (500 + k) * 10 * MS, 0.0) for k in range(100)]
    assert not bag.read(others.write(tmp_path / 'bag', [*first, *later])).doubts


def test_coarse_clocks_and_what_was_recorded_twice_are_told(tmp_path: Path) -> None:
    quantised = [
        others.vector('/q', DAY + k * MS, 0, DAY + k * MS // (10 * MS) * 10 * MS, float(k)) for k in range(100)
    ]
    double = [others.vector('/d', DAY + k * MS, 0, DAY + k // 2 * 2 * MS, float(k // 2)) for k in range(100)]
    run = bag.read(others.write(tmp_path / 'bag', [*quantised, *double]))
    assert run['q/vector/z'][np.isfinite(run['q/vector/z'])].tolist() == [9.0 + 10.0 * k for k in range(10)]
    told = (
        'messages are left out, because a later one has the same header stamp; its clock is too coarse, or has '
        'several publishers'
    )
    assert run.doubts == (f'topic q: 90 of 100 {told}',)
    assert run.remarks == (
        'topic d: 50 of 100 messages are left out, which were recorded twice: the same header stamp, the same values',
    )


@pytest.mark.parametrize('other', [None, 57])
def test_what_was_recorded_twice_is_no_loss_unless_one_of_it_differs(other: int | None, tmp_path: Path) -> None:
    """Two recorders of one topic, merged: by stamps, by publish times, as names of several sets, and where values are
    no numbers."""
    value = [np.nan if k == 7 else 0.1 * k for k in range(100)]
    messages = []
    for k, at in enumerate(range(DAY, DAY + 100 * MS, MS)):
        for late in (0, 1):
            z = value[k] + (late == 1 and k == other)
            names = {'a': z} if k % 2 else {'b': z, 'c': 2.0}
            messages += [others.vector('/v', at + late, 0, at, z), others.scalar('/s', at + late, at, z)]
            messages.append(others.joints('/j', at + late, 0, at, names))
    run = bag.read(others.write(tmp_path / 'bag', messages))
    for topic, clock in (('v', 'header stamp'), ('s', 'publish time'), ('j', 'header stamp')):
        one = run.accounts[topic]
        assert (one.messages, one.rows, one.equal, one.twice) == (200, 100, 100, 100 if other is None else 99)
        same = (
            f'topic {topic}: 100 of 200 messages are left out, which were recorded twice: the same {clock}, the '
            'same values'
        )
        assert (same in run.remarks) is (other is None)
        told = (
            f'topic {topic}: 100 of 200 messages are left out, because a later one has the same {clock} (99 of them '
            'the same values too)'
        )
        assert any(text.startswith(told) for text in run.doubts) is (other is not None)


def test_alike_values_at_one_log_time_are_no_duplicates_where_a_stamp_tells_them_apart(tmp_path: Path) -> None:
    messages = [others.vector('/v', DAY + k // 10 * 10 * MS, 0, DAY + k * MS, 0.5) for k in range(100)]
    account = bag.read(others.write(tmp_path / 'bag', messages), log_times=True).accounts['v']
    assert (account.rows, account.equal, account.twice) == (10, 90, 0)


def reordered(messages: list, how: str) -> list:
    """Messages in another order of the file."""
    if how == 'reversed':
        return messages[::-1]
    if how == 'shuffled':
        return [messages[k] for k in np.random.default_rng(7).permutation(len(messages))]
    return [one for pair in zip(messages[len(messages) // 2 :], messages) for one in pair]  # two halves, in turns


@pytest.mark.parametrize('how', ['reversed', 'shuffled', 'in turns'])
@pytest.mark.parametrize('log_times', [False, True])
def test_the_order_in_the_file_does_not_count(how: str, log_times: bool, tmp_path: Path) -> None:
    messages = [others.vector('/v', DAY + k * 10 * MS, 0, DAY + k * 10 * MS, 0.01 * k) for k in range(400)]
    run = bag.read(others.write(tmp_path / 'bag', reordered(messages, how)), log_times=log_times)
    assert run.time_ns.tolist() == [DAY + k * 10 * MS for k in range(400)]
    assert run['v/vector/z'].tolist() == [0.01 * k for k in range(400)] and not run.doubts
    assert run.accounts['v'].disordered == 0


def test_stamps_that_go_back_in_the_order_of_recording_are_told_whatever_the_order_of_the_file(tmp_path: Path) -> None:
    stamps = [0, 10, 20, 40, 30, *range(50, 400, 10)]
    messages = [others.vector('/v', DAY + k * 10 * MS, 0, DAY + t * MS, 1.0) for k, t in enumerate(stamps)]
    run = bag.read(others.write(tmp_path / 'bag', messages[::-1]))
    assert run.accounts['v'].disordered == 1 and bool(np.all(np.diff(run.time_ns) > 0))


@pytest.mark.parametrize('order', [1, -1])
def test_two_clocks_on_one_topic_are_named_with_the_remedy(order: int, tmp_path: Path) -> None:
    messages = [
        others.vector('/v', DAY + k * 10 * MS, 0, (DAY if k % 2 else 0) + k * 10 * MS, 0.01 * k) for k in range(400)
    ]
    place = others.write(tmp_path / 'bag', messages[::order])
    with pytest.raises(
        BagError, match=r'go back 199 times and by up to 1.7e\+09 s, as of publishers with clocks .*take the log times'
    ):
        bag.read(place)
    run = bag.read(place, log_times=True)
    assert run['v/vector/z'].tolist() == [0.01 * k for k in range(400)] and not run.doubts


@pytest.mark.parametrize(
    ('ahead', 'told'), [(0.09, False), (0.9, False), (1.5, True), (3.0, True), (30.0, True), (-3.0, False)]
)
def test_stamps_later_than_their_recording_are_of_another_clock(ahead: float, told: bool, tmp_path: Path) -> None:
    """Earlier ones may have been on their way; where all are later alike, they have one clock."""
    off = int(ahead * 1e9)
    odo = [others.vector('/odo', DAY + k * 10 * MS, 0, DAY + k * 10 * MS + off, 0.0) for k in range(400)]
    for n, near in enumerate((
        [others.vector('/yaw', DAY + k * 10 * MS, 0, DAY + k * 10 * MS, 0.0) for k in range(400)],
        [others.scalar('/yaw', DAY + k * 10 * MS, DAY + k * 10 * MS, 0.0) for k in range(400)],
    )):  # fmt: skip
        run = bag.read(others.write(tmp_path / f'bag{n}', [*odo, *near]))
        assert [f'; odo (header stamp) from {(DAY + off) * 1e-9:.12g}' in text for text in run.doubts] == [True] * told
        assert (
            not told
            or f'{ahead:g} s later than they were recorded; take the log times of all (--log-times)' in run.doubts[0]
        )
    also = [others.vector('/also', one.log, 0, one.log + off, 0.0) for one in odo]
    assert not bag.read(others.write(tmp_path / 'all', [*odo, *also])).doubts


def test_order_and_numbers_that_are_none_are_told(tmp_path: Path) -> None:
    times = [0, 1, 2, 5, 3, 4, 6]
    messages = [
        others.vector('/v', DAY + k * MS, 0, DAY + t * MS, [1.0, np.nan, np.inf][t % 3]) for k, t in enumerate(times)
    ]
    run = bag.read(others.write(tmp_path / 'bag', messages))
    assert run.doubts == (
        'topic v: 2 of 7 messages were recorded behind one with a later header stamp, and are put in order',
        'topic v: values that are no number: v/vector/z (4)',
    )


def test_named_values_are_columns_by_name_whatever_order_and_publisher(tmp_path: Path) -> None:
    messages = []
    for k in range(40):
        at = DAY + k * 10 * MS
        values = {'left': 1.0 + k, 'right': 2.0 + k} if k % 4 == 0 else {'right': 2.0 + k, 'left': 1.0 + k}
        messages.append(
            others.joints('/joint_states', at, at, at, values if k % 2 == 0 else {'spare': 3.0 + k}, 'ab' * (k % 3))
        )
    run = bag.read(others.write(tmp_path / 'bag', messages))
    assert set(run.columns) == {f'joint_states/{name}/position' for name in ('left', 'right', 'spare')}
    np.testing.assert_array_equal(run['joint_states/left/position'][::2], 1.0 + np.arange(0, 40, 2))
    np.testing.assert_array_equal(run['joint_states/right/position'][::2], 2.0 + np.arange(0, 40, 2))
    np.testing.assert_array_equal(run['joint_states/spare/position'][1::2], 3.0 + np.arange(1, 40, 2))
    assert np.isnan(run['joint_states/spare/position'][::2]).all() and not run.doubts
    only = bag.read(tmp_path / 'bag', ['joint_states/spare/*'])
    assert set(only.columns) == {'joint_states/spare/position'} and not only.doubts


def test_messages_of_two_publishers_at_one_instant_are_one_row(tmp_path: Path) -> None:
    messages = [
        others.joints('/joint_states', at, at, at, values)
        for at in range(DAY, DAY + 10 * MS, MS)
        for values in ({'a': 1.0}, {'b': 2.0})
    ]
    run = bag.read(others.write(tmp_path / 'bag', messages))
    account = run.accounts['joint_states']
    assert (account.messages, account.rows, account.beside, account.equal) == (20, 10, 10, 0) and not run.doubts
    assert (run['joint_states/a/position'] == 1.0).all() and (run['joint_states/b/position'] == 2.0).all()


@pytest.mark.parametrize('kind', others.KINDS)
def test_every_kind_of_file_gives_the_same(kind: str, tmp_path: Path) -> None:
    messages = [others.vector('/v', DAY + k * MS, DAY + k * MS, DAY + k * MS, float(k)) for k in range(300)]
    run = bag.read(others.write(tmp_path / 'bag', messages, kind))
    assert run['v/vector/z'].tolist() == [*range(300)] and run.time_ns.tolist() == [DAY + k * MS for k in range(300)]


def test_databases_of_which_something_is_missing_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    messages = [others.scalar('/s', DAY + k * MS, 0, float(k)) for k in range(3000)]
    place = others.write(tmp_path / 'bag', messages, 'db3')
    file = next(place.glob('*.db3'))
    assert len(bag.read(file).time_ns) == 3000
    whole = file.read_bytes()
    for cut in (0, 1, 100, 4096, len(whole) // 2, len(whole) - 4096):
        file.write_bytes(whole[:cut])
        with pytest.raises(BagError, match=r'is empty|is cut off or damaged'):
            bag.read(place)
    file.write_bytes(whole)
    metadata = place / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace('message_count: 3000', 'message_count: 3001'))
    with pytest.raises(BagError, match=r'says that it holds 3001 messages, and 3000 were found'):
        bag.read(place)
    file.rename(place / 'other.db3')
    assert len(bag.read(place).time_ns) == 3000  # its metadata are of another recording
    monkeypatch.setitem(__import__('sys').modules, 'rosbags.rosbag2', None)
    with pytest.raises(
        BagError, match=r"of ros2 bag, whose reader needs the library rosbags: pip install 'mbd_sim_ros\[rosbag2\]'"
    ):
        bag.read(place)


IDL = """module std_msgs { module msg { struct Float64 { double data; }; }; };"""


def test_types_that_are_defined_in_idl_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mcap.writer import Writer

    file = tmp_path / 'a.mcap'
    text = '=' * 80 + '\nIDL: std_msgs/msg/Float64\n' + IDL
    with file.open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2', library='test')
        channel = writer.register_channel('/s', 'cdr', writer.register_schema(FLOAT, 'ros2idl', text.encode()))
        for k in range(10):
            writer.add_message(channel, DAY + k, others.scalar('/s', 0, 0, float(k)).data, DAY + k)
        writer.finish()
    assert bag.read(file)['s/data'].tolist() == [*range(10)]
    monkeypatch.setitem(__import__('sys').modules, 'rosbags.typesys', None)
    with pytest.raises(
        BagError, match=r"defined in 'ros2idl', which needs the library rosbags: pip install 'mbd_sim_ros\[rosbag2\]'"
    ):
        bag.read(file)
    assert rosbag2.SUFFIX == '.db3'


def test_a_run_is_not_ok_where_something_of_the_recording_that_drives_it_was_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    published = DAY + np.arange(40) * 10 * MS
    log = (published // (100 * MS) + 1) * 100 * MS
    bursts = [others.scalar('/steer', int(a), int(b), 0.01) for a, b in zip(log, published)]
    hole = [*bursts[:20], others.scalar('/steer', int(log[20]), int(published[20]), np.nan), *bursts[21:]]
    twice = [one for one in bursts for _ in (0, 1)]
    places = {
        name: others.write(tmp_path / name, messages)
        for name, messages in (('bursts', bursts), ('hole', hole), ('twice', twice))
    }

    def run(name: str, more: str = '') -> tuple[int, dict]:
        maneuver = f"maneuver={{bag: '{places[name]}', map: {{steering: {{channel: steer/data}}}}{more}}}"
        code = main(['run', 'light_car_straight', '--set', maneuver, '--duration', '0.2', '--no-record', '--json'])
        return code, json.loads(capsys.readouterr().out)

    for name in ('bursts', 'twice'):
        code, told = run(name)
        assert (code, told['status']) == (0, 'ok')
    for name, more, text in (
        ('bursts', ', log_times: true', '36 of 40 messages are left out'),
        ('hole', '', 'steer/data (1)'),
    ):
        code, told = run(name, more)
        assert (code, told['status']) == (1, 'suspect'), told
        (finding,) = told['findings']
        assert finding['quantity'] == 'recorded_inputs' and text in finding['text']


def with_diagnostics(place: Path, day: int, *, only: str = '') -> Path:
    """A run of 1 s in simulation time beside a topic in the time of day. only: another topic in it, which clocks set
    back."""
    messages = []
    for k in range(100):
        at, log = k * 10 * MS, day + k * 10 * MS
        messages += [
            others.vector('/imu', log, log, at, 0.01 * k),
            others.scalar('/diagnostics', log, log, 40.0 + k % 3),
        ]
        if only:
            messages.append(others.vector(only, log, log, k // 10 * 10 * MS, 0.0))
    return others.write(place, messages)


def compared(capsys: pytest.CaptureFixture[str], *argv: object) -> tuple[int, dict]:
    capsys.readouterr()
    code = main(['compare', *map(str, argv), '--json'])
    return code, json.loads(capsys.readouterr().out)


def test_topics_in_the_time_of_day_of_two_runs_are_left_out_with_a_note_and_are_no_doubt(tmp_path, capsys):
    """They share no instant, so two runs of one node were different, and their clocks doubted."""
    one, other = with_diagnostics(tmp_path / 'a', DAY), with_diagnostics(tmp_path / 'b', DAY + 3600 * 10**9)
    code, told = compared(capsys, one, other)
    assert code == 0 and told['doubts'] == {} and told['problems'] == [] and told['left_out'] == []
    assert sorted(told['channels']) == ['imu/vector/x', 'imu/vector/y', 'imu/vector/z']
    assert 'in the time of day beside others in simulation time: diagnostics' in told['notes'][0]
    code, told = compared(capsys, one, other, '--channel', 'imu/*')
    assert code == 0 and not told['notes'] and not told['doubts']
    code, told = compared(capsys, one, one)  # at one time of day it can be compared, and what is read is told
    assert (
        code == 0 and 'diagnostics/data' in told['channels'] and 'do not meet' in next(iter(told['doubts'].values()))[0]
    )


def test_doubts_are_those_of_what_is_compared(tmp_path, capsys):
    """A topic of one recording alone, with equal stamps: it is missing, and nobody compares it."""
    one, other = (
        with_diagnostics(tmp_path / 'a', DAY, only='/coarse'),
        with_diagnostics(tmp_path / 'b', DAY + 3600 * 10**9),
    )
    code, told = compared(capsys, one, other)
    assert code == 1 and told['doubts'] == {} and 'coarse/vector/z' in told['only_in_run']
    assert compared(capsys, one, other, '--allow-missing')[0] == 0
    code, told = compared(capsys, one, with_diagnostics(tmp_path / 'c', DAY + 7200 * 10**9, only='/coarse'))
    assert (
        code == 0
        and all('topic coarse: 90 of 100' in texts[0] for texts in told['doubts'].values())
        and len(told['doubts']) == 2
    )


@pytest.mark.parametrize('published', [0, DAY - 7, (1 << 64) - 1])
def test_what_is_recovered_keeps_the_times_of_publication(published: int, tmp_path: Path) -> None:
    """They were the log times; messages of a recorder in bursts got other times by `mbd recover`."""
    from mcap.reader import make_reader

    messages = [
        others.scalar('/s', DAY + k // 10 * 100 * MS, published and published - k * MS, float(k)) for k in range(100)
    ]
    saved = recover(others.write(tmp_path / 'bag', messages), tmp_path / 'saved').directory
    with next(saved.glob('*.mcap')).open('rb') as stream:
        found = [(m.log_time, m.publish_time) for _, _, m in make_reader(stream).iter_messages(log_time_order=False)]
    assert found == [(one.log, one.publish) for one in messages]


@pytest.mark.parametrize('kind', ['db3', 'db3 file'])
def test_a_database_cannot_be_recovered_and_the_sentence_says_how(kind: str, tmp_path: Path, capsys) -> None:
    place = others.write(tmp_path / 'bag', [others.scalar('/s', DAY + k * MS, DAY, 0.0) for k in range(10)], kind)
    assert main(['recover', str(place), str(tmp_path / 'saved')]) == 5
    said = capsys.readouterr().err
    assert 'is a database of ros2 bag (SQLite)' in said and '.recover | sqlite3' in said and said.count('\n') == 1
    assert ('zstd -d' in said) is (kind == 'db3 file')
