"""The lens against another program's ray trace: Optiland's."""

import numpy as np
import pytest

import optics

# Before the import, which compiles with Numba and warns of its own accord.
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]

GLUE, SCREEN = 1.49, 3.0


@pytest.fixture(scope="module")
def optiland():
    pytest.importorskip("optiland", reason="pip install 'eyespot[referee]'")
    from optiland import materials, optic, rays

    return materials, optic, rays


@pytest.fixture(scope="module", params=[1.0, 1.336])
def system(request, optiland):
    """The dome preset as an Optiland system: core face, cap, screen; and its medium's index."""
    materials, optic, _ = optiland
    lens = optics.load_lens("dome")
    height, sag = float(lens.aperture_radius), float(lens.sag)
    medium = materials.IdealMaterial(n=request.param)
    system = optic.Optic()
    system.add_surface(
        index=0, thickness=float(lens.glue_length), material=materials.IdealMaterial(n=GLUE)
    )
    system.add_surface(
        index=1,
        radius=-(height**2 + sag**2) / (2 * sag),
        thickness=SCREEN,
        material=medium,
        is_stop=True,
    )
    system.add_surface(index=2, material=medium)
    system.set_aperture("EPD", 0.01)
    system.add_wavelength(0.55, is_primary=True)
    return system, request.param


def launch(count):
    """Rays of the dome's light that reach both media: 11° and 0.15 mm at the most."""
    rng = np.random.default_rng(4)
    height, turn = 0.15 * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    sine, way = 0.2 / GLUE * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    points = np.column_stack([height * np.cos(turn), height * np.sin(turn)])
    return points, np.column_stack([sine * np.cos(way), sine * np.sin(way)])


def test_ray_directions_and_spot_radius_agree(optiland, system):
    _, _, rays = optiland
    optic, medium = system
    count = 2000
    points, directions = launch(count)
    lens = optics.load_lens("dome")
    ours = optics.emitted_rays(lens, medium_index=medium, points=points, directions=directions)
    assert np.all(np.asarray(ours.status) == 0)

    theirs = rays.RealRays(
        *points.T,
        np.full(count, -float(lens.glue_length)),
        *directions.T,
        np.sqrt(1 - np.sum(directions**2, axis=1)),
        np.ones(count),
        np.full(count, 0.55),
    )
    optic.surface_group.trace(theirs)
    out = np.column_stack([theirs.L, theirs.M, theirs.N])
    np.testing.assert_allclose(ours.direction, out, atol=1e-6)

    point, direction = np.asarray(ours.point), np.asarray(ours.direction)
    place = point + ((SCREEN - point[:, 2]) / direction[:, 2])[:, None] * direction
    np.testing.assert_allclose(place[:, 0], theirs.x, atol=1e-6)
    np.testing.assert_allclose(place[:, 1], theirs.y, atol=1e-6)
    our_radius = np.sqrt(np.mean(np.sum(place[:, :2] ** 2, axis=1)))
    their_radius = np.sqrt(np.mean(theirs.x**2 + theirs.y**2))
    assert our_radius == pytest.approx(their_radius, rel=1e-6)


def test_the_focal_length_agrees(system):
    optic, medium = system
    focus = float(np.ravel(optic.paraxial.f2())[0])
    ours = float(optics.load_lens("dome").focal_length(medium_index=medium))
    assert ours == pytest.approx(focus, rel=1e-6)
