"""The page of an evaluation: figures and curves in it are those of the result. A browser draws it in
test_page_in_browser.py."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from browser import blocks_of, data_of, numbers

from mbd_sim_ros.analysis.evaluation.figures import Chart, Curve, Figure, Result, sentence
from mbd_sim_ros.analysis.evaluation.html import write_page
from mbd_sim_ros.analysis.evaluation.variants import Variant
from mbd_sim_ros.analysis.pages import POINTS
from solver.errors import BagError

T = np.linspace(0.0, 5.0, 4001)
FIGURES = (
    Figure('angle', 'an angle', math.pi / 6.0, 'rad'),
    Figure('ratio', 'a ratio', 0.4, '1', '<= 0.35', False),
    Figure('gradient', 'a gradient', math.radians(2.0) / 9.80665, 'rad s^2/m'),
    Figure('missing', 'a figure without value', math.nan, 'm'),
)


def result_of(text: str = 'curve', factor: float = 1.0) -> Result:
    swing = Chart(
        title='swing',
        x=('time', 's'),
        y=('angle', 'rad'),
        curves=(Curve(text, T, factor * np.sin(T)), Curve('limit', T[:2], T[:2], 'limit')),
    )
    return Result(
        evaluation='iso7401_step',
        title='A test </script>',
        norm='a norm',
        figures=FIGURES,
        charts=(swing,),
        notes=('a note',),
        source='bags/x',
        parameters={'low': 1.0, 'ratio': None},
    )


def written(file: Path, *of: Variant) -> dict:
    of = of or (Variant('car', (result_of(),)),)
    write_page(of, file, title='title', about=['about'], passed=False, together={'all runs': FIGURES[1:2]})
    return data_of(file)


def test_the_page_holds_figures_and_curves_in_units_for_people(tmp_path: Path) -> None:
    data = written(tmp_path / 'deep' / 'p.html')
    assert data['verdict'] == {'ok': False, 'text': 'limits of the norm are not kept'}
    together, table = blocks_of(data, 'table')
    rows = {row[0]: row[1:] for row in table['rows']}
    assert rows['an angle'] == ['30', 'deg', '', '']
    assert rows['a ratio'] == ['0.4', '', '<= 0.35', 'FAIL']
    assert rows['a gradient'] == ['2', 'deg/g', '', '']
    assert rows['a figure without value'] == ['-', 'm', '', '']
    assert together['rows'] == [['a ratio', '0.4', '', '<= 0.35', 'FAIL']]
    (part,) = blocks_of(data, 'part')
    assert part['title'] == 'A test </script>: FAIL' and part['open']
    assert 'Parameters: low 1' in blocks_of(data, 'text')[0]['lines']
    chart = blocks_of(data, 'charts')[0]['charts'][0]
    assert (chart['x'], chart['y']) == ('time [s]', 'angle [deg]')
    x, y = (numbers(chart['curves'][0][k]) for k in 'xy')
    assert y.max() == pytest.approx(180.0 / math.pi, rel=1e-6)
    assert y == pytest.approx(np.degrees(np.sin(x)), abs=1e-4)
    assert x.size <= POINTS + 2


def test_curves_of_variants_lie_over_each_other(tmp_path: Path) -> None:
    """One colour for each variant; limits are those of the first."""
    of = [Variant(name, (result_of(factor=factor),)) for name, factor in (('base', 1.0), ('stiff', 0.5))]
    data = written(tmp_path / 'p.html', *of)
    chart = blocks_of(data, 'charts')[0]['charts'][0]
    assert [(c['name'], c['colour'], c['style']) for c in chart['curves']] == [
        ('base: curve', 0, 'run'), ('base: limit', 0, 'limit'), ('stiff: curve', 1, 'run'),
    ]  # fmt: skip
    assert numbers(chart['curves'][2]['y']).max() == pytest.approx(90.0 / math.pi, rel=1e-6)
    assert blocks_of(data, 'table')[0]['columns'] == ['figure', 'unit', 'base', 'stiff', 'difference']
    assert [part['title'][:6] for part in blocks_of(data, 'part')] == ['base: ', 'stiff:']
    assert all(not part['open'] for part in blocks_of(data, 'part'))


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
