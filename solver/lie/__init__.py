"""Three-vectors, rotations and their tangent operators."""
