"""The notebook runs from top to bottom, and finds what the example recordings were made with."""

from __future__ import annotations

from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / 'docs'


@pytest.mark.slow
def test_the_notebook_runs_and_finds_what_was_planted(monkeypatch: pytest.MonkeyPatch) -> None:
    nbformat = pytest.importorskip('nbformat', reason='pip install .[test]')
    nbclient = pytest.importorskip('nbclient', reason='pip install .[test]')
    monkeypatch.setenv('PYTHONPATH', str(DOCS.parent), prepend=':')
    notebook = nbformat.read(DOCS / 'recordings.ipynb', as_version=4)
    nbformat.validate(notebook)
    assert not any(cell.get('outputs') for cell in notebook.cells)  # they would age
    nbclient.NotebookClient(notebook, timeout=60, resources={'metadata': {'path': str(DOCS)}}).execute()
    said = {}
    for cell in notebook.cells:
        if cell.cell_type == 'code':
            assert len(cell.outputs) == 1, cell.source  # one result, and nothing is printed beside, no warning
            said[cell.source.splitlines()[-1]] = cell.outputs[0].data
    assert float(said['found.offsets[0]']['text/plain']) == pytest.approx(0.137, abs=1e-3)
    assert float(said['round(gain, 3)']['text/plain']) == pytest.approx(1.02, abs=1e-3)
    assert said["table.index[~table['within limits']].tolist()"]['text/plain'] == "['imu/ay']"
    assert any('image/png' in data for data in said.values())
    assert 'm/s^2' in said['units']['text/plain']
