"""Recordings of the full car over a minute at 1 kHz, every element of it in every step: what reading and comparing two
of them takes, and a difference of 1e-9 in one value of one channel. Times are those of a machine with nothing else to
do; `-s` shows them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from mbd_sim_ros.bags.writer import BagWriter
from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.topics import Topic

pytestmark = pytest.mark.long
RECORD = {'every': 1, 'elements': 'true', 'elements_rate': 0}
SCENE = [
    'car_step_steer',
    '--duration',
    '60',
    *(part for key, value in RECORD.items() for part in ('--set', f'record.{key}={value}')),
]
PLANTED_AT = 34_567  # message of /imu, which is the step too
PROBE = """
import json, resource, sys, time
from mbd_sim_ros.commands.main import main
begin = time.monotonic()
code = main(json.loads(sys.argv[1]))
usage = resource.getrusage(resource.RUSAGE_SELF)
cpu = usage.ru_utime + usage.ru_stime
print(json.dumps({'code': code, 'seconds': time.monotonic() - begin, 'cpu': cpu, 'bytes': 1024 * usage.ru_maxrss}), file=sys.stderr)
"""  # noqa: E501


def probed(*arguments: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """What a command says as JSON; its exit code, seconds, CPU seconds and memory, in a process of its own."""
    process = subprocess.run(
        [sys.executable, '-c', PROBE, json.dumps([*arguments, '--json'])],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    lines = process.stderr.splitlines()
    assert lines and lines[-1].startswith('{'), process.stderr
    return json.loads(process.stdout), json.loads(lines[-1])


@pytest.fixture(scope='module')
def bags(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """A recording, one of the same scene with other settings, and the first with 1e-9 m/s^2 more in one value."""
    home = tmp_path_factory.mktemp('long')
    for name, iterations in (('a', 2), ('other', 1)):
        said, cost = probed('run', *SCENE, '--set', f'integrator.iterations={iterations}', '--out', str(home / name))
        assert cost['code'] == 0, said
    topics: dict[str, str] = {}
    with (home / 'a' / 'a_0.mcap').open('rb') as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        topics = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
        texts = {schema.name: schema.data.decode() for schema in summary.schemas.values()}
        number = {name: i for i, name in enumerate(topics)}
        records = {one.name: dict(one.metadata) for one in reader.iter_metadata()}
        writer = BagWriter(home / 'b', [Topic(*item) for item in topics.items()], records, schemas=texts)
        seen = 0
        for _, channel, message in reader.iter_messages():
            data = message.data
            if channel.topic == '/imu':
                if seen == PLANTED_AT:
                    value, _ = cdr.decode(topics['/imu'], texts[topics['/imu']], data)
                    value['linear_acceleration']['y'] += 1e-9
                    data, _ = cdr.encode(topics['/imu'], texts[topics['/imu']], value)
                seen += 1
            writer.write(message.log_time, [(number[channel.topic], data)])
        writer.finish()
    return home / 'a', home / 'other', home / 'b'


@pytest.mark.parametrize('rating', [True, False])
def test_both_are_read_and_compared_in_ten_seconds_and_a_gigabyte(rating: bool, bags: tuple[Path, Path, Path]) -> None:
    said, cost = probed('compare', *map(str, bags[:2]), *([] if rating else ['--no-rating']))
    print(f'compared, rating {rating}: {cost}')
    assert cost['code'] == 1 and said['instants'] == 60_001  # by the settings
    assert len(said['channels']) > 600
    assert cost['seconds'] < 10.0
    assert cost['bytes'] < 1_000_000_000


def test_one_topic_takes_three_seconds(bags: tuple[Path, Path, Path]) -> None:
    said, cost = probed('compare', *map(str, bags[:2]), '--channel', 'odom/*')
    print(f'odom alone: {cost}')
    assert cost['code'] == 1 and 'odom/twist/wz' in said['channels']
    assert cost['seconds'] < 3.0


def test_a_billionth_in_one_value_is_found_located_and_named(bags: tuple[Path, Path, Path]) -> None:
    said, cost = probed('compare', str(bags[0]), str(bags[2]), '--exact')
    print(f'exact: {cost}')
    assert cost['code'] == 1
    assert said['outside'] == ['imu/ay']
    assert said['channels']['imu/ay']['first'] == pytest.approx(PLANTED_AT * 1e-3, abs=1e-9)
    assert said['channels']['imu/ay']['max'] == pytest.approx(1e-9, rel=1e-3)
    assert cost['seconds'] < 10.0
    assert cost['bytes'] < 1_000_000_000
