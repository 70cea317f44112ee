"""One file per physical concept: specification, table, kernel and output columns.

The contract of a force element, the same for every kind (see docs/contributing.md):

    <kind>_forces(table, now, effects, out)

`now` (solver.elements.instant.Instant) is never written; of `effects` (Effects) f, Kq and Kv are accumulated into and z
is assigned, as is `out`, a row of columns for each element. The first two output columns of every kind are `energy` [J]
(potential, NaN-free) and `dissipation` [W] (power taken out of the mechanics, >= 0 when passive; power delivered by
inputs is negative).
"""
