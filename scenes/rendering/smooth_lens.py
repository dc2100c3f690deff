"""Photons behind the glue lens, as a smooth function of its parameters.

Import after `load_mitsuba`. `scenes.rendering.photons` traces the same lens as Mitsuba's glass,
where random numbers decide which photons the rim absorbs and the cap reflects. Here every photon is
drawn so that it passes the aperture and leaves the cap. Fresnel's equations give its power, which
falls to zero where total reflection begins. If photons were drawn on both sides of that edge, some
would cross it when the lens changes; the derivative of their power is unbounded there, and its
variance does not converge.
"""

# Mitsuba's stubs lack the types of the variants.
# mypy: no-check-untyped-defs

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

import optics
from optics import InputError

_GRAZING = 1e-8  # squared cosine at which a ray leaves along the cap; its power is zero there


def check_lens(values: dict[str, float]) -> None:
    """Refuse invalid values. Plain numbers, because this may run inside a JAX computation."""
    for name, low, high in (
        ("sag", 0.0, min(values["aperture_radius"], values["glue_length"])),
        ("numerical_aperture", 1e-6, values["glue_index"]),
        ("core_radius", 1e-6, math.inf),
        ("glue_index", 1.0, 4.0),
        ("power", 0.0, math.inf),
    ):
        if not low <= values[name] <= high:
            raise InputError(
                f"PhotonImage: {name} must lie in [{low:g}, {high:g}]; got {values[name]:g}. "
                "Start the fit nearer, or fit a transformed parameter that stays in this range."
            )


def leave_cap(values: dict[str, Any], *, launch: optics.GlueLens, medium_index: float, numbers):
    """Position, direction and power of each photon behind the cap, in the frame of the lens.

    Args:
        values: parameters by name.
        launch: lens with the Gaussian launch of the core, if any.
        medium_index: refractive index of the medium in front.
        numbers: uniform random numbers, two for the direction and two for the position.
    """
    index, sag, aperture = values["glue_index"], values["sag"], values["aperture_radius"]
    face, face_light = _filled(values["core_radius"], launch.launch_radius, 1)
    sine, sine_light = _filled(values["numerical_aperture"] / index, launch.launch_aperture, index)
    lateral = sine * mi.warp.square_to_uniform_disk_concentric(numbers[0])
    forward = dr.sqrt(1 - dr.squared_norm(lateral))
    # Light of this direction passes the plane of the rim inside three shapes: the shifted disc of
    # the core, the disc of the aperture, and the ellipse from which it can leave the cap (the sine
    # of incidence on a sphere is the ray's distance from its centre over its radius). The position
    # is drawn inside all three, first along the line of their centres, then across it.
    across = dr.norm(lateral)
    moved = (values["glue_length"] - sag) * across / forward
    # The cap is k|P|^2/2 + P_z = 0 with the curvature k; this includes a flat end (k = 0).
    curvature = 2 * sag / (aperture**2 + sag**2)
    bend = dr.maximum(curvature, 1e-6)
    critical = medium_index / index
    aslant = (1 - curvature * sag) * across
    first = (aslant - critical) / (bend * forward)
    last = (aslant + critical) / (bend * forward)
    first = dr.maximum(first, dr.maximum(moved - face, -aperture))
    last = dr.minimum(last, dr.minimum(moved + face, aperture))
    width = dr.maximum(last - first, 0)
    along = first + width * numbers[1].x
    half = dr.minimum(face**2 - dr.square(along - moved), aperture**2 - dr.square(along))
    ahead = bend * forward * along - aslant
    half = dr.minimum(half, (critical - ahead) * (critical + ahead) / dr.square(bend))
    half = dr.sqrt(dr.maximum(half, 1e-12))
    aside = half * (2 * numbers[1].y - 1)
    unit = lateral / dr.maximum(across, 1e-12)
    power = values["power"] * width * 2 * half / (dr.pi * face**2)
    power *= face_light(dr.square(along - moved) + dr.square(aside))
    power *= sine_light(dr.square(across))

    heading = mi.Vector3f(lateral.x, lateral.y, forward)
    rim = mi.Vector3f(
        along * unit.x - aside * unit.y, along * unit.y + aside * unit.x, -sag + 0 * along
    )
    depth = 0.5 * curvature * (aperture**2 - dr.square(along) - dr.square(aside))
    steepness = 0.5 * (curvature * dr.dot(rim, heading) + forward)
    path = depth / (steepness + dr.sqrt(dr.square(steepness) + 0.5 * curvature * depth))
    place = rim + path * heading
    normal = curvature * place + mi.Vector3f(0, 0, 1)

    # Snell and Fresnel for unpolarised light (Born and Wolf, 1.5.2).
    ratio = index / medium_index
    cos_in = dr.dot(heading, normal)
    cos_squared = 1 - dr.square(ratio) * (1 - dr.square(cos_in))
    cos_out = dr.sqrt(dr.maximum(cos_squared, _GRAZING))
    out = dr.normalize(ratio * heading + (cos_out - ratio * cos_in) * normal)
    passed = 2 * ratio * cos_in * cos_out / dr.square(ratio * cos_in + cos_out)
    passed += 2 * ratio * cos_in * cos_out / dr.square(cos_in + ratio * cos_out)
    return place, out, power * passed & (cos_squared > _GRAZING)


def _filled(limit: Any, waist: Any, index: Any):
    """Radius of a disc of light, and a function that gives its radiance relative to the mean.

    The light is uniform, or Gaussian with that 1/e^2 waist (see `optics.GlueLens`).
    """
    if waist is None:
        return limit, lambda squared: 1
    waist = float(waist) / index
    extent = dr.minimum(limit, 2.6 * waist)
    edge = 2 * dr.square(extent / waist)
    return extent, lambda squared: dr.exp(-2 * squared / waist**2) * edge / (1 - dr.exp(-edge))
