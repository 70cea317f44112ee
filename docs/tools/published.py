"""Products that the documents publish, their sources, and the commands that make them anew.

    python docs/tools/published.py                    what is older than its sources (part of make lint)
    python docs/tools/published.py --make             makes all of that anew (make docs); goes on where it was
                                                      interrupted
    python docs/tools/published.py --make car_cost    one product, whether it is older or not
    python docs/tools/published.py --list             all products, with when they were made and how long that took

A product is a set of generated parts of documents and of pictures that the same commands make. docs/published.json
holds for every product a digest of its sources when it was made, and a digest of what was made. The sources are the
modules that its programs import, at any depth, as syntax without comments and docstrings, and all data in config/. A
part that is older is named, and lint goes on: an edit of the solver need not change a figure. A part that was changed
by hand is an error.
"""

from __future__ import annotations

import argparse
import ast
import functools
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from solver.disk import atomic_write, syntax

ROOT = Path(__file__).resolve().parents[2]
DOCS, MANIFEST = ROOT / 'docs', ROOT / 'docs' / 'published.json'
DATA = ('.yaml', '.tir', '.csv', '.crg')
HELD = re.compile(r'<!-- begin (?P<name>[^\n]*?) -->\n.*?<!-- end -->', re.DOTALL)
Command = tuple[str, ...]


class Product(NamedTuple):
    """commands: argument lists, of `mbd` or of a tool in docs/tools. roots: modules whose imports are the sources.
    parts: a pattern of the names of parts between marks; pages: whole pages; pictures: a pattern of files in
    docs/pictures. peers: other programs that a part holds figures of; without them it is not made, since a page that
    loses them says less than the old one. recordings: of others, in the directory that RECORDINGS names; without them
    it is not made."""

    commands: tuple[Command, ...]
    roots: tuple[str, ...]
    parts: str = ''
    pages: tuple[str, ...] = ()
    pictures: str = ''
    peers: tuple[str, ...] = ()
    recordings: bool = False


def _study(name: str, *more: str, peers: tuple[str, ...] = ()) -> Product:
    commands = (('mbd', 'study', name, '--out', f'out/{name}', *more), ('docs/tools/studies.py', 'out', name))
    return Product(
        commands, (f'mbd_sim_ros.lab.studies.{name}',), rf'{name}(: .*)?', pictures=f'{name}_*.png', peers=peers
    )


def _bench(suite: str, *more: str, peers: tuple[str, ...] = ()) -> Product:
    options = ('--suite', f'{suite}.yaml') if suite else ()
    part = f'bench {suite}' if suite else 'bench'
    return Product(
        (('mbd', 'bench', *options, *more, '--out', 'docs/performance.md'),),
        ('mbd_sim_ros.lab.benchmarks.suite',),
        part,
        peers=peers,
    )


def _picture(name: str, roots: tuple[str, ...], *commands: Command) -> Product:
    return Product(commands, roots, pictures=name)


PEERS = ('exudyn', 'mujoco')
RECORDINGS = 'MBD_RECORDINGS'  # names the directory with recordings of real vehicles (docs/reality.md)
TRADED = ('car_lane_change', 'car_rough_road', 'car_split_mu_brake', 'car_step_steer', 'car_swept_steer')
SEEN = ('mbd_sim_ros.batch', 'mbd_sim_ros.analysis.view')
TRAILER = ('mbd', 'run', 'saloon_with_trailer', '--out', 'out/trailer')
# then it goes straight on
DWELL = ('mbd', 'run', 'car_sine_with_dwell', '--duration', '5', '--out', 'out/sine_with_dwell')
PRODUCTS: dict[str, Product] = {  # those that take seconds first
    'enveloping': _picture(
        'enveloping.png',
        ('solver.elements.enveloping', 'solver.elements.footprint', 'solver.files.tir'),
        ('docs/tools/enveloping_plots.py', 'config/tires/205_55R16.tir', 'docs/pictures/enveloping.png'),
    ),
    'car_film': _picture(
        'car.gif',
        SEEN,
        DWELL,
        ('mbd', 'view', 'out/sine_with_dwell', '--out', 'docs/pictures/car.gif', '--rate', '8', '--width', '640'),
    ),
    'trailer': _picture(
        'trailer.png',
        SEEN,
        TRAILER,
        ('mbd', 'view', 'out/trailer', '--out', 'docs/pictures/trailer.png', '--at', '1.6'),
    ),
    'slider_crank': _study('slider_crank'),
    'validation': _study('validation'),
    'kandc': _study('kandc'),
    'cars': Product(
        (('mbd', 'study', 'kandc', '--out', 'out/kandc'), ('docs/tools/cars.py', 'out/kandc')),
        ('mbd_sim_ros.lab.studies.kandc', 'solver.analysis.figures', *SEEN),
        pages=('cars.md',),
        pictures='cars_*.png',
    ),
    'car': _study('car'),
    'levels': _study('levels'),
    'car_cost': _study('car_cost'),
    'work_precision': _study('work_precision', peers=PEERS),
    'slider_crank_phases': _study('slider_crank_phases'),
    'penalty_map': _study('penalty_map'),
    'stability': _study('stability'),
    'mechanisms': _study('mechanisms'),
    'error_bars': _study('error_bars'),
    'drives': _study('drives'),
    'reality': _study('reality', '--data', os.environ.get(RECORDINGS, ''))._replace(recordings=True),
    'verdicts': _study('verdicts'),
    'change_points': _study('change_points'),
    'constants': _study('constants'),
    'plan': _study('plan'),
    'trade': Product(
        (*(('mbd', 'study', 'trade', scene) for scene in TRADED), ('docs/tools/accuracy.py', 'out/trade')),
        ('mbd_sim_ros.lab.studies.trade',),
        pages=('accuracy.md',),
        pictures='trade_*.png',
    ),
    'bench_startup': _bench('startup'),
    'bench_scaling': _bench('scaling'),
    'bench_node_at_work': _bench('node_at_work', '--cases', 'car', '--duration', '600'),
    'bench': _bench('', peers=PEERS),
}


@functools.cache
def _imports(file: Path) -> tuple[Path, ...]:
    """The files of this project that a file imports anywhere in it.

    A string in the solver that is the name of a module is an import too: levels of detail are imported by their names.
    """
    found: list[Path] = []
    by_name = file.is_relative_to(ROOT / 'solver')
    for node in ast.walk(ast.parse(file.read_bytes())):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names = [node.module, *(f'{node.module}.{alias.name}' for alias in node.names)]
        if by_name and isinstance(node, ast.Constant) and re.fullmatch(r'solver(\.\w+)+', str(node.value)):
            names = [str(node.value)]
        for name in names:
            found += filter(None, (_file(name),))
    return tuple(found)


def _file(module: str) -> Path | None:
    place = ROOT.joinpath(*module.split('.'))
    files = (place.with_suffix('.py'), place / '__init__.py')
    return next((file for file in files if file.is_file()), None)


@functools.cache
def _digest_of(file: Path) -> bytes:
    content = syntax(file.read_bytes()) if file.suffix == '.py' else file.read_bytes()
    return hashlib.sha256(content).digest()


def sources(product: Product) -> list[Path]:
    """All files that a product depends on. Raises KeyError for a root that is not there.

    Commands are passed over: they print what others compute.
    """
    waiting = []
    for root in product.roots:
        file = _file(root)
        if file is None:
            raise KeyError(root)
        waiting.append(file)
    found: set[Path] = set()
    while waiting:
        file = waiting.pop()
        if file not in found and (ROOT / 'mbd_sim_ros' / 'commands') not in file.parents:
            found.add(file)
            waiting += _imports(file)
    published = ROOT / 'mbd_sim_ros' / 'lab' / 'studies' / 'published'
    data = [path for top in (ROOT / 'config', published) for path in top.rglob('*') if path.suffix in DATA]
    return sorted([*found, *data])


def digest(product: Product) -> str:
    """Digest of the sources of a product."""
    total = hashlib.sha256()
    for file in sources(product):
        total.update(file.relative_to(ROOT).as_posix().encode() + _digest_of(file))
    return total.hexdigest()[:16]


def held(product: Product) -> dict[str, str]:
    """Digests of all that a product made, by place."""
    found: dict[str, bytes] = {page: (DOCS / page).read_bytes() for page in product.pages}
    if product.parts:
        for page in sorted(DOCS.glob('*.md')):
            for match in HELD.finditer(page.read_text(encoding='utf-8')):
                if re.fullmatch(product.parts, match['name']):
                    found[f'{page.name}: {match["name"]}'] = match[0].encode()
    for file in sorted((DOCS / 'pictures').glob(product.pictures)) if product.pictures else ():
        patterns = [other.pictures for other in PRODUCTS.values() if other.pictures and file.match(other.pictures)]
        if product.pictures == max(patterns, key=len):  # car_cost_front.png is one of car_cost, and none of car
            found[f'pictures/{file.name}'] = file.read_bytes()
    return {place: hashlib.sha256(content).hexdigest()[:16] for place, content in found.items()}


def manifest() -> dict[str, dict[str, Any]]:
    """Content of docs/published.json, by product."""
    return json.loads(MANIFEST.read_text(encoding='utf-8')) if MANIFEST.exists() else {}


def older(noted: dict[str, dict[str, Any]]) -> list[str]:
    """Products whose sources have changed since they were made, or of which nothing is noted."""
    return [name for name, product in PRODUCTS.items() if noted.get(name, {}).get('sources') != digest(product)]


def changed_by_hand(noted: dict[str, dict[str, Any]]) -> Iterator[str]:
    """Places that are not what was made."""
    for name, product in PRODUCTS.items():
        if name in noted:
            now, then = held(product), noted[name]['holds']
            yield from (place for place in sorted({*now, *then}) if now.get(place) != then.get(place))


def check() -> int:
    """Name what is older and what was changed by hand; 1 for the latter."""
    noted = manifest()
    by_hand, late = list(changed_by_hand(noted)), older(noted)
    for place in by_hand:
        print(
            f'docs/{place}: changed by hand since it was made; python docs/tools/published.py --make, or change what '
            'makes it'
        )
    if late:
        seconds = [noted.get(name, {}).get('seconds') for name in late]
        known = sum(s for s in seconds if s)
        took = f' (they took {known / 60.0:.0f} min the last time)' if known else ''
        print(
            f'older than their sources, {len(late)} of {len(PRODUCTS)} published products: {", ".join(late)}; make '
            f'docs{took}'
        )
    return 1 if by_hand else 0


def make(names: Sequence[str]) -> int:
    """Make products anew, one after the other; each is noted when it is finished. 1 when one failed; the others go
    on."""
    failed = []
    for k, name in enumerate(names, 1):
        print(f'[{k} of {len(names)}] {name}', flush=True)
        product = PRODUCTS[name]
        if away := [peer for peer in product.peers if not _there(peer)]:
            named = ' and '.join(f'MBD_{peer.upper()}_PYTHON' for peer in away)
            remedy = f"pip install 'mbd_sim_ros[bench]', or name a Python that has it in {named}"
            print(f'{name}: {" and ".join(away)} cannot be imported; {remedy}')
            failed.append(name)
            continue
        if product.recordings and not os.environ.get(RECORDINGS):
            print(f'{name}: name the directory of the recordings in {RECORDINGS} (docs/reality.md)')
            failed.append(name)
            continue
        before, began = digest(product), time.monotonic()
        if not all(_run(command) for command in product.commands):
            failed.append(name)
            continue
        note = {
            'sources': before,
            'made': datetime.now(UTC).strftime('%Y-%m-%d'),
            'seconds': round(time.monotonic() - began),
            'holds': held(product),
        }
        with atomic_write(MANIFEST) as part:
            part.write_text(json.dumps({**manifest(), name: note}, indent=1, sort_keys=True) + '\n', encoding='utf-8')
    if failed:
        print(f'not made: {", ".join(failed)}')
    return 1 if failed else 0


def _there(peer: str) -> bool:
    """True where the Python that a peer runs in (mbd_sim_ros.lab.peers.exudyn) has it."""
    interpreter = os.environ.get(f'MBD_{peer.upper()}_PYTHON', sys.executable)
    try:
        return subprocess.run([interpreter, '-c', f'import {peer}'], capture_output=True, check=False).returncode == 0
    except OSError:
        return False


def _run(command: Command) -> bool:
    if command[:2] == ('mbd', 'run'):  # a recording of the last time is in the way: recordings are never overwritten
        shutil.rmtree(ROOT / command[command.index('--out') + 1], ignore_errors=True)
    program = ('-m', 'mbd_sim_ros.commands.main') if command[0] == 'mbd' else (command[0],)
    return subprocess.run([sys.executable, *program, *command[1:]], cwd=ROOT, check=False).returncode == 0


def main() -> int:
    parser = argparse.ArgumentParser(
        description='What the documents publish: what is older than its sources, and how it is made anew.'
    )
    parser.add_argument(
        'names',
        nargs='*',
        metavar='PRODUCT',
        help=f'of --make: {", ".join(PRODUCTS)} (without names: all that are older)',
    )
    parser.add_argument('--make', action='store_true', help='make products anew')
    parser.add_argument(
        '--list', action='store_true', help='all products, when they were made and the seconds that took'
    )
    args = parser.parse_args()
    unknown = [name for name in args.names if name not in PRODUCTS]
    if unknown:
        parser.error(f'{unknown[0]!r}: no such product; one of {", ".join(PRODUCTS)}')
    if args.list:
        noted = manifest()
        for name in PRODUCTS:
            note = noted.get(name, {})
            print(f'{name:22} {note.get("made", "-"):12} {note.get("seconds", "-")}')
        return 0
    if args.make:
        return make(args.names or older(manifest()))
    return check()


if __name__ == '__main__':
    sys.exit(main())
