"""A recording in motion: what is drawn stands where mechanics has it, in pictures and in the page."""

from __future__ import annotations

import base64
import itertools
import json
import math
import re
import shutil
import zlib
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from browser import CHROMIUM, SOFTWARE_WEBGL, Browser, data_of, numbers, opened
from mcap.reader import make_reader
from scipy.ndimage import binary_dilation
from scipy.spatial.transform import Rotation

from mbd_sim_ros.analysis.view.motion import RecordedMotion, read_motion
from mbd_sim_ros.analysis.view.page import packed, size_of, write_page
from mbd_sim_ros.analysis.view.picture import strokes
from mbd_sim_ros.bags import reader
from mbd_sim_ros.bags.recorder import StepRecorder, describe
from mbd_sim_ros.batch import simulate
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.messages import cdr
from solver import load_scene, simulation_of


def recorded(directory: Path, scene: str, *overrides: str) -> Path:
    simulation = simulation_of(load_scene(scene, overrides))
    simulate(simulation, simulation.scene.steps, directory=directory)
    return directory


@pytest.fixture(scope='module')
def car(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp('bags') / 'car', 'light_car_step_steer', 'duration=2.6', 'record.poses=10')


@pytest.fixture(scope='module')
def crank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp('bags') / 'crank', 'slider_crank', 'duration=0.4', 'record.poses=20')


def drawn(motion: RecordedMotion, k: int, kind: str) -> list[np.ndarray]:
    return [points for is_, points in strokes(motion, k) if is_ == kind]


def test_the_rods_of_a_slider_crank_are_a_metre_long_meet_and_end_on_its_axis(crank: Path):
    motion = read_motion(crank)
    angles = motion.run['joint_states/crank/position'] if 'joint_states/crank/position' in motion.run.columns else None
    for k in range(len(motion.time)):
        rods = [line for line in drawn(motion, k, 'body') if np.ptp(line, axis=0).max() > 1e-9]
        assert len(rods) == 2
        for rod in rods:
            assert np.linalg.norm(rod[1] - rod[0]) == pytest.approx(1.0, abs=1e-9)
        gaps = sorted(float(np.linalg.norm(a - b)) for a, b in itertools.product(*rods))
        assert gaps[0] < 1e-6  # the pin between them; constraints are closed to their tolerance
        ends = np.concatenate(rods)
        assert np.sum(np.abs(ends[:, 1]) < 1e-6) >= 2  # bearing and slider
    assert angles is None or np.ptp(angles) > 0.5  # it did move


def test_wheels_steer_and_turn_as_their_poses_have_it(car: Path):
    motion = read_motion(car)
    chassis = motion.follows
    steered, spun = [], []
    for k in range(len(motion.time)):
        wheels = drawn(motion, k, 'wheel')
        assert len(wheels) == 4 * (2 + 5)
        first = wheels[0]  # a rim of the front left wheel
        normal = np.cross(first[7] - first[0], first[14] - first[0])
        forward = Rotation.from_quat(motion.pose[k, chassis, 3:]).apply([1.0, 0.0, 0.0])
        left = Rotation.from_quat(motion.pose[k, chassis, 3:]).apply([0.0, 1.0, 0.0])
        normal /= np.linalg.norm(normal)
        normal *= np.sign(normal @ left)
        steered.append(np.arctan2(-normal @ forward, normal @ left))
        spoke = wheels[2]
        spun.append(spoke[1] - spoke[0])
        # every rim stands on the ground, but for the deflection of the tire
        for i, wheel in enumerate(motion.drawing.wheels):
            rims = np.concatenate(wheels[7 * i : 7 * i + 2])
            assert -0.04 < rims[:, 2].min() < 0.005
            radii = np.linalg.norm(np.diff(wheels[7 * i + 2], axis=0), axis=1)
            assert radii == pytest.approx(wheel.radius, rel=1e-9)
    wheel = motion.run['joint_states/steering_wheel/position']
    straight, steady = np.abs(wheel) < 1e-6, np.abs(wheel) > 0.9 * np.abs(wheel).max()
    assert straight.any() and steady.any()
    # the steering wheel turns the road wheels to its side, ten to twenty times less
    assert steered[-1] - steered[0] == pytest.approx(wheel[-1] / 15.0, rel=0.35)
    assert np.ptp(np.array(spun), axis=0)[2] > motion.drawing.wheels[0].radius  # it rolled


def test_links_and_wheels_stand_where_the_kinematics_of_the_simulation_has_them(car: Path):
    """The same simulation again, asked for its poses: every line, spring and rim goes through points of their bodies
    there."""
    motion = read_motion(car)
    simulation = simulation_of(load_scene('light_car_step_steer', ('duration=2.6', 'record.poses=10')))
    for k in (0, len(motion.time) - 3, len(motion.time) - 1):  # standing straight, while it steers, in the bend
        shot = simulation.advance(round(motion.time[k] / simulation.h) - simulation.k)
        turn = [Rotation.from_quat(q) for q in shot.pose[:, 3:]]

        def place(body: int, point: tuple[float, float, float], shot=shot, turn=turn) -> np.ndarray:
            return shot.pose[body, :3] + turn[body].apply(point)

        lines = drawn(motion, k, 'body') + drawn(motion, k, 'outline')
        fixed = [
            [place(line.body, line.a), place(line.body, line.b)] for line in motion.drawing.lines if line.body >= 0
        ]
        key = lambda points: np.round(np.ravel(points), 6).tolist()  # noqa: E731
        np.testing.assert_allclose(sorted(map(key, lines)), sorted(map(key, fixed)), atol=2e-6)
        for spring, points in zip(motion.drawing.springs, drawn(motion, k, 'spring'), strict=True):
            ends = [place(body, at) if body >= 0 else at for body, at in ((spring.i, spring.a), (spring.j, spring.b))]
            np.testing.assert_allclose(points, ends, atol=1e-9)
        for i, wheel in enumerate(motion.drawing.wheels):
            rim, middle, spin = (
                drawn(motion, k, 'wheel')[7 * i],
                place(wheel.body, wheel.center),
                turn[wheel.body].apply(wheel.axis),
            )
            # in one plane across the axis: it steers
            np.testing.assert_allclose((rim - middle) @ spin, -0.5 * wheel.width, atol=1e-9)
            np.testing.assert_allclose(np.linalg.norm(np.cross(rim - middle, spin), axis=1), wheel.radius, atol=1e-9)


def test_pictures_say_what_their_colours_are(car: Path, crank: Path):
    from mbd_sim_ros.analysis.view.picture import Painter

    def said(*bags: Path) -> list[str]:
        painter = Painter([read_motion(bag) for bag in bags])
        painter.paint(0.1)
        return [
            text.get_text()
            for axes in painter.figure.axes
            for legend in [axes.get_legend()]
            if legend
            for text in legend.get_texts()
        ]

    assert said(car, car) == ['links', 'springs and dampers', 'wheels', 'forces on the tires, 1 m for 6 kN', 'ghost']
    assert said(crank) == ['links']


def test_what_has_no_curves_is_drawn_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """A free body has no joint whose angle could be drawn beside it."""
    bag = recorded(tmp_path / 'top', 'torque_free_top', 'duration=0.1')
    for name, *options in (
        ('one.png', '--width', '320'),
        ('film.gif', '--width', '320'),
        ('page.html',),
        ('layout.json',),
    ):
        assert main(['view', str(bag), '--out', str(tmp_path / name), *options]) == 0, capsys.readouterr().err
        assert (tmp_path / name).stat().st_size > 0
    assert json.loads((tmp_path / 'layout.json').read_text())['layout'] == '3D!motion'


def test_the_arrows_are_the_tire_forces(car: Path):
    motion = read_motion(car)
    weight = 9.81 * sum(body.mass for body in load_scene('light_car_step_steer').model.bodies)
    assert motion.force[0, :, 2].sum() == pytest.approx(weight, rel=1e-3)  # straight ahead on level ground
    arrows = np.array([points[1] - points[0] for points in drawn(motion, len(motion.time) - 1, 'force')])
    assert len(arrows) == 4
    assert 6000.0 * arrows[:, 2].sum() == pytest.approx(weight, rel=0.05)
    side = 6000.0 * arrows[:, :2].sum(axis=0)
    velocity = motion.pose[-1, motion.follows, :2] - motion.pose[-2, motion.follows, :2]
    # towards the inside of the bend
    assert velocity[0] * side[1] - velocity[1] * side[0] > 0.0 if motion.run['imu/wz'][-1] > 0.0 else True


def test_the_grid_of_metres_lies_on_the_road_where_the_tires_touch_it(tmp_path: Path):
    """A plane that rises by 10 %, a bank of 5 %, and a hill on it, 0.5 m high and 40 m long: the picture and the page
    have the road there, and not the level plane z = 0. Tires touch the plane that is tangent below the middle of the
    wheel, aside of that by radius times slope, where the hill with its curvature, 0.25 m (2 pi / 40 m)^2, has left
    it."""
    height = [[0.25 - 0.25 * math.cos(math.tau * k / 40.0)] * 2 for k in range(41)]
    road = (
        f'{{point: [0, 0, 3], normal: [-0.1, 0.05, 1], grids: [{{kind: height_grid, origin: [2, -50], step: [1, '
        f'100], height: {height}}}]}}'
    )
    scene = ['duration=1.0', 'start={kind: equilibrium, speed: 10}', f'road={road}', 'record.poses=10']
    motion = read_motion(recorded(tmp_path / 'hill', 'light_car_straight', *scene))
    x, y, z = motion.contact.reshape(-1, 3).T
    assert z.max() - 3.0 - 0.1 * x.max() > 0.15  # up the hill
    off = 0.25 * (math.tau / 40.0) ** 2 / 2.0 * (0.35 * math.hypot(0.1 + 0.25 * math.tau / 40.0, 0.05)) ** 2
    np.testing.assert_allclose(motion.ground.at(x, y), z, atol=off)
    lines = motion.ground.around(-5.8, -1.4, 2)  # before the hill
    assert lines.shape == (2, 5, 5, 3)
    assert lines[0, 0].tolist() == [
        [k, -3.0, pytest.approx(3.0 + 0.1 * k + 0.15)] for k in (-8.0, -7.0, -6.0, -5.0, -4.0)
    ]
    write_page([motion], tmp_path / 'p.html')
    ground = data_of(tmp_path / 'p.html')['blocks'][0]['ground']
    assert ground['plane'] == pytest.approx([3.0, 0.1, -0.05])
    nodes = np.column_stack([np.frombuffer(base64.b64decode(ground[axis]), '<f4') for axis in 'xyz']).astype(float)
    begin, end = motion.pose[0, motion.follows], motion.pose[-1, motion.follows]
    wanted = {(i, j) for i in range(round(begin[0]) - 10, round(end[0]) + 11) for j in range(-10, 11)}
    assert wanted <= {(int(i), int(j)) for i, j in nodes[:, :2]}
    # single precision
    np.testing.assert_allclose(nodes[:, 2] + begin[2], motion.ground.at(nodes[:, 0], nodes[:, 1]), atol=1e-5)


def test_a_mechanism_of_any_size_fills_the_picture(tmp_path: Path):
    """Andrews' squeezer, 0.1 m in size: the end of its spring in the world is farthest from the origin, C at y = 0.07
    m."""
    motion = read_motion(recorded(tmp_path / 'squeezer', 'andrews', 'duration=0.02', 'record.poses=50'))
    points = np.concatenate([points for k in range(len(motion.time)) for _, points in strokes(motion, k)])
    assert np.abs(points).max() / size_of(motion) == pytest.approx(1.0 / 1.15)


def test_motion_is_packed_to_a_part_of_its_range_and_found_again(rng: np.random.Generator) -> None:
    """To half of a 16000th of the range of each column; no number stays none, and constants stay as they are."""
    t = np.linspace(0.0, 60.0, 3001)[:, None]
    values = np.hstack(
        [np.sin(t), 1e3 * t, np.full_like(t, 7.0), rng.standard_normal((3001, 2)), np.full_like(t, np.nan)]
    )
    values[100:200, 1] = np.nan
    found = packed(values)
    planes = np.frombuffer(zlib.decompress(base64.b64decode(found['data'])), np.uint8).astype(int)
    whole = ((planes[: values.size] << 8) | planes[values.size :]).astype(np.uint16).view(np.int16)
    whole = whole.reshape(values.shape[1], -1).T.copy()
    for _ in range(2):
        whole = np.cumsum(whole, axis=0, dtype=np.int16)
    offset, scale = numbers(found['offset']), numbers(found['scale'])
    again = np.where(whole == -32768, np.nan, offset + scale * whole.astype(float))
    assert np.array_equal(np.isnan(again), np.isnan(values))
    off = 0.51 * scale + 1e-7 * np.nanmax(np.abs(values), axis=0, initial=0.0)  # and single precision of the ends
    assert np.all((np.abs(again - values) <= off) | np.isnan(values))
    smooth = packed(np.sin(t * np.arange(1.0, 2.0, 0.01)))
    assert len(smooth['data']) < 0.2 * 4 / 3 * 4 * 3001 * 100  # a fifth of single precision, or less


@pytest.mark.skipif(CHROMIUM is None, reason='no browser')
@pytest.mark.slow
def test_the_page_draws_what_the_pictures_do(car: Path, tmp_path: Path):
    motion = read_motion(car)
    write_page([motion, motion], tmp_path / 'p.html')
    k = len(motion.time) - 2
    probe = (
        f'await view.ready, {{ drawn: view.drawn(view.runs[0], view.at(view.runs[0], view.runs[0].time[{k}]), false)'
        '.map(x => x[2].map(p => Array.from(p))), words: document.querySelector(".legend").textContent }'
    )
    picture = tmp_path / 'p.png'
    found = opened(tmp_path / 'p.html', (1280, 760), probe, picture)
    for words in ('links', 'springs and dampers', 'wheels', 'forces on the tires, 1 m for 6 kN', 'ghost'):
        assert words in found['words']  # what the colours say
    theirs, ours = found['drawn'], [points for _, points in strokes(motion, k)]
    origin = motion.pose[0, motion.follows, :3]
    # the page keeps all rims, spokes and arrows of a wheel in the same order; forces come last there
    order = [points for kind, points in strokes(motion, k) if kind != 'force'] + [
        points for kind, points in strokes(motion, k) if kind == 'force'
    ]
    assert len(theirs) == len(ours)
    for a, b in zip(theirs, order, strict=True):
        # single precision at 60 m; half a 16000th of the ranges of places (3 m) and quaternions (2, which turn twice
        # as far, at up to 1 m)
        np.testing.assert_allclose(np.array(a), b - origin, atol=5e-4)
    from matplotlib.image import imread

    pixels = imread(picture)[..., :3]
    for colour in ((0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00), (0x22, 0x22, 0x22)):  # links, forces, wheels
        assert np.sum(np.all(np.abs(pixels - np.array(colour) / 255.0) < 0.04, axis=-1)) > 200


@pytest.mark.skipif(CHROMIUM is None, reason='no browser')
@pytest.mark.slow
def test_tubes_lie_where_lines_do(car: Path, tmp_path: Path):
    """Springs and links of the picture of three.js and of the flat one, known by their colours, are in the same
    place."""
    from matplotlib.image import imread

    write_page([read_motion(car)], tmp_path / 'p.html')
    browser = Browser(tmp_path / 'home', (900, 700), SOFTWARE_WEBGL)
    found = {}
    try:
        for how in ('webgl', 'flat'):
            tab = browser.open(f'file://{tmp_path}/p.html?{how}&t=1.5')
            tab.resize(900, 1400)
            assert tab.wait('!!view.picture && !!view.go') and tab.value('!!view.picture.renderer') == (how == 'webgl')
            tab.picture(tmp_path / f'{how}.png')
            box = 'document.querySelector(".motion canvas").getBoundingClientRect()'
            x, y, width, height = (int(tab.value(f'{box}.{name}')) for name in ('x', 'y', 'width', 'height'))
            pixels = imread(tmp_path / f'{how}.png')[y : y + height, x : x + width, :3]
            hue = {'links': pixels[..., 2] - pixels[..., 0] > 0.3, 'springs': pixels[..., 0] - pixels[..., 2] > 0.5}
            found[how] = hue | {'any': pixels.min(axis=-1) < 0.75}
    finally:
        browser.close()
    for name in ('links', 'springs'):
        tubes, lines = found['webgl'][name], found['flat'][name]
        assert tubes.sum() > 200 and lines.sum() > 200, name
        # tubes are a few pixels thicker, and what is behind is hidden there; of lines the last drawn is in front
        assert binary_dilation(found['flat']['any'], iterations=6)[tubes].mean() > 0.98
        assert binary_dilation(found['webgl']['any'], iterations=6)[lines].mean() > 0.98
        assert binary_dilation(tubes, iterations=6)[lines].mean() > 0.8


@pytest.mark.slow
def test_pictures_and_films_are_written(crank: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    from PIL import Image

    for name, options in (
        ('a.png', ['--at', '0.2']),
        ('a.gif', ['--rate', '10']),
        ('a.mp4', ['--rate', '10']),
        ('a.html', []),
    ):
        assert main(['view', str(crank), str(crank), '--out', str(tmp_path / name), *options, '--json']) == 0
        assert json.loads(capsys.readouterr().out)['bytes'] == (tmp_path / name).stat().st_size > 1000
    film = Image.open(tmp_path / 'a.gif')
    assert film.n_frames == 5  # 0 to 0.4 s
    assert film.info['duration'] == 100
    colours = {colour for _, colour in film.convert('RGB').getcolors(1000)}
    assert (0x00, 0x72, 0xB2) in colours and len(colours) <= 60  # a rod has its own colour
    assert (tmp_path / 'a.mp4').read_bytes()[4:8] == b'ftyp'
    assert Image.open(tmp_path / 'a.png').size == (1120, 600)


@pytest.mark.slow
@pytest.mark.parametrize('name', ['a.gif', 'a.mp4'])
def test_a_film_that_is_interrupted_leaves_what_was_there(
    name: str, crank: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    from mbd_sim_ros.analysis.view.picture import Painter

    (tmp_path / name).write_bytes(b'an older film')
    plain = Painter.paint

    def paint(self: Painter, t: float) -> None:
        if t > 0.2:
            raise KeyboardInterrupt
        plain(self, t)

    monkeypatch.setattr(Painter, 'paint', paint)
    assert main(['view', str(crank), '--out', str(tmp_path / name), '--rate', '10']) == 130
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [(name, b'an older film')]


@pytest.mark.slow
def test_a_file_for_rerun_has_all_topics_and_moving_links(
    crank: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    chunks = pytest.importorskip('rerun.chunk', reason="pip install '.[rerun]'")
    assert main(['view', str(crank), '--out', str(tmp_path / 'deep' / 'x.rrd'), '--json']) == 0
    assert json.loads(capsys.readouterr().out)['bytes'] > 10_000
    moved = [
        chunk
        for chunk in chunks.RrdReader(tmp_path / 'deep' / 'x.rrd').stream()
        if str(chunk.entity_path).startswith('/tf')
    ]
    assert sum(chunk.num_rows for chunk in moved) >= len(read_motion(crank).time)


def test_the_paths_of_a_layout_for_foxglove_lead_to_the_values(car: Path, tmp_path: Path):
    patterns = (
        'odom/*',
        'imu/*',
        'tire/front_left/force/*',
        'tire_states/*',
        'joint_states/steering_wheel/*',
        'cmd_applied/steering',
    )
    assert main(['view', str(car), '--out', str(tmp_path / 'x.json'), *(f'--channel={p}' for p in patterns)]) == 0
    data = json.loads((tmp_path / 'x.json').read_text())
    first = {}
    with next(car.glob('*.mcap')).open('rb') as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            if channel.topic not in first:
                first[channel.topic] = cdr.decode(schema.name, schema.data.decode(), message.data)[0]
    run = reader.read(car, list(patterns))
    panels = [config for name, config in data['configById'].items() if name.startswith('Plot!')]
    assert len(panels) == len(run.columns) > 40
    for panel in panels:
        topic, *fields = panel['paths'][0]['value'].split('.')
        value = first[topic]
        for field in fields:
            name, _, index = field.partition('[')
            value = value[name][int(index[:-1])] if index else value[name]
        assert value == run[panel['foxglovePanelTitle']][0]
    named = re.findall(r'"((?:3D|Plot)![^"]*)"', json.dumps(data['layout']))
    assert sorted(named) == sorted(data['configById'])  # every panel has its place


def test_a_layout_for_foxglove_names_topics_with_the_namespace_of_the_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr('mbd_sim_ros.batch.StepRecorder', partial(StepRecorder, namespace='/fleet'))
    monkeypatch.setattr('mbd_sim_ros.batch.describe', partial(describe, namespace='/fleet'))
    bag = recorded(tmp_path / 'run', 'slider_crank', 'duration=0.1', 'record.poses=20')
    assert main(['view', str(bag), '--out', str(tmp_path / 'x.json'), '--channel=joint_states/*/position']) == 0
    panels = json.loads((tmp_path / 'x.json').read_text())['configById']
    assert panels['3D!motion']['layers']['bodies']['topic'] == '/fleet/robot_description'
    paths = [panel['paths'][0]['value'] for name, panel in panels.items() if name.startswith('Plot!')]
    assert paths[0] == '/fleet/joint_states.position[0]' and all(path.startswith('/fleet/') for path in paths)


def test_what_cannot_be_shown_is_one_sentence(
    crank: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    bare = recorded(tmp_path / 'bare', 'four_bar', 'duration=0.01', 'record.poses=0')
    (tmp_path / 'made.gif').mkdir()
    # all of it is told before anything is painted
    monkeypatch.setattr('mbd_sim_ros.analysis.view.picture.Painter.paint', None)
    monkeypatch.setattr(shutil, 'which', lambda _: None)
    for variable in ('DISPLAY', 'WAYLAND_DISPLAY'):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setitem(__import__('sys').modules, 'imageio_ffmpeg', None)
    for arguments, part in (
        ([crank, '--out', tmp_path / 'x.avi'], 'must be one of .html, .png, .gif, .mp4, .rrd, .json'),
        ([bare, '--out', tmp_path / 'x.html'], 'record.poses'),
        ([crank, '--out', tmp_path / 'x.png', '--at', '9'], 'goes from 0 to 0.4 s'),
        ([crank, '--out', tmp_path / 'x.gif', '--rate', '0'], '--rate 0'),
        ([crank, '--out', tmp_path / 'made.gif'], 'Is a directory'),
        (
            [crank, '--out', tmp_path / 'x.gif', '--rate', '50', '--speed', '0.01', '--width', '4000'],
            'bytes of memory; take a smaller --rate',
        ),
        ([crank, '--out', tmp_path / 'x.html', '--channel', 'nothing'], "no channel matches 'nothing'"),
        ([crank, '--out', tmp_path / 'x.mp4'], 'needs ffmpeg'),
        ([crank], 'nothing to show: give --out FILE'),
        (
            [crank, '--rerun'],
            'there is no display' if find_spec('rerun') else "Rerun is not installed: pip install 'mbd_sim_ros[rerun]'",
        ),
        ([tmp_path / 'none', '--out', tmp_path / 'x.html'], 'is not there'),
        (
            [crank, '--out', tmp_path / 'x.gif', '--at', '0.2'],
            'x.gif: --at has no effect there; leave it out, or write one of .png',
        ),
        ([crank, crank, '--out', tmp_path / 'x.json'], 'x.json: a further recording has no effect there'),
        ([crank, '--out', tmp_path / 'x.rrd', '--channel', 'imu/*'], 'x.rrd: --channel has no effect there'),
        ([crank, '--rerun', '--channel', 'imu/*'], '--rerun: --channel has no effect there'),
        ([crank, '--out', tmp_path / 'x.html', '--width', '800'], 'x.html: --width has no effect there'),
        ([crank, '--out', tmp_path / 'x.html', '--speed', '0.5'], 'x.html: --speed has no effect there'),
    ):
        assert main(['view', *map(str, arguments)]) != 0
        said = capsys.readouterr()
        assert part in said.err and said.err.count('\n') == 1, said.err
