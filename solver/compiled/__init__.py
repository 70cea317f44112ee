"""What compiled code is made of: the decorator of kernels, tables by reference, and arithmetic on vectors, rotations and duals."""
