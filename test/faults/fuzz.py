"""Damaged input of every kind: scenes, vehicles, tires, roads, maneuvers, sweeps, overrides, requirements, mappings,
tolerances, recordings, parameters of the node, command lines, models, states, inputs and units of the native library.

    python test/faults/fuzz.py --count 10000 --seed 1 --out out/fuzz

Every case must end in success or in one sentence, within 10 s of CPU time and 1 GB, and lose nothing in silence: a
scene that is read is the same again after its resolved text, and a recording with a damaged byte is never read as if it
were whole (fuzz_cases.py). The same seed gives the same cases. What was done is in OUT/cases.jsonl, and a second run
goes on from there; the files of a fault stay in OUT/faults. Cases are children of one process that has everything
compiled: about ten a second on a core.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import shutil
import sys
import time
from collections import Counter
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1] / 'support'), str(Path(__file__).parents[2])]

from fuzz_cases import EVERY, KINDS, NATIVE, READERS, make_material
from fuzzing import Verdict, run_case

WEIGHTS = {'scenes': 3, 'vehicles': 2, 'bags': 3}  # others count once


def plan(count: int, kinds: list[str]) -> list[tuple[str, int]]:
    """(kind, number of the case) in turns, so that a part of them has all kinds."""
    more = [kind for kind in kinds for _ in range(WEIGHTS.get(kind, 1) - 1)]
    turn = [*kinds, *more]  # so that as many cases as there are kinds have all of them
    numbers: Counter[str] = Counter()
    cases = []
    for k in range(count):
        kind = turn[k % len(turn)]
        cases.append((kind, numbers[kind]))
        numbers[kind] += 1
    return cases


def main() -> int:
    """Run what is missing; exit code 1 if any case has a fault."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--count', type=int, default=10_000, help='cases of all kinds together')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--kinds', default=','.join(KINDS), help='comma separated: ' + ', '.join(KINDS))
    parser.add_argument('--out', type=Path, default=Path('out/fuzz'))
    parser.add_argument('--seconds', type=float, default=1e9, help='stop after so long; run it again to go on')
    args = parser.parse_args()
    out = args.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    log = out / 'cases.jsonl'
    done = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    known = {(one['seed'], one['kind'], one['case']) for one in done}
    missing = [
        (kind, case) for kind, case in plan(args.count, args.kinds.split(',')) if (args.seed, kind, case) not in known
    ]
    begin = time.monotonic()
    asked = {kind for kind, _ in missing}
    loaded = () if asked <= READERS | NATIVE else EVERY
    material = make_material(out / 'material', loaded, native=bool(asked & NATIVE))
    shown = time.monotonic()
    faults = [one for one in done if one['fault']]
    try:
        with log.open('a') as stream:
            for n, (kind, case) in enumerate(missing):
                if time.monotonic() - begin > args.seconds:
                    print(f'{len(missing) - n} cases are left', file=sys.stderr)
                    break
                place = out / 'work' / f'{kind}-{args.seed}-{case}'
                verdict: Verdict = run_case(kind, args.seed, case, place, material)
                one = {'seed': args.seed, **dataclasses.asdict(verdict)}
                if verdict.fault:
                    faults.append(one)
                    shutil.rmtree(out / 'faults' / place.name, ignore_errors=True)
                    shutil.copytree(place, out / 'faults' / place.name)
                    print(f'{place.name}: {verdict.fault}: {verdict.said.strip()[-300:]}', file=sys.stderr, flush=True)
                else:
                    one['said'] = verdict.said[:120]
                shutil.rmtree(place, ignore_errors=True)
                stream.write(json.dumps(one) + '\n')
                stream.flush()
                if time.monotonic() - shown > 10.0:
                    shown = time.monotonic()
                    print(f'{n + 1} of {len(missing)}, {len(faults)} faults', file=sys.stderr, flush=True)
    except KeyboardInterrupt:
        print('interrupted; run it again to go on', file=sys.stderr)
        return 130
    all_done = [json.loads(line) for line in log.read_text().splitlines()]
    codes = Counter('fault' if one['fault'] else 'success' if one['code'] in (0, 1) else 'sentence' for one in all_done)
    seconds, megabytes = (max(one[key] for one in all_done) for key in ('seconds', 'megabytes'))
    print(f'{len(all_done)} cases: {dict(codes)}; at most {seconds:.1f} s and {megabytes} MB')
    return 1 if codes['fault'] else 0


if __name__ == '__main__':
    sys.exit(main())
