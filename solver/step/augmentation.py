"""Augmentations combined: the solution of an iteration with multipliers that close the constraints, at the cost of a
few substitutions.

One augmentation of the saddle system (solver.model.saddle) leaves t = g + A dw = -dlam / W of the violation g. It takes
off a part xi s / (1 + xi s) of a mode of the constraints with the eigenvalue s (docs/formulation.md): nearly all of it
as a rule, nearly nothing where bodies hold each other, a light one carries a heavy one, or something stiff acts on a
light part. A further augmentation, of the violation that is left, gives increments with balanced momentum that change
the constraints by a known image P t. The combination of these that leaves the smallest violation, each row weighed by
its penalty, is found by generalized conjugate residuals, which are GMRES [Saad1986] with the directions kept: as many
as there are slow modes. They hold for as long as the factorization does, so the iterations of a step and the projection
of its velocity share them.

*Directions that may be none.* Rows that depend on each other where constraints are closed do not quite where they are
open: a linkage of which a body is turned by d off its path sees its redundant directions with s of about d^2. The
violation that they seem to leave at the prediction is the curvature of the constraints; closing it takes multipliers
that mean nothing and move the linkage along its path. Next to a singular position a direction is as weak, but must be
held. Which of both it is shows in the iterate without the combination: the violation there is smaller than at the
prediction, or larger. So directions with an image below xi d^2 are tried so, and taken back in (restore) where it has
grown.

*A step that ends in a singular position.* Where the end of a step does not see a direction at all (its image is
dropped), nothing holds it over the step but the multipliers from before, whose force along the rows of the stage is not
what it was: they grow as the inverse of what the rows see. The stage does see the direction, half a step from the
singular position, so such a step is made with its rows in the matrix in place of those of the end
(solver.step.iteration_fixed): the acceleration goes on as predicted, and multipliers follow that make it so.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.by_reference import matrix_at
from solver.compiled.kernel import kernel
from solver.compiled.memory import zeros
from solver.compiled.select import some, where
from solver.model.evaluate import constraint_rates
from solver.model.saddle import CONDENSED, solve_saddle
from solver.output.undetermined import kinetic
from solver.step.stage import largest_turn

# Directions that are kept; ten times as many take ten times the memory, and a hundred times the products.
MOST_DIRECTIONS = 12
# part of the violation at the prediction that an iteration of mode fixed may leave; of the velocity, its projection
ENOUGH = 1e-4
CONTRACTION = 1e-2  # part of its own violation, and of the tolerance, that an iteration of mode tolerance may leave
HELD = 1e-11  # relative velocity over the step; what violates less is rounding
# Of the largest multiplier in the step before one that ends in a singular position: at least 5/3 (rho_inf 1: forces of
# the middle).
GROWTH = 1.4
# relative to the violation; less is a direction that the constraints cannot hold: it is left to its inertia
SMALLEST_IMAGE = 1e-4
BETTER = 2.0  # times, that a stage must see what its rows would hold as the end does


class Augmentation(NamedTuple):
    """Directions of one factorization, and scratch; nothing in it survives a step.

    Directions lie one behind the other in vectors: compiled code has the inner sizes of an array as constants, and must
    be the same for models of all sizes.
    """

    image: np.ndarray  # (MOST_DIRECTIONS * nc,) -A dw of every direction; orthonormal, weighed by the penalties
    dw: np.ndarray  # (MOST_DIRECTIONS * (nb + 1) * 6,)
    dlam: np.ndarray  # (MOST_DIRECTIONS * nc,)
    known: np.ndarray  # (1,) directions so far
    worth: np.ndarray  # (MOST_DIRECTIONS,) image of each, relative to the violation that it was made for
    part: np.ndarray  # (MOST_DIRECTIONS,) of each in the last combination
    tried: np.ndarray  # (MOST_DIRECTIONS,) the same, of one that was only looked at
    withheld: np.ndarray  # (1,) directions of the last combination, if the iterate was left without it
    dropped: np.ndarray  # (1,) 1 when the last combination met a direction without an image
    by_stage: np.ndarray  # (1,) 1 when the factorization has the rows of the stage
    violation: np.ndarray  # (1,) sum W g^2 that was measured last
    left: np.ndarray  # (nc,) violation
    row_length: np.ndarray  # (nc,) what makes a length [m] of the residual of a row (solver.step.work)
    zero: np.ndarray  # (nb + 1, 6)


def new_augmentation(model, row_length: np.ndarray) -> Augmentation:
    """Allocate for a model; row_length (nc,): see Augmentation."""
    n, nb, nc = MOST_DIRECTIONS, model.n_bodies, model.n_rows
    return Augmentation(
        zeros(n * nc),
        zeros(n * (nb + 1) * 6),
        zeros(n * nc),
        zeros(1, int),
        zeros(n),
        zeros(n),
        zeros(n),
        zeros(1, int),
        zeros(1, int),
        zeros(1, int),
        zeros(1),
        zeros(nc),
        row_length,
        zeros((nb + 1, 6)),
    )


@kernel(inner=True)
def begin_augmentation(augmentation):
    """Forget the directions: they were those of another factorization."""
    augmentation.known[0] = 0
    augmentation.withheld[0] = 0


@kernel(inner=True)
def weighed(W, x, y):
    """sum of W x y, in four partial sums, because a sum waits for the one before."""
    n = W.shape[0] // 4
    U, a, b = matrix_at(W, 0, n, 4), matrix_at(x, 0, n, 4), matrix_at(y, 0, n, 4)  # rows of four are loaded at once
    one, two, three, four = 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        one += U[k, 0] * a[k, 0] * b[k, 0]
        two += U[k, 1] * a[k, 1] * b[k, 1]
        three += U[k, 2] * a[k, 2] * b[k, 2]
        four += U[k, 3] * a[k, 3] * b[k, 3]
    for i in range(4 * n, W.shape[0]):
        one += W[i] * x[i] * y[i]
    return (one + two) + (three + four)


@kernel(inline=True)
def _direction(augmentation, k):
    """(image (nc,), dw (nb + 1, 6), dlam (nc,)) of direction k."""
    nc, n = augmentation.left.shape[0], augmentation.zero.shape[0]
    first, last = k * nc, (k + 1) * nc
    return augmentation.image[first:last], matrix_at(augmentation.dw, 6 * n * k, n, 6), augmentation.dlam[first:last]


@kernel(inner=True)
def _add(augmentation, k, factor, dw, dlam):
    """dw and dlam += factor times direction k."""
    _, source, multipliers = _direction(augmentation, k)
    for b in range(source.shape[0]):
        for i in range(6):
            dw[b, i] += factor * source[b, i]
    for i in range(dlam.shape[0]):
        dlam[i] += factor * multipliers[i]


@kernel(inner=True)
def _new_direction(tables, form, saddle, augmentation, size):
    """Append the direction that augments augmentation.left, of the given weighed size; whether it has an image worth
    it."""
    k = augmentation.known[0]
    W = saddle.W
    image, dw, dlam = _direction(augmentation, k)
    solve_saddle(tables, form, saddle, augmentation.zero, augmentation.left, dw, dlam)
    for i in range(W.shape[0]):
        image[i] = augmentation.left[i] + dlam[i] / W[i]
    for j in range(k):
        other, _, _ = _direction(augmentation, j)
        part = weighed(W, other, image)
        for i in range(W.shape[0]):
            image[i] -= part * other[i]
        _add(augmentation, j, -part, dw, dlam)
    length = np.sqrt(weighed(W, image, image))
    if not length > SMALLEST_IMAGE * size:
        return False
    augmentation.worth[k] = length / size
    for i in range(W.shape[0]):
        image[i] /= length
        dlam[i] /= length
    for b in range(dw.shape[0]):
        for i in range(6):
            dw[b, i] /= length
    augmentation.known[0] = k + 1
    return True


@kernel(inner=True)
def combine(tables, form, saddle, augmentation, measure, share, smallest, g, dw, dlam):
    """Add to dw (nb + 1, 6) and dlam (nc,), the solution for the violation g (nc,) that solve_saddle just gave,
    combined augmentations if it leaves more than `share` of the violation that was measured last, and more than
    `smallest` [m/s^2] in every row.

    measure: g is that violation. Violations are sums of W g^2, and so is share. augmentation.known belongs to the
    factorization. Returns how many directions that took; augmentation.dropped says whether one was left.
    """
    W, t = saddle.W, saddle.t
    augmentation.dropped[0] = 0
    if form != CONDENSED:
        for i in range(dlam.shape[0]):
            t[i] = -dlam[i] / W[i]
    if measure:
        augmentation.violation[0] = weighed(W, g, g)
    enough = share * augmentation.violation[0]
    if weighed(W, t, t) > enough:
        return _combine(tables, form, saddle, augmentation, enough, smallest, dw, dlam, augmentation.part)
    return 0


@kernel(inner=True)
def _rates(constraints, J, T, dw, scratch, rate):
    """rate (nc,) = J T dw, of increments dw (nb + 1, 6) whose turns T (nb, 3, 3) takes to where J is; scratch (nb + 1,
    6) is lost."""
    for b in range(dw.shape[0] - 1):
        turned = T[b]
        for i in range(3):
            scratch[b, i] = dw[b, i]
            scratch[b, 3 + i] = turned[i, 0] * dw[b, 3] + turned[i, 1] * dw[b, 4] + turned[i, 2] * dw[b, 5]
    constraint_rates(constraints, J, scratch, rate)


@kernel(borrow=True)
def is_unseen(tables, form, saddle, augmentation, J_stage, T_stage, g, dw, scratch, lam_scratch):
    """True where the increment dw (nb + 1, 6), which closes the violation g (nc,) at the end of the step, goes along a
    direction that the rows of the stage see and those of the factorization do not. scratch (nb + 1, 6) and lam_scratch
    (nc,) are lost.
    """
    t, known = saddle.t, augmentation.known[0]
    _rates(tables.constraints, J_stage, T_stage, dw, scratch, t)
    for i in range(g.shape[0]):
        t[i] += g[i]
    augmentation.dropped[0] = 0
    _combine(
        tables,
        form,
        saddle,
        augmentation,
        ENOUGH * ENOUGH * weighed(saddle.W, t, t),
        0.0,
        scratch,
        lam_scratch,
        augmentation.tried,
    )
    augmentation.known[0] = known  # the projection of velocities need not try them
    return augmentation.dropped[0] == 1


@kernel(borrow=True)
def holds_more(tables, saddle, augmentation, work, dw, before):
    """True where the stage sees the change that its rows made of the increment `before` (nb + 1, 6), to dw, BETTER than
    the end does; before is lost."""
    for b in range(dw.shape[0] - 1):
        for i in range(6):
            before[b, i] = dw[b, i] - before[b, i]
    _rates(tables.constraints, work.J_stage, work.T_stage, before, work.f, saddle.t)
    _rates(tables.constraints, work.J_end, work.T_end, before, work.f, augmentation.left)
    at_end = weighed(saddle.W, augmentation.left, augmentation.left)
    return weighed(saddle.W, saddle.t, saddle.t) > BETTER * BETTER * at_end


@kernel(inner=True)
def grew(lam, before):
    """True where the largest multiplier grew as it does before a singular position: as one over the distance to it."""
    most, then = 0.0, 0.0
    for i in range(lam.shape[0]):
        larger = abs(lam[i]) > most
        if some(larger):
            most, then = where(larger, abs(lam[i]), most), where(larger, abs(before[i]), then)
    return bool(most > 0.0 and most > GROWTH * then)


@kernel(inner=True)
def withhold(augmentation, used, penalty, scale, dw, dlam):
    """Take the last combination, of `used` directions, off dw and dlam again if one of them may be none (module);
    whether it was.

    scale: turn of a body over the increment of its angular acceleration in dw [s^2], penalty: of every row.
    """
    turn, least, most = 0.0, augmentation.worth[0], 0.0
    for b in range(dw.shape[0] - 1):
        turn = max(turn, largest_turn(dw, b))
    for k in range(used):
        least = min(least, augmentation.worth[k])
    for i in range(penalty.shape[0]):
        most = max(most, penalty[i])
    doubtful = least < most * scale * scale * turn * turn
    if doubtful:
        _add_parts(augmentation, used, -1.0, dw, dlam)
        augmentation.withheld[0] = used
    return doubtful


@kernel(inner=True)
def _add_parts(augmentation, used, sign, dw, dlam):
    """dw (nb + 1, 6) and dlam (nc,) += sign times what the last combination had of its directions."""
    for k in range(used):
        _add(augmentation, k, sign * augmentation.part[k], dw, dlam)


@kernel(inner=True)
def restore(augmentation, share, a, lam):
    """Add a share of the combination that was withheld to the iterate a (nb + 1, 6), lam (nc,) after all."""
    _add_parts(augmentation, augmentation.withheld[0], share, a, lam)
    augmentation.withheld[0] = 0


@kernel(inner=True)
def _combine(tables, form, saddle, augmentation, enough, smallest, dw, dlam, parts):
    """Add to dw and dlam what closes the violation saddle.t that they leave, parts (MOST_DIRECTIONS,) of the
    directions. Returns how many that took."""
    W = saddle.W
    left = augmentation.left
    floor = 0.0
    for i in range(W.shape[0]):
        left[i] = saddle.t[i]
        least = smallest / augmentation.row_length[i]
        floor += W[i] * least * least
    enough = max(enough, floor)
    size = weighed(W, left, left)
    used = 0
    for k in range(MOST_DIRECTIONS):
        if not size > enough:
            break
        if k == augmentation.known[0] and not _new_direction(tables, form, saddle, augmentation, np.sqrt(size)):
            augmentation.dropped[0] = 1
            break
        image, _, _ = _direction(augmentation, k)
        part = weighed(W, image, left)
        for i in range(W.shape[0]):
            left[i] -= part * image[i]
        _add(augmentation, k, part, dw, dlam)
        parts[k] = part
        used = k + 1
        size = weighed(W, left, left)
    return used


@kernel(borrow=True)
def opposed(tables, J_s, J_e, dlam, r, f):
    """True where the change dlam (nc,) of the multipliers makes more than half of the momentum residual r (nb + 1, 6)
    by acting along J_s, the force directions of the stage, instead of J_e, those that the matrix has; f (nb + 1, 6) is
    scratch.

    So it is next to a singular position, where a constraint sees the free direction with opposite signs at the stage
    and at the end. A stop that is hit or a wheel that lands makes an iteration grow too, but by its own force.
    """
    con = tables.constraints
    for b in range(f.shape[0]):
        for i in range(6):
            f[b, i] = 0.0
    for g in range(con.row.shape[0] - 1):
        first = con.row[g]
        for e in range(con.entry[g], con.entry[g + 1]):
            for k in range(con.row[g + 1] - first):
                for i in range(6):
                    f[con.body[e], i] += dlam[first + k] * (J_s[e, k, i] - J_e[e, k, i])
    return kinetic(tables, f) > 0.25 * kinetic(tables, r)
