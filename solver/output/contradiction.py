"""Redundant rows that contradict each other: noted in the running account, of every step that has one."""

from __future__ import annotations

from solver.compiled.kernel import kernel
from solver.output.energy import WRITTEN, exchanged_so_far, note

CLOSED = 1e-11  # lengths of the model, or rad; with ten times as much axes that are out by 1e-10 would not be told
BALANCED = 0.03  # of forces: what those that balance each other may leave


@kernel(borrow=True)
def note_contradiction(constraints, J, lam, phi, length, net, gross, account):
    """Note the largest energy [J] of multipliers lam (nc,) that balance each other, in the rows that they cannot close,
    phi (nc,) open, at the Jacobian blocks J, with the row that has most of it. net, gross (nb + 1, 6) are scratch.

    Forces are added up only where that energy is the largest so far and above what numbers leave open, which it is in
    no sound run.
    """
    energy, most, row = 0.0, 0.0, 0
    for i in range(lam.shape[0]):
        if constraints.holonomic[i] == 1 and abs(phi[i]) > CLOSED * length:
            own = abs(lam[i] * phi[i])
            energy += own
            if own > most:
                most, row = own, i
    if not energy > max(account.contradiction[0], WRITTEN * exchanged_so_far(account)):
        return
    net[:] = 0.0
    gross[:] = 0.0
    for g in range(constraints.row.shape[0] - 1):
        first = constraints.row[g]
        for e in range(constraints.entry[g], constraints.entry[g + 1]):
            b = constraints.body[e]
            for r in range(constraints.row[g + 1] - first):
                for k in range(6):
                    force = J[e, r, k] * lam[first + r]
                    net[b, k] += force
                    gross[b, k] += abs(force)
    left, all_ = 0.0, 0.0
    for b in range(net.shape[0] - 1):
        for k in range(6):
            left, all_ = max(left, abs(net[b, k])), max(all_, gross[b, k])
    if left < BALANCED * all_:
        note(account.contradiction, energy, account.time[0], row)
