"""What compiled code is made of: the decorator of kernels, tables by reference, and arithmetic on vectors, rotations and duals."""

import os

os.environ['NUMBA_DISABLE_INTEL_SVML'] = '1'  # before numba is imported: only some machines have it, and its sin, exp, ... are its own
