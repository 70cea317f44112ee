"""The native library: kernels and mbd.c, linked by the C compiler of the system."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from mbd_sim_ros.native.kernels import Kernel, Target, object_code
from solver import disk
from solver.errors import MbdError

HERE = Path(__file__).parent
NAME = 'libmbd.so'
COPIED = ('mbd.h', 'real_time.c')  # what lies beside a library: its header and an example
# -ffp-contract=off: a product is rounded before it is added, as Python does it.
FLAGS = ('-std=c11', '-O2', '-fPIC', '-ffp-contract=off', '-fvisibility=hidden', '-Wall', '-Wextra')


def compiler() -> str:
    """The C compiler of the system: that of CC, where it is set, or cc, gcc, clang. Raises MbdError where there is
    none."""
    named = os.environ.get('CC')
    for name in (named,) if named else ('cc', 'gcc', 'clang'):
        found = shutil.which(name)
        if found:
            return found
    if named:
        raise MbdError(f'CC = {named!r}: no such program: name a C compiler, without options, or leave CC unset')
    raise MbdError('no C compiler was found (cc, gcc, clang): install one (apt-get install gcc), or name it with CC')


def build(
    kernels: Iterable[Kernel],
    wanted: Target,
    file: Path,
    *,
    sources: Sequence[str] = ('mbd.c',),
    exported: Sequence[str] = ('mbd_*',),
    flags: Sequence[str] = (),
) -> None:
    """Link kernels and sources (C, in this folder) to a shared library that exports these names. Raises MbdError."""
    cc, store = compiler(), disk.Store(disk.location() / 'native', bounded=True)
    by_symbol = {kernel.symbol: kernel for kernel in sorted(kernels, key=lambda kernel: kernel.name)}
    with tempfile.TemporaryDirectory() as folder:
        there = Path(folder)
        lines = [f'#define MBD_TARGET "{wanted.name}"', f'#define MBD_AVX512 {int("+avx512f" in wanted.features)}']
        lines += [f'extern void {symbol}(void);' for symbol in by_symbol]
        lines += ['#define MBD_KERNELS(X) \\']
        lines += [f'    X("{kernel.name}", {symbol}) \\' for symbol, kernel in by_symbol.items()]
        (there / 'kernels.inc').write_text('\n'.join(lines) + '\n\n')
        (there / 'exported').write_text(f'{{ global: {" ".join(f"{name};" for name in exported)} local: *; }};\n')
        objects = []
        for k, kernel in enumerate(by_symbol.values()):
            objects.append(there / f'{k}.o')
            objects[-1].write_bytes(object_code(kernel, wanted, store))
        with disk.atomic_write(file) as part:
            command = [cc, *FLAGS, *flags, '-shared', f'-I{there}', f'-I{HERE}']
            command += [*(str(HERE / name) for name in sources), *map(str, objects), '-o', str(part), '-lm', '-s']
            command += [f'-Wl,--version-script={there / "exported"}', '-Wl,--build-id=none']
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                said = done.stderr.strip().splitlines()
                raise MbdError(f'{cc} cannot link {file.name}: {said[-1] if said else "it says nothing"}')


def copy_sources(directory: Path) -> None:
    """Put COPIED beside a library. Raises OSError."""
    for name in COPIED:
        with disk.atomic_write(directory / name) as part:
            part.write_bytes((HERE / name).read_bytes())
