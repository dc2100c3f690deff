"""Light with one profile at all distances, as a lens's table, and what it is on a wall."""

import jax.numpy as jnp

from eyespot import optics


def light_of(profile, *, contact, slope=0.2, aside=0.0):
    """Light in air: its profile over the envelope, and the part of it that points outwards."""
    x = jnp.linspace(0.0, 1.0, len(profile))
    return optics.IrradianceTable(
        values=jnp.tile(jnp.stack([aside * x * profile, profile], axis=-1), (33, 1, 1)),
        medium_index=jnp.asarray(1.0),
        contact_radius=jnp.asarray(contact),
        slope=jnp.asarray(slope),
    )


def light_on(table, beam, points, inward):
    """Irradiance of points of a wall by a beam of light that a table has."""
    offset = points - beam.tip
    along = offset @ beam.axis
    across = offset - along[..., None] * beam.axis
    radius = jnp.linalg.norm(across, axis=-1)
    lateral, axial = table(radius=radius, distance=along)
    vector = (lateral / jnp.maximum(radius, 1e-9))[..., None] * across
    vector = vector + axial[..., None] * beam.axis
    return jnp.maximum(-jnp.sum(vector * inward, axis=-1), 0.0)
