"""Results of long studies, cell by cell in a file, so that a study that was interrupted goes on where it was."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mbd_sim_ros import interrupts
from mbd_sim_ros.analysis.whole import whole

ROOT = Path(__file__).resolve().parents[3]
SOURCES = ('solver', 'config', 'mbd_sim_ros/lab/mechanisms', 'mbd_sim_ros/lab/studies/crank.py')


def digest_of_program(sources: Sequence[str]) -> str:
    """Of everything that results depend on: SOURCES and further files or folders."""
    found = hashlib.sha256()
    for source in (*SOURCES, *sources):
        top = ROOT / source
        for path in sorted(top.rglob('*')) if top.is_dir() else [top]:
            if path.suffix in ('.py', '.yaml', '.tir'):
                found.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return found.hexdigest()[:16]


class Cells:
    """Finished cells as lines of JSON, {'cell': name, ...}, in a file that begins with a digest of the program.

    Cells of another program are not taken over: the file is begun anew. A last line that is not whole is dropped. sources: files of the
    program that they depend on beside SOURCES.
    """

    def __init__(self, file: Path, sources: Sequence[str] = ()) -> None:
        self.rows: dict[str, dict[str, Any]] = {}
        self.kept = 0  # cells that were there
        program = digest_of_program(sources)
        lines = file.read_text(encoding='utf-8', errors='replace').split('\n')[:-1] if file.exists() else []
        if lines and _parsed(lines[0]) == {'program': program}:
            self.rows = {row['cell']: row for row in map(_parsed, lines[1:]) if 'cell' in row}
            self.kept = len(self.rows)
        begun = [{'program': program}, *self.rows.values()]
        replace_text(file, ''.join(f'{json.dumps(row, allow_nan=False)}\n' for row in begun))
        self._file = file.open('a', encoding='utf-8')

    def __enter__(self) -> Cells:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def cell(self, name: str, compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """The row of a cell, computed if it is not there. Between two cells a signal ends the study."""
        if name not in self.rows:
            interrupts.now(f'computing {name}; what is finished is in {self._file.name} and is not computed again')
            interrupts.check()
            row = _plain({'cell': name, **compute()})
            self._write(row)
            self.rows[name] = row
        return self.rows[name]

    def _write(self, row: dict[str, Any]) -> None:
        self._file.write(json.dumps(row, allow_nan=False) + '\n')
        self._file.flush()


def replace_text(file: Path, text: str) -> None:
    """Write a file so that whoever is killed meanwhile, or finds the disk full, leaves the old one."""
    with whole(file) as part:
        part.write_text(text, encoding='utf-8')


def _parsed(line: str) -> dict[str, Any]:
    try:
        found = json.loads(line)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _plain(value: Any) -> Any:
    """As JSON holds it: what is not finite becomes null."""
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if hasattr(value, 'item'):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def number(value: float | None) -> float:
    """A number of a row: null is nan."""
    return math.nan if value is None else float(value)
