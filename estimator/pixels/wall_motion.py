"""Where the wall's picture is in an image: shifted and turned since its map was begun.

The map of the wall is drawn in the pixels of the first frame that it knows. When the eye turns or
the microscope drifts, a point of the map is elsewhere in the image.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float


class WallMotion(NamedTuple):
    """A shift and a turn of the image: p_image = R(turn) p_map + shift.

    Attributes:
        right, down: the shift, px.
        turn: clockwise as it is seen, rad.
    """

    right: float = 0.0
    down: float = 0.0
    turn: float = 0.0

    @classmethod
    def about(
        cls, centre: Float[np.ndarray, "2"], shift: Float[np.ndarray, "2"], turn: float
    ) -> WallMotion:
        """A turn about a point of the map, and then a shift."""
        right, down = centre + shift - cls(turn=turn).ways @ centre
        return cls(float(right), float(down), turn)

    @property
    def ways(self) -> Float[np.ndarray, "2 2"]:
        """Columns: where a step to the right and one down on the map lead in the image."""
        cosine, sine = math.cos(self.turn), math.sin(self.turn)
        return np.array([[cosine, -sine], [sine, cosine]])

    def image_px(self, on_map: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Where points of the map are in the image, px."""
        return on_map @ self.ways.T + (self.right, self.down)

    def map_px(self, in_image: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Where points of the image are on the map, px."""
        return (in_image - (self.right, self.down)) @ self.ways

    def after(self, first: WallMotion) -> WallMotion:
        """This motion after another one."""
        right, down = self.image_px(np.array([first.right, first.down])).tolist()
        return WallMotion(right, down, self.turn + first.turn)

    def since(self, first: WallMotion) -> WallMotion:
        """What came after another motion to make this one."""
        turn = WallMotion(turn=self.turn - first.turn)
        right, down = turn.image_px(np.array([first.right, first.down])).tolist()
        return WallMotion(self.right - right, self.down - down, turn.turn)

    def on_map(self, image: np.ndarray, corner: tuple[int, int], outside: float) -> np.ndarray:
        """An image as the map's pixels have it, from a corner (x, y) of the map on.

        It is as large as the image; what the image does not show has the value `outside`.
        """
        shift = self.image_px(np.array(corner, float))
        return cv2.warpAffine(
            image,
            np.column_stack([self.ways, shift]),
            image.shape[1::-1],
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderValue=outside,
        )


STILL = WallMotion()
"""Nothing has moved."""
