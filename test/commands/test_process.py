"""mbd as a process: what is on its outputs whatever happens to them, and the threads that it starts."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BUFFERED = {name: value for name, value in os.environ.items() if name != 'PYTHONUNBUFFERED'}  # as it is at everybody's


def test_only_the_object_is_on_stdout_whatever_a_library_prints(tmp_path: Path) -> None:
    script = (
        'import ctypes, os, sys\nfrom mbd_sim_ros.commands import main as cli\nfrom mbd_sim_ros.commands import '
        'Result\ndef chatty(_):\n    print("from python")\n    os.write(1, b"to the descriptor\\n")\n    '
        'ctypes.CDLL(None).puts(b"from c")\n    ctypes.CDLL(None).fflush(None)\n    return Result(data={"status": '
        '"ok"})\ncli.info.run = chatty\nsys.exit(cli.main(sys.argv[1:]))\n'
    )
    done = subprocess.run(
        [sys.executable, '-c', script, 'info', 'pendulum', '--json'],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, json.loads(done.stdout)) == (0, {'status': 'ok'})
    for text in ('from python', 'to the descriptor', 'from c'):
        assert text in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize('extra', [(), ('--json',)])
def test_an_output_that_takes_nothing_is_one_sentence(extra: tuple[str, ...]) -> None:
    with open('/dev/full', 'w') as full:
        done = subprocess.run(
            [sys.executable, '-m', 'mbd_sim_ros.commands.main', 'info', 'pendulum', *extra],
            cwd=ROOT, env=BUFFERED, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.count('\n') == 1 and 'No space left on device' in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize('words', [('--help',), ('run', '--help')])
def test_help_that_cannot_be_written_is_one_sentence(words: tuple[str, ...]) -> None:
    with open('/dev/full', 'w') as full:
        done = subprocess.run(
            [sys.executable, '-m', 'mbd_sim_ros.commands.main', *words],
            cwd=ROOT, env=BUFFERED, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False,
        )  # fmt: skip
    assert (done.returncode, done.stderr) == (1, 'mbd: the output: No space left on device\n')


@pytest.mark.parametrize(('given', 'threads'), [({}, 1), ({'OPENBLAS_NUM_THREADS': '2'}, 2)])
def test_blas_has_one_thread_unless_the_user_says_otherwise(given: dict[str, str], threads: int) -> None:
    """As many as numpy's own library tells, in a process that began as the command line does."""
    if (os.cpu_count() or 1) < threads:
        pytest.skip('one core')
    script = (
        'import sys; sys.argv[0] = "mbd"\nimport mbd_sim_ros.commands.main, numpy, ctypes, glob, os\nlibraries = '
        '{line.split()[-1] for line in open("/proc/self/maps") if "scipy_openblas" in line and "numpy" in line}\n'
        'library = ctypes.CDLL(min(libraries))\nprint(library.scipy_openblas_get_num_threads64_())\n'
    )
    environment = (
        {k: v for k, v in os.environ.items() if k != 'OPENBLAS_NUM_THREADS'} | {'PYTHONPATH': str(ROOT)} | given
    )
    told = subprocess.run([sys.executable, '-c', script], env=environment, capture_output=True, text=True, check=True)
    assert int(told.stdout) == threads
