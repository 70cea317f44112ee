"""The site: every page is in its navigation, every link in it leads somewhere, and docstrings are shown as they are
meant."""

from __future__ import annotations

import importlib.util
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).parents[2]


def tool(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / 'docs' / 'tools' / f'{name}.py')
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


site = tool('site_pages')
docstrings = tool('site_docstrings')


class Page(HTMLParser):
    """What a page leads to, and the anchors in it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ('href', 'src') and value:
                self.links.append(value)
            if name in ('id', 'name') and value:
                self.anchors.add(value)


def broken(directory: Path) -> list[str]:
    """Links of a site that lead nowhere: 'page: link'."""
    pages = {
        file: Page(file.read_text(encoding='utf-8')) for file in directory.rglob('*.html') if 'raw' not in file.parts
    }
    found = []
    for file, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            there = target.is_file() and (
                not parts.fragment or target not in pages or unquote(parts.fragment) in pages[target].anchors
            )
            if not there:
                found.append(f'{file.relative_to(directory)}: {link}')
    return found


@pytest.mark.long
def test_the_site_is_built_without_warnings_and_every_link_in_it_leads_somewhere(tmp_path: Path) -> None:
    for name in ('sphinx', 'myst_parser', 'furo'):
        pytest.importorskip(name, reason='comes with the extra site')
    assert site.build(tmp_path / 'site') == 0
    assert broken(tmp_path / 'site') == []
    text = (tmp_path / 'site' / 'reference.html').read_text(encoding='utf-8')
    for name in (
        'solver.load_scene',
        'solver.Simulation.advance',
        'solver.Snapshot.joint_effort',
        'mbd_sim_ros.read',
        'mbd_sim_ros.Run.columns',
    ):
        assert f'id="{name}"' in text
    (tmp_path / 'site' / 'docs' / 'tutorial.html').unlink()
    assert any(one == 'index.html: docs/tutorial.html' for one in broken(tmp_path / 'site'))


def test_every_page_stands_in_the_navigation() -> None:
    """Decisions are reached from their index."""
    shown = {name for names in site.LISTED.values() for name in names}
    there = {site.place(page) for page in site.pages()}
    decisions = {name for name in there if name.startswith('docs/decisions/') and name != 'docs/decisions/index'}
    assert shown == (there | {'reference'}) - decisions - {'index'}


def test_links_lead_to_pages_files_and_folders(tmp_path: Path) -> None:
    made = site.Site(tmp_path)
    page = ROOT / 'docs' / 'vehicle.md'
    text = (
        '[a](scene.md#start) [b](../solver/simulation.py) [c](../solver/levels/) [d](README.md) '
        '[e](https://a.b/c.md)\n```\n[f](none.md)\n```\n'
    )
    assert made._linked(text, page) == (
        '[a](/docs/scene.md#start) [b](/files/solver/simulation.py.md) [c](/files/solver/levels.md) '
        '[d](/docs/index.md) [e](https://a.b/c.md)\n```\n[f](none.md)\n```\n'
    )
    assert made.shown == {ROOT / 'solver' / 'simulation.py', ROOT / 'solver' / 'levels'}
    with pytest.raises(SystemExit, match=r'docs/vehicle.md: the link none.md leads nowhere'):
        made._linked('[f](none.md)', page)
    made._show(ROOT / 'LICENSE')  # a name without an ending is read too, not only fetched
    assert 'Apache License' in (tmp_path / 'files' / 'LICENSE.md').read_text(encoding='utf-8')


@pytest.mark.parametrize(
    ('lines', 'shown'),
    [
        (['Path of |x| and name_ `mbd run`.'], ['Path of \\|x\\| and name\\_ ``mbd run``.']),
        (['One.', '', 'u: held. audit: keep it. Raises X.'], ['One.', '', '**u**: '
            'held.', '', '**audit**: keep it. Raises X.']),
        (['Like so:', '', '    a * b', ''], ['Like so:', '', '::', '', '    a * b']),
        (['a_b, c: both.'], ['**a\\_b, c**: both.']),
    ],
)  # fmt: skip
def test_docstrings_become_restructured_text(lines: list[str], shown: list[str]) -> None:
    assert docstrings.as_rst(lines) == shown
