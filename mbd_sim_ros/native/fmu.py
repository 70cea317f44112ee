"""A scene as a unit of co-simulation, FMI 2.0 or 3.0: an archive with a description, the library and the model."""

from __future__ import annotations

import re
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from mbd_sim_ros.native import library
from mbd_sim_ros.native.channels import ACCOUNT_UNITS, Channel
from mbd_sim_ros.native.kernels import Target
from mbd_sim_ros.native.model import COUNTERS, LARGEST, MAGIC, native
from solver.disk import atomic_write
from solver.inputs.command_filter import BANDWIDTH, COMMANDS, RATE_LIMIT
from solver.inputs.maneuver import is_motion_part
from solver.simulation import Simulation

PLATFORM = {2: 'linux64', 3: 'x86_64-linux'}  # directory of binaries
DATE = (1980, 1, 1, 0, 0, 0)  # of all files in an archive, so that the same scene gives the same archive
# What the units of either version can do.
ABILITY_2 = {
    'canHandleVariableCommunicationStepSize': 'true', 'canNotUseMemoryManagementFunctions': 'true',
    'canGetAndSetFMUstate': 'true', 'canSerializeFMUstate': 'true', 'maxOutputDerivativeOrder': '0',
    'providesDirectionalDerivative': 'false',
}  # fmt: skip
ABILITY_3 = {
    'canGetAndSetFMUState': 'true', 'canSerializeFMUState': 'true', 'canHandleVariableCommunicationStepSize': 'true',
}  # fmt: skip
STEERING = COMMANDS[0]
# Exponents of kg, m, s, K, rad in units that are products of others.
BASES = {
    '1': {}, 'kg': {'kg': 1}, 'm': {'m': 1}, 's': {'s': 1}, 'K': {'K': 1}, 'rad': {'rad': 1}, 'Hz': {'s': -1},
    'N': {'kg': 1, 'm': 1, 's': -2}, 'J': {'kg': 1, 'm': 2, 's': -2}, 'W': {'kg': 1, 'm': 2, 's': -3},
    'Pa': {'kg': 1, 'm': -1, 's': -2},
}  # fmt: skip


class Variable(NamedTuple):
    """A variable of a description. reference: its value reference. start: where it can be set."""

    name: str
    reference: int
    unit: str
    causality: str
    variability: str
    start: float | None = None
    text: str = ''


def write(simulation: Simulation, file: Path, wanted: Target, *, version: int = 2, program: str = '') -> int:
    """Write the scene of a simulation as an archive for FMI `version` (2 or 3); returns its size [bytes].

    program: the version of this package. Raises SpecError, by name, for what lives in Python, MbdError, and OSError.
    """
    made = native(simulation, program)
    identifier = re.sub(r'\W', '_', simulation.scene.name)
    identifier = identifier if identifier[:1].isalpha() else f'mbd_{identifier}'
    with tempfile.TemporaryDirectory() as folder:
        binary = Path(folder) / f'{identifier}.so'
        library.build(made.kernels, wanted, binary, sources=('fmi.c',), exported=(f'fmi{version}*',))
        code = binary.read_bytes()
    token = made.content[len(MAGIC) : len(MAGIC) + 16].hex()  # half of the digest, as fmi.c has it
    variables = list(_variables(simulation, made.channels))
    parts = {
        'modelDescription.xml': description(version, simulation, identifier, token, variables, program).encode(),
        f'binaries/{PLATFORM[version]}/{identifier}.so': code,
        'resources/model.mbd': made.content,
    }
    with atomic_write(file) as part, zipfile.ZipFile(part, 'w', zipfile.ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            entry = zipfile.ZipInfo(name, DATE)
            entry.external_attr = (0o755 if name.endswith('.so') else 0o644) << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, content)
    return file.stat().st_size


def _variables(simulation: Simulation, channels: Iterable[Channel]) -> Iterator[Variable]:
    """Variables in the order of value references, as mbd.c and fmi.c number them."""
    names = simulation.channels.inputs
    k = -1
    for k, c in enumerate(channels):
        filtered = STEERING in names and c.name.startswith(STEERING) and is_motion_part(c.name, names)
        if c.input and filtered and c.name != STEERING:
            yield Variable(c.name, k, c.unit, 'local', 'continuous', text='of the steering wheel, behind the filter')
        elif c.input:
            text = 'command, which passes a filter' if filtered else 'follows the maneuver of the scene until it is set'
            yield Variable(c.name, k, c.unit, 'input', 'continuous', c.start, text)
        else:
            yield Variable(c.name, k, c.unit, 'output', 'continuous')
    for name, unit in ACCOUNT_UNITS.items():
        yield Variable(f'account/{name}', k := k + 1, unit, 'local', 'discrete', text='of the running account')
    for name in COUNTERS:
        yield Variable(name, k := k + 1, '1', 'local', 'discrete', text='so far')
    for name, unit in LARGEST.items():
        yield Variable(name, k := k + 1, unit, 'local', 'discrete', text='so far')
    if STEERING in names:
        text = 'of the filter of steering commands'
        yield Variable('steering_filter/bandwidth', k + 1, 'Hz', 'parameter', 'tunable', BANDWIDTH, text)
        yield Variable('steering_filter/rate_limit', k + 2, 'rad/s', 'parameter', 'tunable', RATE_LIMIT, text)
    yield Variable('time', k + 3, 's', 'independent', 'continuous')
    text = 'of the verdict so far, which go to the log at the end of a run; 0 is ok'
    yield Variable('findings', k + 4, '1', 'local', 'discrete', text=text)


def exponents(unit: str) -> dict[str, int] | None:
    """Exponents of the base units in a unit such as 'N m/rad' or 'm/s^2'; None where it is no product of known ones."""
    found: dict[str, int] = {}
    above, *below = unit.split('/')
    for sign, factors in ((1, above), *((-1, part) for part in below)):
        for factor in factors.split():
            name, _, power = factor.partition('^')
            if name not in BASES or not (power or '1').isdigit():
                return None
            for base, exponent in BASES[name].items():
                found[base] = found.get(base, 0) + sign * exponent * int(power or 1)
    return {base: exponent for base, exponent in found.items() if exponent}


def _units(variables: Iterable[Variable]) -> Iterator[str]:
    for unit in sorted({v.unit for v in variables if v.unit}):
        bases = exponents(unit)
        inner = '/>' if bases is None else f'><BaseUnit{_attributes(bases)}/></Unit>'
        yield f'<Unit name={quoteattr(unit)}{inner}'


def _attributes(values: Mapping[str, object]) -> str:
    return ''.join(f' {name}={quoteattr(str(value))}' for name, value in values.items() if value not in ('', None))


def description(
    version: int, simulation: Simulation, identifier: str, token: str, variables: list[Variable], program: str = ''
) -> str:
    """modelDescription.xml of FMI `version` (2 or 3)."""
    scene = simulation.scene
    head = {
        'fmiVersion': f'{version}.0', 'modelName': scene.name, 'description': scene.title or scene.name,
        'version': program, 'generationTool': f'mbd_sim_ros {program}'.strip(), 'variableNamingConvention': 'flat',
    }  # fmt: skip
    if version == 2:
        head['guid'], ability, lines, structure = token, ABILITY_2, map(_variable2, variables), _structure2(variables)
    else:
        head['instantiationToken'] = token
        ability, lines, structure = ABILITY_3, map(_variable3, variables), _structure3(variables)
    stop = repr(scene.steps * simulation.h_ns * 1e-9)
    parts = (
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription{_attributes(head)}>',
        f'<CoSimulation{_attributes({"modelIdentifier": identifier} | ability)}/>',
        '<UnitDefinitions>', *_units(variables), '</UnitDefinitions>',
        '<LogCategories><Category name="errors"/><Category name="verdict"/><Category name="events"/></LogCategories>',
        f'<DefaultExperiment startTime="0" stopTime="{stop}" stepSize="{simulation.h!r}"/>',
        '<ModelVariables>', *lines, '</ModelVariables>',
        f'<ModelStructure>{structure}</ModelStructure>',
        '</fmiModelDescription>\n',
    )  # fmt: skip
    return '\n'.join(parts)


def _described(v: Variable) -> dict[str, object]:
    return {
        'name': v.name, 'valueReference': v.reference, 'description': v.text, 'causality': v.causality,
        'variability': v.variability,
    }  # fmt: skip


def _number(v: Variable) -> dict[str, object]:
    return {'unit': v.unit, 'start': None if v.start is None else repr(v.start)}


def _variable2(v: Variable) -> str:
    return f'<ScalarVariable{_attributes(_described(v))}><Real{_attributes(_number(v))}/></ScalarVariable>'


def _variable3(v: Variable) -> str:
    return f'<Float64{_attributes(_described(v) | _number(v))}/>'


def _structure2(variables: Iterable[Variable]) -> str:
    """Outputs by their place among the variables, from 1 on. They are of the end of a step, and inputs act in the next
    one: no output depends on an input at the same instant."""
    outputs = [k for k, v in enumerate(variables, 1) if v.causality == 'output']
    unknowns = ''.join(f'<Unknown index="{k}" dependencies=""/>' for k in outputs)
    return f'<Outputs>{unknowns}</Outputs><InitialUnknowns>{unknowns}</InitialUnknowns>' if unknowns else ''


def _structure3(variables: Iterable[Variable]) -> str:
    """Outputs by their value references; see _structure2()."""
    outputs = [v.reference for v in variables if v.causality == 'output']
    kinds = ('Output', 'InitialUnknown')
    return ''.join(f'<{kind} valueReference="{at}" dependencies=""/>' for kind in kinds for at in outputs)
