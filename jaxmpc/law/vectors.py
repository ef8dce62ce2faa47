"""Three and four plain numbers: what stands along the axes, and what stands at the joints."""

Vector3 = tuple[float, float, float]
"""Along x, y, z of the task frame, or of the frame that is named beside it."""
Vector4 = tuple[float, float, float, float]
"""At the joints J1 to J4, or at the motors 1 to 4."""
