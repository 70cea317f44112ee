"""One file per physical concept: specification, table, kernel and output columns.

The contract of a force element, the same for every kind (see docs/contributing.md):

    <kind>_forces(table, laws, kin, zp, cz, u, tangents, f, Kq, Kv, z, out)

Inputs are never written; `f`, `Kq`, `Kv` are accumulated into, `z` and `out` are assigned. The first two output columns of
every kind are `energy` [J] (potential, NaN-free) and `dissipation` [W] (power taken out of the mechanics, >= 0 when passive;
power delivered by inputs is negative).
"""
