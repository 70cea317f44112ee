"""What a command says when it fails is one line that fits a screen, whatever was quoted in it, and --json one object to
the very end."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from mbd_sim_ros.commands.main import SENTENCE_MOST, main, one_sentence
from mbd_sim_ros.commands.main import __file__ as program
from solver.errors import refused

ROOT = Path(program).parents[2]


def test_a_sentence_is_one_line_of_printable_characters() -> None:
    assert one_sentence('a\nb\x1b[2J\u2028c\x00 d') == 'a\\nb\\x1b[2J\\u2028c\\x00 d'
    long = one_sentence('begin ' + 'x' * 5000 + ' end')
    assert 0.99 * SENTENCE_MOST < len(long) <= SENTENCE_MOST and long.startswith('begin') and long.endswith('end')
    assert one_sentence('Gelenk äußere Kante: 5 °') == 'Gelenk äußere Kante: 5 °'


@pytest.mark.parametrize(
    'text', ['"a\\nb": 1\nduration: 1\n', f'{"x" * 5000}: 1\nduration: 1\n', 'mechanism: {kind: "a\\n\\eb"}\n']
)
def test_keys_with_line_breaks_do_not_break_the_sentence(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'scene.yaml').write_text(text)
    for as_json in ([], ['--json']):
        assert main(['info', str(tmp_path / 'scene.yaml'), *as_json]) == 2
        said = capsys.readouterr()
        sentence = json.loads(said.out)['error'] if as_json else said.err.removesuffix('\n')
        assert sentence.isprintable() and len(sentence) <= SENTENCE_MOST


def test_names_of_files_may_be_any_bytes(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(['recover', '\udcff', str(tmp_path / 'new')]) == 5
    assert '\\udcff is not there' in capfd.readouterr().err
    assert main(['recover', 'a\0b', str(tmp_path / 'new'), '--json']) == 5
    assert 'a\\x00b' in json.loads(capfd.readouterr().out)['error']


def test_a_lack_of_memory_is_a_sentence(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def full(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr('mbd_sim_ros.bags.recovery.recover', full)
    assert main(['recover', 'a', 'b']) == 1
    assert 'not enough memory while starting mbd recover' in capsys.readouterr().err


def test_what_a_library_prints_at_the_end_of_the_process_is_not_on_the_output() -> None:
    script = (
        'import atexit, os, runpy, sys\natexit.register(lambda: os.write(1, b"C says goodbye\\n"))\n'
        'atexit.register(print, "Python says goodbye")\nsys.argv = ["mbd", "recover", "nowhere", "new", "--json"]\n'
        'runpy.run_module("mbd_sim_ros.commands.main", run_name="__main__")\n'
    )
    done = subprocess.run(
        [sys.executable, '-c', script], cwd=ROOT, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 5
    assert json.loads(done.stdout)['error'].startswith('nowhere is not there')
    assert 'C says goodbye' in done.stderr and 'Python says goodbye' in done.stderr


def test_a_program_ends_without_taking_the_interpreter_apart() -> None:
    """Behind a second of compiled code that takes longer than the answer to Ctrl-C may. What was registered for the end
    is done."""
    script = (
        'import atexit, os, sys\nclass Last:\n    def __del__(self, write=os.write):\n        write(1, b"taken '
        'apart")\nlast = Last()\natexit.register(lambda: print("registered"))\nsys.argv = ["mbd", "nothing"]\nfrom '
        'mbd_sim_ros.commands.main import main\nsys.exit(main())\n'
    )
    ended = subprocess.run([sys.executable, '-c', script], check=False, capture_output=True, text=True, cwd=ROOT)
    assert (ended.returncode, ended.stdout) == (2, 'registered\n')
    assert "no command 'nothing'" in ended.stderr


def test_a_current_directory_that_was_removed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gone = tmp_path / 'gone'
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    with pytest.raises(FileNotFoundError) as nameless:
        Path.cwd()
    with pytest.raises(FileNotFoundError) as named:
        Path('nowhere').read_bytes()
    assert refused(nameless.value) == 'the current directory: No such file or directory'
    assert refused(named.value) == 'nowhere: No such file or directory'


@pytest.mark.parametrize('as_json', [[], ['--json']])
def test_an_output_that_is_closed_or_full_is_named(
    as_json: list[str], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    # closing it writes the rest
    with suppress(OSError), Path('/dev/full').open('w') as full, monkeypatch.context() as patch:
        patch.setattr(sys, 'stdout', full)
        assert main(['maneuver', *as_json]) == 1
    assert capfd.readouterr().err == 'mbd: the output: No space left on device\n'
    with monkeypatch.context() as patch:
        patch.setattr(sys, 'stdout', None)
        assert main(['maneuver', *as_json]) == 1
    assert capfd.readouterr().err == 'mbd: the output is closed; give it a place, or /dev/null\n'
