"""What only a computation tells of a scene: whether it can be rendered."""

from __future__ import annotations

from scenes.description import Scene
from scenes.rendering import wall_colour
from scenes.world import geometry, labels, photometry


def check_scene(scene: Scene) -> None:
    """Refuse a scene that `render_stack` would refuse; nothing is rendered.

    Raises:
        SceneError: the tip touches the wall, the spot leaves the window, the fixed exposure
            outlasts a frame, or a file that the scene names cannot be read.
    """
    table = geometry.lens_table(scene)
    labels.moments(scene, table)
    photometry.paper_exposure(scene, table, wall_colour=wall_colour(scene))
