"""Pictures and films of a recording, without a display: PNG and GIF by matplotlib, MP4 with ffmpeg."""

from __future__ import annotations

import errno
import math
import os
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from mbd_sim_ros.analysis.runs import units
from mbd_sim_ros.analysis.view.drawing import WORLD_BODY
from mbd_sim_ros.analysis.view.motion import RecordedMotion, curves_of, rotated
from mbd_sim_ros.analysis.view.page import size_of
from solver.disk import atomic_write
from solver.errors import BagError

COLOURS = {
    'outline': '#8a8a8a',
    'body': '#0072b2',
    'wheel': '#222222',
    'spring': '#e69f00',
    'force': '#d55e00',
    'world': '#bbbbbb',
}
GHOST = '#cc79a7'
WIDTHS = {'outline': 0.9, 'body': 2.0, 'wheel': 1.4, 'spring': 2.6, 'force': 2.2, 'world': 2.0}
NEWTONS_PER_METRE = 6000.0  # an arrow of 1 m
WIDTH = 1120  # pixels of a picture
CURVES = 4  # beside the motion
METRES = 8  # of ground to every side of a car
MOST_PICTURES = 100_000  # of a film, which takes hours then
MOST_BYTES = 2e9  # of a film as GIF
RIM, SPOKES = 28, 5  # points of a rim
SHADES = 12  # of a colour in a GIF


class Stroke(NamedTuple):
    """A line through points (n, 3) in the world [m]."""

    kind: str
    points: np.ndarray


def strokes(motion: RecordedMotion, k: int) -> Iterator[Stroke]:
    """Everything that is drawn at instant k."""
    for line in motion.drawing.lines:
        kind = 'world' if line.body == WORLD_BODY else line.kind
        yield Stroke(kind, np.array([motion.point(k, line.body, line.a), motion.point(k, line.body, line.b)]))
    for spring in motion.drawing.springs:
        yield Stroke('spring', np.array([motion.point(k, spring.i, spring.a), motion.point(k, spring.j, spring.b)]))
    for w, wheel in enumerate(motion.drawing.wheels):
        pose = motion.pose[k, wheel.body]
        n = np.array(wheel.axis)
        u = np.cross(n, [0.0, 0.0, 1.0] if abs(n[2]) < 0.9 else [1.0, 0.0, 0.0])
        u /= np.linalg.norm(u)
        v = np.cross(n, u)
        angle = np.linspace(0.0, 2.0 * np.pi, RIM + 1)[:, None]
        circle = wheel.radius * (np.cos(angle) * u + np.sin(angle) * v)
        center = np.array(wheel.center)
        for side in (-0.5, 0.5):
            yield Stroke('wheel', pose[:3] + rotated(pose[3:], center + circle + side * wheel.width * n))
        for a in 2.0 * np.pi * np.arange(SPOKES) / SPOKES:
            spoke = np.array([center, center + wheel.radius * (np.cos(a) * u + np.sin(a) * v)])
            yield Stroke('wheel', pose[:3] + rotated(pose[3:], spoke))
        if np.isfinite(motion.force[k, w]).all():
            foot = motion.contact[k, w]
            yield Stroke('force', np.array([foot, foot + motion.force[k, w] / NEWTONS_PER_METRE]))


class Camera(NamedTuple):
    """Looks from a direction without perspective. target (3,) [m]: what is in the middle."""

    azimuth: float
    elevation: float
    target: np.ndarray

    def see(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) as (n, 2) to the right and upwards [m]."""
        ca, sa, ce, se = np.cos(self.azimuth), np.sin(self.azimuth), np.cos(self.elevation), np.sin(self.elevation)
        axes = np.array([[-sa, ca, 0.0], [-ca * se, -sa * se, ce]])
        return (points - self.target) @ axes.T


def camera_of(motion: RecordedMotion, k: int) -> Camera:
    """From behind and above for what drives; a mechanism that stays in a level plane from above, any other from the
    front."""
    if motion.follows != WORLD_BODY:
        return Camera(-2.2, 0.35, motion.pose[k, motion.follows, :3] + [0.0, 0.0, 0.5])
    level = np.ptp(motion.pose[..., 2]) < 1e-3 * size_of(motion)
    return Camera(-0.5 * np.pi, 0.5 * np.pi if level else 0.35, np.zeros(3))


class Painter:
    """A figure: the motion at the left, curves with the present instant at the right."""

    def __init__(self, motions: list[RecordedMotion], channels: tuple[str, ...] = (), width: int = WIDTH) -> None:
        from matplotlib.figure import Figure

        self.motions = motions
        first = motions[0]
        names = curves_of(first, channels)[: max(CURVES, len(channels))]
        self.figure = Figure(figsize=(0.01 * WIDTH, 6.0), dpi=100 * width / WIDTH, layout='constrained')
        grid = self.figure.add_gridspec(len(names), 2, width_ratios=(3, 2)) if names else self.figure.add_gridspec(1, 1)
        self._scene = self.figure.add_subplot(grid[:, 0])
        self._size = size_of(first) * (1.0 if first.follows == WORLD_BODY else 0.78)  # a car is low
        unit = units(*(motion.run for motion in motions))
        self._cursors: list[Any] = []
        axes: Any = None
        for i, name in enumerate(names):
            axes = self.figure.add_subplot(grid[i, 1], sharex=axes)
            for r, motion in reversed(list(enumerate(motions))):
                topic = next((one for one in motion.run.series.values() if name in one.columns), None)
                if topic is not None:
                    axes.plot(topic.time_ns * 1e-9, topic.columns[name], color=GHOST if r else '#0072b2', linewidth=1.2)
            axes.set_title(f'{name} [{unit(name)}]' if unit(name) else name, fontsize=9, loc='left')
            axes.tick_params(labelsize=8, labelbottom=i == len(names) - 1)
            axes.grid(color='#e5e5e5')
            self._cursors.append(axes.axvline(0.0, color='#d55e00', linewidth=1.2))
        if axes is not None:
            axes.set_xlabel('t [s]', fontsize=9)
        self._legend = self._keys()

    def _keys(self) -> list[Any]:
        """Legend of the colours that occur."""
        from matplotlib.lines import Line2D

        what = self.motions[0].drawing
        inks = [
            (COLOURS['body'], 'links', any(line.kind == 'body' for line in what.lines)),
            (COLOURS['spring'], 'springs and dampers', what.springs),
            (COLOURS['wheel'], 'wheels', what.wheels),
            (COLOURS['force'], f'forces on the tires, 1 m for {1e-3 * NEWTONS_PER_METRE:g} kN', what.wheels),
            (GHOST, 'ghost', self.motions[1:]),
        ]
        return [Line2D([], [], color=ink, linewidth=2.5, label=label) for ink, label, there in inks if there]

    def paint(self, t: float) -> None:
        """Show the instant t [s]."""
        from matplotlib.collections import LineCollection

        axes, first = self._scene, self.motions[0]
        axes.clear()
        axes.set_axis_off()
        axes.set_aspect('equal')
        nearest = [int(np.argmin(np.abs(motion.time - t))) for motion in self.motions]
        camera = camera_of(first, nearest[0])
        if first.follows != WORLD_BODY:
            lines = first.ground.around(float(camera.target[0]), float(camera.target[1]), METRES)
            axes.add_collection(
                LineCollection(
                    [camera.see(line) for line in lines.reshape(-1, *lines.shape[2:])], colors='#dddddd', linewidths=0.6
                )
            )
        for r, motion in reversed(list(enumerate(self.motions))):
            for kind, points in strokes(motion, nearest[r]):
                flat = camera.see(points)
                colour = GHOST if r and kind != 'force' else COLOURS[kind]
                if kind == 'force':
                    axes.annotate(
                        '',
                        flat[1],
                        flat[0],
                        arrowprops={'arrowstyle': '->', 'color': colour, 'lw': WIDTHS[kind], 'alpha': 0.45 if r else 1},
                    )
                else:
                    dot: dict[str, Any] = {'marker': 'o', 'markersize': 3.5} if kind in ('body', 'world') else {}
                    axes.plot(
                        *flat.T,
                        color=colour,
                        linewidth=WIDTHS[kind],
                        alpha=0.45 if r else 1.0,
                        solid_capstyle='round',
                        **dot,
                    )
        axes.set_xlim(-1.25 * self._size, 1.25 * self._size)
        axes.set_ylim(-self._size, self._size)
        names = self.motions[0].name + ''.join(f' (ghost: {motion.name})' for motion in self.motions[1:])
        axes.set_title(f'{names}, t = {t:.2f} s', fontsize=11)
        axes.legend(
            handles=self._legend,
            loc='lower center',
            ncols=5,
            frameon=False,
            fontsize=8,
            handlelength=1.2,
            columnspacing=1.2,
        )
        for cursor in self._cursors:
            cursor.set_xdata([t, t])
        if self.figure.get_layout_engine() is not None:
            self.figure.draw_without_rendering()
            self.figure.set_layout_engine('none')  # the places of all axes are found once


def write_picture(
    motions: list[RecordedMotion],
    file: Path,
    *,
    at: float | None = None,
    width: int = WIDTH,
    channels: tuple[str, ...] = (),
) -> None:
    """One instant [s] (default: the middle) as PNG, so many pixels wide. Raises BagError."""
    time = motions[0].time
    t = 0.5 * (time[0] + time[-1]) if at is None else at
    if not time[0] <= t <= time[-1]:
        raise BagError(f'--at {t:g}: the recording goes from {time[0]:g} to {time[-1]:g} s')
    painter = Painter(motions, channels, width)
    painter.paint(t)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        painter.figure.savefig(file, dpi=painter.figure.dpi)
    except OSError as error:
        raise BagError(f'cannot write {file}: {error.strerror}; choose another place') from None


def write_film(
    motions: list[RecordedMotion],
    file: Path,
    *,
    rate: float,
    speed: float,
    progress: bool,
    width: int = WIDTH,
    channels: tuple[str, ...] = (),
) -> None:
    """A film of the whole recording: .mp4 or .gif. rate: pictures a second. speed: of the motion in it, 1 is as it was.
    Raises BagError."""
    if file.suffix == '.gif':
        # a GIF counts hundredths of a second, and browsers slow down what is faster than 50 Hz
        rate = 100.0 / max(round(100.0 / rate), 2)
    time = motions[0].time
    pictures = (time[-1] - time[0]) * rate / speed
    if pictures > MOST_PICTURES:
        raise BagError(
            f'{file} would have {pictures:.3g} pictures, more than {MOST_PICTURES}; take a larger --speed or a smaller '
            '--rate'
        )
    painter = Painter(motions, channels, width)
    # a byte for a pixel: a GIF is put together in memory
    size = pictures * math.prod(painter.figure.canvas.get_width_height())
    if file.suffix == '.gif' and size > MOST_BYTES:
        raise BagError(
            f'{file} would need {size:.2g} bytes of memory; take a smaller --rate or --width, a larger --speed, or '
            'write an .mp4'
        )
    instants = np.arange(time[0], time[-1] + 1e-9, speed / rate)
    shown = tqdm(instants, unit='picture', desc=file.name, disable=None if progress else True, leave=False)
    write = _write_mp4 if file.suffix == '.mp4' else _write_gif
    if file.suffix == '.mp4':
        _use_ffmpeg(file)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        if file.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        with atomic_write(file) as part:  # a film that is interrupted is none
            part.open('wb').close()  # what cannot be written is told before minutes of painting
            write(painter, shown, part, rate)
    except OSError as error:
        raise BagError(f'cannot write {file}: {error.strerror or error}; choose another place') from None


def _write_mp4(painter: Painter, instants: Iterable[float], file: Path, rate: float) -> None:
    from matplotlib.animation import FFMpegWriter
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(painter.figure)
    extra = ['-pix_fmt', 'yuv420p']
    writer = FFMpegWriter(fps=rate, codec='h264', extra_args=extra)  # type: ignore[arg-type]  # it takes any number of pictures a second
    with writer.saving(painter.figure, str(file), dpi=painter.figure.dpi):
        for t in instants:
            painter.paint(float(t))
            writer.grab_frame()


def _write_gif(painter: Painter, instants: Iterable[float], file: Path, rate: float) -> None:
    """All pictures in the same few colours: what stays the same between two of them takes no space."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    canvas = FigureCanvasAgg(painter.figure)
    palette = Image.new('P', (1, 1))
    palette.putpalette(_shades())
    pictures: list[Image.Image] = []
    for t in instants:
        painter.paint(float(t))
        canvas.draw()
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
        pictures.append(picture.quantize(palette=palette, dither=Image.Dither.NONE))
    pictures[0].save(file, save_all=True, append_images=pictures[1:], duration=1000.0 / rate, loop=0)


def _shades() -> list[int]:
    """The colours that are drawn with, and what lies between them and the white of the paper: red, green, blue of each,
    0 to 255."""
    from matplotlib.colors import to_rgb

    inks = list(dict.fromkeys(('#000000', GHOST, *(COLOURS[kind] for kind in ('body', 'spring', 'force')))))
    part = np.linspace(0.0, 1.0, SHADES)[:, None]
    return (
        np.rint(255.0 * np.concatenate([1.0 + part * (np.array(to_rgb(ink)) - 1.0) for ink in inks]))
        .astype(int)
        .ravel()
        .tolist()
    )


def _use_ffmpeg(file: Path) -> None:
    """Have matplotlib find ffmpeg: that of the system, or of the extra `video`."""
    import matplotlib as mpl

    program = shutil.which('ffmpeg')
    if program is None:
        try:
            import imageio_ffmpeg
        except ImportError:
            remedy = f"install it, or pip install 'mbd_sim_ros[video]', or write {file.with_suffix('.gif').name}"
            raise BagError(f'{file}: a film in MP4 needs ffmpeg, which is not here; {remedy}') from None
        program = imageio_ffmpeg.get_ffmpeg_exe()
    mpl.rcParams['animation.ffmpeg_path'] = program
