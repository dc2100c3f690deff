"""Mitsuba plugins: lens and cone as emitters, a noise-free integrator, the microscope as a sensor.

The microscope is a pinhole, alone or behind a viewing path. Import after `load_mitsuba`: the
base classes exist only once a variant is set.
"""

import functools
import json
import math

import drjit as dr
import mitsuba as mi

from eyespot import optics
from eyespot.scenes.rendering.photons import Glass

# float32 does not resolve the direction between two wall points nearer than this. Ignoring such
# pairs loses 0.2 % of the first reflection of the smallest spot (0.25 mm) onto itself.
_NEAREST_PAIR_MM = 0.01

SPREAD_NODES = 64
"""Points round each camera ray's point whose light is averaged if the wall spreads light."""

# Powers of the root of x^4 = x + 1: steps that fill a cube evenly (Roberts 2018).
_STEPS = (0.8191725133961645, 0.6710436067037893, 0.5497004779019703)


class _PointEmitter(mi.Emitter):
    """Base class of emitters without a surface: a tip, an axis and a power."""

    def __init__(self, props):
        super().__init__(props)
        self.tip = mi.Point3f(props["tip"])
        self.axis, self.power = mi.Vector3f(props["axis"]), mi.Float(props["power"])
        # Without this flag, the scene drops an emitter that has no shape.
        self.m_flags = +mi.EmitterFlags.DeltaPosition

    def pdf_direction(self, ref, ds, active=True):
        """0: a random ray never hits a point light."""
        return mi.Float(0)

    def eval(self, si, active=True):
        """0: a point light has no surface."""
        return mi.Color3f(0)

    def traverse(self, callback):
        """Parameters that change when the tip moves or the power swings."""
        for name in ("tip", "axis", "power"):
            callback.put(name, getattr(self, name), mi.ParamFlags.NonDifferentiable)


class ConeEmitter(_PointEmitter):
    """An ideal cone whose apex lies inside the fibre; shadow rays end at the plane of the tip.

    A camera ray stands for a square of the image. The edge is blurred over the square's width on
    the wall, or rays on a grid would leave steps of a part of a pixel along it.
    """

    def __init__(self, props):
        super().__init__(props)
        self.half_angle, self.apex_offset = props["half_angle"], props["apex_offset"]
        self.width = props["sample_width"]
        self.solid_angle = 2 * math.pi * (1 - math.cos(self.half_angle))

    def sample_direction(self, ref, sample, active=True):
        """Direction to the apex, with its end at the plane of the tip; intensity over r^2."""
        offset = ref.p - (self.tip + self.apex_offset * self.axis)
        distance = dr.norm(offset)
        ds = mi.DirectionSample3f()
        ds.uv = mi.Point2f(0)
        ds.n, ds.time, ds.pdf, ds.delta = self.axis, ref.time, 1, True
        ds.d = -offset / distance
        ds.dist = dr.dot(self.tip - ref.p, self.axis) / dr.dot(ds.d, self.axis)
        ds.p = ref.p + ds.dist * ds.d
        strength = self._lit(offset, ref.n) * self.power / (self.solid_angle * dr.square(distance))
        # At contact the edge lies in the plane of the tip, and its outer half just behind it.
        return ds, mi.Color3f(strength) & (active & (ds.dist > -self.width))

    def _lit(self, offset, normal):
        """Part of a camera ray's square on the wall that is inside the cone."""
        sine, cosine = math.sin(self.half_angle), math.cos(self.half_angle)
        along = dr.dot(offset, self.axis)
        lateral = offset - along * self.axis
        radius = dr.maximum(dr.norm(lateral), 1e-9)
        inside = along * sine - radius * cosine  # distance from the cone's surface, mm
        inwards = sine * self.axis - cosine * lateral / radius
        slope = dr.norm(inwards - dr.dot(inwards, normal) * normal)  # of it, along the wall
        return dr.clip(inside / dr.maximum(slope * self.width, 1e-9) + 0.5, 0, 1)

    def sample_ray(self, time, sample1, sample2, sample3, active=True):
        """A ray of light that starts at the plane of the tip."""
        way = mi.warp.square_to_uniform_cone(sample3, math.cos(self.half_angle))
        direction = mi.Frame3f(self.axis).to_world(way)
        apex = self.tip + self.apex_offset * self.axis
        start = apex - self.apex_offset / dr.dot(direction, self.axis) * direction
        return mi.Ray3f(start, direction, time), mi.Color3f(self.power) & active


class LensEmitter(_PointEmitter):
    """The glue lens, for rays from the wall and for photons from its core.

    From the wall (`sample_direction`) it uses the vector irradiance V from
    `optics.IrradianceTable`. A matt wall with inward normal n receives E = -n . V. So the emitter
    behaves as a light of strength |V| in the direction -V. The shadow ray ends at the tip. Photons
    from the core (`sample_ray`) pass the lens as glass and do not use V.
    """

    def __init__(self, props):
        super().__init__(props)
        values = mi.TensorXf(props["values"])
        self.rows, self.columns = values.shape[:2]
        self.field = mi.Texture2f(values, filter_mode=dr.FilterMode.Linear)
        self.contact_radius, self.slope = props["contact_radius"], props["slope"]
        self.nearest, self.farthest = props["nearest"], props["farthest"]
        self.glass = Glass(optics.load_lens(props["lens"]), medium_index=props["medium_index"])

    def vector_irradiance(self, point):
        """V at a point, mW/mm2: the look-up that `optics.IrradianceTable` defines."""
        offset = point - self.tip
        distance = dr.dot(offset, self.axis)
        lateral = offset - distance * self.axis
        radius = dr.norm(lateral)
        envelope = self.contact_radius + self.slope * distance
        x = radius / envelope
        y = dr.log(dr.clip(distance, self.nearest, self.farthest) / self.nearest)
        y /= math.log(self.farthest / self.nearest)
        # Centres of texels lie at (i + 1/2)/n, samples of the table at i/(n - 1).
        across = (x * (self.columns - 1) + 0.5) / self.columns
        along = (y * (self.rows - 1) + 0.5) / self.rows
        v_lateral, v_axial = self.field.eval(mi.Point2f(across, along))
        scale = dr.select((x <= 1) & (distance >= 0), self.power / dr.square(envelope), 0)
        outwards = lateral * dr.rcp(dr.maximum(radius, 1e-9))
        return scale * (v_lateral * outwards + v_axial * self.axis)

    def sample_direction(self, ref, sample, active=True):
        """Direction -V with weight |V|; the shadow ray ends at the tip."""
        vector = self.vector_irradiance(ref.p)
        strength = dr.norm(vector)
        lit = active & (strength > 0)
        ds = dr.zeros(mi.DirectionSample3f)
        ds.p, ds.n, ds.time, ds.pdf, ds.delta = self.tip, self.axis, ref.time, 1, True
        ds.dist = dr.norm(self.tip - ref.p)
        ds.d = dr.select(lit, -vector / dr.select(lit, strength, 1), -self.axis)
        ds.emitter = mi.EmitterPtr(self)
        return ds, mi.Color3f(strength) & lit

    def sample_ray(self, time, sample1, sample2, sample3, active=True):
        """A photon behind the cap; its weight is 0 if the glue's side or the core absorbed it."""
        ray, out = self.glass.sample_ray(sample1, sample2, sample3)
        frame = mi.Frame3f(self.axis)
        placed = mi.Ray3f(
            self.tip + frame.to_world(mi.Vector3f(ray.o)), frame.to_world(ray.d), time
        )
        return placed, mi.Color3f(self.power) & out & active


def wall_shape(mitsuba_scene):
    """The wall of a Mitsuba scene."""
    return next(shape for shape in mitsuba_scene.shapes() if shape.id() == "wall")


class SpotIntegrator(mi.SamplingIntegrator):
    """Direct light of every point emitter, coaxial light, and light from wall to wall.

    All emitters are points, and their light is summed, so direct light has no random noise; the
    area of a pixel is sampled on a grid. Light that the closed eyeball scatters back is uniform
    (`optics.indirect_irradiance`) and given as `uniform`. If `bounces` is not 0, it is traced
    instead, with up to that many reflections before the last one. The coaxial light comes from the
    pinhole, so it has no shadows. The extra channel `wall` is the fraction of a pixel that shows
    the wall.

    If the wall spreads light, the light that a matt wall radiates at a point arrives at points
    round it (`optics.spread_nodes`). Those are drawn for each camera ray with a seed from the point
    itself, so that an image has the same small noise whenever it is rendered.
    """

    def __init__(self, props):
        super().__init__(props)
        self.uniform = mi.Color3f(props["uniform"])
        self.coaxial = mi.Float(props["coaxial"])
        if "falloff" in props:
            self.falloff = json.loads(props["falloff"])
            self.falloff_scale = props["falloff_scale"]
        else:
            self.falloff, self.pinhole_height = [], float(props["pinhole_height"])
        self.pole_height = float(props["pole_height"])
        self.pupil_height = float(props["pupil_height"])
        self.direct, self.bounces = props["direct"], int(props["bounces"])
        self.spread = [float(props[f"spread_{colour}"]) for colour in "rgb"]
        self.wall_curvature = float(props["wall_curvature"])

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Radiance along camera rays, and whether they hit the wall."""
        si = scene.ray_intersect(ray, active)
        valid = active & si.is_valid()
        context, bsdf = mi.BSDFContext(), si.bsdf(ray)
        radiance = bsdf.eval_diffuse_reflectance(si, valid) * self.uniform * dr.inv_pi
        radiance += bsdf.eval(context, si, si.wi, valid) * self.coaxial * self._falloff(si)
        if self.bounces:
            radiance += self._interreflection(scene, sampler, si, valid)
        wall = si.shape == wall_shape(scene)
        if self.direct and any(self.spread):
            on_surface, within = mi.BSDFContext(), mi.BSDFContext()
            on_surface.type_mask = mi.BSDFFlags.GlossyReflection
            within.type_mask = mi.BSDFFlags.DiffuseReflection
            radiance += _direct(scene, si, on_surface, valid & wall)
            radiance += self._spread_light(scene, si, within, valid & wall)
            radiance += _direct(scene, si, context, valid & ~wall)
        elif self.direct:
            radiance += _direct(scene, si, context, valid)
        return dr.select(valid, radiance, 0), valid, [dr.select(valid & wall, mi.Float(1), 0)]

    @dr.syntax
    def _spread_light(self, scene, si, context, active):
        """Radiance of direct light that arrives round a point of the wall, by its kernel."""
        low, high = mi.sample_tea_32(
            dr.reinterpret_array(mi.UInt32, si.p.x), dr.reinterpret_array(mi.UInt32, si.p.y)
        )
        shift = mi.Point3f(low, high, low ^ high) * 2.0**-32
        radiance, node = mi.Color3f(0), mi.UInt32(0)
        while node < SPREAD_NODES:
            number = shift + mi.Float(node) * mi.Point3f(_STEPS)
            number -= dr.floor(number)
            # The radius is the sum of two exponential ones, the angle is uniform.
            reach = -dr.log(dr.maximum((1 - number.x) * (1 - number.y), 1e-12))
            sine, cosine = dr.sincos(2 * dr.pi * number.z)
            aside = reach * (cosine * si.sh_frame.s + sine * si.sh_frame.t)
            for length in sorted(set(self.spread)):
                arriving = self._moved(si, length * aside)
                light = _direct(scene, arriving, context, active)
                radiance += light * mi.Color3f([float(own == length) for own in self.spread])
            node += 1
        return radiance / SPREAD_NODES

    def _moved(self, si, aside):
        """The interaction at another point of the wall, as the texture is seen at this one."""
        moved = mi.SurfaceInteraction3f(si)
        moved.p += aside
        if self.wall_curvature:
            inwards = -dr.normalize(mi.Vector3f(moved.p))
            moved.p = mi.Point3f(-inwards / self.wall_curvature)
            moved.n = mi.Normal3f(inwards)
            moved.sh_frame = mi.Frame3f(inwards)
        return moved

    @dr.syntax
    def _interreflection(self, scene, sampler, si, active):
        """Radiance of light that reached its last surface from another surface.

        Each point of a path from the camera is connected with the first surface that a photon hits.
        In a uniform sphere all connections carry the same light, so there is no noise. Light that
        leaves through the pupil is lost.
        """
        context, radiance, throughput = mi.BSDFContext(), mi.Color3f(0), mi.Color3f(1)
        bounce = mi.UInt32(0)
        while active & (bounce < self.bounces):
            photon, power, _ = scene.sample_emitter_ray(
                si.time, sampler.next_1d(), sampler.next_2d(), sampler.next_2d(), active
            )
            lit = scene.ray_intersect(photon, active)
            reflects = lit.is_valid() & (lit.p.z < self.pupil_height)
            # Both ends are moved off their surfaces, so that these do not block the connection.
            joint = si.spawn_ray_to(lit.spawn_ray_to(si.p).o)
            distance = dr.norm(lit.p - si.p)
            bsdf = si.bsdf()
            light = lit.bsdf().eval(context, lit, lit.to_local(-joint.d), reflects) * power
            light *= throughput * bsdf.eval(context, si, si.to_local(joint.d), active)
            joined = active & reflects & (distance > _NEAREST_PAIR_MM) & (dr.max(light) > 0)
            joined &= ~scene.ray_test(joint, joined)
            radiance += (light * dr.rcp(dr.square(distance))) & joined
            scattered, weight = bsdf.sample(
                context, si, sampler.next_1d(), sampler.next_2d(), active
            )
            throughput *= weight
            si = scene.ray_intersect(si.spawn_ray(si.to_world(scattered.wo)), active)
            # `&=` would change the mask of the caller.
            active = active & si.is_valid() & (si.p.z < self.pupil_height)
            bounce += 1
        return radiance

    def aov_names(self):
        """Names of the extra channels."""
        return ["wall"]

    def _falloff(self, si):
        """Irradiance of the coaxial light relative to the pole, without cosines."""
        if self.falloff:
            inside = dr.clip((si.p.z - self.pole_height) / self.falloff_scale, 0, 1)
            return functools.reduce(lambda sum_, c: sum_ * inside + c, reversed(self.falloff))
        if math.isinf(self.pinhole_height):
            return mi.Float(1)
        reach = self.pinhole_height - self.pole_height
        return reach**2 / dr.squared_norm(si.p - mi.Point3f(0, 0, self.pinhole_height))

    def traverse(self, callback):
        """The light from all sides, which changes with the source's power."""
        callback.put("uniform", self.uniform, mi.ParamFlags.NonDifferentiable)


def _direct(scene, si, context, active):
    """Radiance of the light that reaches a surface from the emitters without a detour."""
    radiance, bsdf = mi.Color3f(0), si.bsdf()
    for emitter in scene.emitters():
        ds, weight = emitter.sample_direction(si, mi.Point2f(0.5), active)
        reflected = bsdf.eval(context, si, si.to_local(ds.d), active) * weight
        lit = active & (dr.max(reflected) > 0)
        lit = dr.select(scene.ray_test(si.spawn_ray_to(ds.p), lit), False, lit)
        radiance += dr.select(lit, reflected, 0)
    return radiance


mi.register_emitter("eyespot_cone", ConeEmitter)
mi.register_emitter("eyespot_lens", LensEmitter)
mi.register_integrator("eyespot_spot", SpotIntegrator)


# `scenes.world.world` refuses distortions for which these steps do not converge.
_UNDISTORT_STEPS = 12


class _WindowSensor(mi.Sensor):
    """A microscope whose lines of sight start at a height inside the eye.

    Vignetting multiplies the light by 1 - vignetting (s / s_corner)^2, where s is the distance of
    the pixel from the centre of the image.
    """

    def __init__(self, props):
        super().__init__(props)
        self.pole_height, self.entry_height = props["pole_height"], props["entry_height"]
        self.centre = mi.Vector2f(props["principal_point"])
        self.vignetting, self.aperture_slope = props["vignetting"], props["aperture_slope"]
        self.m_needs_sample_3 = self.aperture_slope > 0

    def sample_ray_differential(
        self, time, wavelength_sample, position_sample, aperture_sample, active=True
    ):
        """The same ray; the differentials stay unset, as no texture is filtered."""
        ray, part = self.sample_ray(
            time, wavelength_sample, position_sample, aperture_sample, active
        )
        return mi.RayDifferential3f(ray), part

    def _slope(self, sample):
        """Random slope of a line of sight against the central one; zero for a pinhole."""
        return self.aperture_slope * mi.warp.square_to_uniform_disk_concentric(sample)

    def _ray(self, at_entry, slope, time):
        """Line of sight through a point at the entry's height, with its growth per mm down."""
        start = mi.Point3f(at_entry.x, at_entry.y, self.entry_height)
        return mi.Ray3f(start, dr.normalize(mi.Vector3f(slope.x, slope.y, -1)), time)

    def _part(self, position):
        """Fraction of light that remains after vignetting."""
        size = mi.Vector2f(self.film().size())
        from_middle = (mi.Vector2f(position) - 0.5) * size
        return 1 - self.vignetting * 4 * dr.squared_norm(from_middle) / dr.squared_norm(size)

    def traverse(self, callback):
        """The principal point, which moves with the view."""
        callback.put("principal_point", self.centre, mi.ParamFlags.NonDifferentiable)


class MicroscopeSensor(_WindowSensor):
    """The pinhole of `optics.Microscope`: at any height or at infinity, with lens distortion.

    Unlike Mitsuba's `perspective`, it can look into the closed eyeball.

    With an aperture, the pinhole becomes a thin lens. All lines of sight of a pixel then cross in
    the plane in focus; their slopes against the central one are at most `aperture_slope` (tangent
    of the angle).
    """

    def __init__(self, props):
        super().__init__(props)
        self.scale, self.bend = props["scale"], props["inverse_working_distance"]
        self.distortion = tuple(props[name] for name in ("k1", "k2", "p1", "p2", "k3"))
        self.focus_height = props["focus_height"]

    def sample_ray(self, time, wavelength_sample, position_sample, aperture_sample, active=True):
        """Line of sight of a position on the film, and the fraction of light that arrives."""
        size = mi.Vector2f(self.film().size())
        ideal = self._undistorted(mi.Vector2f(position_sample) * size - self.centre)
        x, y = ideal.x * self.scale, -ideal.y * self.scale
        depth = self._depth(self.entry_height)
        aside = self._slope(aperture_sample)
        above = self.entry_height - self.focus_height
        at_entry = mi.Vector2f(x * depth - above * aside.x, y * depth - above * aside.y)
        slope = mi.Vector2f(self.bend * x + aside.x, self.bend * y + aside.y)
        return self._ray(at_entry, slope, time), mi.Color3f(self._part(position_sample))

    def sample_direction(self, it, sample, active=True):
        """Direction to the pinhole, and the weight of a photon's radiance on the film."""
        size = mi.Vector2f(self.film().size())
        depth = self._depth(it.p.z)
        aside = self._slope(sample)
        # Position from which the central line of sight reaches the same pixel.
        above = it.p.z - self.focus_height
        x, y = (it.p.x + above * aside.x) / depth, (it.p.y + above * aside.y) / depth
        ds = dr.zeros(mi.DirectionSample3f)
        ds.d = -dr.normalize(mi.Vector3f(self.bend * x + aside.x, self.bend * y + aside.y, -1))
        ds.dist = (self.entry_height - it.p.z) / ds.d.z
        ds.p = it.p + ds.dist * ds.d
        offset, growth = self._distorted(mi.Vector2f(x, -y) / self.scale)
        place = self.centre + offset
        seen = active & (ds.dist > 0) & dr.all((place >= 0) & (place < size))
        ds.uv = mi.Point2f(place)
        ds.pdf = dr.select(seen, mi.Float(1), 0)
        # Area of the film on the horizontal plane through the point; ds.d.z is the cosine.
        area = dr.prod(size) * dr.square(self.scale * depth) / growth
        return ds, mi.Color3f(self._part(place / size) * dr.rcp(area * ds.d.z)) & seen

    def _depth(self, height):
        return 1 - self.bend * (height - self.pole_height)

    def _distorted(self, ideal):
        """Brown's distortion of an offset from the principal point, px, and the change of area.

        Brown (1966) with the order and normalisation of OpenCV; the change of area is the
        determinant of its derivative.
        """
        k1, k2, p1, p2, k3 = self.distortion
        u, v = ideal.x, ideal.y
        x, y = u * self.bend * self.scale, v * self.bend * self.scale
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        steepness = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
        offset = mi.Vector2f(
            u * radial + 2 * p1 * u * y + p2 * (3 * u * x + v * y),
            v * radial + p1 * (u * x + 3 * v * y) + 2 * p2 * u * y,
        )
        along = radial + x * x * steepness + 2 * p1 * y + 6 * p2 * x
        across = x * y * steepness + 2 * p1 * x + 2 * p2 * y
        down = radial + y * y * steepness + 6 * p1 * y + 2 * p2 * x
        return offset, along * down - across * across

    def _undistorted(self, offset):
        """Inverse of `_distorted` by fixed-point iteration, as in `optics.Microscope`."""
        ideal = offset
        if any(self.distortion):
            for _ in range(_UNDISTORT_STEPS):
                ideal = ideal + offset - self._distorted(ideal)[0]
        return ideal


mi.register_sensor("eyespot_microscope", MicroscopeSensor)


class PathSensor(_WindowSensor):
    """The camera of `optics.viewing.PathCamera`: the lines of sight inside the eye.

    The iris, or the edge of the field, hides the rest of the image.

    With an aperture, a pixel has the lines of sight of `optics.viewing.Pencils`. The iris stops all
    of them where it stops the central one.
    """

    def __init__(self, props):
        super().__init__(props)
        self.crossing, self.steepness, self.passing = json.loads(props["series"])
        self.px_per_aim, self.widest, self.pupil = (
            props[name] for name in ("px_per_aim", "widest", "pupil")
        )
        if self.aperture_slope:
            self.pencils = json.loads(props["pencils"])

    def sample_ray(self, time, wavelength_sample, position_sample, aperture_sample, active=True):
        """Line of sight of a position on the film, and the fraction of light that arrives."""
        size = mi.Vector2f(self.film().size())
        offset = (mi.Vector2f(position_sample) * size - self.centre) / self.px_per_aim
        aim = mi.Vector2f(offset.x, -offset.y)
        squared = dr.squared_norm(aim)
        place = dr.minimum(2 * squared / self.widest**2 - 1, 1)
        crossing, steepness, passing = (
            _series(terms, place) for terms in (self.crossing, self.steepness, self.passing)
        )
        at_pole, slope = crossing * aim, steepness * aim
        if self.aperture_slope:
            aside = self._slope(aperture_sample)
            across, grown_across, along, grown_along = (
                _series(terms, place) for terms in self.pencils
            )
            turned = dr.dot(aim, aside) * aim
            at_pole += across * aside + along * turned
            slope += grown_across * aside + grown_along * turned
        at_entry = at_pole - slope * (self.entry_height - self.pole_height)
        part = dr.select(squared <= self.pupil**2, passing * self._part(position_sample), 0)
        return self._ray(at_entry, slope, time), mi.Color3f(part)


def _series(terms, place):
    """A Chebyshev series by Clenshaw's recurrence."""
    after, last = mi.Float(0), mi.Float(0)
    for term in reversed(terms[1:]):
        after, last = last, term + 2 * place * last - after
    return terms[0] + place * last - after


mi.register_sensor("eyespot_path", PathSensor)
