"""The linear modes of a body, K phi = omega^2 M phi: each one's frequency from its own stiffness and mass.

python docs/examples/modes.py
"""

from __future__ import annotations

import numpy as np

from defplan_mj.body.model import Body
from defplan_mj.registry import get_task


def frequencies(body: Body) -> np.ndarray:
    """Return f_i = sqrt(k_i / m_i) / 2 pi (r,), Hz, with m_i = phi_i^T M phi_i and k_i = phi_i^T K phi_i."""
    m = np.einsum("v,vir->r", body.vertex_mass, body.modes**2)
    k = body.stiffness
    return np.sqrt(k / m) / (2 * np.pi)


def main() -> np.ndarray:
    """Print the fish's frequencies, and return them beside those that its file holds (2, r)."""
    shipped = get_task("fish-swim").shipped
    assert shipped is not None
    body = Body.load(shipped[0])
    hertz = frequencies(body)
    print("Hz:", np.round(hertz, 2))
    return np.stack([hertz, body.frequencies])


if __name__ == "__main__":
    main()
