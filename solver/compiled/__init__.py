"""Parts of compiled code: the decorator of kernels, tables by reference, and arithmetic on vectors, rotations and
duals."""
