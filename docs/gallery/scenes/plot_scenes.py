"""
What can be rendered
====================

Each picture is one frame; above it stand the keys that differ from the default scene, a lens over a
printed retina. `eyespot render scene.toml --set KEY=VALUE` takes the same.
"""

import matplotlib.pyplot as plt

from eyespot.scenes import load_scene, render_image


def show(*changes: str, frame: int = 0) -> None:
    """One frame, at the exposure that a camera would choose."""
    scene = load_scene(None, ["microscope.illumination_mw_mm2=0.3", *changes])
    plt.figure(figsize=(4.8, 3.6), layout="constrained")
    plt.imshow(render_image(scene, frame=frame, exposure="metered"))
    plt.axis("off")


# %%
# A cone of light on a drawn retina; the instrument stands in front of a part of the wall.
show("source.kind=cone", "phantom.wall=retina", "motion.start_mm=2")

# %%
# The light of a drop of glue falls off smoothly, so that its spot has no edge.
show("source.lens=dome", "source.medium=vitreous", "motion.start_mm=3")

# %%
# A part of a fundus photograph (Häggström 2014, CC0) as the wall. Any image file can be one.
show("phantom.wall=photograph", "source.lens=dome", "source.medium=vitreous", "motion.start_mm=3")

# %%
# A film of water reflects the light of the beam like a mirror.
wet = ("phantom.wall=retina", "phantom.coat=wet", "microscope.light=ambient")
show("source.kind=cone", *wet, "motion.start_mm=3")

# %%
# The eyeball may be an ellipsoid, tilted and shifted.
shape = ("phantom.stretch=[1.08, 0.95]", "phantom.tilt_deg=5", "phantom.shift_mm=[0.3, 0.0]")
show("source.kind=cone", *shape, "spot.eccentricity_mm=4", "motion.start_mm=2")

# %%
# With light from all sides the instrument shades the wall below it. Tracing the indirect light
# takes seconds a frame.
small = ("microscope.scale_mm_px=0.0134", "microscope.width_px=320", "microscope.height_px=240")
traced = ("phantom.indirect=traced", "microscope.light=ambient", "motion.start_mm=1")
show("source.kind=cone", *traced, *small)

# %%
# Another tool hides a part of the wall and of the spot.
tool = ("second_tool.visible=true", "second_tool.tip_mm=[-0.6, 0.5, -10.5]")
show("source.kind=cone", *tool, "motion.start_mm=3")

# %%
# A hand with tremor moves the tip, and the exposure blurs the spot.
hand = ("motion.kind=hand", "motion.duration_s=2", "motion.distance_mm=2")
show("source.kind=cone", *hand, "microscope.illumination_mw_mm2=0.05", frame=10)

# %%
# A cheap camera: a Bayer filter, the noise of a small full well, and JPEG as in USB video.
cheap = ("camera.bayer=RGGB", "camera.full_well_e=1500", "camera.jpeg_quality=50")
show("source.kind=cone", *cheap, "camera.response=srgb", "motion.start_mm=2")

# %%
# With a numerical aperture the wall is blurred where it is not in focus.
focus = ("microscope.numerical_aperture=0.03", "microscope.focus_mm=1.5", "microscope.samples=64")
show("source.kind=cone", "phantom.wall=retina", *focus, "motion.start_mm=2")

# %%
# Through a flat contact lens, the cornea and the crystalline lens of Navarro's eye.
lens = ("source.lens=dome", "source.medium=vitreous", "phantom.wall=retina", "motion.start_mm=2")
flat = ("viewing.lens=flat", "viewing.pupil_mm=14", "spot.eccentricity_mm=4")
show("viewing.eye=navarro", *lens, *flat, "spot.incidence_deg=10")

# %%
# Through a wide-field lens, whose image is inverted; `viewing.upright=true` turns it back.
wide = ("viewing.lens=wide-field-90", "spot.eccentricity_mm=3", "microscope.scale_mm_px=0.015")
show("viewing.eye=navarro", *lens, *wide, "spot.incidence_deg=10")
