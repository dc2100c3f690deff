"""What only a computation tells of a scene: whether it can be rendered."""

from __future__ import annotations

from scenes.description import Scene
from scenes.world import World, paper_exposure


def check_scene(scene: Scene) -> None:
    """Refuse a scene that `render_stack` would refuse; nothing is rendered.

    Raises:
        SceneError: the tip touches the wall, the spot leaves the window, the fixed exposure
            outlasts a frame, or a file that the scene names cannot be read.
    """
    world = World(scene)
    world.truth  # noqa: B018 - deriving it is the check
    paper_exposure(world)
