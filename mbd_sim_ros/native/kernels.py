"""Kernels outside of this process: their names, and object code for a linker.

The name of a kernel is a digest of what its code is made of (solver.compiled.contents): the same in every process and
for every processor, and another one as soon as the code or the layout of its arguments is another. So a model finds the
kernels it was made for in a library, or is refused. Object code is emitted from the optimised code that numba keeps for
callers, without the entries for Python, which are all that needs an interpreter.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numba

from solver import disk
from solver.compiled.contents import contents
from solver.compiled.kernel import optimised
from solver.compiled.target import V3
from solver.elements.registry import CONSTRAINTS, FORCES
from solver.linear.elimination import factorize, solve
from solver.step.augmented_lagrangian import advance, perform
from solver.step.constraint_coefficients import weigh
from solver.step.extrapolation import extrapolate
from solver.step.interval import advance_adapting

# Parts of a module as LLVM writes it: entries for Python, names, functions that several modules have, and data.
PYTHON_ENTRY = re.compile(r'^define [^\n]*@_ZN7cpython.*?^}\n', re.MULTILINE | re.DOTALL)
GLOBAL_NAME = re.compile(r'@(?:"[^"\n]*"|[\w.$-]+)')
SHARED = re.compile(r'^define linkonce_odr\b', re.MULTILINE)
NUMBER = re.compile(r'B\d+v(\d+)(?=B\d+c8tJT)')  # as numba mangles it: behind its length
DATA = re.compile(rf'^({GLOBAL_NAME.pattern}) = .*\n', re.MULTILINE)


class Target(NamedTuple):
    """A processor to emit code for. name: as commands say it. processor, features: as LLVM says them."""

    name: str
    processor: str
    features: str


class Kernel(NamedTuple):
    """A compiled kernel. name: the same everywhere. result: numba's record of it."""

    name: str
    result: Any

    @property
    def symbol(self) -> str:
        """Its symbol in object code."""
        return f'mbd_{re.sub("[^A-Za-z0-9_]", "_", self.name)}'


def target(name: str) -> Target:
    """The target `v3` (every x86-64 processor with AVX2 and FMA) or `host` (this processor)."""
    if name == 'v3':
        return Target('v3', *V3)
    return Target('host', llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten())


def compiled() -> dict[int, Kernel]:
    """Every kernel that a step may call and that is compiled in this process: address -> kernel."""
    found = {}
    for dispatcher in _called():
        for arguments, result in dispatcher.overloads.items():
            address = result.library.get_pointer_to_function(result.fndesc.llvm_func_name)
            found[address] = Kernel(name_of(dispatcher, arguments), result)
    return found


def name_of(dispatcher: Any, arguments: tuple) -> str:
    """The name of a kernel for these types of arguments."""
    digest, _ = contents(dispatcher, arguments)
    return f'{dispatcher.__module__.removeprefix("solver.")}.{dispatcher.__name__}-{digest.hex()}'


def _called() -> Iterator[Any]:
    """The kernels that are called by address, and those that begin a step."""
    for kind in FORCES:
        yield kind.kernel
    for constraint in CONSTRAINTS:
        yield constraint.residuals
        yield constraint.hessians
    yield from (factorize, solve, perform, weigh, extrapolate, advance, advance_adapting)


def object_code(kernel: Kernel, wanted: Target, store: disk.Store) -> bytes:
    """Position-independent object code of a kernel for a target, in ELF; kept in the store."""
    surroundings = (wanted.processor, wanted.features, llvm.llvm_version_info, numba.__version__)
    identity = disk.digest(kernel.name, repr(surroundings))
    name = f'{kernel.name[:150]}-{identity.hex()}'
    code = store.read(name, identity)
    if code is None:
        code = _emitted(kernel, wanted)
        with suppress(OSError):  # it is emitted anew then
            store.write(name, code, identity)
    return code


def _emitted(kernel: Kernel, wanted: Target) -> bytes:
    module = llvm.parse_assembly(_alone(kernel))
    module.get_function(kernel.symbol).linkage = 'external'
    machine = llvm.Target.from_triple(module.triple).create_target_machine(
        cpu=wanted.processor, features=wanted.features, opt=3, reloc='pic', codemodel='default'
    )
    return machine.emit_object(module)


def _alone(kernel: Kernel) -> str:
    """The optimised code of a kernel, without what a process of Python leaves in it.

    numba numbers its symbols in the order in which a process compiles: here they have the order in which they are
    named. Data that nobody uses is text that names them, for the entries for Python. Other functions in the module
    become its own, so that what two kernels share does not depend on which process compiled them. The same code gives
    the same bytes then.
    """
    code = SHARED.sub('define internal', PYTHON_ENTRY.sub('', optimised(kernel.result)))
    code = re.sub(rf'@{re.escape(kernel.result.fndesc.llvm_func_name)}(?![\w.$-])', f'@{kernel.symbol}', code)
    order: dict[str, int] = {}
    code = NUMBER.sub(lambda found: f'B_v{order.setdefault(found[1], len(order))}', code)
    uses = Counter(GLOBAL_NAME.findall(code))
    return DATA.sub(lambda line: line[0] if uses[line[1]] > 1 else '', code)


def addresses(kernels: Mapping[int, Kernel]) -> tuple[dict[int, int], list[str]]:
    """(address -> index, names by index) of kernels, for mbd_sim_ros.native.image."""
    names = sorted({kernel.name for kernel in kernels.values()})
    index = {name: k for k, name in enumerate(names)}
    return {address: index[kernel.name] for address, kernel in kernels.items()}, names
