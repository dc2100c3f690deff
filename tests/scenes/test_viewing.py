"""Scenes seen through viewing lenses and the eye's own optics."""

import importlib.resources
import re
import shlex
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import eyespot
from eyespot import optics, scenes
from eyespot.scenes.rendering.render import Renderer
from eyespot.scenes.world.labels import spot_labels
from eyespot.scenes.world.world import World
from tests.scenes.test_thin_lens import moments

pytestmark = pytest.mark.usefixtures("fast_compilation")

SMALL = {"width_px": 96, "height_px": 72, "scale_mm_px": 0.04, "pinhole_height_mm": 200.0}
STILL = {"start_mm": 2.0, "travel_mm": 1.0, "frames": 1}


def looked_at(viewing, *, phantom=None, microscope=None, **tables):
    """A dark, even wall that a cone lights, without an instrument, behind vitreous."""
    content = {
        "phantom": {"wall": "uniform", "reflectance": 1e-3, "indirect": "off"} | (phantom or {}),
        "source": {"kind": "cone", "medium": "vitreous"},
        "spot": {"eccentricity_mm": 2.0, "azimuth_deg": 30.0},
        "motion": STILL,
        "instrument": {"visible": False},
        "microscope": SMALL | {"illumination_mw_mm2": 0.0} | (microscope or {}),
        "viewing": viewing,
    }
    return scenes.Scene.model_validate(content | tables)


def eye_file(folder, *, index):
    """Navarro's eye with one index everywhere."""
    text = (
        importlib.resources.files("eyespot.optics.viewing") / "eyes" / "navarro.toml"
    ).read_text()
    head, _, _ = text.partition("[indices]")
    path = folder / "even.toml"
    path.write_text(
        f"{head}[indices]\nwavelength_nm = [550.0]\ncornea = [{index}]\naqueous = [{index}]\n"
        f"lens = [[{index}]]\nvitreous = [{index}]\n"
    )
    return str(path)


def test_an_eye_without_refraction_is_a_pinhole(tmp_path):
    lit = {"illumination_mw_mm2": 0.05}
    through = looked_at({"eye": eye_file(tmp_path, index=1.0), "pupil_mm": 50.0}, microscope=lit)
    pinhole = looked_at({}, phantom={"radius_mm": through.phantom.radius_mm}, microscope=lit)
    images = [Renderer(scene).render(0).radiance for scene in (through, pinhole)]
    truths = [World(scene).truth.half_max for scene in (through, pinhole)]
    # The height of the pinhole counts from the eyeball's centre in both.
    np.testing.assert_allclose(truths[0].centre, truths[1].centre, atol=1e-6)
    np.testing.assert_allclose(truths[0].semi_minor, truths[1].semi_minor, atol=1e-6)
    different = np.abs(images[0] - images[1]).max(axis=-1) > 1e-3 * images[1].max()
    # float32 moves lines of sight by some 1e-6 mm, across the spot's edge in few samples. The light
    # from the microscope is even before the eye instead of over angles: 1.5 (3/200)^2 = 3e-4.
    assert np.count_nonzero(different) < 5


@pytest.mark.parametrize(
    "viewing",
    [
        {"eye": "navarro", "lens": "flat"},
        {"eye": "atchison", "refraction_d": -6.0, "lens": "wide-field-90"},
    ],
)
def test_labels_are_those_of_the_image(viewing):
    finer = {"scale_mm_px": 0.01, "samples": 1, "width_px": 192, "height_px": 144}
    scene = looked_at(viewing, microscope=finer, spot={"eccentricity_mm": 3.0, "azimuth_deg": 30.0})
    renderer = Renderer(scene)
    light = renderer.render(0).radiance[..., 1]
    # The edge is as wide as a pixel: half of the light inside is where it passes a pixel's centre.
    down, right = np.indices(light.shape)
    within = light > 0.9 * np.median(light[light > 0.0])
    places = np.stack([right, down, np.ones_like(down)], axis=-1)
    slope = np.linalg.lstsq(places[within], light[within], rcond=None)[0]
    v, u = np.nonzero(light > 0.5 * places @ slope)
    spread = np.linalg.eigvalsh(np.cov(np.stack([u, v]), bias=True))
    ellipse = renderer.world.truth.cone
    expected = [float(ellipse.semi_minor[0]), float(ellipse.semi_major[0])]
    # A uniform ellipse has the variance a^2/4 along an axis. Along an edge of some 200 pixels
    # counting them errs by 0.3 px each, so by 0.3 / sqrt(200) = 0.02 px in all.
    np.testing.assert_allclose(2 * np.sqrt(spread), expected, atol=0.06)
    np.testing.assert_allclose([u.mean(), v.mean()], ellipse.centre[0], atol=0.06)


def test_each_colour_is_rendered_where_its_label_says():
    fine = {"width_px": 320, "height_px": 240, "scale_mm_px": 0.01, "samples": 16}
    eye = {"eye": "navarro", "lens": "wide-field-90"}
    spot = {"eccentricity_mm": 4.0, "azimuth_deg": 30.0, "incidence_deg": 0.0}

    def centres(**viewing):
        scene = looked_at(eye | viewing, microscope=fine, spot=spot)
        light = Renderer(scene).render(0).radiance.astype(float)
        y, x = np.mgrid[0:240, 0:320]
        weight = light / light.sum(axis=(0, 1))
        at = np.stack([np.sum(weight * k[..., None], axis=(0, 1)) for k in (x, y)], axis=-1)
        return at[[0, 2]] - at[1], np.asarray(World(scene).colour_shifts)[:, 0]

    seen, labelled = centres(colours="own")
    # The label is the shift of one point, O; the centre of gravity of a spot of 0.36 mm moves
    # alike, but for the change of the shift across the spot, to second order.
    np.testing.assert_allclose(seen, labelled, rtol=0.05, atol=0.01)
    assert np.hypot(*labelled[0]) > 0.3  # px
    np.testing.assert_allclose(centres(colours="green")[0], 0.0, atol=1e-3)


def test_a_spot_that_touches_an_ellipsoid_touches_it_with_its_rim():
    scene = looked_at(
        {"eye": "atchison", "refraction_d": -8.0, "lens": "flat"},
        motion={"frames": 1},
        instrument={"fibre_diameter_mm": 0.6},  # wider than the cone
    )
    world = World(scene)
    ((tip,), (axis,)) = world.motion.at(np.zeros(1))
    rim = scene.instrument.fibre_diameter_mm / 2
    angle = np.linspace(0, 2 * np.pi, 400)
    across = [np.asarray(v) for v in optics.perpendicular_frame(axis)]
    points = tip + rim * (np.cos(angle)[:, None] * across[0] + np.sin(angle)[:, None] * across[1])
    x, y = scene.phantom.stretch
    level = np.linalg.norm(points / (scene.phantom.radius_mm * np.array([x, y, 1.0])), axis=1)
    # 64 points of the rim miss the lowest by 0.25 (2 pi / 128)^2 / 2 = 3e-4 mm at most.
    assert level.max() == pytest.approx(1.0, abs=5e-5)


def test_phi_is_the_angle_of_the_local_normal():
    scene = looked_at({"eye": "atchison", "lens": "flat"}, spot={"eccentricity_mm": 3.0})
    r, (x, _) = scene.phantom.radius_mm, scene.phantom.stretch
    slope = 3.0 / (r * x) ** 2 / (np.sqrt(1 - (3.0 / (r * x)) ** 2) / r)
    labels = spot_labels(World(scene), 0)
    assert labels["phi_rad"] == pytest.approx(np.arctan(slope), abs=1e-12)


def test_colours_are_shifted_apart_as_the_indices_are():
    """Blue is bent more: behind a contact lens the eye magnifies it less, so c looks smaller."""
    world = World(looked_at({"eye": "navarro", "lens": "flat"}))
    assert world.colour_shifts is not None
    red, blue = world.colour_shifts[:, 0]
    outward = np.array([np.cos(np.pi / 6), -np.sin(np.pi / 6)])  # v grows towards -Y
    assert red @ outward < 0 < blue @ outward
    same = World(looked_at({"eye": "navarro", "lens": "flat", "wavelengths_nm": [550.0] * 3}))
    assert same.colour_shifts is not None
    np.testing.assert_allclose(same.colour_shifts, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    "viewing, changes, said",
    [
        (
            {"eye": "navarro"},
            {},
            r"c <= 0\.1\d mm: the fundus lies near infinity\. .* set viewing\.lens to flat",
        ),
        (
            {"eye": "navarro", "lens": "flat", "pupil_mm": 0.2},
            {},
            r"with a pupil of 0\.2 mm, the microscope sees only c <= 0\.1\d mm\. Raise",
        ),
        (
            {"eye": "navarro", "lens": "flat"},
            {"spot": {"eccentricity_mm": 4.0}},
            r"hidden: a pupil of 7 mm shows c <= 3\.88 mm .* reaches 4\.\d\d mm\. Lower",
        ),
        ({"eye": "nobody"}, {}, "no such file. Known names: atchison, liou-brennan, navarro"),
        ({"eye": "navarro", "lens": "round"}, {}, "no such file. Known names: biconcave, flat"),
        ({"lens": "flat"}, {}, "viewing.lens needs an eye behind it"),
        (
            {"eye": "navarro", "lens": "flat"},
            {"phantom": {"radius_mm": 11.0}},
            r"phantom\.radius_mm contradicts the eye 'navarro', .* 12\.0; got 11\.0\. Remove it",
        ),
        (
            {"eye": "navarro", "lens": "flat"},
            {"microscope": {"pinhole_height_mm": 13.0}},
            r"must lie above the viewing lens and the cornea, at 14\.9 mm; got 13 mm",
        ),
        (
            {"eye": "atchison", "lens": "flat", "refraction_d": 9.0},
            {},
            r"refraction_d must lie in \[-10, 4\] D; got 9 D",
        ),
    ],
)
def test_what_cannot_be_seen_is_refused_with_a_remedy(viewing, changes, said):
    with pytest.raises(ValueError, match=said):
        World(looked_at(viewing, **changes)).check()


def test_the_command_of_the_page_renders_a_scene_file_that_was_just_made(tmp_path, monkeypatch):
    """Such a file has the default radius and pinhole, with which one cannot look into the eye."""
    page = (Path(__file__).parents[2] / "docs/viewing.md").read_text().replace("\\\n", "")
    found = re.search(r"^eyespot (render scene\.toml .*)$", page, re.MULTILINE)
    assert found
    small = {f"microscope.{key}": value for key, value in SMALL.items()} | {"motion.frames": 2}
    quick = {"source.kind": "cone", "phantom.wall": "uniform", "phantom.indirect": "off"}
    changes = "".join(f" --set {key}={value}" for key, value in (small | quick).items())
    monkeypatch.chdir(tmp_path)
    for words in ("scene init scene.toml", found[1] + changes):
        monkeypatch.setattr(sys, "argv", ["eyespot", *shlex.split(words)])
        with pytest.raises(SystemExit) as ended:
            eyespot.main()
        assert not ended.value.code
    written = tomllib.loads(Path("out/phakic/stack.toml").read_text())
    # The retina's radius of Escudero-Sanz and Navarro (1999).
    assert written["scene"]["phantom"]["radius_mm"] == pytest.approx(12.0)
    assert written["scene"]["microscope"]["pinhole_height_mm"] == 200.0


_LENS = {"numerical_aperture": 0.05, "focus_mm": 1.0}
_NARROW = {"kind": "cone", "medium": "vitreous", "cone_k": 60.0, "cone_core_radius_mm": 0.085}
_FINE = {"samples": 256, "scale_mm_px": 0.01, "width_px": 128, "height_px": 128}


def blurred(viewing, **changes):
    """Green light of a sharp and of a blurred spot at c = 1 mm, and the scene."""
    spot = {"eccentricity_mm": 1.0, "azimuth_deg": 30.0, "incidence_deg": 0.0}
    sharp, soft = (
        looked_at(viewing, microscope=_FINE | pupil, spot=spot, source=_NARROW, **changes)
        for pupil in ({}, _LENS)
    )
    images = [Renderer(scene).render(0).radiance[..., 1].astype(float) for scene in (sharp, soft)]
    return *images, soft


@pytest.mark.slow
def test_a_pupil_behind_an_eye_without_refraction_is_the_pinhole_scene_s(tmp_path):
    eye = {"eye": eye_file(tmp_path, index=1.0), "pupil_mm": 50.0}
    _, through, scene = blurred(eye)
    _, bare, _ = blurred({}, phantom={"radius_mm": scene.phantom.radius_mm})
    # The same random places in the pupil; float32 moves lines of sight by some 1e-6 mm.
    np.testing.assert_allclose(through, bare, atol=0.01 * bare.max())


@pytest.mark.slow
def test_a_spot_out_of_focus_is_spread_over_the_pupil_s_disc_behind_an_eye():
    sharp, soft, scene = blurred({"eye": "navarro", "lens": "flat"})
    (_, *before), (_, *after) = moments(sharp), moments(soft)
    np.testing.assert_allclose(after[:2], before[:2], atol=0.05)  # the grain of 256 places
    # Where the wall's point is seen from two places of the pupil's edge, by traced lines of sight.
    world = World(scene)
    camera, found = world.microscope, world.pencils
    centre = np.asarray(world.truth.cone.centre[0])
    slope = np.tan(np.arcsin(_LENS["numerical_aperture"]))
    assert found is not None
    hit = world.wall.intersect(*found.ray(centre, slope * np.eye(2)))
    aside = np.asarray(camera.project(hit.point)) - centre
    assert np.linalg.norm(aside, axis=1).min() > 3.0
    # The variance of a disc, or of its affine image. 16 x 16 places miss 0.4 % of it. The disc
    # shrinks by 22 % per mm2 from the axis, so on a spot of 0.12 mm it differs by 0.6 %.
    np.testing.assert_allclose(
        np.subtract(after, before)[2:], np.sum(aside**2, axis=0) / 4, rtol=0.012
    )


def test_a_surface_that_lines_of_sight_miss_is_not_taken_for_the_pupil(tmp_path):
    text = (
        importlib.resources.files("eyespot.optics.viewing") / "eyes" / "navarro.toml"
    ).read_text()
    path = tmp_path / "small_cornea.toml"
    # An ellipsoid of 0.26 mm across.
    path.write_text(text.replace("front_asphericity = -0.26", "front_asphericity = 900.0"))
    with pytest.raises(
        ValueError, match=r"whose surfaces end there, shows c <= 0\.5\d mm .* viewing\.lens\."
    ):
        World(looked_at({"eye": str(path), "lens": "flat"})).check()
