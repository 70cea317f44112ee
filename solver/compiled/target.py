"""On what the bits of a run depend beside its scene and the code: the instruction set, the C library, and the compiler
of the kernels."""

from __future__ import annotations

import hashlib
import math
import platform
import struct
from importlib.metadata import PackageNotFoundError, version

POINTS = 2000
# Every x86-64 processor with AVX2 and FMA, as LLVM says it: the level v3 of the ABI.
V3 = (
    'x86-64-v3',
    '+64bit,+avx,+avx2,+bmi,+bmi2,+cmov,+cx16,+cx8,+f16c,+fma,+fxsr,+lzcnt,+mmx,+movbe,+popcnt,+sahf,+sse,+sse2,+sse3,'
    '+sse4.1,+sse4.2,+ssse3,+x87,+xsave',
)


def runs_v3() -> bool:
    """True where this processor runs code for V3, and nobody has asked for another one (NUMBA_CPU_NAME)."""
    from llvmlite.binding import get_host_cpu_features
    from numba import config

    if platform.machine() != 'x86_64' or config.CPU_NAME not in (None, V3[0]):
        return False
    try:
        there = get_host_cpu_features()
    except RuntimeError:  # LLVM does not know this machine
        return False
    return all(there.get(feature, feature == 'x87') for feature in V3[1].replace('+', '').split(','))


def target() -> dict[str, str]:
    """Machine, whether it has FMA, C library, a digest of its elementary functions, whether Intel's take their place in
    kernels, and versions of the packages that compute.

    Equal targets give the same bits, whatever the processor; others may not
    (docs/decisions/0008-same-bits-on-every-processor.md).
    """
    from llvmlite.binding import get_host_cpu_features
    from numba import config

    try:
        fma = 'yes' if get_host_cpu_features().get('fma') else 'no'
    except RuntimeError:  # LLVM does not know this machine
        fma = 'unknown'
    found = {
        'machine': platform.machine(),
        'fma': fma,
        'libc': ' '.join(platform.libc_ver()).strip() or 'unknown',
        'elementary': elementary_digest(),
        'svml': 'yes' if config.USING_SVML else 'no',
    }
    for name in ('numba', 'llvmlite', 'numpy'):
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # installed by the distribution, without metadata
            found[name] = 'unknown'
    return found


def elementary_digest() -> str:
    """Digest of sin, cos, tan, exp, log, atan, atan2 and pow of the C library at POINTS numbers each: the library
    chooses them by the processor."""
    found = hashlib.sha256()
    for k in range(POINTS):
        x = 0.003 + k * math.pi / 512.0  # to 12
        y = 0.37 * x - 1.0
        values = (
            math.sin(x),
            math.cos(x),
            math.tan(x),
            math.exp(y),
            math.log(x),
            math.atan(y),
            math.atan2(y, x),
            math.pow(x, y),
        )
        found.update(struct.pack('<8d', *values))
    return found.hexdigest()[:12]


def differences(there: dict[str, str], here: dict[str, str]) -> list[str]:
    """Differences between two targets, in words."""
    return [
        f'{name} {there[name]} there and {here[name]} here'
        for name in there
        if name in here and there[name] != here[name]
    ]
