"""Mitsuba plugins: the lens and the cone as emitters, and an integrator without noise.

Import after `load_mitsuba`: the base classes exist only once a variant is set.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi


class ConeEmitter(mi.Emitter):
    """An emitter whose apex lies inside the fibre: shadow rays end at the plane of the tip.

    Wraps Mitsuba's `spot`, which keeps the light; only the end of the shadow ray moves.
    """

    def __init__(self, props):
        super().__init__(props)
        self.light = props["light"]
        self.tip = mi.Point3f(props["tip"])
        self.axis = mi.Vector3f(props["axis"])
        self.m_flags = +mi.EmitterFlags.DeltaPosition

    def sample_direction(self, ref, sample, active=True):
        """Direction to the apex, with the end point moved along it to the plane of the tip."""
        ds, weight = self.light.sample_direction(ref, sample, active)
        ds.dist = dr.dot(self.tip - ref.p, self.axis) / dr.dot(ds.d, self.axis)
        ds.p = ref.p + ds.dist * ds.d
        return ds, weight & (ds.dist > 0)

    def pdf_direction(self, ref, ds, active=True):
        """0: a point light is never met by chance."""
        return mi.Float(0)

    def eval(self, si, active=True):
        """0: a point light has no surface."""
        return mi.Color3f(0)

    def traverse(self, callback):
        """Parameters that a withdrawal changes."""
        callback.put("light", self.light, mi.ParamFlags.Differentiable)
        callback.put("tip", self.tip, mi.ParamFlags.NonDifferentiable)
        callback.put("axis", self.axis, mi.ParamFlags.NonDifferentiable)


class SpotIntegrator(mi.SamplingIntegrator):
    """Direct light of every point emitter, coaxial light, and uniform light on all surfaces.

    All emitters are points, so each is summed rather than one picked at random: what is left of
    Monte Carlo is the pixel's area, sampled on a grid. Light scattered back by the closed eyeball
    is uniform (`optics.indirect_irradiance`) and enters as `uniform`. The coaxial light comes from
    the pinhole: whatever the camera sees is lit by it, without shadows. The extra channel `wall`
    is the part of a pixel in which the wall is seen.
    """

    def __init__(self, props):
        super().__init__(props)
        self.uniform = mi.Color3f(props["uniform"])
        self.coaxial = mi.Float(props["coaxial"])
        self.pinhole_height = float(props["pinhole_height"])
        self.pole_height = float(props["pole_height"])

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Radiance along camera rays, and whether they meet the wall."""
        si = scene.ray_intersect(ray, active)
        valid = active & si.is_valid()
        context, bsdf = mi.BSDFContext(), si.bsdf(ray)
        radiance = bsdf.eval_diffuse_reflectance(si, valid) * self.uniform * dr.inv_pi
        radiance += bsdf.eval(context, si, si.wi, valid) * self.coaxial * self._falloff(si)
        for emitter in scene.emitters():
            ds, weight = emitter.sample_direction(si, mi.Point2f(0.5), valid)
            reflected = bsdf.eval(context, si, si.to_local(ds.d), valid) * weight
            lit = valid & (dr.max(reflected) > 0)
            lit &= ~scene.ray_test(si.spawn_ray_to(ds.p), lit)
            radiance += reflected & lit
        wall = si.shape == mi.ShapePtr(next(s for s in scene.shapes() if s.id() == "wall"))
        return radiance & valid, valid, [dr.select(valid & wall, mi.Float(1), mi.Float(0))]

    def aov_names(self):
        """Names of the extra channels."""
        return ["wall"]

    def _falloff(self, si):
        """Irradiance of the light at the pinhole relative to that at the pole, before cosines."""
        if math.isinf(self.pinhole_height):
            return mi.Float(1)
        reach = self.pinhole_height - self.pole_height
        return reach**2 / dr.squared_norm(si.p - mi.Point3f(0, 0, self.pinhole_height))

    def traverse(self, callback):
        """Nothing moves."""


mi.register_emitter("eyespot_cone", ConeEmitter)
mi.register_integrator("eyespot_spot", SpotIntegrator)
