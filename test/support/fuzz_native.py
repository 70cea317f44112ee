"""Cases for the fuzzer: damaged models, states and units of the native library, and inputs that make no sense.

Nothing of it may crash: the library answers by a code, and goes on as if nothing had been asked.
"""

from __future__ import annotations

import ctypes
import hashlib
import re
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from mutations import damage_bytes, word
from mutations import pick as pick_object

SCENES = ('slider_crank', 'light_car_step_steer')  # both kinds of inputs: followed, and those of a car with its filter
OK, DAMAGED, LAST = 0, 2, 15  # enum mbd_code of mbd.h
HEAD, DIGEST = 16, 48  # bytes up to the digest of a model, and up to its end
FIELDS = 51
FINITE = (0.0, -0.0, 1.0, -1.0, 30.0, -1e3, 1e9, -1e30, 1e300, 1.7e308, 5e-324)
NUMBERS = (*FINITE, float('nan'), float('inf'), -float('inf'))
PLACES = (0, -1, 1, 8, 1 << 20, 1 << 31, 1 << 40, (1 << 63) - 1, -(1 << 63))
NEEDS = {'units': 'fmpy'}  # kind -> library that reads them


def pick(rng: np.random.Generator, items: Any) -> Any:
    """One of them."""
    return pick_object(rng, items)


def make(there: Path) -> None:
    """Write library, models and archives of SCENES."""
    from mbd_sim_ros.native import fmu, library
    from mbd_sim_ros.native.kernels import target
    from mbd_sim_ros.native.model import native
    from solver import load_scene, simulation_of

    there.mkdir(parents=True, exist_ok=True)
    kernels = {}
    for name in SCENES:
        simulation = simulation_of(load_scene(name))
        for version in (2, 3):
            fmu.write(simulation, there / f'{name}{version}.fmu', target('v3'), version=version)
        made = native(simulation)
        (there / f'{name}.mbd').write_bytes(made.content)
        kernels.update({kernel.name: kernel for kernel in made.kernels})
    library.build(kernels.values(), target('v3'), there / library.NAME)


class Library:
    """libmbd.so, with the types of its functions."""

    def __init__(self, there: Path) -> None:
        p, i, n, d = ctypes.c_void_p, ctypes.c_int, ctypes.c_int64, ctypes.c_double
        self._so = ctypes.CDLL(str(there / 'libmbd.so'))
        for name, result, *arguments in (
            ('make', i, ctypes.c_char_p, ctypes.c_size_t, p), ('copy', i, p, p), ('free', None, p),
            ('variables', i, p), ('kind', i, p, i), ('name', ctypes.c_char_p, p, i), ('unit', ctypes.c_char_p, p, i),
            ('get', i, p, i, p), ('set', i, p, i, d), ('set_motion', i, p, i, d, d, d), ('follow', i, p, i),
            ('filter', i, p, d, d), ('step', i, p, n), ('audit', None, p, i), ('reset', i, p),
            ('size', ctypes.c_size_t, p), ('save', i, p, p, ctypes.c_size_t),
            ('restore', i, p, ctypes.c_char_p, ctypes.c_size_t),
            ('verdict', i, p), ('message', ctypes.c_char_p, p), ('numbers', ctypes.POINTER(d), p, p),
        ):  # fmt: skip
            function = getattr(self._so, f'mbd_{name}')
            function.restype, function.argtypes = result, arguments
            setattr(self, name, function)

    make: Any
    copy: Any
    free: Any
    variables: Any
    kind: Any
    name: Any
    unit: Any
    get: Any
    set: Any
    set_motion: Any
    follow: Any
    filter: Any
    step: Any
    audit: Any
    reset: Any
    size: Any
    save: Any
    restore: Any
    verdict: Any
    message: Any
    numbers: Any

    def made(self, content: bytes) -> tuple[int, ctypes.c_void_p]:
        """(code, model) of a content."""
        model = ctypes.c_void_p()
        return self.make(content, len(content), ctypes.byref(model)), model

    def saved(self, model: ctypes.c_void_p) -> bytes:
        """State of a model."""
        buffer = ctypes.create_string_buffer(self.size(model))
        assert self.save(model, buffer, len(buffer)) == OK
        return buffer.raw

    def end(self, model: ctypes.c_void_p, steps: int = 20) -> bytes:
        """Outputs after so many steps."""
        assert self.step(model, steps) == OK, self.message(model)
        count = ctypes.c_size_t()
        numbers = self.numbers(model, ctypes.byref(count))
        return bytes(np.ctypeslib.as_array(numbers, (count.value,)).tobytes())


def _opened(rng: np.random.Generator, there: Path) -> tuple[Library, bytes, ctypes.c_void_p]:
    library, content = Library(there), (there / f'{pick(rng, SCENES)}.mbd').read_bytes()
    code, model = library.made(content)
    assert code == OK
    return library, content, model


def models(rng: np.random.Generator, there: Path) -> str:
    """Files of models: damaged anywhere, and in what says where things lie, with a digest that fits."""
    library, content, model = _opened(rng, there)
    placed = rng.random() < 0.5
    if placed:
        raw = bytearray(content)
        words = np.frombuffer(content[DIGEST : DIGEST + 8 * FIELDS], np.int64)
        parts = [(DIGEST, FIELDS)]  # of the header, and of lists in it (FIELDS of model.py)
        for at, n, width in ((10, 11, 4), (12, 13, 1), (14, 15, 4), (22, 23, 5), (40, 41, 1)):
            parts.append((int(words[at]), int(words[n]) * width))
        parts.append((int(words[39]) + 8 * 17, 2 * 28))  # places of the account that a verdict looks at
        parts.append((int(words[44]), int(words[45]) // 8))  # what is followed in snapshots
        for _ in range(int(rng.integers(1, 4))):
            at, n = parts[int(rng.integers(len(parts)))]
            value = int(pick(rng, (*PLACES, int(rng.integers(1 << 20)))))
            if n:
                at += 8 * int(rng.integers(n))
                raw[at : at + 8] = value.to_bytes(8, 'little', signed=True)
        raw[HEAD:DIGEST] = hashlib.sha256(raw[DIGEST:]).digest()
        mutant = bytes(raw)
    else:
        mutant = damage_bytes(rng, content)
    code, other = library.made(mutant)
    if not OK <= code <= LAST:
        return f'code {code}'
    if code == OK and not placed and mutant != content:
        return 'a damaged model is taken'
    if code == OK:  # its numbers are none, but they are there
        got = ctypes.c_double()
        for v in range(-1, library.variables(other) + 1):
            library.get(other, v, ctypes.byref(got)), library.name(other, v), library.unit(other, v)
        library.verdict(other)
        library.restore(other, library.saved(other), library.size(other))
        library.free(other)
    again, first = library.made(content)
    return '' if again == OK and library.end(first) == library.end(model) else 'a good model is another one afterwards'


def states(rng: np.random.Generator, there: Path) -> str:
    """States: damaged ones are refused, and the model goes on as if they had never been given."""
    library, content, model = _opened(rng, there)
    library.step(model, 10)
    state = library.saved(model)
    mutant = damage_bytes(rng, state)
    code = library.restore(model, mutant, len(mutant))
    if mutant != state and code == OK:
        return 'a damaged state is taken'
    if library.saved(model) != state:
        return 'a damaged state changes the model'
    _, other = library.made(content)
    library.step(other, 10)
    return '' if library.end(model) == library.end(other) else 'a model goes on in another way'


def inputs(rng: np.random.Generator, there: Path) -> str:
    """Calls in any order with numbers that make no sense; a model that is reset is as good as new."""
    library, _, model = _opened(rng, there)
    fresh = library.end(model)
    state, value, copy = b'', ctypes.c_double(), ctypes.c_void_p()
    variables = library.variables(model)
    own = [v for v in range(variables) if library.kind(model, v) == 0] or [0]
    for _ in range(60):
        a, b, c = (float(rng.normal()) if rng.random() < 0.3 else float(pick(rng, NUMBERS)) for _ in range(3))
        v = int(pick(rng, own) if rng.random() < 0.8 else pick(rng, (-1, variables, 1 << 30, -(1 << 31), 3)))
        call = str(pick(rng, ('set', 'set', 'motion', 'follow', 'filter', 'step', 'step', 'step', 'other', 'state')))
        codes = [OK]
        if call == 'set':
            codes = [library.set(model, v, a)]
        elif call == 'motion':
            codes = [library.set_motion(model, v, a, b, c)]
        elif call == 'follow':
            codes = [library.follow(model, v)]
        elif call == 'filter':
            codes = [library.filter(model, a, b)]
        elif call == 'step':
            codes = [library.step(model, int(pick(rng, (-1, 0, 1, 2, 7, -(1 << 63)))))]
        elif call == 'state':
            if rng.random() < 0.5:
                state = library.saved(model)
            elif state:
                codes = [library.restore(model, state, len(state))]
        else:
            library.audit(model, int(rng.integers(2)))
            library.verdict(model)
            codes = [library.get(model, v, ctypes.byref(value)), library.copy(model, ctypes.byref(copy))]
            library.free(copy)
            if rng.random() < 0.3:
                library.reset(model)
        if not all(OK <= code < LAST for code in codes):  # the last one is an error of the program
            return f'{call}: codes {codes}: {library.message(model)}'
    library.reset(model)
    return '' if library.end(model) == fresh else 'a model that was reset is another one'


def _other_attribute(rng: np.random.Generator, text: str) -> str:
    """A description in which one attribute is another, of the controller's own variable or of any element."""
    about = text.index('name="joint_states/crank/effort"')
    line = slice(text.rindex('<', 0, about), text.index('\n', about))
    element = (line, slice(0, text.index('<UnitDefinitions>')), slice(0, None))[int(rng.integers(3))]
    found = list(re.finditer(r'="([^"]*)"', text[element]))
    one = found[int(rng.integers(len(found)))]
    begin, end = one.span(1)
    value = escape(word(rng, one[1]) if rng.random() < 0.8 else one[1][: len(one[1]) // 2], {'"': '&quot;'})
    first = element.start or 0
    return text[: first + begin] + value + text[first + end :]


def units(rng: np.random.Generator, at: Path, there: Path) -> list[str]:
    """Archives that a scene has as a controller: bytes, or a file in them with a sum that fits. (Its machine code is
    left as it is: that of others may do what it likes in its own process.)"""
    version = int(pick(rng, (2, 3)))
    good = (there / f'{SCENES[0]}{version}.fmu').read_bytes()
    if rng.random() < 0.4:
        mutant = damage_bytes(rng, good)
    else:
        with zipfile.ZipFile(BytesIO(good)) as archive:
            parts = {name: archive.read(name) for name in archive.namelist()}
        name = str(pick(rng, ('resources/model.mbd', *['modelDescription.xml'] * 3)))
        if name.endswith('.xml') and rng.random() < 0.9:
            parts[name] = _other_attribute(rng, parts[name].decode()).encode('utf-8', 'surrogatepass')
        else:
            parts[name] = damage_bytes(rng, parts[name])
        if rng.random() < 0.2:
            del parts[str(pick(rng, list(parts)))]
        written = BytesIO()
        with zipfile.ZipFile(written, 'w') as archive:
            for part, content in parts.items():
                archive.writestr(part, content)
        mutant = written.getvalue()
    (at / 'unit.fmu').write_bytes(mutant)
    controller = f'{{fmu: {at / "unit.fmu"}, outputs: {{joint_states/crank/effort: drive_torque}}, every: 0.005}}'
    return ['run', SCENES[1], '--set', f'controllers=[{controller}]']
