"""Three-vectors and 3x3 matrices as tuples: pure values that live in registers.

Vectors are 3-tuples, matrices 9-tuples in row-major order, real or complex (complex only for complex-step derivatives,
so nothing here conjugates).
"""

from __future__ import annotations

from solver.compiled.kernel import kernel


@kernel(inline=True)
def load3(a, i):
    """Row i of an (n, >=3) array as a vector."""
    return (a[i, 0], a[i, 1], a[i, 2])


@kernel(inline=True)
def load33(a, i):
    """Matrix i of an (n, 3, 3) array."""
    return (a[i, 0, 0], a[i, 0, 1], a[i, 0, 2], a[i, 1, 0], a[i, 1, 1], a[i, 1, 2], a[i, 2, 0], a[i, 2, 1], a[i, 2, 2])


@kernel(inline=True)
def store33(a, i, m):
    """Assign m to matrix i of an (n, 3, 3) array."""
    a[i, 0, 0], a[i, 0, 1], a[i, 0, 2] = m[0], m[1], m[2]
    a[i, 1, 0], a[i, 1, 1], a[i, 1, 2] = m[3], m[4], m[5]
    a[i, 2, 0], a[i, 2, 1], a[i, 2, 2] = m[6], m[7], m[8]


@kernel(inline=True)
def add(a, b):
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@kernel(inline=True)
def sub(a, b):
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@kernel(inline=True)
def scale(s, a):
    return (s * a[0], s * a[1], s * a[2])


@kernel(inline=True)
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel(inline=True)
def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel(inline=True)
def mv(m, a):
    """Matrix times vector."""
    return (
        m[0] * a[0] + m[1] * a[1] + m[2] * a[2],
        m[3] * a[0] + m[4] * a[1] + m[5] * a[2],
        m[6] * a[0] + m[7] * a[1] + m[8] * a[2],
    )


@kernel(inline=True)
def tmv(m, a):
    """Transposed matrix times vector."""
    return (
        m[0] * a[0] + m[3] * a[1] + m[6] * a[2],
        m[1] * a[0] + m[4] * a[1] + m[7] * a[2],
        m[2] * a[0] + m[5] * a[1] + m[8] * a[2],
    )


@kernel(inline=True)
def col(m, k):
    """Column k of a matrix."""
    if k == 0:
        return (m[0], m[3], m[6])
    if k == 1:
        return (m[1], m[4], m[7])
    return (m[2], m[5], m[8])


@kernel(inline=True)
def row(m, k):
    """Row k of a matrix."""
    if k == 0:
        return (m[0], m[1], m[2])
    if k == 1:
        return (m[3], m[4], m[5])
    return (m[6], m[7], m[8])


@kernel(inline=True, inner=False)
def mm(a, b):
    """Matrix product a b."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
        a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
        a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
        a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )


@kernel(inline=True)
def transpose(m):
    return (m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8])


@kernel(inline=True)
def tmm(a, b):
    """Product a^T b."""
    return mm(transpose(a), b)


@kernel(inline=True)
def mmt(a, b):
    """Product a b^T."""
    return mm(a, transpose(b))


@kernel(inline=True)
def madd(a, b):
    return (
        a[0] + b[0],
        a[1] + b[1],
        a[2] + b[2],
        a[3] + b[3],
        a[4] + b[4],
        a[5] + b[5],
        a[6] + b[6],
        a[7] + b[7],
        a[8] + b[8],
    )


@kernel(inline=True)
def mscale(s, a):
    return (s * a[0], s * a[1], s * a[2], s * a[3], s * a[4], s * a[5], s * a[6], s * a[7], s * a[8])


@kernel(inline=True)
def outer(a, b):
    """Dyad a b^T."""
    return (
        a[0] * b[0],
        a[0] * b[1],
        a[0] * b[2],
        a[1] * b[0],
        a[1] * b[1],
        a[1] * b[2],
        a[2] * b[0],
        a[2] * b[1],
        a[2] * b[2],
    )


@kernel(inline=True, inner=False)
def skew(a):
    """Matrix of the cross product: skew(a) b = a x b."""
    z = 0.0 * a[0]
    return (z, -a[2], a[1], a[2], z, -a[0], -a[1], a[0], z)


@kernel(inline=True, inner=False)
def cross_m(a, m):
    """Matrix skew(a) m without the products by zero."""
    return (
        a[1] * m[6] - a[2] * m[3], a[1] * m[7] - a[2] * m[4], a[1] * m[8] - a[2] * m[5],
        a[2] * m[0] - a[0] * m[6], a[2] * m[1] - a[0] * m[7], a[2] * m[2] - a[0] * m[8],
        a[0] * m[3] - a[1] * m[0], a[0] * m[4] - a[1] * m[1], a[0] * m[5] - a[1] * m[2],
    )  # fmt: skip


@kernel(inline=True, inner=False)
def m_cross(m, a):
    """Matrix m skew(a) without the products by zero."""
    return (
        m[1] * a[2] - m[2] * a[1], m[2] * a[0] - m[0] * a[2], m[0] * a[1] - m[1] * a[0],
        m[4] * a[2] - m[5] * a[1], m[5] * a[0] - m[3] * a[2], m[3] * a[1] - m[4] * a[0],
        m[7] * a[2] - m[8] * a[1], m[8] * a[0] - m[6] * a[2], m[6] * a[1] - m[7] * a[0],
    )  # fmt: skip


@kernel(inline=True)
def cross_cross(a, b):
    """Matrix skew(a) skew(b) = b a^T - (a . b) 1."""
    s = dot(a, b)
    return (
        b[0] * a[0] - s, b[0] * a[1], b[0] * a[2],
        b[1] * a[0], b[1] * a[1] - s, b[1] * a[2],
        b[2] * a[0], b[2] * a[1], b[2] * a[2] - s,
    )  # fmt: skip


@kernel(inline=True)
def msub(a, b):
    return (
        a[0] - b[0],
        a[1] - b[1],
        a[2] - b[2],
        a[3] - b[3],
        a[4] - b[4],
        a[5] - b[5],
        a[6] - b[6],
        a[7] - b[7],
        a[8] - b[8],
    )


@kernel(inline=True)
def put33(blocks, s, r, c, m):
    """Add matrix m to blocks[s, r:r+3, c:c+3]."""
    for i in range(3):
        blocks[s, r, c + i] += m[i]
        blocks[s, r + 1, c + i] += m[3 + i]
        blocks[s, r + 2, c + i] += m[6 + i]


@kernel(inline=True)
def put66(blocks, s, a, b, c, d):
    """Add the matrix [[a, b], [c, d]] of 3x3 matrices to blocks[s]."""
    block = blocks[s]
    for i in range(3):
        block[0, i] += a[i]
        block[0, 3 + i] += b[i]
        block[1, i] += a[3 + i]
        block[1, 3 + i] += b[3 + i]
        block[2, i] += a[6 + i]
        block[2, 3 + i] += b[6 + i]
        block[3, i] += c[i]
        block[3, 3 + i] += d[i]
        block[4, i] += c[3 + i]
        block[4, 3 + i] += d[3 + i]
        block[5, i] += c[6 + i]
        block[5, 3 + i] += d[6 + i]


@kernel(inline=True)
def minus(m):
    return (-m[0], -m[1], -m[2], -m[3], -m[4], -m[5], -m[6], -m[7], -m[8])


@kernel(inline=True)
def add3(a, i, c, x):
    """Add vector x to a[i, c:c+3]."""
    a[i, c] += x[0]
    a[i, c + 1] += x[1]
    a[i, c + 2] += x[2]
