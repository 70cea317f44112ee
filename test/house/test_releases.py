"""A release says the same of itself everywhere: version, changelog, citation."""

from __future__ import annotations

import re
import runpy
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

ROOT = Path(__file__).parents[2]
RELEASE = re.compile(r'^(\d+\.\d+\.\d+) \((\d{4}-\d\d-\d\d)\)\n-+$', re.MULTILINE)


def built() -> dict:
    """What setup.py says: its names, and what it gives to setup."""
    found: dict = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('setuptools.setup', lambda **options: found.update(options))
        patch.chdir(ROOT)
        return runpy.run_path(str(ROOT / 'setup.py')) | found


def manifest() -> str:
    return str(ElementTree.parse(ROOT / 'package.xml').getroot().findtext('version'))


def releases() -> list[tuple[str, str]]:
    return RELEASE.findall((ROOT / 'CHANGELOG.rst').read_text(encoding='utf-8'))


def test_the_version_is_the_same_everywhere() -> None:
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text(encoding='utf-8'))
    assert built()['version'] == manifest() == str(citation['version'])
    newest, date = releases()[0]
    assert (newest, date) == (manifest(), str(citation['date-released']))
    assert citation['license'] == built()['license'] == 'Apache-2.0'


def test_the_changelog_descends_and_has_no_list_of_what_is_to_come() -> None:
    """catkin_pkg reads the headings; what is not released yet may stand under Forthcoming, in one screen."""
    found = [tuple(map(int, number.split('.'))) for number, _ in releases()]
    assert found == sorted(set(found), reverse=True) and len(found) >= 2
    text = (ROOT / 'CHANGELOG.rst').read_text(encoding='utf-8')
    forthcoming = text.partition('Forthcoming\n')[2].partition('\n\n' + releases()[0][0])[0]
    assert len(forthcoming.splitlines()) < 40, (
        'give what has come a version: setup.py, package.xml, CITATION.cff, CHANGELOG.rst'
    )


def test_continuous_integration_tries_every_package_that_kernels_are_compiled_with() -> None:
    """The script reads setup.py as text: it runs before anything is installed."""
    found = subprocess.run([ROOT / '.ci/ends', 'packages'], capture_output=True, text=True, check=True).stdout
    assert found.split() == built()['COMPILED_WITH']
