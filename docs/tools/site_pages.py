"""Makes the documents a static site with a reference of the public interface: `make site`, into site/ (extra `site`:
Sphinx, MyST, furo).

    python docs/tools/site_pages.py [DIRECTORY]

The pages are those of the checkout, as they are, where they are: docs/, bags/README.md and the pages at the root,
READMEs as index pages. A link to another file of the checkout leads to a page with its text, one to a folder to a page
with its files. The reference is made from the docstrings of what docs/api.md lists. Every warning of Sphinx is an
error.
"""

from __future__ import annotations

import inspect
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r'(?P<head>\]\()(?P<path>[^)\s#:]+)(?P<anchor>#[^)\s]*)?\)')
FENCED = re.compile(r'(^```.*?^```$)', re.MULTILINE | re.DOTALL)
SHOWN = 'files'  # folder of the pages that show files of the checkout
# Lexers of what is shown; a file of another kind can be fetched.
LEXERS = {
    '': 'text',  # LICENSE, NOTICE
    '.py': 'python',
    '.yaml': 'yaml',
    '.cff': 'yaml',
    '.toml': 'toml',
    '.xml': 'xml',
    '.json': 'json',
    '.rst': 'text',
    '.msg': 'text',
    '.tir': 'text',
}
LARGEST = 200_000  # bytes of a file that is shown; ten times as much is a page that browsers find heavy
LISTED = {  # heading of the navigation -> pages
    'Use': (
        *('docs/tutorial', 'docs/commands', 'docs/coming-from', 'docs/scene', 'docs/vehicle', 'docs/cars', 'docs/tire'),
        *(
            'docs/levels',
            'docs/sweeps',
            'docs/viewing',
            'docs/comparing',
            'docs/fitting',
            'docs/reality',
            'docs/evaluating',
        ),
        *('bags/index', 'docs/driving', 'docs/ensembles', 'docs/learning', 'docs/control', 'docs/native'),
    ),
    'ROS and Python': ('docs/ros', 'docs/api', 'reference', 'docs/conventions'),
    'Method and evidence': (
        *('docs/formulation', 'docs/accuracy', 'docs/studies', 'docs/validation', 'docs/stability', 'docs/performance'),
        'docs/references',
    ),
    'Work on it': ('docs/index', 'docs/contributing', 'docs/decisions/index', 'CONTRIBUTING', 'SECURITY'),
}
CONF = """
project, author, copyright = 'mbd_sim_ros', 'mbd_sim_ros maintainers', 'mbd_sim_ros maintainers'
version = release = {version!r}
extensions = ['myst_parser', 'sphinx.ext.autodoc']
html_theme = 'furo'
html_title = 'mbd_sim_ros ' + release
html_copy_source = html_show_sourcelink = smartquotes = False
html_extra_path = ['raw']
myst_heading_anchors = 6
myst_links_external_new_tab = False
suppress_warnings = ['myst.header', 'toc.not_included']
autodoc_typehints = 'signature'
autodoc_member_order = 'bysource'
python_use_unqualified_type_names = True
pygments_style, pygments_dark_style = 'friendly', 'github-dark'

import sys
sys.path.insert(0, {tools!r})
from site_docstrings import setup
"""


def pages() -> Iterator[Path]:
    """The Markdown pages of the checkout."""
    yield from sorted(ROOT.glob('*.md'))
    yield ROOT / 'bags' / 'README.md'
    yield from sorted((ROOT / 'docs').rglob('*.md'))


def place(path: Path) -> str:
    """Place in the site of a page of the checkout, without its ending."""
    inside = path.relative_to(ROOT)
    return (inside.parent / ('index' if inside.name == 'README.md' else inside.stem)).as_posix()


class Site:
    """The sources of the site in a directory, in the layout of the checkout."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.pages = set(pages())
        self.shown: set[Path] = set()

    def write(self) -> None:
        """Write all pages, and those that they lead to."""
        for page in sorted(self.pages):
            self._put(place(page), self._linked(page.read_text(encoding='utf-8'), page))
        for folder in ('docs/pictures', 'bags'):
            for picture in [*(ROOT / folder).rglob('*.png'), *(ROOT / folder).rglob('*.gif')]:
                self._copy(picture, self.directory / picture.relative_to(ROOT))
        self._put('reference', reference())
        waiting = sorted(self.shown)
        for path in waiting:
            self._show(path)
        index = self.directory / 'index.md'
        trees = ''.join(
            f'\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n' + '\n'.join(names) + '\n```\n'
            for caption, names in LISTED.items()
        )
        index.write_text(index.read_text(encoding='utf-8') + trees, encoding='utf-8')

    def _put(self, name: str, text: str) -> None:
        file = self.directory / f'{name}.md'
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding='utf-8')

    def _copy(self, path: Path, target: Path) -> None:
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, target)

    def _linked(self, text: str, page: Path) -> str:
        """A page whose links lead to where things are in the site. Raises SystemExit for one that leads nowhere."""

        def linked(match: re.Match[str]) -> str:
            target = (page.parent / match['path']).resolve()
            if not target.exists() or not target.is_relative_to(ROOT):
                raise SystemExit(f'{page.relative_to(ROOT)}: the link {match["path"]} leads nowhere')
            return f'](/{self._target(target)}{match["anchor"] or ""})'

        parts = FENCED.split(text)
        return ''.join(part if k % 2 else LINK.sub(linked, part) for k, part in enumerate(parts))

    def _target(self, path: Path) -> str:
        """The place of a file or folder of the checkout in the sources of the site."""
        if path.suffix in ('.png', '.gif'):
            return path.relative_to(ROOT).as_posix()
        if path.is_dir() and (path / 'README.md') in self.pages:
            path /= 'README.md'
        if path in self.pages:
            return f'{place(path)}.md'
        self.shown.add(path)
        return f'{SHOWN}/{path.relative_to(ROOT).as_posix()}.md'

    def _show(self, path: Path) -> None:
        """A page that shows a file, or what is in a folder."""
        name = path.relative_to(ROOT).as_posix()
        head = f'---\norphan: true\n---\n# {name}\n\n'
        if path.is_dir():
            files = sorted(one for one in path.iterdir() if not one.name.startswith(('.', '__pycache__')))
            lines = [f'- `{one.name}{"/" if one.is_dir() else ""}` {first_line(one)}' for one in files]
            self._put(f'{SHOWN}/{name}', head + '\n'.join(lines) + '\n')
            return
        copy = self.directory / 'raw' / 'raw' / path.relative_to(ROOT)
        self._copy(path, copy)
        depth = '../' * (len(path.relative_to(ROOT).parts))
        fetch = f'<a href="{depth}raw/{name}" download>Fetch this file</a>\n\n'
        text = ''
        if path.suffix in LEXERS and path.stat().st_size <= LARGEST:
            text = f'`````{LEXERS[path.suffix]}\n{path.read_text(encoding="utf-8").rstrip()}\n`````\n'
        self._put(f'{SHOWN}/{name}', head + fetch + text)


def first_line(path: Path) -> str:
    """First line of the docstring of a Python file."""
    if path.suffix != '.py':
        return ''
    match = re.match(r'"""(.*?)(?:\n\n|""")', path.read_text(encoding='utf-8'), re.DOTALL)
    return ': ' + re.sub(r'([*_\[\]<>])', r'\\\1', ' '.join(match[1].split())) if match else ''


def reference() -> str:
    """The page of the public interface: every name in `__all__` of the two packages, from its docstring."""
    import mbd_sim_ros
    import solver

    parts = [
        '# Reference\n\nMade from the docstrings. What of it stays from release to release: [From '
        'Python](/docs/api.md).\n'
    ]
    for package in (solver, mbd_sim_ros):
        parts.append(f'\n## {package.__name__}\n\n{(package.__doc__ or "").partition(chr(10))[0]}\n')
        functions = [name for name in package.__all__ if not isinstance(getattr(package, name), type)]
        classes = [name for name in package.__all__ if name not in functions and not name.endswith('Error')]
        errors = [name for name in package.__all__ if name not in functions and name not in classes]
        for name in (*functions, *classes, *errors):
            parts.append(_directive(package.__name__, name, getattr(package, name)))
    return '\n'.join(parts)


def _directive(package: str, name: str, thing: Any) -> str:
    kind = 'class' if inspect.isclass(thing) else 'function'
    error = inspect.isclass(thing) and issubclass(thing, Exception)
    members = '' if kind == 'function' or error else '   :members:\n'
    return f'```{{eval-rst}}\n.. auto{"exception" if error else kind}:: {package}.{name}\n{members}```\n'


def build(target: Path) -> int:
    """Make the site; 0 where nothing is wrong with it."""
    from sphinx.cmd.build import build_main

    sys.path.insert(0, str(ROOT))
    with tempfile.TemporaryDirectory(prefix='mbd-site-') as scratch:
        source = Path(scratch) / 'source'
        Site(source).write()
        (source / 'raw').mkdir(exist_ok=True)
        version = re.search(r"version='([\d.]+)'", (ROOT / 'setup.py').read_text(encoding='utf-8'))
        assert version
        (source / 'conf.py').write_text(
            CONF.format(version=version[1], tools=str(Path(__file__).parent)), encoding='utf-8'
        )
        return build_main(
            [
                '--quiet',
                '--fail-on-warning',
                '--keep-going',
                '-b',
                'html',
                '-d',
                f'{scratch}/doctrees',
                str(source),
                str(target),
            ]
        )


if __name__ == '__main__':
    sys.exit(build(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / 'site'))
