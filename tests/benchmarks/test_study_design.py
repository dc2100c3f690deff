"""The bound of a distance on an unknown wall, its gradient, and the study that makes it small."""

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from eyespot import optics, scenes
from eyespot.benchmarks.studies import design
from eyespot.benchmarks.studies.design import LIMITS, DropSearch, limits_in
from eyespot.formats.inputs import InputError
from eyespot.optics.wall_light.unknown_wall import lit_radii, texture
from eyespot.scenes.walls.picture import wall_picture, write_random_wall
from eyespot.scenes.world.unknown_wall_bound import UnknownWallScene

DISTANCES = [1.0, 3.0]
SCENE = scenes.load_scene(None, ("source.medium=vitreous",))


def test_all_light_of_a_cone_lies_on_its_cells():
    light = UnknownWallScene(SCENE).of_cone(DISTANCES)
    power = light.spots.light[:, :, 0, 0].sum(axis=-1) * light.spots.side_mm**2
    # Cells are as large as at the spot's middle; over 1 mm of a wall of 11.5 mm the pinhole on the
    # sphere sees them up to 1 % larger or smaller.
    assert power == pytest.approx(1.0, abs=0.01)


def test_more_light_helps_until_the_wall_is_what_limits():
    wall = UnknownWallScene(SCENE)
    light = wall.of_cone(DISTANCES)
    doses = wall.full_dose * np.array([1e-6, 1e-5, 1e4, 1e6])
    sigmas = np.stack([wall.sigmas(light, dose) for dose in doses])
    assert (np.diff(sigmas, axis=0) < 0).all()
    # Read noise alone: the error is inversely proportional to the light.
    assert sigmas[0] / sigmas[1] == pytest.approx(10.0, rel=0.05)
    assert sigmas[2] / sigmas[3] == pytest.approx(1.0, abs=1e-3)


def test_an_outline_says_less_than_all_light():
    wall = UnknownWallScene(SCENE)
    light = wall.of_cone(DISTANCES)
    dose = 0.8 * wall.full_dose
    assert (wall.sigmas(light, dose, outline=True) > wall.sigmas(light, dose)).all()


def test_a_random_wall_has_the_texture_that_the_bound_assumes(tmp_path):
    variances, covariances = [], []
    for seed in range(4):
        write_random_wall(tmp_path / "wall.png", seed=seed, width_mm=12.0)
        image = {"wall": "image", "wall_image": str(tmp_path / "wall.png"), "wall_image_mm": 12.0}
        picture = wall_picture(SCENE.phantom.model_copy(update=image))
        log = np.log(picture[512:1536, 512:1536, 0])  # the map is twice as wide as the image
        off = log - log.mean()
        variances.append(np.mean(off**2))
        covariances.append(np.mean(off * np.roll(off, 43, axis=0)))
    # 43 pixels of 0.0117 mm are 0.504 mm. With shading of 1 mm a wall of 12 mm has some 100
    # independent parts: four walls give the covariance to 10 %, of which three are allowed.
    assert np.mean(variances) == pytest.approx(float(texture(jnp.zeros(()))), rel=0.3)
    assert np.mean(covariances) == pytest.approx(float(texture(jnp.asarray(0.504))), rel=0.3)


def test_limits_narrow_or_fix_a_number_and_a_wrong_one_is_named():
    found = limits_in("sag=0:0.1 core_radius=0.25")
    assert found == LIMITS | {"sag": (0.0, 0.1), "core_radius": (0.25, 0.25)}
    for wrong in ("sag=0.1:0", "sag=0:9", "height=1", "sag", "sag=a"):
        with pytest.raises(InputError, match=f"sag=0:0.2.*got '{wrong}'"):
            limits_in(wrong)


def test_a_cones_spot_is_lit_within_its_radius():
    wall = UnknownWallScene(
        scenes.load_scene(None, ("spot.incidence_deg=0", "spot.eccentricity_mm=0"))
    )
    light = wall.of_cone(DISTANCES)
    found = lit_radii(light.spots, np.zeros(0)) * 0.0067
    # The edge cuts cells of a thirteenth of the radius; a pinhole on the sphere is nearer by 0.3 %.
    assert found == pytest.approx(light.radii, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("goal", ["worst", "mean"])
def test_the_gradient_equals_differences(goal):
    search, free = DropSearch(SCENE, count=2, goal=goal, dose=None), tuple(LIMITS)
    drop = {"sag": 0.06, "rim_height": 0.3, "core_radius": 0.15, "numerical_aperture": 0.15}
    light = search.light(drop, free=free)
    _, slope = search.score(light)
    for k, (name, step) in enumerate(zip(LIMITS, (1e-3, 5e-3, 1e-3, 1e-3), strict=True)):
        # On the same cells, because the gradient is that of the light alone.
        near = [drop | {name: drop[name] + sign * step} for sign in (1, -1)]
        ahead, back = (
            search.score(search.light(other, free=free, radii=light.radii))[0] for other in near
        )
        # A table is good to 0.2 % of the peak. The steps change the light by some per cent, so that
        # a difference is good to a tenth.
        difference = (ahead - back) / (2 * step)
        assert difference == pytest.approx(slope[k], rel=0.1, abs=0.02 * np.abs(slope).max())


@pytest.mark.slow
def test_a_quick_run_finds_a_drop_that_beats_those_at_random(tmp_path):
    lights = design.design(out=tmp_path / "run", quick=True).set_index("light")
    drops = pd.read_csv(tmp_path / "run" / "drops.csv").groupby("way").sigma_mm.min()
    assert drops["gradient"] < drops["random"]
    assert lights.worst_mm["best drop"] < lights.worst_mm["dome"]
    assert optics.load_lens(tmp_path / "run" / "best.toml").sag > 0
