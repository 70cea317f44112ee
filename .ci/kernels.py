"""Kernels for a wheel: `python .ci/kernels.py DIRECTORY` compiles what the delivered scenes need for every x86-64
processor with AVX2 and FMA (solver.compiled.target.V3) and puts the files into DIRECTORY, which is emptied before.

It begins with an empty cache, and takes minutes: a process that finds kernels does not meet those that are copied into
them, and an element that somebody adds would compile them anew. So a wheel has the same kernels whatever was kept.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from solver.compiled.target import V3

POLICIES = ('integrator.step_policy=auto', 'integrator.step_policy=constant')  # of a run, and of the node
# Levels of detail of the full car beside its scenes.
LEVELS = ('condensed', 'kc', 'single_track')


def main(directory: Path) -> None:
    """Compile, and copy what was used."""
    from mbd_sim_ros.batch import warm_up
    from solver import simulation_of
    from solver.compiled.kernel import KERNELS
    from solver.files.catalogue import files
    from solver.files.scene import load_scene

    cases = [(name, [policy]) for name in files('scenes') for policy in POLICIES]
    cases += [('car_step_steer', [f'fidelity={level}']) for level in LEVELS]
    for name, settings in cases:
        warm_up(simulation_of(load_scene(name, settings)))
        print(f'{name} {" ".join(settings)}: {len(KERNELS.used)} kernels', file=sys.stderr, flush=True)
    shutil.rmtree(directory, ignore_errors=True)
    directory.mkdir(parents=True)
    for name in KERNELS.used:
        shutil.copy(KERNELS.store.directory / name, directory / name)
    size = sum(path.stat().st_size for path in directory.iterdir())
    print(f'{len(KERNELS.used)} kernels, {size / 1e6:.1f} MB, in {directory}')


if __name__ == '__main__':
    if len(sys.argv) != 2:
        sys.exit('usage: python .ci/kernels.py DIRECTORY')
    if os.environ.get('NUMBA_CPU_NAME') != V3[0]:  # numba looks when it is imported
        with TemporaryDirectory() as cache:
            own = {'NUMBA_CPU_NAME': V3[0], 'NUMBA_CPU_FEATURES': V3[1], 'MBD_CACHE_DIR': cache}
            sys.exit(subprocess.run([sys.executable, *sys.argv], env=os.environ | own, check=False).returncode)
    main(Path(sys.argv[1]))
