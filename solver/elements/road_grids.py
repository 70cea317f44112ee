"""Properties that vary over a road: heights given number by number, in a raster, or random with the spectrum of
[ISO8608]; friction in a raster."""

from __future__ import annotations

import base64
import binascii
import zlib
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from solver.compiled.elementary import exp
from solver.dimensions import Angle, Length, Place
from solver.elements.enveloping import Heights
from solver.validate import finite, require, vector

# [ISO8608], annex C: displacement spectral density at 0.1 cycles/m, geometric mean of each class [m^3]
ISO_8608_DENSITY = {c: 16e-6 * 4.0**k for k, c in enumerate('ABCDEFGH')}
ISO_8608_REFERENCE = 0.1  # [cycles/m]
MOST_NODES = 2_000_000  # of all grids of a road: seconds and some hundred MB at the start


@dataclass(frozen=True, kw_only=True)
class HeightGrid:
    """Heights above the plane on a rectangular grid.

    origin: (x, y) [m] in W of node (0, 0). step: (dx, dy) [m]. yaw: direction of the grid's x axis in W [rad].
    height: [m], height[i][j] at (i dx, j dy); at least 2 x 2.
    """

    origin: Place
    step: Place
    height: tuple[tuple[Length, ...], ...]
    yaw: Angle = 0.0

    def __post_init__(self) -> None:
        where = 'height grid'
        object.__setattr__(self, 'origin', vector(where, 'origin', self.origin, 2))
        object.__setattr__(self, 'step', vector(where, 'step', self.step, 2))
        object.__setattr__(self, 'yaw', finite(where, 'yaw', self.yaw))
        require(min(self.step) > 0.0, where, 'step', self.step, 'both must be positive')
        rows = tuple(len(row) for row in self.height)
        regular = len(rows) >= 2 and min(rows) >= 2 and len(set(rows)) == 1
        require(regular, where, 'height', rows, 'must be rows of equal length, 2 x 2 or more')
        h = np.array(self.height, float)
        require(bool(np.isfinite(h).all()), where, 'height', 'not finite', 'every height must be a finite number')
        object.__setattr__(self, 'height', tuple(map(tuple, h.tolist())))

    @property
    def nodes(self) -> int:
        """Number of heights."""
        return len(self.height) * len(self.height[0])

    @property
    def heights(self) -> Heights:
        """The numbers."""
        return Heights(self.origin, self.step, self.yaw, np.array(self.height))


LARGEST_RASTER = MOST_NODES  # numbers
# characters: a scene with it, as it stands in a recording, can still be read (solver.files.yaml_tree)
LARGEST_PACKED = 600_000
_LEVELS = 65535


@dataclass(frozen=True, kw_only=True)
class Raster:
    """Numbers on a grid in one text: low + resolution * (whole numbers from 0 to 65535).

    packed: rows x columns of them, 16 bits, little-endian, each the difference (modulo 65536) from the one in the row
    before, deflated (zlib), in base64. Files stand for it: .png (greyscale: 0 to 1; x to the right and y up in the
    picture) and .npz (one array; first index along x), which are rounded to 1/65535 of their range.
    """

    rows: int
    columns: int
    low: float
    resolution: float
    packed: str

    def __post_init__(self) -> None:
        where = 'raster'
        for name in ('rows', 'columns'):
            finite(where, name, getattr(self, name), low=2)
        size = self.rows * self.columns
        require(
            size <= LARGEST_RASTER, where, 'rows', self.rows, f'{size} numbers are too many (at most {LARGEST_RASTER})'
        )
        for name in ('low', 'resolution'):
            object.__setattr__(self, name, finite(where, name, getattr(self, name), low=-1e6, high=1e6))
        length = len(self.packed)
        require(
            length <= LARGEST_PACKED,
            where,
            'packed',
            f'{length} characters',
            f'{LARGEST_PACKED} at most: take a part, or coarser steps',
        )
        require(self.values.size == size, where, 'packed', '...', 'has another size')

    @staticmethod
    def of(values: np.ndarray) -> Raster:
        """The raster of a matrix. Raises SpecError for one that is too large."""
        low, high = float(values.min()), float(values.max())
        resolution = (high - low) / _LEVELS
        levels = (
            np.zeros(values.shape, np.int64)
            if resolution == 0.0
            else np.rint((values - low) / resolution).astype(np.int64)
        )
        levels[1:] -= levels[:-1].copy()
        data = (levels % (_LEVELS + 1)).astype('<u2').tobytes()
        packed = base64.b64encode(zlib.compress(data, 9)).decode()
        return Raster(rows=values.shape[0], columns=values.shape[1], low=low, resolution=resolution, packed=packed)

    @property
    def nodes(self) -> int:
        """Number of values."""
        return self.rows * self.columns

    @property
    def values(self) -> np.ndarray:
        """The matrix, (rows, columns)."""
        size = 2 * self.rows * self.columns
        try:
            data = zlib.decompressobj().decompress(base64.b64decode(self.packed, validate=True), size + 1)
        except (binascii.Error, zlib.error, ValueError):
            data = b''
        require(
            len(data) == size,
            'raster',
            'packed',
            f'{len(data)} bytes',
            f'must be {size} bytes (16 bits a number), deflated, in base64',
        )
        steps = np.frombuffer(data, '<u2').reshape(self.rows, self.columns).astype(np.int64)
        return self.low + self.resolution * (np.cumsum(steps, axis=0) % (_LEVELS + 1))


@dataclass(frozen=True, kw_only=True)
class _Map:
    """A raster on the road: offset + scale * number at every node. origin, step, yaw: as in HeightGrid. raster: the
    numbers, or a .png or .npz file with them."""

    origin: Place
    step: Place
    raster: Raster
    yaw: Angle = 0.0
    scale: float = 1.0
    offset: float = 0.0

    WHERE: ClassVar[str]

    def __post_init__(self) -> None:
        for name in ('origin', 'step'):
            object.__setattr__(self, name, vector(self.WHERE, name, getattr(self, name), 2))
        for name in ('yaw', 'scale', 'offset'):
            object.__setattr__(self, name, finite(self.WHERE, name, getattr(self, name)))
        require(min(self.step) > 0.0, self.WHERE, 'step', self.step, 'both must be positive')

    @property
    def nodes(self) -> int:
        """Number of values."""
        return self.raster.nodes

    @property
    def heights(self) -> Heights:
        """Heights of its nodes."""
        return Heights(self.origin, self.step, self.yaw, self.offset + self.scale * self.raster.values)


@dataclass(frozen=True, kw_only=True)
class RasterGrid(_Map):
    """Heights above the plane in a raster: offset + scale * number [m].

    origin, step, yaw: as in HeightGrid. raster: the numbers, or a .png or .npz file with them.
    """

    scale: Length = 1.0
    offset: Length = 0.0

    WHERE = 'raster grid'


@dataclass(frozen=True, kw_only=True)
class FrictionMap(_Map):
    """A factor on the tires' peak friction in a raster: offset + scale * number, between 0.001 and 10.

    origin, step, yaw, raster: as in RasterGrid. Between the nodes it is the cubic B-spline with these numbers (smooth,
    and never beyond them), outside the raster what it is at its border.
    """

    WHERE = 'friction map'

    def __post_init__(self) -> None:
        super().__post_init__()
        factor = self.heights.height
        low, high = float(factor.min()), float(factor.max())
        must = 'offset + scale * number must be in [0.001, 10] everywhere'
        require(low >= 1e-3 and high <= 10.0, self.WHERE, 'raster', (low, high), must)


@dataclass(frozen=True, kw_only=True)
class RandomRoad:
    """A random road with the displacement spectrum of [ISO8608], G(n) = G(0.1) (n/0.1)^-2 along x.

    origin, yaw: as in HeightGrid. length, width: [m]. step: (dx, dy) [m]. quality: class 'A' to 'H'. seed: of numpy's
    PCG64. coherence: tracks a distance y apart have the coherence function exp(-2 pi coherence n y) at n [cycles/m] (0:
    a cylindrical road; about 0.5 to 1 is measured on roads). shortest: shortest wavelength [m] (the tire envelops
    shorter ones). Heights fade to zero over `ramp` [m] at both ends.
    """

    origin: Place
    length: Length
    width: Length
    quality: Literal['A', 'B', 'C', 'D', 'E', 'F', 'G', 'H']
    seed: int
    step: Place = (0.1, 0.5)
    yaw: Angle = 0.0
    coherence: float = 0.7
    shortest: Length = 0.4
    ramp: Length = 5.0

    def __post_init__(self) -> None:
        where = 'random road'
        require(self.quality in ISO_8608_DENSITY, where, 'quality', self.quality, "must be one of 'A' to 'H'")
        require(
            isinstance(self.seed, int) and self.seed >= 0, where, 'seed', self.seed, 'must be a non-negative integer'
        )
        object.__setattr__(self, 'step', vector(where, 'step', self.step, 2))
        object.__setattr__(self, 'origin', vector(where, 'origin', self.origin, 2))
        object.__setattr__(self, 'ramp', finite(where, 'ramp', self.ramp, low=0.0, strict=True))
        object.__setattr__(self, 'length', finite(where, 'length', self.length, low=2.0 * self.ramp))
        object.__setattr__(self, 'width', finite(where, 'width', self.width, low=0.0, strict=True))
        object.__setattr__(self, 'coherence', finite(where, 'coherence', self.coherence, low=0.0))
        require(min(self.step) > 0.0, where, 'step', self.step, 'both must be positive')
        object.__setattr__(self, 'shortest', finite(where, 'shortest', self.shortest, low=2.0 * self.step[0]))
        size = f'{self.length:g} m x {self.width:g} m at steps of {self.step[0]:g} m x {self.step[1]:g} m'
        most = f'needs {self.nodes:.3g} heights, more than {MOST_NODES}; take a shorter road or longer steps'
        require(self.nodes <= MOST_NODES, where, 'length', size, most)

    @property
    def nodes(self) -> float:
        """Approximate number of heights."""
        return (self.length / self.step[0] + 1.0) * (self.width / self.step[1] + 2.0)

    def expand(self) -> HeightGrid:
        """Return the grid; the same seed gives the same road.

        Amplitudes are complex Gaussian with variance G(n) dn, neighbouring tracks a first-order Markov chain per
        frequency.
        """
        dx, dy = self.step
        n_x = round(self.length / dx) + 1
        n_y = max(int(np.ceil(self.width / dy)) + 1, 2)
        n = np.fft.rfftfreq(n_x, dx)[1:]
        density = ISO_8608_DENSITY[self.quality] * np.square(ISO_8608_REFERENCE / n) * (n <= 1.0 / self.shortest)
        rng = np.random.default_rng(self.seed)
        # E|a|^2 = 2 G dn: the variance of Re(a e^(i...)) is half of that
        draws = rng.standard_normal((n_y, 2, n.size)) * np.sqrt(density / (n_x * dx))
        memory = exp(-2.0 * np.pi * self.coherence * n * dy)
        for j in range(1, n_y):
            draws[j] = memory * draws[j - 1] + np.sqrt(1.0 - memory * memory) * draws[j]
        spectrum = np.zeros((n_y, n.size + 1), complex)
        spectrum.real[:, 1:], spectrum.imag[:, 1:] = np.moveaxis(draws * n_x / 2.0, 1, 0)
        height = np.fft.irfft(spectrum, n_x, axis=1).T
        x = np.arange(n_x) * dx
        t = np.clip(np.minimum(x, x[-1] - x) / self.ramp, 0.0, 1.0)
        height *= (t * t * (3.0 - 2.0 * t))[:, None]
        return HeightGrid(origin=self.origin, step=self.step, yaw=self.yaw, height=tuple(map(tuple, height.tolist())))
