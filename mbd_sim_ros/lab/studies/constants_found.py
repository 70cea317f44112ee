"""Numbers that modules of the solver name, found in their syntax: value, place, comment, and why one is not varied."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.lab.studies.cells import ROOT

EXACT = {  # mathematics, which nobody chose
    'solver.step.extrapolation.THIRD': 'Richardson extrapolation of a second-order step: 1 / (2^2 - 1)',
    'solver.step.interval.ORDER': 'order of the error of the method',
    'solver.step.iteration_fixed.UNSEEN': 'leading error of a second-order step: 1 / 12 of the second difference',
}
FROM_ONE = {  # numbers of which the distance from one is what was chosen
    'solver.step.iteration.WARM_START': 'part of the multipliers that a step begins with: one less what it forgets',
    'solver.start.reach.PARALLEL': 'cosine',
    'solver.start.rolling.ALIGNED': 'cosine',
}
LABEL = 'a label: its place in an enumeration'


class Constant(NamedTuple):
    """A number that a module names. kept: the reason why it is not varied, or empty. comment: beside or above it."""

    module: str
    name: str
    line: int
    value: float
    comment: str
    kept: str = ''

    @property
    def key(self) -> str:
        """Dotted name."""
        return f'{self.module}.{self.name}'

    @property
    def place(self) -> str:
        """File and line."""
        return f'{self.module.replace(".", "/")}.py:{self.line}'

    def times(self, factor: float) -> float:
        """The changed value: for integers rounded, and different by one at least; for those of FROM_ONE their distance
        from one."""
        if factor == 1.0:
            return self.value
        if isinstance(self.value, int):
            changed = round(self.value * factor)
            return changed if changed != self.value else self.value + (1 if factor > 1.0 else -1)
        return 1.0 - (1.0 - self.value) * factor if self.key in FROM_ONE else self.value * factor


def constants(folders: Sequence[str], root: Path = ROOT) -> list[Constant]:
    """All numbers that modules in these folders name, by file and line, also those that are not varied."""
    return [one for folder in folders for file in sorted((root / folder).glob('*.py')) for one in _of_file(file, root)]


def _of_file(file: Path, root: Path) -> Iterator[Constant]:
    module = '.'.join(file.relative_to(root).with_suffix('').parts).removesuffix('.__init__')
    text = file.read_text(encoding='utf-8')
    lines, values, labels = text.splitlines(), vars(importlib.import_module(module)), set[str]()
    for node in ast.parse(text).body:
        for target, source in _assigned(node):
            names = [one.id for one in ast.walk(target) if isinstance(one, ast.Name)]
            used = {one.id for one in ast.walk(source) if isinstance(one, ast.Name)}
            if used & {'range', *labels}:
                labels.update(names)
            for name in names:
                value = values.get(name)
                if isinstance(value, int | float | np.number) and not isinstance(value, bool | np.bool_):
                    key = f'{module}.{name}'
                    plain = value.item() if isinstance(value, np.number) else value
                    kept = LABEL if name in labels else EXACT.get(key, '')
                    yield Constant(module, name, target.lineno, plain, _comment(lines, node), kept)


def _assigned(node: ast.stmt) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Target and value of every assignment in a statement; those of `a, b = 1, 2` one by one."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    value = getattr(node, 'value', None)
    for target in targets:
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            yield from zip(target.elts, value.elts, strict=False)
        elif value is not None:
            yield target, value


def _comment(lines: Sequence[str], node: ast.stmt) -> str:
    """Text of the comment behind a statement, or of the lines directly above it."""
    assert node.end_lineno is not None and node.end_col_offset is not None
    behind = lines[node.end_lineno - 1].encode()[node.end_col_offset :].decode().strip()
    if behind.startswith('#'):
        return behind.removeprefix('#').strip()
    above: list[str] = []
    for line in reversed(lines[: node.lineno - 1]):
        if not line.startswith('#'):
            break
        above.insert(0, line.removeprefix('#').strip())
    return ' '.join(above)
