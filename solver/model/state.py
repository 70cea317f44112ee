"""State is a value: poses, twists, accelerations, internal states, multipliers, unwrapped coordinates."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Mapping, MutableMapping, Sequence
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.kernel import kernel
from solver.compiled.memory import zeros
from solver.compiled.portable import product
from solver.compiled.so3 import matrix_of_quaternion
from solver.elements.coordinate import ROTATION, coordinate_rate, coordinate_value, evaluate_coordinate
from solver.elements.point_pair import Kinematics
from solver.elements.rigid_body import RigidBodySpec
from solver.errors import SpecError

MOST = 1 << 26  # bytes of a saved state
# Format of saved states, the array `format` in them. It grows by one when an array comes, goes or means something else.
# A state without it is of mbd_sim_ros 0.1 (format 1).
FORMAT = 3


class Saved(bytes):
    """A saved state: its bytes, and in memory what restore() would have to make of them each time.

    arrays: those that the bytes hold, not to be written. shown: by what shows them, the outputs of that state. Both are
    left behind where the bytes go to a file or another process. Raises SpecError where the bytes are damaged.
    """

    arrays: Mapping[str, np.ndarray]
    shown: MutableMapping[Any, Sequence[np.ndarray]]

    def __new__(cls, data: bytes, arrays: Mapping[str, np.ndarray] | None = None) -> Saved:
        saved = super().__new__(cls, data)
        saved.arrays = load_arrays(data) if arrays is None else arrays
        saved.shown = WeakKeyDictionary()
        return saved

    @classmethod
    def of(cls, arrays: Mapping[str, np.ndarray]) -> Saved:
        """The state of these arrays, which it keeps."""
        file = io.BytesIO()
        np.savez(file, **arrays)  # type: ignore[arg-type]
        return cls(file.getvalue(), arrays)

    def __reduce__(self) -> tuple:
        return bytes, (bytes(self),)


class State(NamedTuple):
    """Everything the next step depends on (layout in docs/conventions.md)."""

    q: np.ndarray  # (nb + 1, 7)
    v: np.ndarray  # (nb + 1, 6) the integrator's own twist; outputs are projected
    a: np.ndarray  # (nb + 1, 6)
    a_stage: np.ndarray  # (nb + 1, 6) acceleration of the last stage, the predictor of the next
    a_stage_before: np.ndarray  # (nb + 1, 6) and of the one before
    z: np.ndarray  # (nz,)
    zd: np.ndarray  # (nz,)
    lam: np.ndarray  # (nc,) multipliers of the last stage
    lam_before: np.ndarray  # (nc,) multipliers of the stage before
    angle: np.ndarray  # (nx,)


def new_state(model) -> State:
    """A state of zeros with the placed configuration."""
    nb, nz, nc, nx = model.n_bodies, model.n_internal, model.n_rows, len(model.coordinate_names)
    six = lambda: zeros((nb + 1, 6))  # noqa: E731
    q = zeros((nb + 1, 7))
    q[:] = placed_configuration(model.spec.bodies)
    return State(
        q,
        six(),
        six(),
        six(),
        six(),
        zeros(nz),
        zeros(nz),
        zeros(nc),
        zeros(nc),
        zeros(nx),
    )


def copy_state(source: State, target: State) -> None:
    """target <- source, array by array."""
    for a, b in zip(source, target, strict=True):
        b[...] = a


def placed_configuration(bodies: Sequence[RigidBodySpec]) -> np.ndarray:
    """q (nb + 1, 7) of bodies as their specifications place them."""
    q = np.zeros((len(bodies) + 1, 7))
    q[:, 6] = 1.0
    for b, spec in enumerate(bodies):
        R = np.array(matrix_of_quaternion(spec.orientation)).reshape(3, 3)
        q[b, :3] = np.array(spec.position) + product(R, spec.com)
        q[b, 3:] = spec.orientation
    return q


@kernel(borrow=True)
def fill_kinematics(q, v, kin):
    """Assign kin from q (nb + 1, 7) and v (nb + 1, 6)."""
    for b in range(q.shape[0]):
        R = matrix_of_quaternion((q[b, 3], q[b, 4], q[b, 5], q[b, 6]))
        for i in range(3):
            kin.p[b, i] = q[b, i]
            kin.R[b, i, 0] = R[3 * i]
            kin.R[b, i, 1] = R[3 * i + 1]
            kin.R[b, i, 2] = R[3 * i + 2]
        for i in range(6):
            kin.v[b, i] = v[b, i]


def new_kinematics(nb: int) -> Kinematics:
    """Kinematics of nb bodies and the world, all in place."""
    R = zeros((nb + 1, 3, 3))
    R[:] = np.eye(3)
    return Kinematics(R, zeros((nb + 1, 3)), zeros((nb + 1, 6)))


def kinematics_of(q: np.ndarray, v: np.ndarray) -> Ref:
    """Kinematics (by reference) of a configuration and twist."""
    kin = Ref(new_kinematics(len(q) - 1))
    fill_kinematics(q, v, kin)
    return kin


@kernel(borrow=True)
def update_angles(coordinates, kin, angle):
    """Advance the unwrapped values of all joint coordinates to the configuration of kin."""
    for k in range(coordinates.kind.shape[0]):
        angle[k] = coordinate_value(coordinates, kin, k, angle)


@kernel(borrow=True)
def turn_angles(coordinates, kin, h, angle):
    """Advance the unwrapped values of rotations by what their rates turn them in h [s]: from half a turn on the value
    that is nearest to the one before is one of another turn."""
    for k in range(coordinates.kind.shape[0]):
        if coordinates.kind[k] == ROTATION:
            _, g_i, g_j = evaluate_coordinate(coordinates, kin, k, angle)
            angle[k] += h * coordinate_rate(coordinates, kin, k, g_i, g_j)


def require_format(saved: Mapping[str, np.ndarray], what: str) -> None:
    """Raise SpecError, whose sentence begins with `what`, for the arrays of a saved state of another version: nothing
    of it is guessed."""
    found = int(fitting('format', saved.get('format', np.array(1)), np.array(FORMAT)))
    if found != FORMAT:
        remedy = (
            'save it anew with this version, or go on with the version that saved it'
            if found < FORMAT
            else 'update mbd_sim_ros'
        )
        raise SpecError(f'{what} has format {found}, and this version of mbd_sim_ros reads format {FORMAT}: {remedy}')


def step_of(k: np.ndarray | None) -> int:
    """The index of a step in a saved state. Raises SpecError."""
    if k is None or k.shape != () or k.dtype.kind != 'i' or not 0 <= k < 1 << 53:
        raise SpecError('restore: the saved state does not say which step it is of')
    return int(k)


def load_arrays(data: bytes) -> dict[str, np.ndarray]:
    """The arrays in a saved state. Raises SpecError when it is damaged, or claims to be larger than a state is."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            size = sum(entry.file_size for entry in packed.infolist())
        if size > MOST:
            raise SpecError(f'restore: the saved state claims to hold {size} bytes, more than {MOST}')
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (
        ValueError,
        KeyError,
        OSError,
        EOFError,
        MemoryError,
        NotImplementedError,
        struct.error,
        zipfile.BadZipFile,
        zlib.error,
    ):
        raise SpecError('restore: the saved state is damaged') from None


def fitting(name: str, saved: np.ndarray | None, own: np.ndarray) -> np.ndarray:
    """A saved array that must be like the one of this model. Raises SpecError."""
    if saved is None or saved.shape != own.shape or saved.dtype != own.dtype:
        found = 'is missing' if saved is None else f'has shape {saved.shape}, this model needs {own.shape}'
        raise SpecError(f'restore: {name} {found}: the saved state is of another model')
    return saved
