"""What web pages share: samples to draw, numbers for the script, pages of one file."""

from __future__ import annotations

import base64
import errno
import json
import re
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.analysis.pages import fill, floats, plain_page, thinned, write_text
from solver.errors import BagError

POINTS = 1500
TEMPLATES = (
    'mbd_sim_ros.analysis:report.html',
    'mbd_sim_ros.analysis.evaluation:page.html',
    'mbd_sim_ros.analysis.view:view.html',
)


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


@pytest.mark.parametrize('template', TEMPLATES)
def test_a_template_is_filled_and_needs_nothing_else(template: str, tmp_path: Path) -> None:
    fill(tmp_path / 'deep' / 'p.html', template, {'title': '</script>', 'worst': [float('inf'), 1.5]})
    page = (tmp_path / 'deep' / 'p.html').read_text(encoding='utf-8')
    assert not re.search('@[A-Z]+@', page)
    assert page.count('</script>') == 2  # nothing in the data ends a script
    assert not re.search(r'(src|href)=|https?://|@import|url\(', page)
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert data is not None and json.loads(data[1]) == {'title': '</script>', 'worst': [None, 1.5]}


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


def test_a_plain_page_escapes_its_title() -> None:
    page = plain_page('a < b', ['<p>text</p>'])
    assert '<title>a &lt; b</title>' in page and '<h1>a &lt; b</h1>' in page and '<p>text</p>' in page
