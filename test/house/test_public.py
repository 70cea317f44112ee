"""The public interface: what __all__ lists is there, is documented, and is what docs/api.md shows."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import mbd_sim_ros
import solver

ROOT = Path(__file__).parents[2]
PACKAGES = (solver, mbd_sim_ros)
NAMES = [(package, name) for package in PACKAGES for name in package.__all__]
HEAVY = ('numpy', 'numba', 'scipy', 'yaml', 'mcap', 'pandas')


@pytest.mark.parametrize('package', PACKAGES, ids=lambda package: package.__name__)
def test_what_is_listed_is_there_and_is_shown(package: Any) -> None:
    assert package.__all__ == sorted(package.__all__)
    assert set(package.__all__) <= set(dir(package))
    for name in package.__all__:
        assert getattr(package, name).__name__ == name
    with pytest.raises(AttributeError, match=f"module '{package.__name__}' has no attribute 'unheard_of'"):
        package.unheard_of  # noqa: B018
    assert (Path(package.__file__).parent / 'py.typed').is_file()


@pytest.mark.parametrize('package', PACKAGES, ids=lambda package: package.__name__)
def test_type_checkers_see_the_same_names_from_the_same_modules(package: Any) -> None:
    """The imports for type checkers and those at run time name one home for each."""
    tree = ast.parse(inspect.getsource(package))
    (block,) = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == 'TYPE_CHECKING']
    seen = {alias.name: node.module for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert {name: seen[name] for name in package._HOMES} == package._HOMES
    assert set(package.__all__) - set(package._HOMES) == {name for name in package.__all__ if name in vars(package)}


@pytest.mark.parametrize('package', PACKAGES, ids=lambda package: package.__name__)
def test_nothing_heavy_is_imported_before_it_is_asked_for(package: Any) -> None:
    seen = f'import sys, {package.__name__}; print(*(name for name in {HEAVY} if name in sys.modules))'
    done = subprocess.run([sys.executable, '-c', seen], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.split() == []


def members(cls: type) -> Iterator[tuple[str, Any]]:
    """What a class of ours brings: methods and properties without a leading underscore."""
    for name, member in inspect.getmembers(cls):
        own = next((base for base in cls.__mro__ if name in vars(base)), object)
        ours = own.__module__.startswith(('solver', 'mbd_sim_ros'))
        if (
            ours
            and not name.startswith('_')
            and (callable(member) or isinstance(inspect.getattr_static(cls, name), property))
        ):
            yield name, inspect.getattr_static(cls, name)


def text_of(thing: Any) -> str:
    return inspect.getdoc(thing.func if hasattr(thing, 'func') else thing) or ''


@pytest.mark.parametrize(('package', 'name'), NAMES, ids=lambda one: one if isinstance(one, str) else one.__name__)
def test_everything_public_has_a_docstring(package: Any, name: str) -> None:
    thing = getattr(package, name)
    assert len(text_of(thing)) > 20 and not text_of(thing).startswith(f'{name}(')
    if not isinstance(thing, type):
        required = ('name', 'text', 'scene', 'simulation', 'steps', 'n', 'path', 'bag')  # what the first line speaks of
        missing = [
            p
            for p in inspect.signature(thing).parameters
            if p not in required and not re.search(rf'\b{p}\b', text_of(thing))
        ]
        assert missing == [], f'{name}: arguments that its docstring does not name'
        assert 'Raises' in text_of(thing)
        return
    for member, found in members(thing):
        assert len(text_of(found)) > 10, f'{name}.{member} has no docstring'


def test_arrays_of_a_snapshot_have_shapes_and_units() -> None:
    for name, found in members(solver.Snapshot):
        if isinstance(found, property):
            assert re.match(r'\(.+\) ', text_of(found)), f'{name}: no shape'
            assert '[' in text_of(found) or name in ('inputs', 'elements'), f'{name}: no unit'


def test_the_page_shows_what_is_listed_and_nothing_else() -> None:
    """docs/api.md, `## What is public`."""
    section = (
        (ROOT / 'docs' / 'api.md').read_text(encoding='utf-8').partition('## What is public\n')[2].partition('\n## ')[0]
    )
    table = section.partition('| of a simulation |')[0]
    shown = {
        name
        for line in table.splitlines()
        for name in re.findall(r'`((?:solver|mbd_sim_ros)\.\w+)', line.split('|')[1] if line.startswith('|') else '')
    }
    assert shown == {f'{package.__name__}.{name}' for package, name in NAMES}
    methods = set(re.findall(r'\[`Simulation\.(\w+)\(\)`\]', section))
    assert methods and methods <= {name for name, _ in members(solver.Simulation)}


def test_arguments_that_the_page_names_are_there() -> None:
    text = (ROOT / 'docs' / 'api.md').read_text(encoding='utf-8')
    for name, arguments in re.findall(r'^\| `((?:solver|mbd_sim_ros)\.\w+)\(([^)]*)\)`', text, re.MULTILINE):
        package, _, function = name.rpartition('.')
        taken = inspect.signature(getattr(importlib.import_module(package), function)).parameters
        given = [one.strip() for one in arguments.split(',')]
        assert all(one in taken or (one, next(iter(taken))) == ('path', 'bag') for one in given), name


def test_errors_are_one_family() -> None:
    errors = [getattr(solver, name) for name in solver.__all__ if name.endswith('Error')]
    assert all(issubclass(one, solver.MbdError) for one in errors) and len({one.exit_code for one in errors}) > 3
    assert dataclasses.is_dataclass(solver.Scene) and dataclasses.is_dataclass(mbd_sim_ros.Run)
