"""A box whose top is in contact with a rigid shape, for tests of contact."""

import numpy as np
import warp as wp

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.contact.contact import Contact
from simgen.fem.elements.element import P2P1
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from tests.fem.box import box, top

CUBE = rigid_shape(Kind.CUBE, 20.0, 1.0)  # its flat face covers the whole box
SPHERE = rigid_shape(Kind.SPHERE, 3.5)
K = 60.0  # of a face of the box
NEAR = np.ones(1)  # mm: all faces of the box are near
STIFFNESS = (2.0 * K, 2.0 * 15.0)  # its faces have edges of 2 mm


def contact(friction, shape, n_env=1):
    nodes, _, _, faces = box()
    active = ActiveEnvironments(n_env, "cpu")
    term = Contact(P2P1, nodes, top(nodes, faces), STIFFNESS, friction, "cpu", active)
    term.set_shapes([shape] * n_env)
    return nodes, term



def state(x):
    return wp.array(np.ascontiguousarray(x, dtype=float).reshape(len(x), -1), dtype=wp.float64, device="cpu")



def pose(*translation):
    out = np.eye(4)[None].copy()
    out[0, :3, 3] = translation
    return out



def forces(term, x):
    r = wp.zeros(x.shape, dtype=wp.float64, device="cpu")
    term.residual(x, r)
    return r.numpy()[:, 0]



def update(term, x):
    """Move the multipliers to the tractions at x; norms of the change and of what they are then, as before it."""
    forces(term, x)
    change = np.sqrt(term.multiplier_change().numpy() / term.edge)
    term.update_multipliers()
    return change
