"""mbd tune: values of a vehicle's parameters, within bounds, that give figures wanted values."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from mbd_sim_ros.commands import Result, declare, names_of, offer, table
from solver.errors import MbdError, SceneError, SpecError, suggestion

if TYPE_CHECKING:
    from mbd_sim_ros.analysis.tuning import Found, Key, Target

EXAMPLE = """mbd tune compact_fwd axles.front.anti_roll_bar.stiffness=200:1500 'roll_gradient=4 deg/g'
  mbd tune full_car front.lower_link.bushing.stiffness[0]=2e6:2e7 rear.wheel.toe_deg=-0.1:0.4 \\
      'understeer_gradient=2.5 deg/g' 'toe_rear=0.2 deg' --out out/tuned.yaml
  mbd tune light_car chassis.mass=1000:1500 'iso7401_step.yaw_rate_response_time=0.25 s'
KEY is one of the vehicle file, in the unit that it has there (as --set vehicle.KEY); FIGURE is one of
mbd info VEHICLE --json (understeer_gradient, roll_gradient, bounce_frequency, ...), or EVALUATION.FIGURE of
mbd maneuver; the target has its unit."""
START = 'vehicle: {}\nstart: {{kind: equilibrium}}\nduration: 1\n'


def add(parsers: Any) -> None:
    """Declare the command."""
    help_ = 'find values of parameters, within bounds, that give a vehicle wanted figures'
    parser = declare(parsers, 'tune', run, help_, EXAMPLE)
    vehicle = parser.add_argument(
        'vehicle', metavar='VEHICLE', help='path of a vehicle file, or a name in config/vehicles'
    )
    offer(vehicle, names_of('vehicles'), files=True)
    parser.add_argument('given', metavar='KEY=LOW:HIGH | FIGURE=TARGET', nargs='+', help='at least one of each')
    parser.add_argument(
        '--out', metavar='FILE', type=Path, help='vehicle file with what was found (default: out/VEHICLE_tuned.yaml)'
    )
    parser.add_argument(
        '--tolerance',
        metavar='PERCENT',
        type=float,
        default=1.0,
        help='by which a target may be missed, of the target (of one that is 0: of the figure as given; default: 1)',
    )


class Wanted(NamedTuple):
    """A target as given. evaluation: '' for a figure of mbd info."""

    evaluation: str
    name: str
    text: str

    @property
    def label(self) -> str:
        """Its name, as it was given."""
        return f'{self.evaluation}.{self.name}' if self.evaluation else self.name


class Car:
    """The figures of a vehicle with other values of its keys. file: of the vehicle."""

    def __init__(self, file: Path, wanted: Sequence[Wanted], scratch: Path) -> None:
        from solver.files.naming import included

        self.file, self.wanted, self.scratch = file, wanted, scratch
        self.text, self.name = START.format(included(file)), file.stem
        self.units: dict[str, tuple[str, str, float]] = {}  # label -> SI unit, unit for people, factor to it
        self.texts: dict[str, str] = {}
        self.count = 0

    def figures(self, values: Mapping[str, float]) -> dict[str, float]:
        """Label -> figure [SI]. Raises MbdError for one that is missing."""
        from mbd_sim_ros import interrupts
        from mbd_sim_ros.analysis.vehicle_figures import unit_of, vehicle_figures
        from solver import load_scene_text
        from solver.analysis.typical_values import TEXTS

        interrupts.check()
        self.count += 1
        overrides = [f'vehicle.{key}={value!r}' for key, value in values.items()]
        found: dict[str, float] = {}
        names = [one.name for one in self.wanted if not one.evaluation]
        if names:
            known, failed = vehicle_figures(load_scene_text(self.text, self.name, overrides), names)
            for name in names:
                if name in failed:
                    raise SpecError(f'{self.name}: no figure {name}: {failed[name]}')
                found[name], self.units[name] = known[name], (unit_of(name), *TEXTS[name][1:])
                self.texts[name] = TEXTS[name][0]
        for evaluation in dict.fromkeys(one.evaluation for one in self.wanted if one.evaluation):
            found |= self._evaluated(evaluation, overrides)
        return found

    def _evaluated(self, name: str, overrides: Sequence[str]) -> dict[str, float]:
        """Figures of an evaluation, of the maneuver that is driven for it."""
        from mbd_sim_ros.analysis.evaluation import judging
        from mbd_sim_ros.analysis.evaluation.driving import Driving
        from mbd_sim_ros.analysis.evaluation.figures import SHOWN
        from mbd_sim_ros.analysis.evaluation.variants import Variant

        (evaluation,) = judging.called(name)
        places, _ = Driving(str(self.file), self.scratch, overrides).drive(evaluation)
        results = []
        for place in places:
            recording, held, scene = judging.read(place)
            results.append(judging.judge(evaluation, recording, str(place), {}, held=held, scene=scene))
        known = {figure.name: figure for figure in Variant(self.name, tuple(results)).figures(evaluation.name)}
        found = {}
        for one in self.wanted:
            if one.evaluation != name:
                continue
            if one.name not in known:
                raise SpecError(f'{one.label}: {name} has found no such figure{suggestion(one.name, known)}')
            figure = known[one.name]
            if not math.isfinite(figure.value):
                raise SpecError(f'{one.label}: {name} finds no value of it for {self.name}')
            found[one.label] = figure.value
            self.units[one.label] = (figure.unit, *SHOWN.get(figure.unit, (figure.unit.removeprefix('1'), 1.0)))
            self.texts[one.label] = figure.text
        return found


def run(args: argparse.Namespace) -> Result:
    """Read what is wanted, search, write the vehicle."""
    from mbd_sim_ros import compiling, interrupts
    from mbd_sim_ros.analysis.tuning import Target, Tuning
    from mbd_sim_ros.analysis.vehicle_figures import in_si
    from solver import load_scene_text
    from solver.files.scene import find_file
    from solver.validate import finite

    share = finite('mbd tune', '--tolerance', args.tolerance, low=0.0, strict=True) / 100.0
    file = find_file(args.vehicle, 'vehicles')
    bounds, wanted = parted(args.given)
    keys, units = keys_of_vehicle(file, bounds)
    with interrupts.scratch('mbd-tune-') as scratch:
        car = Car(file, wanted, scratch)
        compiling.tell(not args.json, load_scene_text(car.text, car.name).model)
        interrupts.now(f'tuning {file.stem}')
        given = car.figures({})  # of the vehicle as it is: a wrong figure or unit is told before anything is searched
        targets = []
        for one in wanted:
            value = in_si(one.label, one.text, *car.units[one.label])
            tolerance = share * abs(value or given[one.label])
            targets.append(Target(one.label, value, tolerance or share))
        found = Tuning(keys, targets, car.figures, given).run()
    return _said(args, file, car, keys, units, targets, given, found)


def parted(given: Sequence[str]) -> tuple[dict[str, tuple[float, float]], list[Wanted]]:
    """(bounds of keys, targets) of the arguments. Raises SpecError."""
    from mbd_sim_ros.analysis.evaluation.judging import called
    from mbd_sim_ros.analysis.vehicle_figures import unit_of

    bounds: dict[str, tuple[float, float]] = {}
    wanted: dict[str, Wanted] = {}
    for text in given:
        name, equals, value = (part.strip() for part in text.partition('='))
        if not (name and equals and value):
            raise SpecError(f'{text}: write it as KEY=LOW:HIGH or FIGURE=TARGET')
        if name in wanted or name.removeprefix('vehicle.') in bounds:
            raise SpecError(f'{text}: {name} is given twice; keep one of them')
        if ':' in value:
            name = name.removeprefix('vehicle.')
            ends = value.split(':')
            try:
                low, high = (float(end) for end in ends)
            except ValueError:
                low = high = math.nan
            if not (math.isfinite(low) and math.isfinite(high)):
                raise SpecError(f'{text}: the bounds must be two numbers, LOW:HIGH, in the unit of the vehicle file')
            if not low < high:
                remedy = f'write {name}={ends[1]}:{ends[0]}' if high < low else 'a key that shall not change needs none'
                raise SpecError(f'{text}: the low bound must be below the high one; {remedy}')
            bounds[name] = (low, high)
            continue
        evaluation, dot, figure = name.partition('.')
        if dot and '.' not in figure and '[' not in name:
            found = called(evaluation)  # a wrong name is told here
            if len(found) > 1:
                raise SpecError(f'{text}: {evaluation} has several maneuvers; take one of {_names(found)}')
            wanted[name] = Wanted(found[0].name, figure, value)
        elif dot or '[' in name:
            raise SpecError(f'{text}: {name} is no figure; for a key of the vehicle give bounds, {name}=LOW:HIGH')
        else:
            unit_of(name)
            wanted[name] = Wanted('', name, value)
    if not bounds:
        raise SpecError('mbd tune: nothing may change; give a key of the vehicle with bounds, KEY=LOW:HIGH')
    if not wanted:
        raise SpecError('mbd tune: nothing is wanted; give a figure with its target, e.g. "roll_gradient=4 deg/g"')
    return bounds, list(wanted.values())


def _names(found: Sequence[Any]) -> str:
    return ', '.join(one.name for one in found)


def keys_of_vehicle(file: Path, bounds: Mapping[str, tuple[float, float]]) -> tuple[list[Key], dict[str, str]]:
    """(keys with their values in the file, their units). Both bounds of each are tried, so that a wrong name or an
    impossible value is told before the search. Raises SceneError and SpecError."""
    from mbd_sim_ros.analysis.tuning import Key
    from solver.files.naming import included
    from solver.files.scene import load_scene_and_units

    tree = _tree(file)
    keys, units = [], {}
    for name, (low, high) in bounds.items():
        start = _value(tree, name, file)
        try:
            for end in (low, high):
                _, known = load_scene_and_units(START.format(included(file)), file.stem, [f'vehicle.{name}={end!r}'])
        except MbdError as error:
            raise SceneError(f'{name}={low:g}:{high:g}: {str(error).removeprefix(f"--set vehicle.{name}: ")}') from None
        units[name] = known.get(f'vehicle.{name}', '') or known.get(f'vehicle.{name.partition("[")[0]}', '')
        keys.append(Key(name, low, high, start))
    return keys, units


def _tree(file: Path) -> Any:
    """The vehicle file with all that it includes, as mappings, lists and numbers."""
    import yaml

    from solver.files.scene import config_directories
    from solver.files.yaml_tree import read, text_of

    return yaml.safe_load(text_of(read(file, config_directories())))


def _value(tree: Any, name: str, file: Path) -> float | None:
    """The number under a key, None where the file has none."""
    from solver.files.overrides import keys_of

    for key in keys_of(name):
        if isinstance(tree, list) and key.isdigit() and int(key) < len(tree):
            tree = tree[int(key)]
        elif isinstance(tree, dict) and key in tree:
            tree = tree[key]
        else:
            return None
    if isinstance(tree, bool) or not isinstance(tree, int | float):
        what = f'a list of {len(tree)}; take one of its items, {name}[0]' if isinstance(tree, list) else 'no number'
        raise SceneError(f'{file}: {name} is {what}')
    return float(tree)


def vehicle_text(file: Path, values: Mapping[str, float], about: Sequence[str]) -> str:
    """A vehicle file that takes another one and changes the values of some keys; where that does not give the same
    vehicle, all of it."""
    import yaml

    from solver import load_scene_text
    from solver.files.naming import included
    from solver.files.overrides import keys_of, override
    from solver.files.scene import config_directories
    from solver.files.yaml_tree import read, text_of

    tree, changes = _tree(file), dict[str, Any]()
    for name, value in values.items():
        here, there = changes, tree
        path = keys_of(name)
        for k, key in enumerate(path):
            if k + 1 == len(path) or isinstance(there.get(key), list):
                break
            here, there = here.setdefault(key, {}), there.get(key, {})
        if k + 1 == len(path):
            here[key] = value
        else:  # a list is replaced as a whole
            items = here[key] = here.get(key) or there[key]
            for index in path[k + 1 : -1]:
                items = items[int(index) if isinstance(items, list) else index]
            items[int(path[-1]) if isinstance(items, list) else path[-1]] = value
    base = f'vehicles/{file.name}' if _is_delivered(file) else included(file)
    head = ''.join(f'# {line}\n' for line in about)
    text = f'{head}<<: {base}\n{yaml.safe_dump(changes, sort_keys=False, width=140)}'
    overrides = [f'vehicle.{name}={value!r}' for name, value in values.items()]
    wanted = load_scene_text(START.format(included(file)), file.stem, overrides)
    short = START.format('\n' + ''.join(f'  {line}\n' for line in text.splitlines() if not line.startswith('#')))
    if load_scene_text(short, file.stem).model == wanted.model:
        return text
    root = read(file, config_directories())
    for name, value in values.items():
        override(root, f'{name}={value!r}', config_directories())
    return head + text_of(root)


def _is_delivered(file: Path) -> bool:
    """True for a vehicle that is found by its name from anywhere."""
    from solver.files.catalogue import files

    known = files('vehicles').get(file.stem)
    return known is not None and known.resolve() == file.resolve()


def _said(
    args: argparse.Namespace,
    file: Path,
    car: Car,
    keys: Sequence[Key],
    units: Mapping[str, str],
    targets: Sequence[Target],
    given: Mapping[str, float],
    found: Found,
) -> Result:
    """The object and the text; writes the vehicle file where the targets are reached."""
    from mbd_sim_ros.analysis.pages import write_text

    def shown(label: str, value: float) -> str:
        _, unit, factor = car.units[label]
        return f'{value * factor:.4g} {unit}'.rstrip()

    rows: list[tuple[str, ...]] = [('figure', 'as given', 'target', 'found', '')]
    for target in targets:
        near = abs(found.figures[target.name] - target.value) <= target.tolerance
        values = (given[target.name], target.value, found.figures[target.name])
        rows.append((target.name, *(shown(target.name, value) for value in values), '' if near else 'NOT REACHED'))
    changed: list[tuple[str, ...]] = [
        ('key', 'as given', 'bounds', 'found', 'unit', *(f'{target.name} per unit' for target in targets))
    ]
    slopes: dict[str, dict[str, float]] = {target.name: {} for target in targets}
    for k, key in enumerate(keys):
        per = []
        for i, target in enumerate(targets):
            slope = float(found.sensitivity[i, k])
            slopes[target.name][key.name] = slope
            _, unit, factor = car.units[target.name]
            per.append(f'{slope * factor:.3g} {unit}'.rstrip())
        start = '-' if key.start is None else f'{key.start:.6g}'
        at = f'{found.values[key.name]:.6g}'
        changed.append((key.name, start, f'{key.low:g} to {key.high:g}', at, units[key.name] or '-', *per))
    data: dict[str, Any] = {
        'status': 'ok' if found.reached else 'unreached',
        'vehicle': str(file),
        'values': found.values,
        'figures': {
            target.name: {
                'given': given[target.name],
                'target': target.value,
                'tolerance': target.tolerance,
                'found': found.figures[target.name],
                'unit': car.units[target.name][0],
                'reached': abs(found.figures[target.name] - target.value) <= target.tolerance,
                'per_unit': slopes[target.name],
            }
            for target in targets
        },
        'held_by': found.holding,
        'evaluations': car.count,
        'out': None,
    }
    lines = [table(rows), '', table(changed), '']
    if not found.reached:
        lines.append(f'{unreached(targets, keys, found, shown)} {car.count} evaluations.')
        return Result(data=data, text='\n'.join(lines), code=1)
    out = args.out or Path('out') / f'{file.stem}_tuned.yaml'
    about = [f'{file.stem}, tuned by mbd tune {args.vehicle} {" ".join(args.given)}']
    about += [f'{target.name}: {shown(target.name, found.figures[target.name])}' for target in targets]
    write_text(out, vehicle_text(file, found.values, about))
    data['out'] = str(out)
    lines.append(f'reached after {car.count} evaluations; the vehicle: {out}')
    return Result(data=data, text='\n'.join(lines))


def unreached(targets: Sequence[Target], keys: Sequence[Key], found: Found, shown: Any) -> str:
    """Sentence on targets that cannot be reached: the best values, and what holds them."""
    missed = [t for t in targets if abs(found.figures[t.name] - t.value) > t.tolerance]
    best = ', '.join(f'{t.name} {shown(t.name, found.figures[t.name])}' for t in missed)
    ends = {key.name: {'low': key.low, 'high': key.high} for key in keys}
    held = [f'{name}={ends[name][end]:g}' for name, end in found.holding.items()]
    if found.failures:
        why = f'beyond it there are no figures: {found.failures[0]}'
    elif held:
        why = f'held by the {"bounds" if len(held) > 1 else "bound"} {" and ".join(held)}'
    elif not _changes_any(found):
        why = 'none of the keys changes it'
    elif len(targets) > 1:
        why = 'no bound holds it: the targets contradict each other'
    else:
        why = 'no bound holds it: this is the extreme within the bounds'
    return f'NOT REACHED within the bounds: the best is {best}; {why}. No file is written.'


def _changes_any(found: Found) -> bool:
    """True where a key changes a target at all."""
    return bool((abs(found.sensitivity) > 0.0).any())
