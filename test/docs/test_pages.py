"""Pages say what is so: links lead somewhere, files and functions they name exist, the index is complete, examples
run."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest
from program_copy import ROOT, run_there

from mbd_sim_ros import interrupts
from mbd_sim_ros.commands import main
from mbd_sim_ros.node.companion import NoSimulator
from solver.errors import MbdError
from solver.model.state import State

DOCS = ROOT / 'docs'
PAGES = sorted({*ROOT.glob('*.md'), ROOT / 'bags' / 'README.md', *DOCS.rglob('*.md')})
LINK = re.compile(r'(?<!!)\[([^\]\n]+)\]\(([^)\s]+)\)|!\[[^\]]*\]\(([^)\s]+)\)')
CODE = re.compile(r'`([^`\n]+)`')
FENCE = re.compile(r'^```.*?^```$', re.MULTILINE | re.DOTALL)
CALLED = re.compile(r'(?:[A-Za-z_]\w*\.)*[A-Za-z_]\w*\(\)')
FILE = re.compile(r'[\w./-]+\.(?:py|yaml|toml|tir|md|msg)')
DOTTED = re.compile(r'(?:solver|mbd_sim_ros)(?:\.\w+)+')
GENERATED = {'report.md', 'metadata.yaml', 'mine.yaml'}  # written by runs, and by readers


def ids(pages: list[Path]) -> list[str]:
    return [str(page.relative_to(ROOT)) for page in pages]


def prose(page: Path) -> str:
    """The text of a page without its fenced code."""
    return FENCE.sub('', page.read_text(encoding='utf-8'))


def anchors(page: Path) -> set[str]:
    """What a link into a page may name: its headings, as they are spelt in addresses."""
    headings = re.findall(r'^#+ (.*)$', prose(page), re.MULTILINE)
    return {re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-') for heading in headings}


@cache
def defined(file: Path) -> frozenset[str]:
    """Functions, classes, methods ('Class.method') and assigned names of a file."""
    found: set[str] = set()
    body = ast.parse(file.read_text(encoding='utf-8')).body
    body += [part for node in body if isinstance(node, ast.If) for part in node.body]  # imports for type checkers
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            found |= {f'{node.name}.{part.name}' for part in node.body if isinstance(part, ast.FunctionDef)}
            found |= {
                f'{node.name}.{part.target.id}'
                for part in node.body
                if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name)
            }
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        found |= {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}
        if isinstance(node, ast.ImportFrom):
            found |= {alias.asname or alias.name for alias in node.names}
    return frozenset(found)


@cache
def everywhere() -> frozenset[str]:
    """Names of all functions and methods of the program and its tests."""
    found: set[str] = set()
    for folder in ('solver', 'mbd_sim_ros', 'test', 'docs'):
        for path in (ROOT / folder).rglob('*.py'):
            for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
                if isinstance(node, ast.FunctionDef):
                    found.add(node.name)
    return frozenset(found)


@cache
def file_names() -> frozenset[str]:
    """Every path below the root and all its ends: 'config/tires/x.tir', 'tires/x.tir', 'x.tir'."""
    found: set[str] = set()
    for folder in ('solver', 'mbd_sim_ros', 'test', 'docs', 'config', 'bags', 'launch', '.'):
        for path in (ROOT / folder).glob('*' if folder == '.' else '**/*'):
            parts = path.relative_to(ROOT).parts
            found |= {'/'.join(parts[k:]) for k in range(len(parts))}
    return frozenset(found)


@pytest.mark.parametrize('page', PAGES, ids=ids(PAGES))
def test_links_lead_somewhere(page):
    for text, target, picture in LINK.findall(prose(page)):
        address = target or picture
        if re.match(r'\w+:', address):
            continue
        path, _, anchor = address.partition('#')
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), f'[{text}]({address})'
        if anchor:
            assert anchor in anchors(there), f'[{text}]({address}): {sorted(anchors(there))}'


@pytest.mark.parametrize('page', PAGES, ids=ids(PAGES))
def test_what_a_link_names_is_in_the_file_it_leads_to(page):
    """[`name()`](file.py) and [`Name`](file.py): defined there."""
    for text, target, _ in LINK.findall(prose(page)):
        name = text.strip('`').removesuffix('()')
        if text.startswith('`') and target.endswith('.py') and re.fullmatch(r'[A-Za-z_]\w*(\.\w+)*', name):
            assert name in defined((page.parent / target).resolve()), f'[{text}]({target})'


@pytest.mark.parametrize('page', PAGES, ids=ids(PAGES))
def test_files_that_a_page_names_exist(page):
    """Also in parts: `tires/205_55R16.tir`, `road.py`."""
    for code in CODE.findall(prose(page)):
        for name in FILE.findall(code):
            known = (
                name.startswith(('out/', '/', '..'))
                or name in GENERATED
                or '*' in code
                or name.removeprefix('./') in file_names()
            )
            assert known, f'`{code}` names {name}'


@pytest.mark.parametrize('page', PAGES, ids=ids(PAGES))
def test_functions_and_modules_that_a_page_names_exist(page):
    text = prose(page)
    for code in CODE.findall(text):
        for call in CALLED.findall(code):
            assert call.removesuffix('()').rpartition('.')[2] in everywhere(), f'`{code}`: no function {call}'
        for dotted in DOTTED.findall(code):
            assert resolves(dotted), f'`{code}`: no {dotted}'


def resolves(dotted: str) -> bool:
    """Whether 'solver.step.stage.place' is a module, a package, or a name in one."""
    parts = dotted.split('.')
    for k in range(len(parts), 0, -1):
        path = ROOT.joinpath(*parts[:k])
        file = path / '__init__.py' if path.is_dir() else path.with_suffix('.py')
        if file.is_file():
            rest = '.'.join(parts[k:])
            return not rest or rest in defined(file) or (file.parent / f'{rest}.msg').exists()
    return False


def test_the_table_of_the_state_has_its_fields():
    """docs/conventions.md, `## State`: every array, in order."""
    section = (DOCS / 'conventions.md').read_text(encoding='utf-8').partition('## State\n')[2].partition('\n\n')[0]
    named = [name for line in section.splitlines()[2:] for name in CODE.findall(line.split('|')[1])]
    assert tuple(named) == State._fields


def test_every_page_stands_in_the_index():
    index = {(DOCS / target).resolve() for _, target, _ in LINK.findall(prose(DOCS / 'README.md'))}
    assert {page for page in DOCS.glob('*.md') if page.name != 'README.md'} <= index
    assert DOCS / 'decisions' / 'README.md' in index
    decisions = DOCS / 'decisions'
    listed = re.findall(r'^\| \[(\d{4})\]\(([^)]+)\)', prose(decisions / 'README.md'), re.MULTILINE)
    assert [name for _, name in listed] == sorted(path.name for path in decisions.glob('0*.md'))
    numbers = [number for number, _ in listed]
    assert len(set(numbers)) == len(numbers)
    for number, name in listed:
        assert (decisions / name).read_text(encoding='utf-8').startswith(f'# {number} ')


@pytest.mark.slow
def test_the_example_of_the_public_interface_runs(tmp_path):
    """docs/api.md, from the first line to the last of each example; their own assertions are checked."""
    examples = re.findall(
        r'^```python\n(.*?)^```$', (DOCS / 'api.md').read_text(encoding='utf-8'), re.MULTILINE | re.DOTALL
    )
    for example, lines in zip(examples, (3, 2), strict=True):
        (tmp_path / 'example.py').write_text(example, encoding='utf-8')
        done = run_there(tmp_path, 'example.py', PYTHONPATH=str(ROOT))
        assert done.returncode == 0, done.stderr
        assert len(done.stdout.splitlines()) == lines
    assert len(list((tmp_path / 'run').glob('*.mcap'))) == 1


def test_the_readme_lists_every_exit_code():
    """Those of all errors, of the command line, and of what a signal ends (128 and its number)."""
    of_errors, kinds = {0}, [MbdError]
    while kinds:
        kind = kinds.pop()
        of_errors.add(kind.exit_code)
        # none of a test
        kinds += [one for one in kind.__subclasses__() if one.__module__.startswith(('solver.', 'mbd_sim_ros.'))]
    assert {NoSimulator.exit_code, main.USAGE_ERROR} < of_errors
    table = re.search(r'\| exit code .*?\n\n', (DOCS / 'commands.md').read_text(encoding='utf-8') + '\n\n', re.DOTALL)
    listed = re.findall(r'^\| ([\d, ]+) \|', table[0], re.MULTILINE)
    of_signals = {interrupts.EXIT + number for number in interrupts.SIGNALS}
    assert {int(code) for codes in listed for code in codes.split(',')} == of_errors | {
        main.INTERNAL_ERROR
    } | of_signals
