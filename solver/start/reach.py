"""Drivers that ask for more than a mechanism can do: which one, how far the mechanism goes, and which bars are in line
there.

A driver (a coupler with an input) is to blame where the mechanism closes without it and does not close at the value it
asks for. The end of its reach is found by bisection between the value that the mechanism has without it and the value
asked for. There the row of the driver depends on the other rows, so forces balance each other without a load: bars that
meet in a joint are in line (a dead centre), or the constraints with most of that force are named.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from solver.compiled.portable import norm, product
from solver.elements.coordinate import TRANSLATION
from solver.elements.coupler import CouplerSpec
from solver.elements.marker import WORLD, Marker
from solver.errors import ConsistencyError
from solver.model.evaluate import evaluate_constraints, prepare
from solver.model.frames import matrix
from solver.model.spec import ModelSpec
from solver.model.state import State, copy_state, kinematics_of, new_state
from solver.model.tables import Model
from solver.output.dependence import scaled_jacobian
from solver.start.newton import ConsistentState

AHEAD = 20  # steps that a driver is followed beyond a step that failed: near the end of its reach no step converges
HALVINGS = 30  # of the way between a value within reach and one beyond it
ITERATIONS = 100  # of one assembly
COARSEST = (
    # m or rad: spacing of the numbers about a value that is taken for one, at 4e9; ten times as much lets constraints
    # stay open
    1e-6
)
IN_LINE = 0.01  # sine between bars that are in line, at the end of a reach that is known to 1e-9 of the way to it
PARALLEL = 0.9999  # cosine of hinges that are parallel
LOADED = 0.2  # of the largest of the balanced forces, from which a constraint is named
# joints whose place says nothing about a direction in which a body is held
NO_BAR = ('prismatic', 'cylindrical', 'fixed', 'planar')


class _Bar(NamedTuple):
    """A place where two members meet: bodies, or joints that keep a distance. point: (3,) in the world [m]; axis: (3,)
    of a hinge, or 0."""

    point: np.ndarray
    axis: np.ndarray
    members: tuple[str, str]


def beyond_reach(model: Model, state: State, u: np.ndarray, h: float = 0.0) -> str:
    """The sentence about drivers that ask for more than the mechanism can do at the inputs u (nu,), or nothing. The
    state [m, rad] is left as it is. h: step [s] in which a driver goes on with its rate beyond u; 0 where it stands
    still."""
    drivers = [c for c in model.spec.couplers if c.input is not None]
    if not drivers:
        return ''
    wanted = u.copy()
    index = {name: k for k, name in enumerate(model.spec.inputs)}
    for c in drivers:
        channel = index[f'{c.input}']
        wanted[channel] += AHEAD * h * u[index[f'{c.input}_rate']]
        if np.spacing(abs(wanted[channel])) > COARSEST:
            asked, digits = f'{wanted[channel]:.4g} {_unit(model, c)}', f'{np.spacing(abs(wanted[channel])):.2g}'
            return (
                f'driver {c.name!r} asks for {c.input} = {asked}, whose last digit is worth {digits}; keep it below '
                '4e9, or check its unit'
            )
    if _closed(model, state, wanted) is not None:
        return ''
    found, names = [], []
    for driver in drivers:
        free = prepare(_without(model.spec, driver))
        start = _closed(free, state, wanted)
        if start is not None:
            names.append(f'driver {driver.name!r}')
            found.append(_end(model, driver, start, wanted, u, index[f'{driver.input}']))
    more = f'; it closes without {" or ".join(names[1:])} too: together they ask for too much' if names[1:] else ''
    return found[0] + more if found else ''


def _without(spec: ModelSpec, driver: CouplerSpec) -> ModelSpec:
    return type(spec)(**{**spec.__dict__, 'couplers': tuple(c for c in spec.couplers if c is not driver)})


def _closed(model: Model, state: State, u: np.ndarray) -> State | None:
    """The state nearest to this one that satisfies the constraints; None where there is none."""
    found = new_state(model)
    found.q[:], found.angle[:] = state.q, state.angle
    try:
        ConsistentState(model).assemble(found, u, limit=ITERATIONS)
    except ConsistencyError:
        return None
    return found if np.isfinite(found.q).all() else None


def _residuals(model: Model, state: State, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    phi, J = np.zeros(model.n_rows), np.zeros((model.n_entries + 1, 6, 6))
    evaluate_constraints(model.tables, kinematics_of(state.q, np.zeros_like(state.v)), state.angle, u, True, phi, J)
    return phi, J


def _end(model: Model, driver: CouplerSpec, start: State, wanted: np.ndarray, u: np.ndarray, channel: int) -> str:
    """Sentence on where the reach of a driver ends. start: closed without the driver, so that the residual of its row
    is how far it is from u."""
    row = model.row_names.index(driver.row_names()[0])
    at = wanted.copy()
    at[channel] += _residuals(model, start, wanted)[0][row]
    near, far, last = float(at[channel]), float(wanted[channel]), new_state(model)
    last.q[:], last.angle[:] = start.q, start.angle
    for _ in range(HALVINGS):
        at[channel] = 0.5 * (near + far)
        found = _closed(model, last, at)
        if found is None:
            far = float(at[channel])
        else:
            near = float(at[channel])
            copy_state(found, last)
    name, unit = driver.terms[0][0], _unit(model, driver)
    asks = f'asks for {driver.input} = {u[channel]:.4g} {unit}'
    if (u[channel] - near) * (wanted[channel] - near) <= 0.0:  # it is on its way there
        asks = f'moves on from {driver.input} = {u[channel]:.4g} {unit} to {far:.4g} {unit}'
    of = f' of {name!r}' if len(driver.terms) == 1 else ''
    rest = _in_line(model, last) or _locked(model, last, at, row)
    return (
        f'driver {driver.name!r} {asks}{of}, and the mechanism reaches {near:.4g} {unit} at most{rest}; keep '
        f'{driver.input} within its reach, or change the lengths'
    )


def _unit(model: Model, driver: CouplerSpec) -> str:
    return (
        'm' if model.tables.coordinates.kind[model.coordinate_names.index(driver.terms[0][0])] == TRANSLATION else 'rad'
    )


def _in_line(model: Model, state: State) -> str:
    """Members that meet in a joint and are in line, in words."""
    bars, found = _bars(model, state), []
    for joint in bars:
        a, b = joint.members
        if WORLD in joint.members:
            continue
        for first, second in itertools.product(bars, bars):
            if (
                first is joint
                or second is joint
                or first is second
                or a not in first.members
                or b not in second.members
            ):
                continue
            d, e = first.point - joint.point, second.point - joint.point
            # of planar loops the distances across count
            if min(abs(joint.axis @ first.axis), abs(joint.axis @ second.axis)) > PARALLEL:
                d, e = d - joint.axis * (joint.axis @ d), e - joint.axis * (joint.axis @ e)
            if min(norm(d), norm(e)) > 1e-9 and norm(np.cross(d, e)) < IN_LINE * norm(d) * norm(e):
                found.append((a, b))
                break
    pairs = [f'{a!r} and {b!r}' for a, b in dict.fromkeys(found)]
    return f', where {", and ".join(pairs)} are in line' if pairs else ''


def _bars(model: Model, state: State) -> list[_Bar]:
    """All places where members meet."""
    at = {name: (state.q[k, :3], kinematics_of(state.q, state.v).R[k]) for k, name in enumerate(model.body_names)}
    com = {body.name: np.array(body.com) for body in model.spec.bodies}

    def place(marker: Marker) -> np.ndarray:
        if marker.body == WORLD:
            return np.array(marker.position)
        p, R = at[marker.body]
        return p + product(R, np.array(marker.position) - com[marker.body])

    bars, none = [], np.zeros(3)
    for joint in model.spec.joints:
        if joint.kind == 'distance':
            bars += [
                _Bar(place(joint.i), none, (joint.i.body, joint.name)),
                _Bar(place(joint.j), none, (joint.name, joint.j.body)),
            ]
        elif joint.kind not in NO_BAR:
            R = np.eye(3) if joint.i.body == WORLD else at[joint.i.body][1]
            axis = product(R, matrix(joint.i.orientation)[:, 2]) if joint.kind == 'revolute' else none
            bars.append(_Bar(place(joint.i), axis, (joint.i.body, joint.j.body)))
    return bars


def _locked(model: Model, state: State, u: np.ndarray, row: int) -> str:
    """The constraints whose forces balance each other and the driver's at the end of its reach, in words."""
    A = scaled_jacobian(model, _residuals(model, state, u)[1])
    others = np.delete(np.arange(model.n_rows), row)
    force = np.abs(np.linalg.lstsq(A[others].T, A[row], rcond=1e-6)[0])
    names = dict.fromkeys(
        model.row_names[others[k]].partition('/')[0] for k in np.argsort(-force) if force[k] > LOADED * force.max()
    )
    return f', where the constraints {", ".join(map(repr, list(names)[:4]))} hold it' if names else ''
