"""What web pages share: samples to draw, numbers for the script, pages of one file."""

from __future__ import annotations

import base64
import errno
import json
import math
import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from browser import data_of

from mbd_sim_ros import interrupts
from mbd_sim_ros.analysis import pages
from mbd_sim_ros.analysis.pages import POINTS, Page, floats, thinned, write_text
from solver.errors import BagError


@pytest.mark.parametrize('signals', [1, 3])
def test_thinning_keeps_the_extremes_of_all_signals_and_the_ends(signals: int, rng: np.random.Generator) -> None:
    values = rng.standard_normal((signals, 60_001))
    values[0, 12_345], values[-1, 45_678] = 9.0, -9.0
    values[0, 500:600] = np.nan
    keep = thinned(POINTS, *values)
    assert keep.size <= 1.05 * POINTS
    assert {0, 12_345, 45_678, 60_000} <= set(keep.tolist())
    assert np.all(np.diff(keep) > 0)
    assert np.array_equal(thinned(POINTS, *values[:, :100]), np.arange(100))


def test_numbers_arrive_as_floats_of_32_bits() -> None:
    found = np.frombuffer(base64.b64decode(floats(np.array([0.1, -2.0, np.nan, 1e300]))), '<f4')
    np.testing.assert_array_equal(found, np.array([0.1, -2.0, np.nan, np.inf], np.float32))
    assert floats(np.array([])) == ''


def test_a_page_is_whole_and_nothing_in_its_data_ends_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Program, time and command stand in every page; the policy in its head lets it fetch nothing."""
    monkeypatch.setattr(interrupts, 'command', 'mbd some <thing>')
    file = tmp_path / 'deep' / 'p.html'
    odd = pages.table([('a', 'b'), ('</script>', math.inf), ('@DATA@', 1.5)])
    Page(title='a < b </script>', verdict='bad', ok=False, facts=[('x', 'y')], blocks=[odd]).write(file)
    text, data = file.read_text(encoding='utf-8'), data_of(file)
    assert text.count('</script>') == 2 and '<title>a &lt; b &lt;/script&gt;</title>' in text
    assert not re.search(r'(src|href)="|@import|url\((?!#)', text.replace(json.dumps(data), ''))
    assert "default-src 'none'" in text
    assert data['blocks'][0]['rows'] == [['</script>', None], ['@DATA@', 1.5]]
    facts = dict(data['facts'])
    assert facts['command'] == 'mbd some <thing>' and facts['x'] == 'y'
    assert facts['program'].startswith('mbd_sim_ros ') and re.match(r'\d{4}-\d\d-\d\d .* UTC', facts['made'])
    licence = files('mbd_sim_ros.analysis.third_party.uplot').joinpath('LICENSE').read_text()
    assert 'MIT' in licence and 'uPlot (v1.6.32)' in text  # what is embedded names itself


def test_points_of_a_page_stay_within_its_size() -> None:
    """All curves together, whatever their number: 1.5 MB less the program and the text around."""
    for curves in (1, 30, 160, 700):
        points = pages.points_for(curves)
        assert pages.FEWEST <= points <= POINTS
        assert points == pages.FEWEST or curves * points * 2 * 16 / 3 < 1.3e6


def test_markdown_becomes_blocks() -> None:
    source = '## Head\n\nSome `code`\nand more.\n\n- one\n  goes on\n- two\n\n| a | b |\n|---|---|\n| 1 | x |'
    head, text, items, table = pages.markdown(source)
    assert (head['kind'], head['text'], head['level']) == ('heading', 'Head', 2)
    assert text['lines'] == ('Some `code` and more.',)
    assert items['lines'] == ('\u2022 one goes on', '\u2022 two')
    assert (table['columns'], table['rows']) == (['a', 'b'], [['1', 'x']])


def test_a_page_that_cannot_be_written_leaves_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A full disk left an empty file in its place."""
    file, link = tmp_path / 'page.html', tmp_path / 'link.html'
    link.symlink_to(file)
    write_text(link, 'before')
    write = Path.write_text

    def full(self: Path, text: str, **options: str) -> int:
        write(self, text[:2], **options)
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr(Path, 'write_text', full)
    for place in (file, link):
        with pytest.raises(BagError, match=f'cannot write {place}: No space left on device; choose another place'):
            write_text(place, 'after')
    assert file.read_text() == 'before' and sorted(tmp_path.iterdir()) == [link, file]
    monkeypatch.undo()
    with pytest.raises(BagError, match='cannot write /dev/full: No space left on device'):
        write_text(Path('/dev/full'), 'after')
    assert Path('/dev/full').is_char_device()
