"""Names of files in scenes: which values are names, what reads the files, and where these are found."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from yaml.nodes import Node, ScalarNode

from solver.errors import SceneError
from solver.files.raster import read_npz, read_png
from solver.files.tir import read_tir

INCLUDE = re.compile(r'(?:[\w./-]+|/.*)(\.[a-z]+)')  # what begins with / is a path, whatever is in it


def _read_crg(path: Path) -> object:
    """See solver.files.crg_surface.read_crg(), which brings numba."""
    from solver.files.crg_surface import read_crg

    return read_crg(path)


# file ending -> what reads it into a dataclass or mapping; .yaml is built in
READERS: dict[str, Callable[[Path], object]] = {'.tir': read_tir, '.crg': _read_crg, '.png': read_png, '.npz': read_npz}


def names_file(node: Node) -> bool:
    """True for the name of a file that can be included where it stands without quotes."""
    match = INCLUDE.fullmatch(node.value) if isinstance(node, ScalarNode) else None
    return match is not None and match[1] in ('.yaml', *READERS)


def unfit(node: Node) -> str:
    """Spelling that a value which looks like the name of a file needs to stand for its content; '' of any other."""
    if not isinstance(node, ScalarNode) or node.style is not None or names_file(node):
        return ''
    ending = Path(node.value).suffix
    if ending.lower() not in ('.yaml', *READERS):
        return ''
    if ending != ending.lower():
        return f'; the ending of a file that stands here is in small letters: {ending.lower()}'
    return (
        '; a name with anything but letters, digits and . _ - / in it is written as a whole path, from the first / on'
    )


def included(file: Path) -> str:
    """A file as scenes and overrides include it. Raises SceneError."""
    name = str(file.resolve())
    if INCLUDE.fullmatch(name) is None or re.search(r':\s|\s#', name) or file.suffix not in ('.yaml', *READERS):
        raise SceneError(
            f'{name!r}: a scene cannot include it; move it to a path without ": " and " #" that ends in .yaml'
        )
    return name


def find(name: str, directories: Sequence[Path]) -> Path | None:
    """First existing directory/name."""
    return next((d / name for d in directories if (d / name).is_file()), None)


def listing(directory: Path, like: Path) -> Iterator[str]:
    """Names of the files in directory/<parent of like> with the same ending, as they would be written in an include."""
    folder = directory / like.parent
    if folder.is_dir():
        yield from ((like.parent / file.name).as_posix() for file in folder.glob(f'*{like.suffix}'))


def one_folder_down(name: str, directories: Sequence[Path]) -> str | None:
    """The include that names a file of a folder in one of the directories, where its name alone was written."""
    folders = (folder for directory in directories for folder in sorted(directory.glob('*/')))
    return next((f'{folder.name}/{name}' for folder in folders if (folder / name).is_file()), None)
