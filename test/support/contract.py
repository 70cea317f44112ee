"""The laws every force element obeys (docs/contributing.md), checked on one element kind without a model or an
integrator.

    context = ContractContext(bodies=2, inputs=('throttle',))
    table = compile_spring_dampers([spec], context)
    laws = context.laws()
    element = Element(forcing(spring_damper_forces, table, laws), context, n=1, outputs=OUTPUTS)
    check_contract(element, random_kinematics(rng, 2))

Bodies are called b0, b1, ...; their reference frames sit at `com` from the centres of mass.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from interpreted import interpreted
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from solver.compiled.by_reference import Ref
from solver.elements.coordinate import CoordinateSpec, CoordinateTable, compile_coordinates
from solver.elements.instant import Effects, Instant
from solver.elements.laws import Law, LawTable, compile_laws
from solver.elements.marker import WORLD, ConstraintSpec, Marker, PlacedMarker
from solver.elements.point_pair import Kinematics
from solver.elements.road import RoadSpec
from solver.errors import SpecError, suggestion
from solver.validate import Vector

IDENTITY = np.eye(3)
STEP = 1e-40  # complex step: its square vanishes, so derivatives carry rounding errors only


class ContractContext:
    """The compile context of a model that consists of n bodies, inputs and joint coordinates; all 6x6 blocks exist.

    Slot 0 is the trash slot of the world, never read.
    """

    def __init__(
        self,
        *,
        bodies: int = 2,
        com: Sequence[Sequence[float]] | None = None,
        inputs: Sequence[str] = (),
        coordinates: Sequence[CoordinateSpec] = (),
        road: RoadSpec | None = None,
    ) -> None:
        self.road = road or RoadSpec()
        self.n_rows = 0
        self.n_bodies = bodies
        self.com = np.zeros((bodies, 3)) if com is None else np.array(com, float)
        self.inputs = tuple(inputs)
        self.coordinates = tuple(coordinates)
        self.n_states = 0
        self._laws: list[Law] = []

    def body(self, where: str, name: str) -> int:
        names = [f'b{k}' for k in range(self.n_bodies)] + [WORLD]
        return _index(names, name, where, 'body')

    def marker(self, where: str, marker: Marker) -> PlacedMarker:
        b = self.body(where, marker.body)
        com = np.zeros(3) if b == self.n_bodies else self.com[b]
        return PlacedMarker(b, np.array(marker.position) - com, Rotation.from_quat(marker.orientation).as_matrix())

    def slot(self, row: int, column: int) -> int:
        return 0 if self.n_bodies in (row, column) else 1 + row * self.n_bodies + column

    def input(self, where: str, name: str) -> int:
        return _index(self.inputs, name, where, 'input')

    def coordinate(self, where: str, name: str) -> int:
        return _index([c.name for c in self.coordinates], name, where, 'coordinate')

    def coordinate_bodies(self, index: int) -> tuple[int, int]:
        spec = self.coordinates[index]
        return self.body(spec.where, spec.i.body), self.body(spec.where, spec.j.body)

    def placed_coordinate(self, index: int) -> float:
        raise AssertionError('the contract has no placed configuration: give the offset')

    def rows(self, spec: ConstraintSpec, bodies: Sequence[int]) -> tuple[int, list[int]]:
        """Jacobian block b + 1 is that of body b; the world has one too, so that reactions on it are seen."""
        first = self.n_rows
        self.n_rows += len(spec.row_names())
        return first, [b + 1 for b in bodies]

    def law(self, law: object) -> int:
        if law is None:
            return -1
        assert isinstance(law, Law)
        self._laws.append(law)
        return len(self._laws) - 1

    def internal_states(self, where: str, count: int, size: float = 1.0) -> int:
        first = self.n_states
        self.n_states += count
        return first

    def laws(self) -> LawTable:
        """All laws asked for so far."""
        return compile_laws(self._laws)

    def coordinate_table(self) -> CoordinateTable:
        """The joint coordinates."""
        return compile_coordinates(self.coordinates, self)


def _index(names: Sequence[str], name: str, where: str, what: str) -> int:
    if name not in names:
        raise SpecError(f'{where}: unknown {what} {name!r}{suggestion(name, names)}')
    return list(names).index(name)


class Result(NamedTuple):
    """What one call of a kernel gave: f (nb+1, 6); Kq, Kv as dense (6 nb, 6 nb) matrices; z (nz,); out (n, columns)."""

    f: np.ndarray
    Kq: np.ndarray
    Kv: np.ndarray
    z: np.ndarray
    out: np.ndarray


class _Shared:
    """Kinematics by reference, as models have them: one Ref for each number of bodies, for making one takes longer than
    a kernel."""

    def __init__(self) -> None:
        self._held: dict[int, Ref] = {}

    def call(self, kin: Kinematics, function: Callable[[Ref], Any]) -> Any:
        """Call a function with these kinematics, and see that it does not write into them."""
        n = len(kin.p)
        if n not in self._held:
            self._held[n] = Ref(Kinematics(*map(np.empty_like, kin)))
        held = self._held[n]
        for memory, given in zip(held.value, kin, strict=True):
            memory[:] = given
        found = function(held)
        unwritten = all(a.tobytes() == b.tobytes() for a, b in zip(held.value, kin, strict=True))
        assert unwritten, 'the kernel wrote into the kinematics'
        return found


def acting(kernel: Callable[..., Any], *tables: Any) -> Callable[..., Any]:
    """A kernel bound to its tables, called with kinematics and what follows them.

    Real numbers go by reference, so with the machine code of models; complex ones through the source of the kernel.
    """
    references = [Ref(table) for table in tables]
    plain, shared = interpreted(kernel), _Shared()

    def call(kin: Kinematics, *rest: Any) -> Any:
        if np.iscomplexobj(kin.p):
            return plain(*tables, kin, *rest)
        return shared.call(kin, lambda held: kernel(*references, held, *rest))

    return call


def forcing(
    kernel: Callable[..., Any],
    table: Any,
    laws: LawTable,
    x: CoordinateTable | None = None,
    angle: ArrayLike = (),
) -> Callable[..., None]:
    """A force kernel bound to its tables, as Element.call.

    x, angle: joint coordinates and the reference values of rotations, of kernels that act on them.
    """
    x = compile_coordinates((), ContractContext()) if x is None else x
    of_kind, coordinates, force_laws = Ref(table), Ref(x), Ref(laws)
    plain, shared, around = interpreted(kernel), _Shared(), np.array(angle, float)

    def call(kin: Kinematics, zp, cz: float, u, tangents: bool, f, Kq, Kv, z, out) -> None:
        now, effects = Instant(x, laws, kin, around, zp, float(cz), u, bool(tangents)), Effects(f, Kq, Kv, z)
        if np.iscomplexobj(kin.p):
            plain(table, now, effects, out)
            return
        now = now._replace(coordinates=coordinates, laws=force_laws)
        shared.call(kin, lambda held: kernel(of_kind, now._replace(kin=held), effects, out))

    return call


@dataclass(frozen=True)
class Element:
    """A kernel bound to its tables. call(kin, zp, cz, u, tangents, f, Kq, Kv, z, out); n: number of elements."""

    call: Callable[..., None]
    context: ContractContext
    n: int
    outputs: Collection[str]

    def evaluate(
        self, kin: Kinematics, *, zp=(), cz: float = 0.0, u=(), tangents: bool = False, dtype=float, start: float = 0.0
    ) -> Result:
        """Call the kernel on fresh arrays: z and out poisoned with NaN, f, Kq, Kv filled with `start`."""
        nb = self.context.n_bodies
        zp = np.array(zp, dtype)
        assert zp.shape == (self.context.n_states,), f'zp must have {self.context.n_states} entries'
        u = np.array(u, float)
        f = np.full((nb + 1, 6), start, dtype)
        Kq = np.full((nb * nb + 1, 6, 6), start, dtype)
        Kv = np.full((nb * nb + 1, 6, 6), start, dtype)
        z = np.full(self.context.n_states, np.nan, dtype)
        out = np.full((self.n, len(self.outputs)), np.nan, dtype)
        self.call(Kinematics(*(np.ascontiguousarray(a, dtype) for a in kin)), zp, cz, u, tangents, f, Kq, Kv, z, out)
        return Result(f, self._dense(Kq), self._dense(Kv), z, out)

    def output(self, result: Result, name: str) -> np.ndarray:
        """A column of the outputs by name, (n,)."""
        return result.out[:, list(self.outputs).index(name)]

    def _dense(self, blocks: np.ndarray) -> np.ndarray:
        nb = self.context.n_bodies
        return blocks[1:].reshape(nb, nb, 6, 6).transpose(0, 2, 1, 3).reshape(6 * nb, 6 * nb)


def kinematics(poses: Sequence[tuple[ArrayLike, ArrayLike]], twists: ArrayLike | None = None) -> Kinematics:
    """Kinematics of bodies given as (position of the centre of mass [m], rotation matrix or rotation vector [rad]);
    world appended."""
    n = len(poses)
    R = np.empty((n + 1, 3, 3))
    R[:] = IDENTITY
    p = np.zeros((n + 1, 3))
    v = np.zeros((n + 1, 6))
    for b, (position, rotation) in enumerate(poses):
        p[b] = position
        r = np.array(rotation, float)
        R[b] = r if r.shape == (3, 3) else Rotation.from_rotvec(r).as_matrix()
    if twists is not None:
        v[:n] = twists
    return Kinematics(R, p, v)


def random_marker(rng: np.random.Generator, body: str, position: Vector | None = None) -> Marker:
    """A marker of any orientation, at a given position or at any."""
    at: Any = rng.normal(size=3) if position is None else position
    return Marker(body=body, position=at, orientation=Rotation.random(random_state=rng).as_quat())


def random_kinematics(
    rng: np.random.Generator, bodies: int, *, spread: float = 1.0, turn: float = 3.0, speed: float = 1.0
) -> Kinematics:
    """Random placements: positions N(0, spread) [m], rotation vectors up to `turn` [rad], twists N(0, speed)."""
    poses = []
    for _ in range(bodies):
        axis = rng.normal(size=3)
        poses.append((spread * rng.normal(size=3), axis / np.linalg.norm(axis) * turn * rng.uniform()))
    return kinematics(poses, speed * rng.normal(size=(bodies, 6)))


def displaced(kin: Kinematics, dq: np.ndarray, dv: np.ndarray) -> Kinematics:
    """kin after the variation dq and the twist increment dv, both (nb, 6), along the imaginary axis: exact to first
    order."""
    nb = kin.p.shape[0] - 1
    R, p, v = (a.astype(complex) for a in kin)
    p[:nb] += 1j * STEP * dq[:, :3]
    v[:nb] += 1j * STEP * dv
    for b in range(nb):
        R[b] = R[b] @ (np.eye(3) + 1j * STEP * _skew(dq[b, 3:]))
    return Kinematics(R, p, v)


def _skew(a: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def complex_step_tangents(element: Element, kin: Kinematics, **arguments) -> tuple[np.ndarray, np.ndarray]:
    """(Kq, Kv), each (6 nb, 6 nb): derivatives of f through the kernel itself."""
    n = 6 * element.context.n_bodies
    zero = np.zeros(n)
    columns: list[list[np.ndarray]] = [[], []]
    for k in range(n):
        e = np.zeros(n)
        e[k] = 1.0
        for which, (dq, dv) in enumerate(((e, zero), (zero, e))):
            f = element.evaluate(displaced(kin, dq.reshape(-1, 6), dv.reshape(-1, 6)), dtype=complex, **arguments).f
            columns[which].append(f[:-1].imag.ravel() / STEP)
    return np.array(columns[0]).T, np.array(columns[1]).T


def check_tangents(element: Element, kin: Kinematics, *, tolerance: float = 1e-11, **arguments) -> None:
    """Kq and Kv equal the complex-step derivatives of f to `tolerance` times the largest entry (rounding errors only).

    So does f, compiled, what its source gives.
    """
    exact = complex_step_tangents(element, kin, **arguments)
    result = element.evaluate(kin, tangents=True, **arguments)
    source = element.evaluate(displaced(kin, *np.zeros((2, *kin.v[:-1].shape))), dtype=complex, **arguments).f.real
    np.testing.assert_allclose(
        result.f, source, rtol=0.0, atol=tolerance * max(float(np.abs(source).max()), 1e-300), err_msg='f'
    )
    for name, K, reference in zip(('Kq', 'Kv'), (result.Kq, result.Kv), exact, strict=True):
        scale = max(float(np.abs(reference).max()), 1e-300)
        np.testing.assert_allclose(
            K / scale, reference / scale, rtol=0.0, atol=tolerance, err_msg=f'{name} (scaled by its largest entry)'
        )


def check_action_reaction(element: Element, kin: Kinematics, *, tolerance: float = 1e-12, **arguments) -> None:
    """All forces, including those on the world, have no resultant and no moment about the origin of the world."""
    f = element.evaluate(kin, **arguments).f
    moments = np.cross(kin.p, f[:, :3]) + np.einsum('bij,bj->bi', kin.R, f[:, 3:])
    arm = 1.0 + float(np.abs(kin.p).max())
    scale = max(float(np.abs(f).max()) * arm, 1e-300)
    np.testing.assert_allclose(f[:, :3].sum(0) / scale, 0.0, atol=tolerance, err_msg='resultant force')
    np.testing.assert_allclose(moments.sum(0) / scale, 0.0, atol=tolerance, err_msg='resultant moment')


def check_power_balance(element: Element, kin: Kinematics, *, tolerance: float = 1e-11, **arguments) -> None:
    """f . v = -dE/dt - dissipation, with dE/dt along the motion v and zdot = (z - zp)/cz (cz > 0 needed with internal
    states)."""
    result = element.evaluate(kin, **arguments)
    z = result.z
    if len(z):
        zdot = (z - np.array(arguments['zp'])) / arguments['cz']
        arguments = {**arguments, 'zp': z + 1j * STEP * zdot, 'cz': 0.0}
    moved = element.evaluate(displaced(kin, kin.v[:-1], np.zeros_like(kin.v[:-1])), dtype=complex, **arguments)
    stored = float(moved.out[:, 0].sum().imag / STEP)
    power = float((result.f * kin.v).sum())
    lost = float(result.out[:, 1].sum())
    scale = float((np.abs(result.f) * np.abs(kin.v)).sum()) + abs(lost) + 1e-300
    np.testing.assert_allclose(
        (power + stored + lost) / scale, 0.0, atol=tolerance, err_msg='f.v + dE/dt + dissipation'
    )


def check_purity(element: Element, kin: Kinematics, **arguments) -> None:
    """Same arguments, same bits; arguments unwritten; f, Kq, Kv accumulated; z and out assigned; tangents do not change
    f."""
    before = [a.copy() for a in kin]  # where the call is not that of forcing(), which looks itself
    first = element.evaluate(kin, tangents=True, **arguments)
    again = element.evaluate(kin, tangents=True, **arguments)
    bare = element.evaluate(kin, tangents=False, **arguments)
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(first.f, bare.f)
    np.testing.assert_array_equal(first.out, bare.out)
    np.testing.assert_array_equal(first.z, bare.z)
    assert not np.any(bare.Kq) and not np.any(bare.Kv)
    for a, b in zip(before, kin, strict=True):
        np.testing.assert_array_equal(a, b)
    assert np.all(np.isfinite(first.out)), 'an output was not assigned'
    assert np.all(np.isfinite(first.z)), 'an internal state was not assigned'
    shifted = element.evaluate(kin, tangents=True, start=0.5, **arguments)
    for name in ('f', 'Kq', 'Kv'):
        value = getattr(first, name)
        scale = 1.0 + float(np.abs(value).max())
        np.testing.assert_allclose(
            (getattr(shifted, name) - 0.5) / scale,
            value / scale,
            rtol=0.0,
            atol=1e-14,
            err_msg=f'{name} is not accumulated',
        )


def check_states(element: Element, kin: Kinematics, *, tolerance: float = 1e-9, **arguments) -> None:
    """Internal states are solved with their own rate: z = zp + cz g(z), whatever the way that leads to z.

    The rate is (z - zp)/cz. A stage of any other length cz' that begins at z - cz' rate ends in the same z, so gives
    the same rate; an infinitesimal one begins at z itself. An explicit element, z = zp + cz g(zp), fails: it would make
    every step first order. The law also holds where g is set-valued (dry friction). `tolerance` is relative to |rate|
    and to the rounding of z in the shortest stage, 1e-3 cz: a residual of Newton's iteration within an element of 1e-12
    |z| passes, ten times the tolerance would still see an explicit element whose own time constant is 1e7 stages.
    """
    if not element.context.n_states or not arguments['cz']:
        return
    zp, cz = np.array(arguments['zp'], float), arguments['cz']
    z = element.evaluate(kin, **arguments).z
    rate = (z - zp) / cz
    for ratio in (1e-3, 0.5, 2.0):
        other = {**arguments, 'zp': z - ratio * cz * rate, 'cz': ratio * cz}
        again = (element.evaluate(kin, **other).z - other['zp']) / other['cz']
        scale = float((np.abs(rate) + 1e-3 * np.abs(z) / other['cz']).max()) + 1e-300
        np.testing.assert_allclose(
            again / scale,
            rate / scale,
            rtol=0.0,
            atol=tolerance,
            err_msg=f'rate of the internal states, in a stage {ratio} times as long',
        )


def check_contract(
    element: Element, kin: Kinematics, *, pair: bool = True, power: bool = True, tolerance: float = 1e-11, **arguments
) -> None:
    """All of the above. pair: action = reaction applies; power: the balance applies to all elements of the table
    together.

    tolerance: of tangents and power, relative; it is rounding, which cancellations inside of an element may raise.
    """
    check_purity(element, kin, **arguments)
    check_states(element, kin, **arguments)
    check_tangents(element, kin, tolerance=tolerance, **arguments)
    if pair:
        check_action_reaction(element, kin, **arguments)
    if power:
        check_power_balance(element, kin, tolerance=tolerance, **arguments)
