"""State files: written by the service ~/save_state, and read by the parameter `restore`, with which a node goes on from
a state."""

from __future__ import annotations

import dataclasses
import hashlib
import time
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from mbd_sim_ros.bags.recorder import file_stem
from solver.disk import atomic_write
from solver.elements.road import RoadSpec
from solver.errors import SpecError
from solver.inputs.actuation import Chain
from solver.inputs.assistance import Assistant
from solver.inputs.command_filter import CommandSource, filter_state_at
from solver.model.spec import ModelSpec
from solver.model.state import FORMAT, fitting, load_arrays, require_format
from solver.output.snapshot import TIRE_COLUMNS

if TYPE_CHECKING:
    from solver.scene import Scene
    from solver.simulation import Simulation


class Part(Protocol):
    """A source of inputs with a state, e.g. a filter of commands or actuators."""

    state: np.ndarray


def hand_over(simulation: Simulation, parts: Mapping[str, Part], *, commanded: bool) -> None:
    """Set the states of inactive sources of inputs to the present inputs, before a state is saved.

    After a restore another source may drive: it then goes on from the present inputs without a jump. commanded: whether
    topics drive. Then the driver of the scene is inactive. Otherwise the maneuver of the scene drives, and the filter
    of commands is inactive; so are actuators and assistance if the maneuver is a recording, whose inputs have passed
    through them already.
    """
    sources, inputs = simulation.sources, simulation.snapshot().inputs
    if commanded:
        if sources.driver is not None:
            sources.driver.start(inputs)
        return
    acting = (sources.actuators, sources.assistant)
    for part in parts.values():
        if isinstance(part, CommandSource):
            part.state = filter_state_at(simulation.channels.inputs, inputs)
        elif isinstance(part, Chain) and part not in acting:
            part.start(inputs)
        elif isinstance(part, Assistant) and part not in acting:
            part.begin(inputs, None)


def save(scene: Scene, simulation: Simulation, parts: Mapping[str, Part], commands: Mapping[str, float]) -> Path:
    """Write the state of a simulation to a new file in the current directory; returns its path.

    parts: name -> source of inputs; `steering` is one of them. commands: name -> command in force. Raises SpecError if
    the file cannot be written; nothing of it is left then.
    """
    stem = f'{file_stem(scene.name)}-step{simulation.k}-{time.strftime("%Y%m%d-%H%M%S")}'
    path = next(one for n in count(1) if not (one := Path(f'{stem}{f"-{n}" if n > 1 else ""}.state.npz')).exists())
    content = {
        'format': np.array(FORMAT),
        'simulation': np.frombuffer(simulation.save(), np.uint8),
        'scene': scene.hash,
        'model': _model_hash(scene.model),
        'h_ns': simulation.h_ns,
        'commands': np.array(list(commands)),
        'latched': np.array(list(commands.values())),
        **{name: part.state for name, part in parts.items()},
    }
    try:
        with atomic_write(path) as part:
            np.savez(part, **content)  # type: ignore[arg-type]
    except OSError as error:
        raise SpecError(
            f'the state cannot be saved in {path.absolute()}: {error.strerror or error}; make room, or start the node '
            'in another directory'
        ) from error
    return path.resolve()


def restore(path: Path, scene: Scene, simulation: Simulation, parts: Mapping[str, Part]) -> dict[str, float]:
    """Restore a state file; returns command name -> command that was in force.

    The file may be of another scene with the same vehicle. Then motion and commands are restored, and actuators begin
    at the present inputs. If only one of the two scenes has an assistance, gear and clutch commands are dropped,
    because they mean different things there (a lever, a gear); the gear stays in.

    Raises SpecError for a file that is no state file, is of another version, or of a scene with another vehicle or
    step; and if wheels would begin in the ground.
    """
    if not path.is_file():
        raise SpecError(f'parameter restore: {path} is not a state file of ~/save_state (no file is there)')
    try:
        saved = load_arrays(path.read_bytes())
        data, steering, hash_of_scene = saved['simulation'].tobytes(), saved['steering'], str(saved['scene'])
        model, h_ns = str(saved['model']), int(fitting('h_ns', saved['h_ns'], np.array(simulation.h_ns)))
    except (OSError, KeyError, SpecError) as error:
        raise SpecError(f'parameter restore: {path} is not a state file of ~/save_state ({error})') from error
    require_format(saved, f'parameter restore: {path}')
    own = _model_hash(scene.model)
    elsewhere = hash_of_scene != scene.hash
    if elsewhere and (model != own or h_ns != simulation.h_ns):
        why = f'h is {h_ns * 1e-9:g} s there' if model == own else 'its vehicle is another one'
        raise SpecError(f'parameter restore: {path} belongs to another scene, and {why}')
    names = np.ravel(saved.get('commands', ())).tolist()
    latched = fitting('latched', saved.get('latched'), np.zeros(len(names)))
    if not np.isfinite(latched).all():
        raise SpecError(f'parameter restore: {path} holds commands that are not finite; save the state anew')
    simulation.restore(data, elsewhere=elsewhere)
    if elsewhere:
        _require_above_the_road(path, scene, simulation)
    commands = dict(zip(map(str, names), latched.tolist(), strict=True))
    for name, part in parts.items():
        if isinstance(part, Chain) and elsewhere:
            part.start(simulation.snapshot().inputs)
        elif isinstance(part, Assistant) and elsewhere:
            part.begin(simulation.snapshot().inputs, saved.get(name))
        else:
            part.state = fitting(name, steering if name == 'steering' else saved.get(name), part.state)
    if elsewhere and ('assistance' in parts) != ('assistance' in saved):
        commands = {name: value for name, value in commands.items() if name not in ('gear', 'clutch')}
    return commands


def jump(simulation: Simulation, rate: float) -> str:
    """Sentence on a jump of the steering wheel in the next step, '' where there is none.

    A maneuver that gives the angle over time does not know where the steering wheel stands. It makes a jump if the
    wheel would turn faster than `rate` [rad/s], and does not stand where the maneuver had it before. A driver or an
    actuator makes none.
    """
    sources, names, inputs = simulation.sources, simulation.channels.inputs, simulation.snapshot().inputs
    turned = sources.driver is not None and sources.driver.driver is not None
    if (
        turned
        or 'steering' not in names
        or (sources.actuators is not None and 'steering' in simulation.scene.actuation.actuators)
    ):
        return ''
    place, t, k = names.index('steering'), simulation.t_ns * 1e-9, simulation.k
    stands = float(inputs[place])
    wanted, before = (float(sources.of_time.table(step, 1)[0, place]) for step in (k, max(k - 1, 0)))
    # a maneuver of its own may be faster
    if min(abs(wanted - stands), abs(before - stands)) <= rate * simulation.h_ns * 1e-9:
        return ''
    return (
        f'the steering wheel stands at {stands:.3g} rad, and the maneuver has it at {wanted:.3g} rad behind t = {t:g} '
        's, where it jumps; restore a state of that maneuver, or drive by topics'
    )


def _require_above_the_road(path: Path, scene: Scene, simulation: Simulation) -> None:
    """Raise SpecError where the road is so much higher than at the saved state that the rim of a wheel would be in
    it."""
    deflection = TIRE_COLUMNS.index('deflection')
    tires = {tire.name: tire.data.values for tire in getattr(scene.model, 'tires', ())}
    for name, row in zip(simulation.channels.wheels, simulation.snapshot().tire.tolist(), strict=True):
        most = tires[name]['UNLOADED_RADIUS'] - tires[name].get('RIM_RADIUS', 0.0)
        if row[deflection] > most:
            raise SpecError(
                f'parameter restore: {path}: the tire {name} would begin {row[deflection]:.3g} m deep in the road of '
                f'this scene, and its rim is reached at {most:.3g} m; save the state where the road is as high as here'
            )


def _model_hash(model: Any) -> str:
    """Hash of the model without its road: states carry over between scenes of the same vehicle."""
    return hashlib.sha256(
        repr(dataclasses.replace(model, road=RoadSpec()) if isinstance(model, ModelSpec) else model).encode()
    ).hexdigest()
