"""Recordings say which format they have: older ones are read, newer ones are refused in one sentence."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.bags import reader
from mbd_sim_ros.bags.inputs import content
from mbd_sim_ros.bags.recorder import describe
from mbd_sim_ros.bags.writer import FORMAT, RECORD, BagWriter
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.messages.cdr import template
from mbd_sim_ros.messages.topics import JOINT_STATE, Topic
from solver.errors import BagError

EXAMPLE = Path(__file__).parents[2] / 'bags' / 'step_steer'  # made by mbd_sim_ros 0.1


def bag(directory: Path, **about: str) -> Path:
    """A recording of one message that says `about` of itself."""
    writer = BagWriter(directory, [Topic('joint_states', JOINT_STATE)], {RECORD: about})
    header = {'stamp': {'sec': 0, 'nanosec': 1_000_000}, 'frame_id': ''}
    writer.write(1_000_000, [(0, template(JOINT_STATE, {'header': header, 'name': ['a'], 'position': [0.5]}).data)])
    writer.finish()
    return directory


def test_a_recording_says_its_format() -> None:
    assert describe(scene='s', resolved_yaml='')['format'] == str(FORMAT)


def test_one_of_mbd_sim_ros_0_1_has_no_format_and_is_read() -> None:
    run = reader.read(EXAMPLE, ['odom/*'])
    assert 'format' not in run.metadata and run.metadata['code_version'].startswith('0.1.0')
    assert len(run.time) > 100


@pytest.mark.parametrize('text', ['1', str(FORMAT)])
def test_older_formats_and_the_own_one_are_read(text: str, tmp_path: Path) -> None:
    path = bag(tmp_path / 'run', format=text)
    assert reader.read(path)['joint_states/a/position'].tolist() == [0.5]
    assert content(path).metadata['format'] == text


def test_a_newer_format_is_refused_by_every_door_with_the_remedy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = bag(tmp_path / 'run', format=str(FORMAT + 1), code_version='0.9.1+abc')
    says = (
        rf'has format {FORMAT + 1}, and this version .* reads formats up to {FORMAT}: update mbd_sim_ros .*was '
        r'made '
        r'by 0\.9\.1\)'
    )
    for read in (reader.read, content):
        with pytest.raises(BagError, match=says):
            read(path)
    for words in (
        ['export', str(path), '--csv', str(tmp_path / 'csv')],
        ['replay', str(path)],
        ['compare', str(path), str(path)],
        ['recover', str(path), str(tmp_path / 'new')],
    ):
        assert main(words) == BagError.exit_code
        said = capsys.readouterr().err
        assert f'has format {FORMAT + 1}' in said and len(said.splitlines()) == 1


def packed(**arrays: np.ndarray) -> str:
    """A saved state as the metadata of a recording hold it."""
    file = io.BytesIO()
    np.savez(file, **arrays)  # type: ignore[arg-type]
    return base64.b64encode(file.getvalue()).decode()


@pytest.mark.parametrize(
    ('state', 'says'),
    [
        (
            packed(k=np.int64(5)),
            r'cannot be replayed: its state at the beginning has format 1, .* reads format 3: save it anew',
        ),
        (packed(k=np.int64(5), format=np.array(4)), r'has format 4, .* reads format 3: update mbd_sim_ros'),
        ('AAAA', r'cannot be replayed: restore: the saved state is damaged'),
        ('no base64', r'hold a start_state that is not base64'),
    ],
)
def test_the_state_that_a_recording_begins_with_is_refused_by_its_format(state: str, says: str, tmp_path: Path) -> None:
    path = bag(tmp_path / 'run', start_step='5', start_state=state)
    with pytest.raises(BagError, match=rf'^{path}.*{says}'):
        content(path).state  # noqa: B018


@pytest.mark.parametrize('text', ['', 'two', '-1', '2.5', '²', '9' * 30])
def test_a_format_that_is_no_number_is_damage(text: str, tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r'is damaged: its metadata say format = '):
        reader.read(bag(tmp_path / 'run', format=text))
