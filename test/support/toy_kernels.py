"""A package `solver` with the real compiler and cache and three small kernels, for processes of their own: they compile
in a second."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

SOLVER = Path(__file__).parents[2] / 'solver'
TOY = """
from solver.compiled.kernel import kernel

@kernel(inline=True)
def square(x):
    return x * x

@kernel
def total(values):
    found = 0.0
    for x in values:
        found += square(x)
    return found

@kernel
def twice(values):
    return 2.0 * total(values)
"""
# For every job (a line of JSON) a process of its own, forked from one that has imported everything and compiled
# nothing.
PROGRAM = """
import json, os, sys
from pathlib import Path
import numpy as np
import numba
from numba.core import event
from solver.compiled import kernel
from solver.elements import toy

numba.njit(lambda x: x + x)(1.0)  # what the first compilation of a process costs
for line in sys.stdin:
    job = json.loads(line)
    if os.fork():
        os.wait()
        continue
    out = os.open(job['out'] + '.err', os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(out, 2)
    if 'cache' in job:
        kernel.KERNELS.store.directory = Path(job['cache'])
    compiled = event.RecordingListener()
    event.register('numba:compile', compiled)
    if 'limit' in job:
        import resource
        resource.setrlimit(resource.RLIMIT_FSIZE, (job['limit'], job['limit']))
    for statement in job.get('first', []):
        exec(statement)
    values = [toy.total(np.arange(5.0)), toy.twice(np.arange(5.0))]
    count = sum(record.is_start for _, record in compiled.buffer)
    print(json.dumps({'values': values, 'compiled': count, 'cache': str(kernel.KERNELS.store.directory)}), flush=True)
    os._exit(0)
"""
VALUES = [30.0, 60.0]  # of total and twice of 0, 1, ..., 4


def package(root: Path) -> Path:
    """Write the package below root, which is what PYTHONPATH must be."""
    for folder in ('compiled', 'elements'):
        (root / 'solver' / folder).mkdir(parents=True)
        (root / 'solver' / folder / '__init__.py').touch()
    (root / 'solver' / '__init__.py').touch()
    shutil.copyfile(SOLVER / 'disk.py', root / 'solver' / 'disk.py')
    for name in ('kernel', 'cache', 'contents', 'by_reference', 'interruption', 'target'):
        shutil.copyfile(SOLVER / 'compiled' / f'{name}.py', root / 'solver' / 'compiled' / f'{name}.py')
    (root / 'solver' / 'elements' / 'toy.py').write_text(TOY, encoding='utf-8')
    return root


class Toys:
    """Runs jobs on one package and one cache. A job may have: cache (another directory of kernels), first (statements
    before the first call), limit (bytes a file may have). Each answers with values, compiled (kernels), cache and err,
    what was on stderr.
    """

    def __init__(self, root: Path, cache: Path, scratch: Path, **environment: str) -> None:
        self._scratch = scratch
        scratch.mkdir(exist_ok=True)
        self._environment = {**os.environ, 'PYTHONPATH': str(root), 'MBD_CACHE_DIR': str(cache), **environment}

    def start(self) -> subprocess.Popen[str]:
        """A process that takes jobs."""
        pipe = subprocess.PIPE
        return subprocess.Popen(
            [sys.executable, '-c', PROGRAM],
            cwd=self._scratch,
            env=self._environment,
            stdin=pipe,
            stdout=pipe,
            stderr=pipe,
            text=True,
        )

    def run(self, *jobs: dict[str, Any]) -> list[dict[str, Any]]:
        """Answers of one process to its jobs, one after the other."""
        process = self.start()
        self.send(process, jobs or ({},))
        return self.receive(process, jobs or ({},))

    def send(self, process: subprocess.Popen[str], jobs: Sequence[dict[str, Any]]) -> None:
        """Give a process all it has to do."""
        assert process.stdin
        process.stdin.writelines(json.dumps({**job, 'out': self._out(process, k)}) + '\n' for k, job in enumerate(jobs))
        process.stdin.flush()

    def receive(self, process: subprocess.Popen[str], jobs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        """Its answers, when it has ended."""
        stdout, stderr = process.communicate(timeout=120.0)
        errors = [Path(self._out(process, k) + '.err').read_text() for k in range(len(jobs))]
        answers = [json.loads(line) for line in stdout.splitlines()]
        assert process.returncode == 0 and len(answers) == len(jobs), stderr + ''.join(errors)
        return [{**answer, 'err': err} for answer, err in zip(answers, errors, strict=True)]

    def _out(self, process: subprocess.Popen[str], k: int) -> str:
        return str(self._scratch / f'job-{process.pid}-{k}')


class Edited:
    """A package whose files in solver/elements may change between two processes, which share a cache. program: assigns
    `values`."""

    def __init__(self, directory: Path, files: dict[str, str], program: str) -> None:
        self._directory, self._program = directory, program
        package(directory)
        self.change(files)

    def change(self, files: dict[str, str]) -> None:
        """Have these files, by name, and no others; an empty one is not there."""
        for path in (self._directory / 'solver' / 'elements').glob('[a-z]*.py'):
            path.unlink()
        for name, text in files.items():
            if text:
                (self._directory / 'solver' / 'elements' / f'{name}.py').write_text(text, encoding='utf-8')

    def run(self, **environment: str) -> tuple[list[float], set[str]]:
        """(values, names of the kernels that were compiled) of a process."""
        program = f"""
import json
from numba.core import event
compiled = event.RecordingListener()
event.register('numba:compile', compiled)
{self._program}
names = {{record.data['dispatcher'].__name__ for _, record in compiled.buffer if record.is_start}}
print(json.dumps([values, sorted(names)]))
"""
        own = {
            'PYTHONPATH': str(self._directory),
            'MBD_CACHE_DIR': str(self._directory / 'cache'),
            'PYTHONDONTWRITEBYTECODE': '1',
        }
        own = {**os.environ, **own, **environment}
        run = [sys.executable, '-c', program]
        done = subprocess.run(
            run, cwd=self._directory, env=own, capture_output=True, text=True, timeout=120, check=False
        )
        assert (done.returncode, done.stderr) == (0, ''), done.stderr
        values, names = json.loads(done.stdout)
        return values, set(names)
