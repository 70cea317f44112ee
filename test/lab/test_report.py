"""Pictures of a study: curves are shown as curves on its page, and everything else as it is drawn."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbd_sim_ros.analysis import pages
from mbd_sim_ros.lab.studies.report import Report, figure, interactive

TIME = np.linspace(0.0, 2.0, 401)


def lines(ax: Any) -> None:
    """Two curves with names, one of them dashed."""
    ax.plot(TIME, np.sin(TIME), label='one', color='#1b6ca8')
    ax.plot(TIME, np.cos(TIME), '--', color='#d95f02')
    ax.set(xlabel='time [s]', ylabel='angle [rad]', title='both')


def test_curves_become_a_chart_with_their_numbers(tmp_path: Path) -> None:
    new, axes = figure(6.0, 3.0)
    lines(axes[0, 0])
    (chart,) = interactive(new)
    assert (chart['title'], chart['x'], chart['y']) == ('both', 'time [s]', 'angle [rad]')
    first, second = chart['curves']
    assert [first['name'], second['name']] == ['one', ''] and [first['dash'], second['dash']] == [0, 1]
    assert first['colour'] != second['colour'] and first['x'] == pages.floats(TIME)
    assert [first['y'], second['y']] == [pages.floats(np.sin(TIME)), pages.floats(np.cos(TIME))]
    report = Report(tmp_path, 'a study')
    report.figure('drawn', new, 'what is to be seen')
    report.write()
    assert (tmp_path / 'drawn.png').is_file() and 'drawn.png' in (tmp_path / 'report.md').read_text(encoding='utf-8')
    page = (tmp_path / 'report.html').read_text(encoding='utf-8')
    assert json.dumps(first['y']) in page and 'what is to be seen' in page


@pytest.mark.parametrize(
    'draw',
    [
        lambda ax: ax.set_yscale('log'),
        lambda ax: ax.scatter([1.0], [0.5]),
        lambda ax: ax.axhline(0.5),
        lambda ax: ax.fill_between(TIME, 0.0, 1.0),
        lambda ax: ax.text(0.1, 0.1, 'here'),
        lambda ax: ax.twinx().plot(TIME, TIME),
        lambda ax: ax.plot(np.cos(TIME * 4.0), np.sin(TIME * 4.0)),
        lambda ax: ax.plot([0.0, 1.0, 2.0], [0.0, 1.0, 0.0], 'o'),
        lambda ax: ax.invert_yaxis(),
    ],
)
def test_a_picture_with_anything_else_stays_a_picture(draw: Callable[[Any], Any]) -> None:
    new, axes = figure(6.0, 3.0)
    lines(axes[0, 0])
    draw(axes[0, 0])
    assert interactive(new) == []
