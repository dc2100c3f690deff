"""Checks whether a scene can be rendered."""

from __future__ import annotations

from scenes.description import Scene
from scenes.world import World, paper_exposure


def check_scene(scene: Scene) -> None:
    """Refuse a scene that `render_stack` would refuse, without rendering.

    Raises:
        SceneError: the tip touches the wall, the spot leaves the window, the fixed exposure
            is longer than a frame, or a file of the scene cannot be read.
    """
    world = World(scene)
    world.check()
    paper_exposure(world)
