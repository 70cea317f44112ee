"""Numbers of several simulations at once, one in each lane of a SIMD vector, for the kernels that step a single one.

Kernels are written for float64, and run on complex and dual numbers too (solver.compiled.dual). With the types of this
folder they run on LANES simulations: number.py (a number of each, a truth value of each), arrays.py (arrays of them,
the lane innermost), functions.py (elementary functions), agreement.py (branches), mirror.py (tables, states and scratch
of several simulations as one), transfer.py (what is copied between both).

Arithmetic is done lane by lane in the same order, elementary functions are those of the C library, called for one lane
after the other. So every lane has the bits of its single run. Where a kernel branches on numbers, all lanes take the
branch that most of them ask for, and those that ask for the other one are noted: their numbers are void from there on,
and they take that step alone (solver.engine.lanes). `where` (solver.compiled.select) chooses for every lane by itself.

The cache of kernels knows these files by the names of the types, so an edit of them compiles no kernel of a single
simulation anew. Nothing imports this folder before an Ensemble is made.
"""

LANES = 8
