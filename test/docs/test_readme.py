"""README.md: short enough to be read, and its figures are those of the tables that commands wrote."""

from __future__ import annotations

import importlib.util
import re
import shlex
from pathlib import Path

import pytest

from mbd_sim_ros.commands.main import parser

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / 'README.md').read_text(encoding='utf-8')


def tool():
    spec = importlib.util.spec_from_file_location('readme', ROOT / 'docs' / 'tools' / 'readme.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_figures_are_those_of_the_tables() -> None:
    assert tool().render(TEXT) == TEXT, 'run `python docs/tools/readme.py`'
    assert len(re.findall(r'^\| .* \| `mbd [^`]+` \|$', TEXT, re.MULTILINE)) >= 3


def test_a_figure_that_is_gone_is_told() -> None:
    with pytest.raises(LookupError, match="no row car_9ms below 'A step'"):
        tool().row((ROOT / 'docs' / 'performance.md').read_text(encoding='utf-8'), 'A step', 'car_9ms')


def test_it_is_short() -> None:
    assert TEXT.count('\n') <= 120


def test_its_commands_are_commands() -> None:
    lines = [line.strip() for line in TEXT.splitlines() if line.startswith('    mbd ')]
    told = re.findall(r'`(mbd [a-z]+ [^`]*)`', TEXT)
    assert len(lines) >= 6
    for line in (*lines, *told):
        understood(line)


@pytest.mark.parametrize('page', ['commands.md', 'coming-from.md'])
def test_commands_of_the_pages_for_beginners_are_commands(page: str) -> None:
    """Those that are written with arguments; a name alone stands for the command itself."""
    told = re.findall(r'`(mbd [a-z]+ [^`]*)`', (ROOT / 'docs' / page).read_text(encoding='utf-8'))
    assert len(told) >= 5
    for line in told:
        understood(' '.join(line.split()))


def understood(line: str) -> None:
    """Refuses what the command line refuses."""
    parser().parse_args(shlex.split(line, comments=True)[1:])
