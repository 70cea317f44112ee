"""The bundle of three.js in pages: its version, its licence, and that it has what the picture uses."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

ROOT = Path(__file__).parents[2]
THREE = runpy.run_path(str(ROOT / 'docs' / 'tools' / 'three.py'))
HOME = THREE['HOME']


def test_the_bundle_has_what_the_picture_uses_and_names_its_licence() -> None:
    used = set(
        re.findall(
            r'THREE\.(\w+)', (ROOT / 'mbd_sim_ros' / 'analysis' / 'view' / 'scene.js').read_text(encoding='utf-8')
        )
    )
    assert used == set(THREE['named']())
    bundle = (HOME / 'three.min.js').read_text(encoding='utf-8')
    assert bundle.startswith(THREE['BANNER'])
    assert all(re.search(rf'\b{name}:\(\)=>', bundle) for name in used)
    assert set(re.findall(r'https?://[^\s"\'`]+', bundle)) <= {'http://www.w3.org/1999/xhtml'}  # it asks nobody
    assert 'MIT License' in (HOME / 'LICENSE').read_text(encoding='utf-8')
    notice = (ROOT / 'NOTICE').read_text(encoding='utf-8')
    assert f'version {THREE["VERSION"]}' in notice and 'third_party/three' in notice
