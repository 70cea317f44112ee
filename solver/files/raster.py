"""Pictures (.png) and arrays (.npz) as rasters of numbers (docs/scene.md, Roads)."""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np

from solver.elements.road_grids import LARGEST_RASTER, Raster
from solver.errors import SceneError, SpecError

_SIGNATURE = b'\x89PNG\r\n\x1a\n'
_LARGEST_FILE = 64_000_000  # [bytes]


def content_of(path: Path, most: int = _LARGEST_FILE) -> bytes:
    """The bytes of a file of at most so many. Raises SceneError."""
    try:
        size = path.stat().st_size
        if size > most:
            raise SceneError(f'{path}: {size} bytes are too many (at most {most})')
        return path.read_bytes()
    except OSError as error:
        raise SceneError(f'{path}: cannot be read: {error.strerror}') from None


def packed(path: Path, values: np.ndarray) -> Raster:
    """The raster of a matrix from a file. Raises SceneError for one that is too large."""
    try:
        return Raster.of(values)
    except SpecError as error:
        raise SceneError(f'{path}: {error}') from None


def read_npz(path: Path) -> Raster:
    """The array in a .npz file, the only one or the one called `height`; its first index runs along x. Raises
    SceneError."""
    content_of(path)
    try:
        with zipfile.ZipFile(path) as archive:
            sizes = [member.file_size for member in archive.infolist()]
        if sum(sizes) > _LARGEST_FILE:
            raise SceneError(f'{path}: {sum(sizes)} bytes unpacked are too many (at most {_LARGEST_FILE})')
        with np.load(path, allow_pickle=False) as arrays:
            names = list(arrays.files)
            if len(names) != 1 and 'height' not in names:
                raise SceneError(f'{path}: has the arrays {", ".join(names) or "none"}: give one, or call it height')
            values = arrays['height' if 'height' in names else names[0]]
    except (
        ValueError,
        OSError,
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        KeyError,
        NotImplementedError,
        RuntimeError,
    ) as error:
        raise SceneError(f'{path}: not readable as .npz: {" ".join(str(error).split())[:120]}') from None
    return _raster(path, values)


def _raster(path: Path, values: np.ndarray) -> Raster:
    if values.ndim != 2 or min(values.shape) < 2 or values.dtype.kind not in 'fiub':
        raise SceneError(
            f'{path}: an array of shape {values.shape} and type {values.dtype}: must be numbers, 2 x 2 or more'
        )
    if values.size > LARGEST_RASTER:
        raise SceneError(f'{path}: {values.size} numbers are too many (at most {LARGEST_RASTER})')
    numbers = values.astype(float)
    if not np.isfinite(numbers).all() or np.abs(numbers).max() > 1e6:
        raise SceneError(f'{path}: every number must be finite and below 1e6')
    return packed(path, numbers)


def read_png(path: Path) -> Raster:
    """A greyscale picture of 8 or 16 bits: black is 0, white is 1; x to the right, y up. Raises SceneError."""
    data = content_of(path)
    if not data.startswith(_SIGNATURE):
        raise SceneError(f'{path}: is not a PNG picture')
    header, deflated = _chunks(path, data)
    width, height, depth, colour, _, _, interlaced = header
    if colour not in (0, 4) or depth not in (8, 16) or interlaced:
        raise SceneError(
            f'{path}: must be greyscale of 8 or 16 bits, not interlaced (colour type {colour}, {depth} bits)'
        )
    if min(width, height) < 2 or width * height > LARGEST_RASTER:
        raise SceneError(
            f'{path}: {width} x {height} pixels: must be 2 x 2 or more and at most {LARGEST_RASTER} in all'
        )
    channels = 1 if colour == 0 else 2
    stride = channels * depth // 8
    size = height * (1 + width * stride)
    try:
        raw = zlib.decompressobj().decompress(deflated, size + 1)
    except zlib.error as error:
        raise SceneError(f'{path}: not readable as PNG: {error}') from None
    if len(raw) != size:
        raise SceneError(f'{path}: has {len(raw)} bytes of pixels instead of {size}')
    rows = _unfiltered(path, np.frombuffer(raw, np.uint8).reshape(height, 1 + width * stride), stride)
    pixels = rows.reshape(height, width, channels, depth // 8)[:, :, 0].astype(np.uint32)
    grey = pixels[:, :, 0] if depth == 8 else pixels[:, :, 0] * 256 + pixels[:, :, 1]
    return packed(path, (grey / float(2**depth - 1))[::-1].T)


def _chunks(path: Path, data: bytes) -> tuple[tuple[int, ...], bytes]:
    """(header, compressed pixels)."""
    at, header, pixels = len(_SIGNATURE), None, []
    while at + 8 <= len(data):
        length, kind = struct.unpack('>I4s', data[at : at + 8])
        body = data[at + 8 : at + 8 + length]
        if len(body) != length or kind == b'IEND':
            break
        if kind == b'IHDR' and length == 13:
            header = struct.unpack('>IIBBBBB', body)
        elif kind == b'IDAT':
            pixels.append(body)
        at += 12 + length
    if header is None or not pixels:
        raise SceneError(f'{path}: not readable as PNG: it has no {"header" if header is None else "pixels"}')
    return header, b''.join(pixels)


def _unfiltered(path: Path, rows: np.ndarray, stride: int) -> np.ndarray:
    """Undo the filters of PNG (specification of the W3C, section 9), row by row."""
    count, width = rows.shape[0], rows.shape[1] - 1
    out = np.zeros((count, width), np.uint8)
    above = [0] * width
    for k in range(count):
        kind, line = int(rows[k, 0]), rows[k, 1:]
        if kind == 0:
            row = line.tolist()
        elif kind == 2:
            row = ((line.astype(np.uint16) + np.array(above, np.uint16)) & 255).tolist()
        elif kind in (1, 3, 4):
            row = line.tolist()
            for i in range(width):
                left = row[i - stride] if i >= stride else 0
                if kind == 1:
                    guess = left
                elif kind == 3:
                    guess = (left + above[i]) // 2
                else:
                    guess = _paeth(left, above[i], above[i - stride] if i >= stride else 0)
                row[i] = (row[i] + guess) & 255
        else:
            raise SceneError(f'{path}: not readable as PNG: row {k} has the unknown filter {kind}')
        out[k] = row
        above = row
    return out


def _paeth(a: int, b: int, c: int) -> int:
    p = a + b - c
    pa, pb, pc = abs(p - a), abs(p - b), abs(p - c)
    return a if pa <= pb and pa <= pc else (b if pb <= pc else c)
