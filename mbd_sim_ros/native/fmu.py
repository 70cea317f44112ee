"""A scene as a unit of co-simulation, FMI 2.0 or 3.0: an archive with a description, the library and the model."""

from __future__ import annotations

import re
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from mbd_sim_ros.native import library
from mbd_sim_ros.native.channels import ACCOUNT_UNITS
from mbd_sim_ros.native.kernels import Target
from mbd_sim_ros.native.model import BANDWIDTH, COUNTERS, LARGEST, RATE_LIMIT, native
from solver.disk import atomic_write
from solver.inputs.maneuver import is_motion_part
from solver.simulation import Simulation

PLATFORM = {2: 'linux64', 3: 'x86_64-linux'}  # directory of binaries
DATE = (1980, 1, 1, 0, 0, 0)  # of all files in an archive, so that the same scene gives the same archive
STEERING = 'steering'
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
    token = made.content[16:32].hex()
    variables = list(_variables(simulation, made.channels))
    describe = description2 if version == 2 else description3
    parts = {
        'modelDescription.xml': describe(simulation, identifier, token, variables, program).encode(),
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


def _variables(simulation: Simulation, channels: Iterable) -> Iterator[Variable]:
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
        inner = '' if bases is None else f'<BaseUnit{_attributes(bases)}/>'
        yield f'<Unit name={quoteattr(unit)}>{inner}</Unit>' if inner else f'<Unit name={quoteattr(unit)}/>'


def _attributes(values: dict) -> str:
    return ''.join(f' {name}={quoteattr(str(value))}' for name, value in values.items() if value not in ('', None))


def _head(simulation: Simulation, version: str, program: str) -> dict[str, str]:
    scene = simulation.scene
    return {
        'fmiVersion': version, 'modelName': scene.name, 'description': scene.title or scene.name, 'version': program,
        'generationTool': f'mbd_sim_ros {program}'.strip(), 'variableNamingConvention': 'flat',
    }  # fmt: skip


def _experiment(simulation: Simulation) -> str:
    stop = repr(simulation.scene.steps * simulation.h_ns * 1e-9)
    return f'<DefaultExperiment startTime="0" stopTime="{stop}" stepSize="{simulation.h!r}"/>'


def description2(
    simulation: Simulation, identifier: str, token: str, variables: list[Variable], program: str = ''
) -> str:
    """modelDescription.xml of FMI 2.0."""
    head = _head(simulation, '2.0', program) | {'guid': token}
    ability = {
        'modelIdentifier': identifier, 'canHandleVariableCommunicationStepSize': 'true',
        'canNotUseMemoryManagementFunctions': 'true', 'canGetAndSetFMUstate': 'true', 'canSerializeFMUstate': 'true',
        'maxOutputDerivativeOrder': '0', 'providesDirectionalDerivative': 'false',
    }  # fmt: skip
    lines = []
    for v in variables:
        of_variable = {
            'name': v.name, 'valueReference': v.reference, 'description': v.text, 'causality': v.causality,
            'variability': v.variability,
        }  # fmt: skip
        number = {'unit': v.unit, 'start': None if v.start is None else repr(v.start)}
        lines.append(f'<ScalarVariable{_attributes(of_variable)}><Real{_attributes(number)}/></ScalarVariable>')
    unknowns = [f'<Unknown index="{k + 1}"/>' for k, v in enumerate(variables) if v.causality == 'output']
    structure = f'<Outputs>{"".join(unknowns)}</Outputs><InitialUnknowns>{"".join(unknowns)}</InitialUnknowns>'
    return _document(
        f'<fmiModelDescription{_attributes(head)}>',
        f'<CoSimulation{_attributes(ability)}/>',
        '<UnitDefinitions>', *_units(variables), '</UnitDefinitions>',
        '<LogCategories><Category name="errors"/><Category name="events"/></LogCategories>',
        _experiment(simulation),
        '<ModelVariables>', *lines, '</ModelVariables>',
        f'<ModelStructure>{structure if unknowns else ""}</ModelStructure>',
        '</fmiModelDescription>',
    )  # fmt: skip


def description3(
    simulation: Simulation, identifier: str, token: str, variables: list[Variable], program: str = ''
) -> str:
    """modelDescription.xml of FMI 3.0."""
    head = _head(simulation, '3.0', program) | {'instantiationToken': token}
    ability = {
        'modelIdentifier': identifier, 'canGetAndSetFMUState': 'true', 'canSerializeFMUState': 'true',
        'canHandleVariableCommunicationStepSize': 'true',
    }  # fmt: skip
    lines = []
    for v in variables:
        of_variable = {
            'name': v.name, 'valueReference': v.reference, 'description': v.text, 'causality': v.causality,
            'variability': v.variability, 'unit': v.unit, 'start': None if v.start is None else repr(v.start),
        }  # fmt: skip
        lines.append(f'<Float64{_attributes(of_variable)}/>')
    outputs = [v for v in variables if v.causality == 'output']
    structure = [f'<Output valueReference="{v.reference}"/>' for v in outputs]
    structure += [f'<InitialUnknown valueReference="{v.reference}"/>' for v in outputs]
    return _document(
        f'<fmiModelDescription{_attributes(head)}>',
        f'<CoSimulation{_attributes(ability)}/>',
        '<UnitDefinitions>', *_units(variables), '</UnitDefinitions>',
        '<LogCategories><Category name="errors"/><Category name="events"/></LogCategories>',
        _experiment(simulation),
        '<ModelVariables>', *lines, '</ModelVariables>',
        f'<ModelStructure>{"".join(structure)}</ModelStructure>',
        '</fmiModelDescription>',
    )  # fmt: skip


def _document(*lines: str) -> str:
    return '\n'.join(('<?xml version="1.0" encoding="UTF-8"?>', *lines, ''))
