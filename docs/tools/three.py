"""Makes mbd_sim_ros/analysis/third_party/three/three.min.js anew: `python docs/tools/three.py`. Needs npm.

It holds those parts of three.js that entry.js names, bundled by esbuild as one script, which pages carry in them.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from pathlib import Path

VERSION, ESBUILD = '0.187.0', '0.28.2'
HOME = Path(__file__).parents[2] / 'mbd_sim_ros' / 'analysis' / 'third_party' / 'three'
BANNER = (
    f'/* three.js {VERSION}, MIT licence, copyright 2010-2026 three.js authors: LICENSE beside it; made by '
    'docs/tools/three.py */'
)


def make(file: Path) -> None:
    """Write the bundle, and the licence beside it."""
    with tempfile.TemporaryDirectory() as name:
        there = Path(name)
        subprocess.run(
            ['npm', 'install', '--silent', '--prefix', name, f'three@{VERSION}', f'esbuild@{ESBUILD}'], check=True
        )
        shutil.copy(HOME / 'entry.js', there / 'entry.js')
        options = [
            '--bundle',
            '--minify',
            '--format=iife',
            '--global-name=THREE',
            '--target=es2020',
            '--log-level=warning',
        ]
        subprocess.run(
            [there / 'node_modules/.bin/esbuild', 'entry.js', *options, f'--banner:js={BANNER}', f'--outfile={file}'],
            cwd=name, check=True,
        )  # fmt: skip
        shutil.copy(there / 'node_modules/three/LICENSE', file.with_name('LICENSE'))


def named() -> list[str]:
    """The parts that entry.js names."""
    return re.findall(r'[A-Z]\w+', (HOME / 'entry.js').read_text(encoding='utf-8').partition('{')[2].partition('}')[0])


if __name__ == '__main__':
    make(HOME / 'three.min.js')
