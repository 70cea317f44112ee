"""Every kind of page in a real browser, at the size of a desk and of a phone: charts are drawn, nothing is fetched,
nothing is said on the console, nothing is wider than the screen, pictures can be saved, tables sorted, channels
picked."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from browser import CHROMIUM, opened
from scalars import run

from mbd_sim_ros.analysis import pages, run_page
from mbd_sim_ros.analysis.comparison import compare
from mbd_sim_ros.analysis.evaluation.figures import Chart, Curve, Figure, Result
from mbd_sim_ros.analysis.evaluation.html import write_page as write_evaluation
from mbd_sim_ros.analysis.evaluation.variants import Variant
from mbd_sim_ros.analysis.html import write_report
from mbd_sim_ros.analysis.view.motion import read_motion
from mbd_sim_ros.analysis.view.page import write_page as write_view
from mbd_sim_ros.batch import simulate
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.lab.studies.report import Report, figure
from solver import load_scene, simulation_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason='needs a browser: apt-get install chromium'),
]
SIZES = ((1280, 900), (520, 900))  # the smallest window that a browser without a screen takes is 500 wide
MOST = 1_500_000  # bytes of a page
PROBE = """{
    charts: page.charts.length, drawn: page.charts.filter(c => c.u).length, wide: document.documentElement.scrollWidth - innerWidth,
    title: document.querySelector('h1').textContent, facts: page.data.facts.map(f => f[0]), theme: document.documentElement.dataset.theme,
    svg: page.charts.length ? page.svgOf(page.charts[0].picture()) : '', pdf: page.charts.length ? btoa(page.pdfOf(page.charts[0].picture())) : '',
    canvases: Array.from(document.querySelectorAll('canvas')).filter(c => c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some(v => v)).length
}"""  # noqa: E501


@pytest.fixture(scope='module')
def car(tmp_path_factory: pytest.TempPathFactory) -> Path:
    simulation = simulation_of(load_scene('light_car_step_steer', ['duration=1.5', 'maneuver.steering.start=0.2']))
    place = tmp_path_factory.mktemp('car') / 'run'
    simulate(simulation, simulation.scene.steps, directory=place)
    return place


def _evaluation(file: Path, _: Path) -> None:
    t = np.linspace(0.0, 5.0, 4001)
    of = []
    for name, factor in (('soft', 1.0), ('stiff', 0.8)):
        charts = (
            Chart(title='swing', x=('time', 's'), y=('angle', 'rad'), curves=(Curve('swing', t, factor * np.sin(t)),)),
        )
        figures = (Figure('gain', 'gain', factor, '1/s', '<= 0.9', factor <= 0.9),)
        result = Result(evaluation='iso7401_step', title='Step', norm='a norm', figures=figures, charts=charts)
        of.append(Variant(name, (result,)))
    write_evaluation(of, file, title='Step', passed=False, together={})


def _comparison(file: Path, _: Path) -> None:
    repeats = [run(n=501, x=lambda t, d=d: np.sin(t) + d) for d in (-0.05, 0.0, 0.05)]
    found = compare(run(n=501, x=lambda t: 1.3 * np.sin(t)), *repeats)
    names = ('run', 'lap 1', 'lap 2', 'lap 3')
    write_report(found, file, names=names, about=[], verdict=(False, '1 of 1 channels outside'))


def _study(file: Path, _: Path) -> None:
    report = Report(file.parent, 'A study')
    report.text('## Part', 'Some `code`.')
    drawing, axes = figure(4.0, 3.0)
    axes[0, 0].plot([0.0, 1.0], [0.0, 1.0])
    report.figure('line', drawing, 'a line')
    report.table('rows', [{'a': 1.0, 'b': 'x'}])
    report.check('small', 0.1, 1.0)
    report.write()
    (file.parent / 'report.html').rename(file)


def _sweep(file: Path, _: Path) -> None:
    what = file.with_name('s.yaml')
    what.write_text(
        'scene: pendulum\nset: [duration=0.1]\nerrors: none\nparameters: {integrator.h: {values: [0.01, 0.005]}}\n'
        'figures: {fast: {quantity: odom/twist/wz}}\n'
    )
    assert main(['sweep', str(what), '--out', str(file.parent / 'sweep'), '--workers', '1', '--json']) == 0
    (file.parent / 'sweep' / 'report.html').rename(file)


def _bench(file: Path, _: Path) -> None:
    assert main(['kandc', 'light_car', '--points', '5', '--out', str(file.parent / 'k'), '--json']) == 0
    (file.parent / 'k' / 'report.html').rename(file)


KINDS: dict[str, tuple[Callable[[Path, Path], object], int]] = {  # what writes a page, and its charts that are open
    'compare': (_comparison, 2),
    'evaluate': (_evaluation, 1),
    'view': (lambda file, car: write_view([read_motion(car)], file), 8),
    'run': (lambda file, car: run_page.write_page([car, car], file), 6),
    'info': (lambda file, _: main(['info', 'light_car', '--brief', '--html', str(file), '--json']), 0),
    'study': (_study, 0),
    'sweep': (_sweep, 1),
    'kandc': (_bench, 30),
}


@pytest.mark.parametrize('kind', KINDS)
def test_a_page_is_drawn_at_both_sizes(
    kind: str, car: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write, count = KINDS[kind]
    file = tmp_path / f'{kind}.html'
    write(file, car)
    capsys.readouterr()
    assert file.stat().st_size < MOST
    for size in SIZES:
        found = opened(file, size, PROBE, ready='page.charts.some(c => c.u)' if count else 'true')
        assert found['charts'] >= count and (found['drawn'] > 0) == (count > 0)
        assert found['canvases'] >= min(found['drawn'], 1)
        assert found['wide'] <= 0, f'{found["wide"]} pixels beyond the screen'
        assert {'program', 'made'} <= set(found['facts']) and found['title']
        if count:
            picture = ElementTree.fromstring(found['svg'])
            assert picture.tag.endswith('svg') and len(picture) > 10
            _is_pdf(base64.b64decode(found['pdf']))


def _is_pdf(content: bytes) -> None:
    """Header, objects where the table of references says, and the end."""
    assert content.startswith(b'%PDF-1.4\n') and content.endswith(b'%%EOF\n')
    start = int(re.search(rb'startxref\n(\d+)', content)[1])  # type: ignore[index]
    assert content[start : start + 4] == b'xref'
    for k, place in enumerate(re.findall(rb'(\d{10}) 00000 n', content), 1):
        assert content[int(place) :].startswith(b'%d 0 obj' % k)
    length, stream = re.search(rb'/Length (\d+) >>\nstream\n(.*?)\nendstream', content, re.DOTALL).groups()  # type: ignore[union-attr]
    assert len(stream) == int(length)


def test_what_a_page_says_is_heard(tmp_path: Path) -> None:
    """An error, a line on the console and a request that the policy of all pages forbids."""
    for k, script in enumerate(('missing.name', 'console.log("hello")', 'fetch("https://example.invalid/x")')):
        file = tmp_path / f'{k}.html'
        pages.Page(title='x', blocks=[]).write(file)
        file.write_text(file.read_text('utf-8').replace('</html>', f'<script>{script}</script></html>'), 'utf-8')
        with pytest.raises(AssertionError):
            opened(file, SIZES[0])


def test_a_page_answers_to_its_user(tmp_path: Path) -> None:
    """A table is sorted by numbers, rows are filtered, a channel is picked, a zoom moves linked charts, a curve is
    hidden, the theme turns."""
    t = np.linspace(0.0, 10.0, 1001)
    rows = [('name', 'size'), *((f'row {k}', f'{(k * 7) % 20} mm') for k in range(20))]
    two = [
        pages.chart(
            name, 'time [s]', 'y [m]', [pages.curve('a', t, np.sin(t)), pages.curve('b', t, 5.0 * t)], linked='t'
        )
        for name in ('one', 'two')
    ]
    of = {name: {'label': name, 'runs': [[pages.floats(t), pages.floats(t)]]} for name in ('imu/ax', 'imu/ay')}
    picker = {'kind': 'channels', 'runs': ['run'], 'channels': of, 'chosen': ['imu/ax']}
    pages.Page(title='x', blocks=[pages.table(rows), pages.charts(two), picker]).write(tmp_path / 'p.html')
    probe = """await (async () => {
        const cells = () => Array.from(document.querySelectorAll('tbody tr')).filter(r => !r.hidden).map(r => r.children[1].textContent);
        const found = {}, wait = () => new Promise(done => setTimeout(done, 50)), [one, two] = page.charts;
        document.querySelectorAll('th')[1].click(); found.up = cells();
        document.querySelectorAll('th')[1].click(); found.down = cells();
        const filter = document.querySelector('input[type=search]'); filter.value = 'row 3'; filter.oninput(); found.left = cells().length;
        page.show(one, [2, 3]); await wait(); found.zoomed = [two.u.scales.x.min, two.u.scales.x.max];
        page.show(one, null); await wait(); found.whole = [two.u.scales.x.min, two.u.scales.x.max, two.u.scales.y.max];
        const box = two.figure.querySelectorAll('.keys input')[1]; box.checked = false; box.onchange(); await wait(); found.hidden = two.u.scales.y.max;
        const pick = document.querySelectorAll('.picker input')[1]; pick.checked = true; pick.onchange(); found.charts = page.charts.map(c => c.item.title);
        document.querySelector('header button').click(); await wait(); found.theme = document.documentElement.dataset.theme;
        return found;
    })()"""  # noqa: E501
    found = opened(tmp_path / 'p.html', SIZES[0], probe)
    assert found['up'] == [f'{k} mm' for k in range(20)] and found['down'] == found['up'][::-1]
    assert found['left'] == 1  # 'row 3' alone
    assert found['zoomed'] == pytest.approx([2.0, 3.0])
    assert found['whole'][:2] == pytest.approx([0.0, 10.0]) and 50.0 < found['whole'][2] < 60.0
    assert found['hidden'] < 1.5  # the sine alone
    assert found['charts'] == ['one', 'two', 'imu/ax', 'imu/ay']
    assert found['theme'] == 'dark'


def test_what_a_page_would_fetch_is_forbidden_and_told(tmp_path: Path) -> None:
    """The policy in the head of every page: what opened() takes as a sign of silence is one."""
    pages.Page(title='x').write(tmp_path / 'p.html')
    with pytest.raises(AssertionError, match='Content Security Policy'):
        opened(tmp_path / 'p.html', SIZES[0], 'new Image().src = "http://127.0.0.1:9/x.png"')


def test_a_request_is_told_where_no_policy_forbids_it(tmp_path: Path) -> None:
    (tmp_path / 'p.html').write_text('<!doctype html><title>x</title>')
    script = 'await fetch("http://127.0.0.1:9/x", {mode: "no-cors"}).catch(() => 0)'
    with pytest.raises(AssertionError, match=r"'url': 'http://127\.0\.0\.1:9/x'"):
        opened(tmp_path / 'p.html', SIZES[0], script)


@pytest.mark.long
def test_a_minute_of_the_full_car_fits(tmp_path: Path) -> None:
    """Its motion and its channels, each in a page of at most 1.5 MB."""
    simulation = simulation_of(load_scene('car_swept_steer', ['duration=60']))
    simulate(simulation, simulation.scene.steps, directory=tmp_path / 'run')
    write_view([read_motion(tmp_path / 'run')], tmp_path / 'view.html')
    run_page.write_page([tmp_path / 'run'], tmp_path / 'run.html')
    for name in ('view', 'run'):
        assert (tmp_path / f'{name}.html').stat().st_size <= MOST


@pytest.mark.parametrize(
    ('middle', 'swing'), [(5e5, 1e-3), (-2.5e6, 0.5), (4286.0, 0.1), (1.0, 1e-9), (3e-7, 1e-12), (0.0, 2.0), (9.5, 0.0)]
)
def test_small_swings_are_drawn_without_stairs_and_their_numbers_stand_clear(
    middle: float, swing: float, tmp_path: Path
) -> None:
    """Values in the page are within a rounding of a 32-bit float of the swing, and one of a 64-bit float of the value;
    numbers at the scale differ from each other, and have their place between label (20 pixels), gap and mark (15)."""
    t = np.arange(201) * 0.01
    y = middle + swing * np.sin(9.0 * t)
    found = run(n=201, total=lambda t: middle + swing * np.sin(9.0 * t))
    pages.Page(title='x', blocks=run_page.channels([found], ['run'])).write(tmp_path / 'p.html')
    probe = """(() => { document.body.insertAdjacentHTML('beforeend', page.svgOf(page.charts[0].picture()));
        const { u, curves } = page.charts[0], g = document.createElement('canvas').getContext('2d'); g.font = '11.5px system-ui, sans-serif';
        const texts = u.axes[1]._values, wide = Math.max(...texts.map(v => g.measureText(v).width));
        return { y: Array.from(curves[0].y), texts, free: u.bbox.left / devicePixelRatio - 35 - wide, range: [u.scales.y.min, u.scales.y.max],
            saved: Math.min(...Array.from(document.querySelectorAll('body > svg [text-anchor=end]'), e => e.getBBox().x)) }; })()"""  # noqa: E501
    for size in SIZES:
        seen = opened(tmp_path / 'p.html', size, probe, ready='page.charts.some(c => c.u)')
        y_seen = np.array(seen['y'])
        assert np.abs(y_seen - y).max() <= 2.0**-23 * swing + 2.0**-52 * abs(middle)
        assert len({*seen['texts']}) == len(seen['texts']) >= 2
        assert seen['free'] >= 0.0
        if swing:
            assert swing < seen['range'][1] - seen['range'][0] < 3.0 * swing
        assert seen['saved'] >= 17.0  # where the label ends in the picture that is saved


def test_labels_and_numbers_of_scales_are_not_cut(tmp_path: Path) -> None:
    """A long label is shortened and keeps its unit; the last number of x has room beyond the scale; heads of numbers
    stand above them; a dot in the legend is as large as those of its curve."""
    label = 'lateral acceleration per steering-wheel angle of the road wheels [m/s^2/deg]'
    x = np.linspace(-3000.0, 3000.0, 5)
    curves = [pages.curve('line', x, x), pages.curve('dots', x, -x, points=6)]
    rows = [('name', 'size'), ('a', '12.5'), ('b', '7')]
    page = pages.Page(
        title='x', blocks=[pages.table(rows), pages.charts([pages.chart('one', 'force [N]', label, curves)])]
    )
    page.write(tmp_path / 'p.html')
    probe = """(() => {
        const u = page.charts[0].u, g = document.createElement('canvas').getContext('2d'), dpr = devicePixelRatio, texts = u.axes[0]._values;
        g.font = '12px system-ui, sans-serif';
        const tall = g.measureText(u.axes[1].label).width; g.font = '11.5px system-ui, sans-serif';
        return { label: u.axes[1].label, free: u.bbox.height / dpr - tall,
            right: u.width - (u.bbox.left + u.bbox.width) / dpr - 0.5 * g.measureText(texts[texts.length - 1]).width,
            heads: Array.from(document.querySelectorAll('th'), e => getComputedStyle(e).textAlign), dot: document.querySelector('i.dot').offsetWidth };
    })()"""  # noqa: E501
    for size in SIZES:
        seen = opened(tmp_path / 'p.html', size, probe, ready='page.charts.some(c => c.u)')
        assert seen['label'].startswith('lateral acc') and seen['label'].endswith('.. [m/s^2/deg]')
        assert seen['free'] >= 0.0 and seen['right'] >= 0.0
        assert seen['heads'] == ['left', 'right'] and seen['dot'] == 12


@pytest.mark.parametrize('start', [0, 123, 9990, 200_000, 1_700_000_000])
def test_stamps_stay_sharp_wherever_a_recording_begins(start: int, tmp_path: Path) -> None:
    """At 1 kHz, and what the pointer says of one: stamps that a 32-bit float would round to a millisecond, or to two
    minutes."""
    n = 2001
    found = run(n=n, h_ns=1_000_000, start_ns=start * 10**9, total=np.sin)
    pages.Page(title='x', blocks=run_page.channels([found], ['run'])).write(tmp_path / 'p.html')
    probe = """(() => {
        const c = page.charts[0], origin = c.item.origin || 0;
        page.show(c, [start - origin + 0.5, start - origin + 0.51]);
        c.u.setCursor({ left: c.u.valToPos(start - origin + 0.507, 'x'), top: 20 });
        return { x: Array.from(c.curves[0].x, x => x + origin - start), read: c.read.textContent };
    })()""".replace('start', str(start))
    seen = opened(tmp_path / 'p.html', SIZES[0], probe, ready='page.charts.some(c => c.u)')
    np.testing.assert_allclose(seen['x'], 1e-3 * np.arange(n), atol=2e-7 + 2.0**-52 * start)
    assert float(re.search(r'time (\S+)', seen['read'])[1]) - start == pytest.approx(0.507, abs=2e-4)  # type: ignore[index]


@pytest.mark.parametrize('start', [0, 9990])
def test_stamps_of_comparisons_and_evaluations_stay_sharp(start: int, tmp_path: Path) -> None:
    """Two curves of one chart over one time, and of two variants over times of their own."""
    n = 2001
    b = run(n=n, h_ns=1_000_000, start_ns=start * 10**9, x=np.sin)
    write_report(compare(b, b), tmp_path / 'c.html', names=('a', 'b'), about=[], verdict=(True, 'ok'))
    t = start + 1e-3 * np.arange(n)
    of = []
    for name, later in (('soft', 0.25), ('stiff', 0.0)):
        curves = (Curve('swing', t + later, np.sin(t)), Curve('limit', t + later, 0.0 * t, style='limit'))
        chart = Chart(title='swing', x=('time', 's'), y=('angle', 'rad'), curves=curves)
        of.append(Variant(name, (Result(evaluation='iso7401_step', title='E', norm='n', figures=(), charts=(chart,)),)))
    write_evaluation(of, tmp_path / 'e.html', title='E', passed=None, together={})
    probe = 'page.charts.map(c => c.curves.map(curve => Array.from(curve.x, x => x + (c.item.origin || 0))))'
    ready = 'page.charts.some(c => c.u)'
    compared = opened(tmp_path / 'c.html', SIZES[0], probe.join(('{x: ', '}')), ready=ready)['x']
    assert len(compared) == 2 and len(compared[0]) == 2
    for x in (*compared[0], *compared[1]):
        np.testing.assert_allclose(x, t, atol=2e-7)
    (variants,) = opened(tmp_path / 'e.html', SIZES[0], probe.join(('{x: ', '}')), ready=ready)['x']
    for x in variants:
        assert min(np.abs(x - t - later).max() for later in (0.0, 0.25)) < 2e-7


def test_cells_keep_to_their_columns_and_numbers_stand_below_numbers(tmp_path: Path) -> None:
    """A name without a gap ends in its column; a number among values with units stands as they do, to the left."""
    name = 'element_states/upper_front_link_of_the_rear_axle_right_inner_bushing/energy'
    head = ['channel', 'value', 'size', *(f'column {k}' for k in range(20))]
    rows = [[name, value, k, *range(20)] for k, value in enumerate(('25 kN/m', '3 mm', '16.5'))]
    pages.Page(title='x', blocks=[pages.table([head, *rows], bad=[0])]).write(tmp_path / 'p.html')
    probe = """{
        over: Array.from(document.querySelectorAll('td')).filter(c => c.scrollWidth > c.clientWidth + 1).length,
        right: Array.from(document.querySelectorAll('tbody tr')).map(r => [1, 2].map(k => r.children[k].classList.contains('number')))
    }"""  # noqa: E501
    for size in SIZES:
        found = opened(tmp_path / 'p.html', size, probe)
        assert found['over'] == 0 and found['right'] == [[False, True]] * 3
