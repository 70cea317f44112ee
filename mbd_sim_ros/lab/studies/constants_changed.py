"""A process in which one constant of the solver has another value. Run it as a module: MODULE NAME VALUE DIR.

The value is replaced in the syntax of the module that defines the constant, when that is imported. So other constants
that are computed from it, modules that import it by name, and kernels, which freeze it when they are compiled, all have
the new value, as if the file had been edited; of the kept kernels only those fit that do not depend on it
(solver.compiled.contents). All else that is kept on disk is kept by the sources of the program, and would not fit: it
goes to the directory DIR instead, which is new.

Every line of the standard input names a run, every line of the standard output is its Outcome, both as JSON. A run that
takes more than LIMIT ends the process.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import json
import os
import signal
import sys
from collections.abc import Sequence
from dataclasses import replace
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import CodeType, ModuleType
from typing import Any, NamedTuple

LIMIT = 300.0  # s of CPU time: all compiles in 100, a run takes 5; ten times as much waits an hour for an endless loop
LOOKS = 10  # instants of a run that are compared; ten times as many find hardly larger departures
OUTCOMES = ('ok', 'suspect', 'refused', 'error', 'crashed', 'no end')


class Member(NamedTuple):
    """One run of the set: a scene of config/scenes for at most so many seconds, or a random mechanism. halved: with
    half its step."""

    scene: str
    seconds: float
    number: int = -1  # of the mechanism in the series of seed 0; the scene is then its name
    halved: bool = False


class Outcome(NamedTuple):
    """Result of one run. counters: names and numbers of what its steps did. numbers: (instants, n) of its snapshots.
    fields: name and number of columns of every field of them."""

    status: str
    text: str = ''
    findings: Sequence[str] = ()
    digest: str = ''
    counters: Sequence[tuple[str, int]] = ()
    fields: Sequence[Sequence[Any]] = ()
    numbers: Sequence[Sequence[float]] = ()


class _Replace(ast.NodeTransformer):
    """Another value for one name that a module assigns."""

    def __init__(self, name: str, value: float) -> None:
        self.name, self.value, self.replaced = name, value, 0

    def visit_Assign(self, node: ast.Assign) -> ast.Assign:
        """Replace the value of the name, or its entry where several are assigned at once."""
        for target in node.targets:
            if isinstance(target, ast.Name) and target.id == self.name:
                node.value = self._constant(node.value)
            elif isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                for k, one in enumerate(target.elts):
                    if isinstance(one, ast.Name) and one.id == self.name:
                        node.value.elts[k] = self._constant(node.value.elts[k])
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AnnAssign:
        """Replace the value of a name with a hint."""
        if isinstance(node.target, ast.Name) and node.target.id == self.name and node.value is not None:
            node.value = self._constant(node.value)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        """Leave functions alone: a local name is no constant of the module."""
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.ClassDef:
        """Leave classes alone."""
        return node

    def _constant(self, node: ast.expr) -> ast.expr:
        self.replaced += 1
        return ast.copy_location(ast.Constant(self.value), node)


class _Loader(SourceFileLoader):
    """A module with another value for one of its constants; no bytecode is read or kept."""

    def __init__(self, module: str, path: str, name: str, value: float) -> None:
        super().__init__(module, path)
        self._constant, self._value = name, value

    def get_code(self, fullname: str) -> CodeType:
        """Bytecode of the changed syntax. Raises ImportError where the module does not assign the name exactly once."""
        change = _Replace(self._constant, self._value)
        tree = change.visit(ast.parse(self.get_data(self.path)))
        if change.replaced != 1:
            raise ImportError(f'{fullname} assigns {self._constant} {change.replaced} times, not once')
        return compile(tree, self.path, 'exec', dont_inherit=True)


class Changed:
    """A finder of modules that changes one of them."""

    def __init__(self, module: str, name: str, value: float) -> None:
        self._module, self._name, self._value = module, name, value

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:  # fmt: skip
        """The module with the other value; None of all others."""
        if fullname != self._module:
            return None
        spec = PathFinder.find_spec(fullname, path)
        if spec is None or spec.origin is None:
            return None
        loader = _Loader(fullname, spec.origin, self._name, self._value)
        return importlib.util.spec_from_loader(fullname, loader, origin=spec.origin)


def change(module: str, name: str, value: float) -> None:
    """From now on the module has another value. Raises ImportError when it was imported before."""
    if module in sys.modules:
        raise ImportError(f'{module} was imported before {name} was changed')
    sys.meta_path.insert(0, Changed(module, name, value))


def outcome(member: Member) -> Outcome:
    """One run. What the changed constant breaks is an outcome, too."""
    from solver.analysis.verdict import findings, status_of
    from solver.errors import MbdError, StepError
    from solver.files.scene import load_scene
    from solver.output.snapshot import OutputArrays
    from solver.simulation import Simulation

    try:
        if member.number < 0:
            scene = load_scene(member.scene)
        else:
            from mbd_sim_ros.lab.mechanisms.families import drawn

            scene = drawn(member.number, 0).at(member.seconds)
        if member.halved:
            scene = replace(scene, integrator=replace(scene.integrator, h=scene.integrator.h / 2.0))
        simulation = Simulation(scene)
        snapshot = simulation.snapshot()
        rows, h = [snapshot.numbers], simulation.h * (2.0 if member.halved else 1.0)
        steps = max(1, round(min(member.seconds, scene.duration) / h) // LOOKS)
        for _ in range(LOOKS):
            snapshot = simulation.advance(2 * steps if member.halved else steps)
            rows.append(snapshot.numbers)
        found = findings(simulation)
    except StepError as error:
        return Outcome('error', str(error))
    except MbdError as error:
        return Outcome('refused', str(error))
    except Exception as error:  # a program that is not made for the value
        return Outcome('crashed', f'{type(error).__name__}: {error}')
    bits = hashlib.sha256(b''.join(row.tobytes() for row in rows))
    for array in simulation.state:
        bits.update(array.tobytes())
    sizes = [[name, getattr(snapshot, name).size] for name in OutputArrays._fields]
    names = sorted({finding.quantity for finding in found})
    counters = [(name, value) for name, value in simulation.totals().items() if isinstance(value, int)]
    text = '; '.join(map(str, found))
    return Outcome(status_of(found), text, names, bits.hexdigest(), counters, sizes, [row.tolist() for row in rows])


def main() -> None:
    """Answer until the standard input ends."""
    module, name, value, directory = sys.argv[1:]
    change(module, name, json.loads(value))
    answers = os.fdopen(os.dup(1), 'w', encoding='utf-8')
    os.dup2(2, 1)  # whatever prints does not come between the answers
    import solver.compiled.kernel  # noqa: F401  finds the kernels that are kept

    os.environ['MBD_CACHE_DIR'] = directory
    for line in sys.stdin:
        signal.setitimer(signal.ITIMER_PROF, LIMIT)
        answers.write(json.dumps(outcome(Member(*json.loads(line)))) + '\n')
        answers.flush()
        signal.setitimer(signal.ITIMER_PROF, 0.0)


if __name__ == '__main__':
    main()
