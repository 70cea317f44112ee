"""The page of an evaluation: everything is in one file, figures and curves in it are those of the result, and a browser
draws them."""

from __future__ import annotations

import base64
import json
import math
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from browser import CHROMIUM, QUIET

from mbd_sim_ros.analysis.evaluation.figures import Chart, Curve, Figure, Result, sentence
from mbd_sim_ros.analysis.evaluation.html import POINTS, write_page
from solver.errors import BagError

T = np.linspace(0.0, 5.0, 4001)
FIGURES = (
    Figure('angle', 'an angle', math.pi / 6.0, 'rad'),
    Figure('ratio', 'a ratio', 0.4, '1', '<= 0.35', False),
    Figure('gradient', 'a gradient', math.radians(2.0) / 9.80665, 'rad s^2/m'),
    Figure('missing', 'a figure without value', math.nan, 'm'),
)


def written(file: Path, text: str = 'curve') -> dict:
    swing = Chart(
        title='swing',
        x=('time', 's'),
        y=('angle', 'rad'),
        curves=(Curve(text, T, np.sin(T)), Curve('limit', T[:2], T[:2], 'limit')),
    )
    result = Result(
        evaluation='x',
        title='A test </script>',
        norm='a norm',
        figures=FIGURES,
        charts=(swing,),
        notes=('a note',),
        source='bags/x',
    )
    write_page(
        [result], file, title='title', about=['about'], passed=result.passed, together={'all runs': FIGURES[1:2]}
    )
    page = file.read_text(encoding='utf-8')
    assert page.count('</script>') == 2  # nothing in the data ends a script
    assert not re.search(r'(src|href)=|https?://', page)
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)[1])


def test_the_page_holds_figures_and_curves_in_units_for_people(tmp_path: Path) -> None:
    data = written(tmp_path / 'deep' / 'p.html')
    assert data['verdict']['ok'] is False
    rows = {row[0]: row[1:] for row in data['results'][0]['rows']}
    assert rows['an angle'] == ['30', 'deg', '', '']
    assert rows['a ratio'] == ['0.4', '', '<= 0.35', 'FAIL']
    assert rows['a gradient'] == ['2', 'deg/g', '', '']
    assert rows['a figure without value'] == ['-', 'm', '', '']
    assert data['together'][0]['rows'] == [['a ratio', '0.4', '', '<= 0.35', 'FAIL']]
    chart = data['results'][0]['charts'][0]
    assert (chart['x'], chart['y']) == ('time [s]', 'angle [deg]')
    x, y = (np.frombuffer(base64.b64decode(chart['curves'][0][k]), '<f4') for k in 'xy')
    assert y.max() == pytest.approx(180.0 / math.pi, rel=1e-6)
    assert y == pytest.approx(np.degrees(np.sin(x)), abs=1e-4)
    assert x.size <= POINTS + 2


def test_what_was_not_judged_is_not_counted_as_kept() -> None:
    kept, missed, left, plain = (Figure(n, n, 1.0, 'm', limit, ok) for n, limit, ok in (
        ('kept', '<= 2', True), ('missed', '<= 0', False), ('left', '>= 1 from 5 A on', None),
        ('plain', '', None)))  # fmt: skip

    def said(*of: Figure) -> str:
        return sentence([Result(evaluation='x', title='x', norm='x', figures=of)])

    assert said(kept, plain) == 'all limits of the norm are kept'
    assert said(kept, left, plain) == 'all limits of the norm that were judged are kept, 1 was not judged'
    assert said(kept, missed, left) == 'limits of the norm are not kept'
    assert said(left, left) == 'not judged: see the notes (2 limits)'
    assert said(plain) == 'not judged: the norm has no limits'


def test_a_page_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagError, match='cannot write'):
        written(tmp_path / 'file' / 'p.html')


@pytest.mark.skipif(CHROMIUM is None, reason='needs a browser: apt-get install chromium')
def test_a_browser_draws_it(tmp_path: Path) -> None:
    from PIL import Image

    written(tmp_path / 'p.html')
    home = [
        '--user-data-dir=' + str(tmp_path / 'profile'),
        '--window-size=1280,900',
        '--disable-component-update',
        '--disable-sync',
    ]
    picture = tmp_path / 'p.png'
    arguments = [str(CHROMIUM), *QUIET, *home, f'--screenshot={picture}', (tmp_path / 'p.html').as_uri()]
    subprocess.run(arguments, check=True, capture_output=True, timeout=120)
    pixels = np.asarray(Image.open(picture).convert('RGB')).astype(int)
    drawn = np.abs(pixels - np.array([0xD5, 0x5E, 0x00])).sum(axis=2) < 30  # the colour of a run
    columns = np.flatnonzero(drawn[400:].any(axis=0))
    assert columns.size > 400  # a curve across a chart, not only its key
