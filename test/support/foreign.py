"""Stand-ins of message packages that no wheel offers, with the same names, fields and constants (interfaces/): the
generators of ROS make them real, so that they go over real topics, services and actions. Needs a C++ compiler; made
once and kept.

Sources of the fields: github.com/ros-drivers/ackermann_msgs, github.com/autowarefoundation/autoware_msgs,
github.com/ros-simulation/simulation_interfaces (2.1.0), github.com/ros2/geometry2.
"""

from __future__ import annotations

import fcntl
import functools
import hashlib
import importlib
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import pytest

DEFINITIONS = Path(__file__).parent / 'interfaces'
PREFIX = Path(sys.prefix)
SUPPORTS = ('typesupport_introspection_c', 'typesupport_fastrtps_c')
OTHERS = ('std_msgs', 'builtin_interfaces', 'geometry_msgs', 'service_msgs', 'action_msgs', 'unique_identifier_msgs')


def location() -> Path:
    """Where the packages are kept, by what they are made of."""
    found = hashlib.sha256(Path(__file__).read_bytes())
    for path in sorted(DEFINITIONS.rglob('*.*')):
        found.update(str(path.relative_to(DEFINITIONS)).encode() + path.read_bytes())
    base = Path(os.environ.get('XDG_CACHE_HOME', Path.home() / '.cache'))
    return base / 'mbd_sim_ros_tests' / f'foreign-{found.hexdigest()[:16]}-{sysconfig.get_config_var("SOABI")}'


def packages() -> Path:
    """The folder of the packages, for PYTHONPATH; skips the test where they cannot be made."""
    where = location()
    if where.is_dir():
        return where
    for module in ('rclpy', 'rosidl_generator_py', 'rosidl_typesupport_fastrtps_c', 'em'):
        pytest.importorskip(module, reason=f'needs ROS with its generators of messages: {module} is not installed')
    if shutil.which('g++') is None or not (PREFIX / 'include' / 'rosidl_runtime_c').is_dir():
        pytest.skip('needs a C++ compiler and the headers of ROS')
    where.parent.mkdir(parents=True, exist_ok=True)
    lock = (where.parent / 'foreign.lock').open('w')  # another process of tests may be at it
    with lock, tempfile.TemporaryDirectory(dir=where.parent) as scratch, pytest.MonkeyPatch.context() as patch:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if where.is_dir():
            return where
        made = Path(scratch) / 'packages'
        # seven generators read the same definitions, for a third of all the time
        parser = importlib.import_module('rosidl_parser.parser')
        patch.setattr(parser, 'get_ast_from_idl_string', functools.cache(parser.get_ast_from_idl_string))
        for name in (
            'ackermann_msgs',
            'autoware_control_msgs',
            'autoware_vehicle_msgs',
            'simulation_interfaces',
            'tf2_msgs',
        ):
            make(name, Path(scratch) / name, made)
        made.replace(where)
    return where


def make(name: str, scratch: Path, out: Path) -> None:
    """Generate and compile one package."""
    idl = [convert(name, source, scratch / 'idl') for source in sorted((DEFINITIONS / name).rglob('*.*'))]
    include = [
        f'{p.name}:{p}'
        for p in (PREFIX / 'share').iterdir()
        if any((p / kind).is_dir() for kind in ('msg', 'srv', 'action'))
    ]
    given = {
        'package_name': name,
        'idl_tuples': [f'{scratch}/idl:{path}' for path in idl],
        'include_paths': include,
        'ros_interface_dependencies': [],
        'target_dependencies': [],
        'type_description_tuples': [],
    }
    generate('generator_type_description', 'generate_type_hash', given, scratch / 'hash')
    given['type_description_tuples'] = [f'{path}:{scratch}/hash/{path.removesuffix(".idl")}.json' for path in idl]
    for part, function, more in (
        ('generator_c', 'generate_c', ()),
        ('typesupport_introspection_c', 'generate_c', ()),
        ('typesupport_fastrtps_c', 'generate_typesupport_fastrtps_c', ()),
        ('typesupport_c', 'generate_c', ([f'rosidl_{part}' for part in SUPPORTS],)),
        ('generator_py', 'generate_py', (['rosidl_typesupport_c'],)),
    ):
        generate(part, function, given, scratch / part / name, *more)
    modules = scratch / 'generator_py' / name
    shutil.copytree(modules, out / name, ignore=lambda _, names: [n for n in names if n.endswith('.c')])
    (out / name / '__init__.py').touch()
    compile_all(name, scratch, out / name)


def convert(name: str, source: Path, out: Path) -> str:
    """The IDL of a definition; returns its path in the package."""
    kind = source.suffix[1:]
    to_idl = getattr(importlib.import_module(f'rosidl_adapter.{kind}'), f'convert_{kind}_to_idl')
    (out / kind).mkdir(parents=True, exist_ok=True)
    with open(os.devnull, 'w', encoding='utf-8') as nothing:
        stdout, sys.stdout = sys.stdout, nothing  # it tells what it reads
        try:
            to_idl(DEFINITIONS / name, name, Path(kind) / source.name, out / kind)
        finally:
            sys.stdout = stdout
    return f'{kind}/{source.stem}.idl'


def generate(generator: str, function: str, given: dict, out: Path, *more: list[str]) -> None:
    """Run a generator of ROS."""
    arguments = out.parent / f'{generator}.json'
    out.mkdir(parents=True, exist_ok=True)
    templates = PREFIX / 'share' / f'rosidl_{generator}' / 'resource'
    arguments.write_text(json.dumps({**given, 'output_dir': str(out), 'template_dir': str(templates)}))
    getattr(importlib.import_module(f'rosidl_{generator}'), function)(str(arguments), *more)


def compile_all(name: str, sources: Path, out: Path) -> None:
    """The libraries of a package, and the module that Python imports, which finds them beside itself."""
    for part, macro in (('rosidl_generator_c', 'ROSIDL_GENERATOR_C'),
    ('rosidl_typesupport_fastrtps_c', 'ROSIDL_TYPESUPPORT_FASTRTPS_C'),
                        ('rosidl_typesupport_introspection_c', 'ROSIDL_TYPESUPPORT_INTROSPECTION_C')):  # fmt: skip
        header = sources / 'generator_c' / name / 'msg' / f'{part}__visibility_control.h'
        header.parent.mkdir(exist_ok=True)
        header.write_text(''.join(f'#define {macro}_{way}_{name}\n' for way in ('PUBLIC', 'IMPORT', 'EXPORT')))
    suffix = sysconfig.get_config_var('SOABI')
    libraries = {part: f'lib{name}__rosidl_{part}.so' for part in ('generator_c', *SUPPORTS)}
    libraries['module'] = f'{name}_s__rosidl_typesupport_c.{suffix}.so'
    for part, library in libraries.items():
        folders = [sources / folder for folder in (('typesupport_c', 'generator_py') if part == 'module' else (part,))]
        objects = [unit for folder in folders for unit in compiled(name, folder, sources)]
        link = [
            f'-L{out}',
            f'-L{PREFIX / "lib"}',
            '-Wl,-rpath,$ORIGIN',
            f'-Wl,-rpath,{PREFIX / "lib"}',
            '-Wl,--no-as-needed',
        ]
        link += [f'-l:{other}' for other in list(libraries.values())[:-1] if (out / other).exists()]
        link += [
            f'-l{other}'
            for other in (
                'fastcdr',
                'rosidl_runtime_c',
                'rmw',
                'rcutils',
                *(f'rosidl_{p}' for p in ('typesupport_c', *SUPPORTS)),
            )
        ]
        link += [
            f'-l{other}__rosidl_{p}'
            for other in OTHERS
            for p in ('generator_c', 'generator_py', 'typesupport_c', *SUPPORTS)
        ]
        subprocess.run(
            ['g++', '-shared', f'-Wl,-soname,{library}', '-o', out / library, *objects, *link],
            check=True,
            capture_output=True,
            text=True,
        )


def compiled(name: str, folder: Path, sources: Path) -> list[Path]:
    """Objects of all sources in a folder, as few as can be."""
    numpy = importlib.import_module('numpy').get_include()
    headers = [p for p in (PREFIX / 'include').iterdir() if p.is_dir()]
    include = [
        *(p for p in sources.iterdir() if p.is_dir()),
        PREFIX / 'include',
        sysconfig.get_paths()['include'],
        numpy,
        *headers,
    ]
    flags = ['-O0', '-fPIC', '-w', *(f'-I{path}' for path in include)]
    objects = []
    for suffix, compiler in (('c', ['gcc', '-std=c11']), ('cpp', ['g++', '-std=c++17'])):
        found = sorted((folder / name).rglob(f'*.{suffix}'))
        alone = [path for path in found if path.stem.endswith('__description')]  # they name private things alike
        together = folder / f'all.{suffix}'
        together.write_text(''.join(f'#include "{path}"\n' for path in found if path not in alone))
        for unit in [*([together] if found else []), *alone]:
            objects.append(unit.with_suffix(f'.{suffix}.o'))
            subprocess.run(
                [*compiler, *flags, '-c', unit, '-o', objects[-1]], check=True, capture_output=True, text=True
            )
    return objects
