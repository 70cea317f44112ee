"""Catalogue of what can be named: scenes, vehicles, maneuvers, ... on the path on which load_scene() looks for them, a
line each."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import yaml

from solver.files.search_path import config_directories

# Kind: (folder below a config directory, ending of its files). The folder and the name make what a scene includes.
KINDS = {
    'scenes': ('scenes', '.yaml'),
    'vehicles': ('vehicles', '.yaml'),
    'trailers': ('vehicles/trailers', '.yaml'),
    'maneuvers': ('maneuvers', '.yaml'),
    'tires': ('tires', '.tir'),
    'roads': ('roads', '.yaml'),
    'mechanisms': ('mechanisms', '.yaml'),
    'sweeps': ('sweeps', '.yaml'),
}
# characters of a file that are read: the comment and the title stand at its head; ten times as much would slow big
# files
MOST = 65536
TITLE = re.compile(r'title:[ \t]+(.*)')
COMMENT = re.compile(r'[#!$]+[ \t]?(.*)')
OF_TIRE = re.compile(r'!\s*:\s*COMMENT\s*:\s*(\S.*)')  # in the header of tire files that Adams writes
# What is no word about the content.
OF_TOOLS = re.compile(r'yaml-language-server:|-\*-|vim?:|SPDX-|Copyright\b|(?:\(c\)|©)\s', re.IGNORECASE)
RULES = ('--', '==', '**', '__')  # with which lines begin that only divide
SENTENCE_END = re.compile(r'(?<=[.!?])\s+(?=[A-Z`\[])')


class Entry(NamedTuple):
    """A file that has a name. text: what it is, in its own words; '' where it does not say. include: as scenes include
    it."""

    name: str
    text: str
    file: Path
    include: str


def files(kind: str) -> dict[str, Path]:
    """Name -> file of a kind, a key of KINDS. Of two files with one name the one that load_scene() finds, in the first
    directory."""
    folder, ending = KINDS[kind]
    found: dict[str, Path] = {}
    for root in config_directories():
        for file in (root / folder).glob(f'*{ending}'):
            if file.is_file():
                found.setdefault(file.stem, file)
    return dict(sorted(found.items()))


def entries(kind: str) -> list[Entry]:
    """The files of a kind, a key of KINDS, by name."""
    return [Entry(name, described(file), file, f'{KINDS[kind][0]}/{file.name}') for name, file in files(kind).items()]


def described(file: Path) -> str:
    """The title of a file, or the first sentence of the comment at its head; why it cannot be read, if that is so."""
    try:
        with file.open(encoding='utf-8-sig', errors='replace') as stream:
            lines = stream.read(MOST).splitlines()
    except OSError as error:
        return f'cannot be read: {error.strerror or error}'
    title = next((match[1] for line in lines if (match := TITLE.fullmatch(line))), '')
    written = (
        next((match[1] for line in lines if (match := OF_TIRE.fullmatch(line))), '') if file.suffix == '.tir' else ''
    )
    return _plain(title) or written.strip() or _first_sentence(lines)


def _plain(title: str) -> str:
    """The value of a line of YAML as text."""
    try:
        value = yaml.safe_load(title)
    except yaml.YAMLError:
        return title.strip()
    return ' '.join(str(value).split()) if isinstance(value, str | int | float) else ''


def _first_sentence(lines: list[str]) -> str:
    words: list[str] = []
    for line in lines:
        comment = COMMENT.fullmatch(line.strip())
        if comment is None and line.strip() and not line.startswith(('---', '%')):
            break  # the content begins
        text = comment[1].strip() if comment is not None else ''
        if text and not text.startswith(RULES) and not OF_TOOLS.match(text):
            words.append(text)
        elif words:
            break
    return SENTENCE_END.split(' '.join(' '.join(words).split()), maxsplit=1)[0].removesuffix('.')
