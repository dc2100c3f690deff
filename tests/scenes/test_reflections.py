"""Reflexes of the microscope's lamp in rendered scenes."""

import numpy as np
import pytest

from eyespot import scenes
from eyespot.optics.viewing.projection import PathCamera
from eyespot.scenes.rendering.render import Renderer
from eyespot.scenes.world.labels import spot_labels
from eyespot.scenes.world.world import World
from tests.scenes.test_viewing import eye_file, looked_at

pytestmark = pytest.mark.usefixtures("fast_compilation")

FINE = {"scale_mm_px": 0.005, "width_px": 192, "height_px": 160, "illumination_mw_mm2": 0.05}


def scene_with(tmp_path, *, reflexes=True, **changes):
    """An eye of one index behind a contact lens: of its surfaces only the cornea reflects here."""
    viewing = {
        "eye": eye_file(tmp_path, index=1.336),
        "lens": "flat",
        "reflexes": reflexes,
        "lamp_mm": (20.0, -12.0),
    }
    centred = {"eccentricity_mm": 0.2, "incidence_deg": 0.0}
    small = {"kind": "cone", "medium": "vitreous", "cone_k": 60.0}
    return looked_at(viewing, microscope=FINE, spot=centred, source=small, **changes)


def test_the_lamp_is_seen_where_its_label_says(tmp_path):
    with_lamp, without = (Renderer(scene_with(tmp_path, reflexes=shown)) for shown in (True, False))
    reflex = (with_lamp.render(0).radiance - without.render(0).radiance)[..., 1].astype(float)
    v, u = np.nonzero(reflex > 0.5 * reflex.max())
    label = spot_labels(with_lamp.world, 0)
    # Counting pixels of a disc of radius 10 px; off the axis its image is slightly oval.
    assert u.size > 200
    np.testing.assert_allclose(
        [label["reflex_x_px"], label["reflex_y_px"]], [u.mean(), v.mean()], atol=0.15
    )
    assert "reflex_x_px" not in spot_labels(without.world, 0)


def test_the_lamp_s_image_has_the_radiance_of_the_lamp_after_fresnel(tmp_path):
    """A mirror keeps radiance; the lamp's follows from the light that it gives the retina."""
    scene = scene_with(tmp_path)
    world = World(scene)
    assert world.reflections is not None and isinstance(world.microscope, PathCamera)
    image = world.reflections.image(np.zeros(2))
    index, glass, radius = 1.336, 1.49, scene.viewing.lamp_radius_mm
    reflected = ((glass - index) / (glass + index)) ** 2
    once = 1 - ((glass - 1) / (glass + 1)) ** 2
    # The cornea's vertex lies 12 mm above the middle of Navarro's retina, the pinhole at 200 mm.
    solid_angle = np.pi * (radius / (200.0 - 12.0)) ** 2
    magnification = float(world.microscope.magnification)
    passed = once * (1 - reflected)
    radiance = 0.05 * magnification**2 / passed / solid_angle * once**2 * reflected * index**2
    # Near the axis Fresnel's part is even to 1e-3.
    assert image.max() == pytest.approx(radiance, rel=2e-3)


def test_the_reflex_moves_with_the_view(tmp_path):
    shaken = Renderer(scene_with(tmp_path, unrest={"shake_px": 3.0, "seed": 2}))
    moment = shaken.world.unrest.at(0, float(shaken.world.times[0]))
    label = spot_labels(shaken.world, 0)
    at_rest = shaken.world.brightest_reflex_px
    np.testing.assert_allclose(
        [label["reflex_x_px"], label["reflex_y_px"]], at_rest + moment.view_px
    )
    assert shaken.world.reflections is not None
    image = shaken.world.reflections.image(moment.view_px)
    v, u = np.nonzero(image > 0.5 * image.max())
    np.testing.assert_allclose([u.mean(), v.mean()], at_rest + moment.view_px, atol=0.15)


def test_scenes_with_reflexes_say_that_these_are_approximate(tmp_path):
    assert any("reflexes" in line for line in scene_with(tmp_path).approximations)


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"viewing": {"reflexes": True}}, "viewing.reflexes needs an eye .* Set viewing.eye"),
        (
            {
                "viewing": {"eye": "navarro", "lens": "flat", "reflexes": True},
                "microscope": {"pinhole_height_mm": np.inf},
            },
            "needs a finite microscope.pinhole_height_mm for viewing.reflexes; got inf",
        ),
        (
            {
                "viewing": {"eye": "navarro", "lens": "flat", "reflexes": True},
                "microscope": {"pinhole_height_mm": 200.0, "light": "ambient"},
            },
            "needs microscope.light = 'coaxial' for viewing.reflexes; got 'ambient'",
        ),
    ],
)
def test_a_lamp_that_cannot_be_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        scenes.Scene.model_validate(changes)
