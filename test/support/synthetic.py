"""A simulation of nothing: every number of every snapshot is distinct and known, so a swapped one is seen."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from solver.elements.rigid_body import RigidBodySpec
from solver.errors import StepError
from solver.inputs.actuation import Actuation
from solver.inputs.assistance import Assistance
from solver.model.spec import ModelSpec
from solver.output.sensors import Sensors
from solver.output.snapshot import Channels, Counters, Snapshot, layout_of, new_numbers
from solver.scene import Record

WHEELS = ('front_left', 'front_right', 'rear_left', 'rear_right')
INPUTS = ('steering', 'steering_rate', 'steering_acceleration', 'drive_torque', 'brake_torque')


def channels(*, vehicle: bool = True, joints: int = 5) -> Channels:
    """Names of a small vehicle, or of a mechanism without chassis and tires."""
    return Channels(
        joints=tuple(f'joint_{i}' for i in range(joints)),
        joint_kinds=('rotation',) * joints,
        bodies=('subframe', 'chassis', 'wheel'),
        wheels=WHEELS if vehicle else (),
        inputs=INPUTS,
        elements=('spring/energy', 'spring/force', 'damper/force'),
        reactions=('hinge/x', 'hinge/y'),
        chassis=1 if vehicle else None,
    )


def snapshot(names: Channels, k: int = 1, *, h_ns: int = 2_000_000, inputs: np.ndarray | None = None) -> Snapshot:
    """Snapshot k, with numbers counted through from 1000 k on."""
    layout = layout_of(names)
    result = Snapshot(k, k * h_ns, new_numbers(layout), layout, Counters(3, 1, 3, 0, 1e-9, 1e-10, 1e-11))
    for i, (place, _) in enumerate(layout.values()):
        result.numbers[place] = 1000.0 * k + 100.0 * i + 0.1 * np.arange(place.stop - place.start)
    if inputs is not None:
        result.inputs[:] = inputs
    return result


class Synthetic:
    """Has the interface of solver.simulation.Simulation. `fails_at`: step that raises StepError; `bad_at`: step with a
    NaN in it."""

    def __init__(self, *, h_ns: int = 2_000_000, vehicle: bool = True, fails_at: int = -1, bad_at: int = -1) -> None:
        self.h_ns, self.fails_at, self.bad_at = h_ns, fails_at, bad_at
        self.events: list = []
        self.sources = SimpleNamespace(
            actuators=None, assistant=None, driver=None,
            of_time=SimpleNamespace(table=lambda k0, n: np.zeros((n, len(INPUTS))))
        )  # fmt: skip
        self.channels = channels(vehicle=vehicle)
        self.scene = SimpleNamespace(
            model=ModelSpec(bodies=(RigidBodySpec(name='chassis', mass=1.0, inertia=(1.0, 1.0, 1.0, 0.0, 0.0, 0.0)),))
        )
        self.reset()

    @property
    def t_ns(self) -> int:
        return self.k * self.h_ns

    def reset(self) -> None:
        self.k = 0
        self.inputs = np.zeros(len(INPUTS))
        self.applied = self.inputs[None]

    def snapshot(self) -> Snapshot:
        result = snapshot(self.channels, self.k, h_ns=self.h_ns, inputs=self.inputs)
        if self.k == self.bad_at:
            result.pose[1, 2] = np.nan
        return result

    def advance(self, n: int = 1, inputs: np.ndarray | None = None) -> Snapshot:
        if self.k + n == self.fails_at:
            raise StepError(
                f't = {self.t_ns * 1e-9:.6f} s, step {self.k}: no convergence at constraint hinge; reduce integrator.h'
            )
        self.k += n
        if inputs is not None:
            self.applied = np.broadcast_to(np.atleast_2d(np.array(inputs, float)), (n, len(INPUTS)))
            self.inputs = self.applied[-1].copy()
        return self.snapshot()

    def place(self, x: float, y: float, heading: float) -> None:
        self.placed = (x, y, heading)

    def renumber(self, k: int) -> None:
        self.k = k

    def urdf(self) -> str:
        return '<robot name="of the model"/>'

    def save(self) -> bytes:
        return self.k.to_bytes(8, 'little') + self.inputs.tobytes()

    def restore(self, data: bytes, *, elsewhere: bool = False) -> None:
        self.k, self.inputs = int.from_bytes(data[:8], 'little'), np.frombuffer(data[8:]).copy()


def scene(**values: object) -> SimpleNamespace:
    """What the node needs of a solver.scene.Scene."""
    defaults = {'name': 'synthetic', 'resolved': 'name: synthetic\n', 'hash': 'f' * 16, 'seed': 7, 'duration': 1.0}
    return SimpleNamespace(
        **{
            **defaults,
            'record': Record(poses=0.0, elements_rate=0.0),
            'controllers': (),
            'actuation': Actuation(),
            'assistance': Assistance(),
            'sensors': Sensors(),
            'model': None,
            **values,
        }
    )
