"""Common ways to render a spot behind a lens, on our own scene, for comparison.

Import after `load_mitsuba`.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

import optics
from optics import InputError
from scenes.description import Scene
from scenes.rendering import build
from scenes.rendering.render import Renderer
from scenes.world import uniform_irradiance


class CapEmitter(mi.Emitter):
    """The flat end of a fibre as a luminous disc.

    Its radiance is L n0^2/n_g^2 T within the numerical aperture (no glue in front of the core).
    """

    def __init__(self, props):
        super().__init__(props)
        self.radiance, self.sine_limit = props["radiance"], props["sine_limit"]
        self.index_ratio = props["index_ratio"]
        self.m_flags = +mi.EmitterFlags.Surface

    def eval(self, si, active=True):
        """Radiance towards `si.wi`."""
        cosine = mi.Frame3f.cos_theta(si.wi)
        lit = active & (cosine > 0) & (1 - dr.square(cosine) <= self.sine_limit**2)
        reflectance, *_ = mi.fresnel(cosine, self.index_ratio)
        return mi.Color3f(self.radiance * (1 - reflectance)) & lit

    def sample_direction(self, ref, sample, active=True):
        """A random point of the disc; the weight is radiance over density."""
        ds = self.get_shape().sample_direction(ref, sample, active)
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = mi.Frame3f(mi.Vector3f(ds.n)).to_local(-ds.d)
        ds.emitter = mi.EmitterPtr(self)
        return ds, self.eval(si, active & (ds.pdf > 0)) / dr.maximum(ds.pdf, 1e-30)

    def pdf_direction(self, ref, ds, active=True):
        """Probability density of `sample_direction`."""
        return self.get_shape().pdf_direction(ref, ds, active)


mi.register_emitter("eyespot_cap", CapEmitter)


def randomly_sampled_scene(scene: Scene) -> Any:
    """Our scene at the first frame, with random samples in each pixel instead of a grid."""
    renderer = Renderer(scene)
    content = build.mitsuba_dict(renderer.world, uniform=uniform_irradiance(renderer.world))
    content["sensor"]["sampler"] = {
        "type": "independent",
        "sample_count": scene.microscope.samples,
    }
    return _placed(content, scene, renderer)


def particle_tracer_scene(scene: Scene, *, reconstruction: str) -> Any:
    """Our scene for Mitsuba's `ptracer` (sensor 1), placed at the first frame.

    Args:
        scene: a scene of source.kind `photons`.
        reconstruction: reconstruction filter of the film.
    """
    renderer = Renderer(scene)
    content = build.mitsuba_dict(renderer.world, uniform=np.zeros(3))
    content["photon_camera"]["film"]["rfilter"] = {"type": reconstruction}
    return _placed(content, scene, renderer)


def cap_scene(scene: Scene) -> Any:
    """Our scene with the fibre's flat end as a luminous disc, placed at the first frame.

    Args:
        scene: a scene of source.kind `lens`, with a lens of zero length.
    """
    lens = optics.load_lens(scene.source.lens)
    if float(lens.glue_length) > 0:
        raise InputError("a disc of uniform light needs a lens with glue_length = 0")
    index = optics.MEDIA[scene.source.medium]
    renderer = Renderer(scene)
    content = build.mitsuba_dict(renderer.world, uniform=np.zeros(3))
    beam = renderer.world.truth.beam
    tip, axis = np.asarray(beam.tip[0]), np.asarray(beam.axis[0])
    radius, aperture = float(lens.face_radius), float(lens.numerical_aperture)
    across = np.asarray(optics.perpendicular_frame(axis)[0])
    place = mi.ScalarTransform4f().look_at(tip, tip + axis, across)
    content["sensor"]["sampler"] = {"type": "independent", "sample_count": 1}
    del content["source"]
    content["cap"] = {
        "type": "disk",
        "to_world": place @ mi.ScalarTransform4f().scale(radius),
        "bsdf": {"type": "diffuse", "reflectance": 0.0},
        "emitter": {
            "type": "eyespot_cap",
            "radiance": scene.source.power_mw * index**2 / (math.pi * radius * aperture) ** 2,
            "sine_limit": aperture / index,
            "index_ratio": float(lens.glue_index) / index,
        },
    }
    return _placed(content, scene, renderer)


def _placed(content: dict[str, Any], scene: Scene, renderer: Renderer) -> Any:
    loaded = mi.load_dict(content)
    beam = renderer.world.truth.beam
    build.mover(scene, loaded)(np.asarray(beam.tip[0]), np.asarray(beam.axis[0]))
    return loaded
