"""Links and control arms without mass: bodies with a bushing or a joint at one end and a ball joint at the other.

A link between ideal joints becomes a distance joint. A link in a bushing can swing about the bushing in two directions.
It becomes one rod (solver.elements.rod): along its line with the stiffness of the bushing, and with the resistance of
the bushing to the swing. A control arm can swing about the axis of its bushing only. Its stiffness at the ball joint,
in the plane of axis and ball, is a 2x2 matrix. Two rods from the axis to the ball have exactly that matrix. The mass of
the body goes to the bodies at its ends (Draft.share).

In this file a is the place of the bushing or joint, which holds the body `near`, and b that of the ball joint, which
holds the body `far`, both (3,) [m] in the design frame. C is the compliance (3, 3) [m/N] of the bushing, felt at b.
"""

from __future__ import annotations

import math

import numpy as np

from solver.compiled.portable import norm, product
from solver.elements.bushing import BushingSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.rod import RodSpec
from solver.levels.compliance import at_arm, in_series, increasing, rates, solved
from solver.levels.draft import Draft, Hold, three, unit
from solver.model.frames import frame_of_axis

# Stiffness at b across the line a-b, relative to the stiffness along it: a direction that is softer swings freely. With
# ten times as much, stiff arms with soft bushings would become links.
SOFT = 0.01
HANGING = ('spherical', 'universal')  # kinds of ideal joints about which a link swings


def massless_links(draft: Draft) -> None:
    """Replace all links and control arms of a model by rods or distance joints, in place."""
    for body in list(draft.bodies):
        ends = _two_ends(draft, body)
        if ends is not None and body != draft.chassis:
            _replace(draft, body, *ends)


def _two_ends(draft: Draft, body: str) -> tuple[Hold, Hold] | None:
    """(marker of the bushing or joint, marker of the ball joint) of a body that has these two markers and no others,
    else None."""
    holds = draft.holds(body)
    if len(holds) != 2 or holds[0].name == holds[1].name:
        return None
    balls = [h for h in holds if h.section == 'joints' and draft.spec(h).kind == 'spherical']
    others = [h for h in holds if h not in balls[:1]]
    if not balls or len(others) != 1:
        return None
    hanging = others[0]
    ideal = hanging.section == 'joints' and draft.spec(hanging).kind in HANGING
    return (hanging, balls[0]) if ideal or hanging.section == 'bushings' else None


def _replace(draft: Draft, body: str, hanging: Hold, ball: Hold) -> None:
    """Replace one body, if it is a link or an arm. hanging, ball: its markers from _two_ends()."""
    near, far = draft.other(hanging).body, draft.other(ball).body
    a, R = draft.placed(draft.spec(hanging).i)
    b = draft.placed(draft.other(ball)).p
    spec = draft.spec(hanging)
    about: np.ndarray | None = None
    if hanging.section == 'joints':
        joint = JointSpec(
            name=body, kind='distance', i=draft.marker(near, a), j=draft.marker(far, b), length=norm(b - a)
        )
        parts: list[RodSpec] = []
    else:
        joint = None
        about, parts = _rods(draft, body, spec, near, far, a, b, R)
        if not parts:
            return
    draft.drop(hanging.section, hanging.name)
    draft.drop(ball.section, ball.name)
    draft.share(body, near, a, far, b, about)
    if joint is not None:
        draft.put('joints', joint)
    for rod in parts:
        draft.put('rods', rod)
    draft.lose(f'vibration of {body} by itself')


def _rods(
    draft: Draft, body: str, spec: BushingSpec, near: str, far: str, a: np.ndarray, b: np.ndarray, R: np.ndarray
) -> tuple[np.ndarray | None, list[RodSpec]]:
    """(unit vector of the axis about which an arm swings, or None for a link; the rods). No rods: it is neither."""
    if any(spec.preload):
        return None, []
    k, c = rates(spec), np.array(spec.damping)
    C = at_arm(k, R, b - a)
    # damping over stiffness [s] of the bushing: of its soft rotations, of its stiff translations
    loss = float((c / k)[3:].min()), float(np.median((c / k)[:3]))
    u = unit(b - a)
    stiff = 1.0 / float(product(u, product(C, u)))
    frame = _swing_frame(u, solved(C))
    across = [float(product(e, product(solved(C), e))) for e in frame.T[:2]]
    if max(across) < SOFT * stiff:
        return None, [_link(draft, body, spec, near, far, a, b, R, C, frame, loss)]
    if min(across) < SOFT * stiff:
        axis = R[:, int(np.argmin(k[3:]))]
        return axis, _arm(draft, body, near, far, a, b, axis, C, loss)
    return None, []


def _swing_frame(u: np.ndarray, K: np.ndarray) -> np.ndarray:
    """(3, 3) axes: z along u; x and y across it, as principal axes of the stiffness K, so that K_xy = 0."""
    F = frame_of_axis(three(u))
    xx, yy, xy = (float(product(F[:, p], product(K, F[:, q]))) for p, q in ((0, 0), (1, 1), (0, 1)))
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy) if abs(xy) > 1e-12 * (xx + yy) else 0.0
    s, t = math.cos(angle), math.sin(angle)
    return np.stack([s * F[:, 0] + t * F[:, 1], s * F[:, 1] - t * F[:, 0], F[:, 2]], axis=1)


def _link(
    draft: Draft, body: str, spec: BushingSpec, near: str, far: str, a: np.ndarray, b: np.ndarray, R: np.ndarray,
    C: np.ndarray,
    F: np.ndarray, loss: tuple[float, float],
) -> RodSpec:  # fmt: skip
    """The rod of a link. Its law is that of the three translations of the bushing in series; it swings about x and y of
    F (3, 3)."""
    length = norm(b - a)
    u = F[:, 2]
    laws = [
        (law or Law.linear(rate), float(product(R[:, q], u)))
        for q, (law, rate) in enumerate(zip(spec.laws[:3], rates(spec)[:3], strict=True))
    ]
    if all(increasing(law) for law, _ in laws):
        law = in_series(laws)
    else:
        law = Law.linear(1.0 / float(product(u, product(C, u))))
        draft.lose(f'the nonlinear law of {spec.name}')
    across = [1.0 / float(product(e, product(C, e))) for e in F.T[:2]]
    rate = 1.0 / float(product(u, product(C, u)))
    return RodSpec(
        name=body, i=draft.marker(near, a, F), j=draft.marker(far, b), length=length, law=law, damping=loss[1] * rate,
        swing=(across[1] * length * length, across[0] * length * length),
        across=loss[0] * 0.5 * (across[0] + across[1]),
    )  # fmt: skip


def _arm(
    draft: Draft,
    body: str,
    near: str,
    far: str,
    a: np.ndarray,
    b: np.ndarray,
    axis: np.ndarray,
    C: np.ndarray,
    loss: tuple[float, float],
) -> list[RodSpec]:
    """The two rods of an arm, from the axis (unit vector) to the ball joint.

    Their directions n_1 and n_2 are conjugate, n_1 C n_2 = 0. So k_1 n_1 n_1^T + k_2 n_2 n_2^T with k = 1/(n C n) is
    the inverse of C in the plane of axis and ball.
    """
    arm = b - a
    shift = float(product(axis, arm))
    radial = arm - shift * axis
    r = norm(radial)
    e = radial / r
    out = np.cross(axis, e)
    aa, rr, ar = (float(product(p, product(C, q))) for p, q in ((axis, axis), (e, e), (axis, e)))
    half = math.sqrt(max(shift * shift + (2.0 * ar * shift * r + rr * r * r) / aa, 1e-6))
    swinging = 1.0 / float(product(out, product(C, out)))
    found = []
    for k, sign in enumerate((1.0, -1.0)):
        foot = a + sign * half * axis
        d = b - foot
        length = norm(d)
        n = d / length
        rate = 1.0 / float(product(n, product(C, n)))
        F = np.stack([out, np.cross(n, out), n], axis=1)  # swing towards `out` is a turn about y
        found.append(
            RodSpec(
                name=f'{body}_{k + 1}', i=draft.marker(near, foot, F), j=draft.marker(far, b), length=length,
                law=Law.linear(rate),
                damping=loss[1] * rate, swing=(0.0, 0.5 * swinging * length * length), across=loss[0] * 0.5 * swinging,
            )
        )  # fmt: skip
    return found
