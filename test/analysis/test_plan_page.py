"""The page of a plan."""

from __future__ import annotations

import base64
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from browser import CHROMIUM, opened

from mbd_sim_ros.analysis import pages, plan_page
from mbd_sim_ros.analysis.pages import Page
from mbd_sim_ros.analysis.plan_page import elsewhere, error_rows
from solver.trade.influence import Influence
from solver.trade.judging import Verdict
from solver.trade.setting import Setting


def test_errors_have_the_units_of_their_quantities() -> None:
    """0.1 rad/s are 5.73 deg/s; what is not known is a dash."""
    parts = {'model': 0.1, 'step': 0.1, 'iteration': None, 'reference': 0.0, 'sum': None, 'limit': 0.2, 'share': None}
    data = {
        'errors': {'yaw_rate': {'rms': parts, 'delay': {**parts, 'model': 2e-3}}, 'imu/ay': {'max': parts}},
        'units': {'yaw_rate': 'rad/s', 'imu/ay': 'm/s^2'},
    }
    head, *rows = error_rows(data)
    assert head == ('error', 'model', 'step', 'iteration', 'reference', 'sum', 'limit')
    assert rows == [
        ('yaw_rate rms', '5.73 deg/s', '5.73 deg/s', '-', '0 deg/s', '-', '11.5 deg/s'),
        ('yaw_rate delay', '2 ms', '0.1 s', '-', '0 s', '-', '0.2 s'),
        ('imu/ay max', '0.1 m/s^2', '0.1 m/s^2', '-', '0 m/s^2', '-', '0.2 m/s^2'),
    ]


CONFIDENCE = '(Statistically: with 95 % confidence at most {} % could fail.)'


@pytest.mark.parametrize(
    ('passed', 'failed', 'bound', 'largest', 'text'),
    [
        (
            12,
            0,
            1.0 - 0.05 ** (1 / 12),
            0.851,
            '12 of 12 other maneuvers passed, the worst at 85 % of the limit. ' + CONFIDENCE.format(22),
        ),
        (
            59,
            0,
            1.0 - 0.05 ** (1 / 59),
            0.04,
            '59 of 59 other maneuvers passed, the worst at 4 % of the limit. ' + CONFIDENCE.format(5),
        ),
        (1, 1, None, 1.3, '1 of 2 other maneuvers passed, the worst at 130 % of the limit'),
        (0, 0, None, None, 'not checked on other maneuvers'),
    ],
)
def test_checks_are_told_in_the_words_of_an_engineer(passed, failed, bound, largest, text) -> None:
    assert elsewhere({'passed': passed, 'failed': failed, 'bound': bound, 'largest': largest}) == text


def _search() -> Any:
    """What was tried: two levels, one setting dropped, one that is unlimited; two subsystems, one error not known."""
    settings = [Setting(level=level, h=h, iterations=1) for level in ('kc', 'full') for h in (1e-3, 4e-3)]
    used = (0.02, 0.7, 0.003, np.inf)
    tried = [
        Verdict(s, u, cost, 'yaw_rate rms', 'no margin' if k == 1 else '', {})
        for k, (s, u, cost) in enumerate(zip(settings, used, (3e-3, 8e-4, 4e-2, 1e-2), strict=True))
    ]
    names = ['yaw_rate', 'roll', 'wheel_load.front_left']
    influences = [
        Influence('steering', {'yaw_rate': 0.5, 'roll': 1e-4, 'wheel_load.front_left': 0.0}, 0.7, ''),
        Influence('bushings', {'yaw_rate': np.inf, 'roll': 2e-3, 'wheel_load.front_left': 0.03}, 0.4, ''),
    ]
    return SimpleNamespace(tried=tried, shown=names, influences=influences)


def _data() -> dict[str, Any]:
    parts = {'model': 0.1, 'step': 0.04, 'iteration': None, 'reference': 0.01, 'sum': 0.15, 'limit': 0.2, 'share': None}
    checks = [
        {'variation': 'amplitude 0.9', 'used': 0.6, 'worst': 'yaw_rate rms', 'failure': ''},
        {'variation': 'speed 1.05', 'used': 1.2, 'worst': 'yaw_rate rms', 'failure': ''},
        {'variation': 'friction 0.5', 'used': None, 'worst': '', 'failure': 'came to no end'},
    ]
    return {'errors': {'yaw_rate': {'rms': parts}}, 'units': {'yaw_rate': 'rad/s'}, 'checks': checks}


def test_pictures_hold_the_numbers_of_a_plan() -> None:
    """Bars in % of limits by their origin; cells in % of peaks, None where not known; places of what was tried that has
    any; a text for each bar, cell and dot."""
    bars = plan_page._origins(_data())
    assert [s['values'] for s in bars['series']] == [[50.0], [20.0], [0.0], [pytest.approx(5.0)]]
    assert bars['says'][:3] == [
        'yaw_rate rms: model 5.73 deg/s, 50 % of the limit', 'yaw_rate rms: step 2.29 deg/s, 20 % of the limit',
        'yaw_rate rms: iteration -, 0 % of the limit',
    ]  # fmt: skip
    cells = plan_page._influences(_search())
    assert cells['values'] == [[50.0, pytest.approx(0.01), 0.0], [None, pytest.approx(0.2), pytest.approx(3.0)]]
    assert cells['says'][0] == 'without steering, yaw_rate: 50 % of its peak'
    assert cells['says'][3] == 'without bushings, yaw_rate: not known' and len(cells['says']) == 6
    checks = plan_page._checks(_data())
    assert [s['values'] for s in checks['series']] == [[60.0, None, None], [None, pytest.approx(120.0), 200.0]]
    assert checks['says'][4] == 'friction 0.5: -: came to no end' and len(checks['says']) == 6
    (chart,) = plan_page._tried(_search(), _search().tried[0])['charts']
    assert [c['name'] for c in chart['curves']] == ['chosen', 'kc', 'kc, dropped', 'full', 'limit']
    assert [len(c.get('labels', [])) for c in chart['curves']] == [0, 1, 1, 1, 0]  # one has no share: it is unlimited
    assert chart['curves'][2]['labels'] == ['kc, 4 ms, 1 iteration, rho 0.8: 70 % of the limit, 0.8 ms; no margin']


PROBE = """(async () => {
    const move = (e, x, y) => e.dispatchEvent(new PointerEvent('pointermove', { bubbles: true, clientX: x, clientY: y })), wait = () => new Promise(done => setTimeout(done, 60));
    const drawn = Array.from(document.querySelectorAll('.drawn')), told = e => e.parentElement.querySelector('.read').textContent, found = { wide: document.documentElement.scrollWidth - innerWidth };
    found.areas = drawn.map(d => d.querySelectorAll('[data-i]').length);
    found.says = drawn.map(d => { const area = d.querySelectorAll('[data-i]')[1]; move(area); return told(d); });
    move(drawn[0].querySelector('text')); found.none = told(drawn[0]);
    const long = () => Math.max(...Array.from(drawn[0].querySelectorAll('[data-i]'), a => a.getBBox().x + a.getBBox().width)), before = long();
    const box = drawn[0].parentElement.querySelector('.keys input'); box.checked = false; box.onchange();
    found.hidden = [drawn[0].querySelectorAll('[data-i]').length, long() < before];
    const colour = () => drawn[1].querySelector('[data-i]').getAttribute('fill'), light = colour(); document.querySelector('header button').click(); await wait(); found.turned = light !== colour();
    found.outside = drawn.map(d => Array.from(d.querySelectorAll('text, polygon')).filter(e => { const a = e.getBoundingClientRect(), b = d.firstElementChild.getBoundingClientRect(); return a.left < b.left - 1 || a.right > b.right + 1 || a.bottom > b.bottom + 1 || a.top < b.top - 1; }).length);
    const c = page.charts[0], u = c.u, k = c.curves.findIndex(x => x.labels);
    u.setCursor({ left: u.valToPos(c.curves[k].x[0], 'x'), top: u.valToPos(c.curves[k].y[0], 'y') }); await wait(); found.point = c.read.textContent;
    found.ticks = u.axes.map(a => a._values); found.svg = page.svgOf(c.picture());
    const saved = []; URL.createObjectURL = blob => { saved.push(blob.arrayBuffer()); return '#'; };
    for (const d of drawn) for (const b of d.parentElement.querySelectorAll('button')) b.click();
    found.saved = (await Promise.all(saved)).map(b => btoa(Array.from(new Uint8Array(b), v => String.fromCharCode(v)).join('')));
    return found;
})()"""  # noqa: E501


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason='needs a browser: apt-get install chromium')
@pytest.mark.parametrize('size', [(1400, 1800), (500, 2400)])
def test_pictures_answer_to_their_user(size: tuple[int, int], tmp_path: Path) -> None:
    """What lies under the pointer is said, a part is hidden, all is inside its picture, colours follow the theme, and
    SVG and PDF are saved."""
    search, data = _search(), _data()
    chosen = search.tried[0]
    blocks = [
        plan_page._origins(data), plan_page._influences(search), plan_page._checks(data),
        plan_page._tried(search, chosen), pages.text('end'),
    ]  # fmt: skip
    Page(title='plan', blocks=blocks).write(tmp_path / 'plan.html')
    found = opened(tmp_path / 'plan.html', size, PROBE, ready='page.charts.some(c => c.u)')
    assert found['wide'] <= 0
    assert found['areas'] == [3, 6, 3]
    assert found['says'] == [
        'yaw_rate rms: step 2.29 deg/s, 20 % of the limit', 'without steering, roll: 0.01 % of its peak',
        'speed 1.05: 120 % of its limit: yaw_rate rms',
    ]  # fmt: skip
    assert found['none'] == '' and found['hidden'] == [2, True] and found['turned'] and found['outside'] == [0, 0, 0]
    assert found['point'] == 'kc, 1 ms, 1 iteration, rho 0.8: 2 % of the limit, 3 ms'
    for texts in found['ticks']:  # round values of decades
        assert len(texts) >= 2 and {t.strip('0.')[:1] for t in texts} <= {'1', '2', '3', '5'}, texts
    assert ElementTree.fromstring(found['svg']).tag.endswith('svg')
    saved = [base64.b64decode(one) for one in found['saved']]
    assert [one[:4] for one in saved] == [b'<svg', b'%PDF'] * 3
    assert all(len(ElementTree.fromstring(one)) > 8 for one in saved[::2])


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason='needs a browser: apt-get install chromium')
def test_scales_in_decades_have_round_values(tmp_path: Path) -> None:
    """Of less than a decade, of one, of twenty: at least two values, each at its logarithm, few enough to be read."""
    Page(title='x').write(tmp_path / 'p.html')
    ranges = ((0.85, 1.05), (2.0, 2.1), (0.8, 9.0), (1.0, 100.0), (3e-4, 2e4), (1e-12, 1e8))
    asked = [[*np.log10(of).tolist(), count] for of in ranges for count in (3, 8)]
    for (low, high, count), found in zip(
        asked, opened(tmp_path / 'p.html', (800, 600), f'{asked}.map(a => decades(...a))'), strict=True
    ):
        values, texts = found['values'], found['texts']
        assert 2 <= len(values) <= 2 * count and len({*texts}) == len(texts)
        assert all(low - 1e-6 <= v <= high + 1e-6 for v in values)
        assert 10.0 ** np.array(values) == pytest.approx([float(t) for t in texts], rel=1e-9)
