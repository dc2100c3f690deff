"""The light of a withdrawal on square cells of its frames, with all derivatives.

The mean light of a cell is exact, however sharp its edges are (see `optics.wall_light`). The light
is evaluated on tiles of cells that a frame's beam can reach, so that one compilation serves all
frames and no time is spent on the dark.
"""

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from eyespot import optics
from eyespot.calibration.pixels.data import CONE, LENS, POSE, Footage
from eyespot.calibration.pixels.lens_light import LinearLensLight
from eyespot.calibration.spots.cone_trials import (
    beam_directions,
    phantom_wall,
    reading_at,
    undelayed,
)
from eyespot.estimator.pixels.beam_on_cells import blurred, blurred_with_growth
from eyespot.optics.wall_light.cells import NODES, CellBeam, pixels_see, square_lattice
from eyespot.optics.wall_light.cone import UniformCone
from eyespot.optics.wall_light.pose_light import (
    BeamFrame,
    beam_at_wall,
    irradiance_alone,
    irradiance_and_slopes,
)

TILE = 16  # cells along a tile's side
STATES = ("power", "exposure", "x", "y", "z", "right", "down")
"""What each frame has of its own: logarithms of the source's power and of the exposure over what
is reported, the tip's place less the robot's, mm, and the shift of the image, px."""
TIP, SHIFT = slice(2, 5), slice(5, 7)
_OBLIQUE_MARGIN_MM = 0.3
"""Farther along the beam than the axis meets the wall: an oblique wall is lit there."""
VIEW = ("scale", "eye_radius", "inverse_working_distance")
"""Parameters of how the microscope sees the wall."""
_STEP = 1e-6
"""Relative, of differences by these: a step of 1e-4 moves an edge by 0.005 px, whose second order,
a quarter of a percent of the first, would pass for knowledge of what only a prior says."""
_LEAST_SIZE = 1e-3
"""Size from which on a step is relative: of 1/mm, that of a pinhole a metre away."""


class Cells(NamedTuple):
    """Square cells of an image.

    Attributes:
        left, top: first pixel.
        side: of a cell, px.
        tiles: number of tiles along each side.
    """

    left: int
    top: int
    side: int
    tiles: int

    @classmethod
    def over(cls, shape: tuple[int, int], side: int, *, beyond: bool = False) -> "Cells":
        """Cells over a whole image of height x width, and one tile beyond it on each side."""
        tiles = math.ceil(max(shape) / (side * TILE)) + 2 * beyond
        top, left = ((length - tiles * TILE * side) // 2 for length in shape)
        return cls(left, top, side, tiles)

    @property
    def along(self) -> int:
        """Cells along each side."""
        return self.tiles * TILE

    def centres(self) -> Float[np.ndarray, "n 2"]:
        """(u, v) of the cells' centres, px."""
        centres = (np.arange(self.along) + 0.5) * self.side - 0.5
        u, v = np.meshgrid(centres + self.left, centres + self.top)
        return np.stack([u.ravel(), v.ravel()], axis=-1)

    def means(
        self, image: Float[np.ndarray, "h w"], clear: Bool[np.ndarray, "h w"]
    ) -> tuple[Float[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
        """Mean of each cell, and whether all of its pixels are inside the image and clear."""
        size = self.along * self.side
        begins = -self.top, -self.left
        room = [(at, size - at - length) for at, length in zip(begins, image.shape, strict=True)]

        def in_cells(values: np.ndarray) -> np.ndarray:
            padded = np.pad(values, room)
            return padded.reshape(self.along, self.side, self.along, self.side)

        mean = in_cells(image).mean(axis=(1, 3), dtype=float)
        return mean.ravel(), in_cells(clear).all(axis=(1, 3)).ravel()

    def tile(self, row: int, column: int) -> Int[np.ndarray, "m"]:
        """Numbers of a tile's cells."""
        rows, columns = (at * TILE + np.arange(TILE) for at in (row, column))
        return np.asarray((rows[:, None] * self.along + columns).ravel())

    def tiles_near(self, at_px: Float[np.ndarray, "2"], reach_px: float) -> list[tuple[int, int]]:
        """Rows and columns of the tiles within some distance of a point."""
        size = TILE * self.side
        found = []
        for row, column in itertools.product(range(self.tiles), repeat=2):
            corner = np.array([self.left + column * size, self.top + row * size]) - 0.5
            aside = np.maximum(np.maximum(corner - at_px, at_px - corner - size), 0.0)
            if math.hypot(*aside) <= reach_px:
                found.append((row, column))
        return found


class FrameLight(NamedTuple):
    """The model of one frame on the n cells of the tiles near its beam, full wells.

    Attributes:
        light: all light of an even wall.
        direct: the beam's part of it.
        along: distance of the wall from the tip's plane, mm.
        tip, axis: the tip, mm, and the beam.
        slopes: of `light`, by the free parameters.
        by_state: of `light`, by the frame's power, exposure and tip.
    """

    cells: Int[np.ndarray, "n"]
    light: Float[np.ndarray, "n"]
    direct: Float[np.ndarray, "n"]
    along: Float[np.ndarray, "n"]
    tip: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    slopes: Float[np.ndarray, "p n"]
    by_state: Float[np.ndarray, "5 n"]


class Light:
    """The light of all frames of a withdrawal on one lattice of cells.

    Where parameters of the view (`VIEW`) are free, the light is linear in them around those of the
    last `look`: their derivatives take as long as three more models.

    Args:
        names: names of the free parameters.
        lens: the light of a fit's lens; None for a cone.
        nodes: at which a lens's light is taken on each side of a cell.
    """

    def __init__(
        self,
        footage: Footage,
        cells: Cells,
        names: tuple[str, ...],
        lens: LinearLensLight | None,
        *,
        nodes: int = NODES,
    ) -> None:
        self.footage, self.cells, self.names, self.lens = footage, cells, names, lens
        # The beam's own parameters, which its light takes.
        self.own = tuple(name for name in names if name in (CONE if lens is None else LENS))
        of_cone = np.array([[name == free for free in self.own] for name in CONE], float)
        self._of_cone = of_cone.reshape(len(CONE), len(self.own))
        self.of_view = tuple(name for name in VIEW if name in names)
        self._view = functools.lru_cache(maxsize=4)(
            functools.partial(_WallView, footage, cells, nodes)
        )
        self._looked: dict[str, float] = {}
        self._by_view: dict[int, np.ndarray] = {}  # by number of frame, of all cells
        self._last: tuple[Any, list[FrameLight]] = None, []

    def view(self, values: Mapping[str, float]) -> "_WallView":
        """The wall as the microscope sees it."""
        return self._view(*(values[name] for name in VIEW))

    def look(
        self,
        values: Mapping[str, float],
        states: Float[np.ndarray, "frames 7"],
        numbers: Sequence[int],
    ) -> None:
        """Make the light of some frames linear in the view around that of these parameters."""
        if not self.of_view:
            return
        self._looked = {name: values[name] for name in self.of_view}
        self._by_view = {k: np.zeros((len(self.of_view), self.cells.along**2)) for k in numbers}
        self._last = None, []
        here = self._frames(values, states, numbers, False)
        if here is None:  # a beam meets no wall
            return
        for row, name in enumerate(self.of_view):
            step = _STEP * max(abs(values[name]), _LEAST_SIZE)
            moved = self._frames({**values, name: values[name] + step}, states, numbers, False)
            for number, own, other in zip(numbers, here, moved or here, strict=True):
                self._by_view[number][row, own.cells] = (other.light - own.light) / step

    def frames(
        self,
        values: Mapping[str, float],
        states: Float[np.ndarray, "frames 7"],
        numbers: Sequence[int],
        *,
        slopes: bool = True,
    ) -> list[FrameLight] | None:
        """The model of some frames; None if a beam meets no wall.

        Args:
            values: of all parameters.
            states: of all frames, see `STATES`.
            slopes: whether to compute the derivatives, which may be empty otherwise.
        """
        # Fits choose cells, learn the noise and start anew where they were.
        table = () if self.lens is None else self.lens.where
        place = tuple(values.items()), states[list(numbers)].tobytes(), tuple(numbers), table
        if place == self._last[0]:
            return self._last[1]
        found = self._frames({**values, **self._looked}, states, numbers, slopes)
        if found is None:
            return None
        rows = [self.names.index(name) for name in self._looked]
        moved = np.array([values[name] - at for name, at in self._looked.items()])
        for k, own in enumerate(found if rows else ()):
            by_view = self._by_view[numbers[k]][:, own.cells]
            found[k] = own._replace(light=own.light + moved @ by_view)
            if slopes:
                own.slopes[rows] = by_view
        if slopes:
            self._last = place, found
        return found

    def _frames(
        self,
        values: Mapping[str, float],
        states: np.ndarray,
        numbers: Sequence[int],
        slopes: bool,
    ) -> list[FrameLight] | None:
        footage, view = self.footage, self.view(values)
        chosen = list(numbers)
        delayed = undelayed(footage.readings) if footage.delayed is None else footage.delayed
        poses, turns = map(
            np.asarray,
            _poses(
                jnp.array([values[name] for name in POSE]),
                jnp.asarray(delayed[chosen]),
                jnp.asarray(footage.delay_s),
                jnp.asarray(footage.motion),
                jnp.asarray(footage.axis),
                view.camera,
                view.wall,
            ),
        )
        source: Any
        if self.lens is None:
            source, emitted = UniformCone.of(values["half_angle"], values["b"]), 1.0
        else:
            source = self.lens.at(values)
            emitted = float(source.transmitted())
        every = zip(numbers, poses, turns, strict=True)

        def one(frame: tuple[int, np.ndarray, np.ndarray]) -> FrameLight | None:
            return self._frame(values, states[frame[0]], *frame, view, source, emitted, slopes)

        with ThreadPoolExecutor(2) as pool:
            # The first frame runs alone, so that only one thread compiles.
            first = one(next(every))
            found = [first, *pool.map(one, every)]
        return None if any(own is None for own in found) else found  # type: ignore[return-value]

    def _frame(
        self,
        values: Mapping[str, float],
        state: Float[np.ndarray, "7"],
        number: int,
        pose: Float[np.ndarray, "6"],
        turn: Float[np.ndarray, "6 9"],
        view: "_WallView",
        source: CellBeam,
        emitted: float,
        slopes: bool,
    ) -> FrameLight | None:
        tip, axis = pose[:3] + state[TIP], pose[3:]
        beam = beam_at_wall(view.wall, tip, axis)
        if beam is None:
            return None
        cells, shine = self._shine(values, view, source, beam, slopes)
        # The light by a change of the tip and of the axis, through the five numbers of a pose.
        log_power, log_exposure = state[:2]
        rho = values["reflectance"]
        gain = values["sensitivity"] * self.footage.exposure_s[number] * math.exp(log_exposure)
        gain *= rho / math.pi
        power = gain * values["power"] * math.exp(log_power)
        sphere = 4.0 * math.pi * values["eye_radius"] ** 2
        closed = emitted / sphere if self.footage.kind == "eyeball" else 0.0
        direct, coaxial = power * shine[0], gain * view.coaxial[cells]
        glow = direct + power * closed * rho / (1.0 - rho)
        light = glow + values["illumination"] * coaxial
        along = (view.point[cells] - tip) @ axis
        if not slopes:
            none = np.zeros((0, cells.size))
            return FrameLight(cells, light, direct, along, tip, axis, none, none)
        # By the parameters of a pose and by the tip, from those by its five changes.
        change, by_change = np.linalg.inv(beam.slopes), power * shine[1:6]
        of_turn = np.concatenate([turn[:3], np.stack([beam.first, beam.second]) @ turn[3:]])
        by_pose, by_tip = (change @ of_turn).T @ by_change, change[:, :3].T @ by_change
        own = power * shine[6:]
        by_name = dict(zip(POSE, by_pose, strict=True)) | {
            "sensitivity": light / values["sensitivity"],
            "illumination": coaxial,
            "power": glow / values["power"],
            "reflectance": light / rho + power * closed / (1.0 - rho) ** 2,
            **dict(zip((*self.own, *self._spreads(values)), own, strict=True)),
        }
        zero = np.zeros(cells.size)
        by_parameter = np.array([by_name.get(name, zero) for name in self.names])
        by_state = np.concatenate([[glow, light], by_tip])
        return FrameLight(cells, light, direct, along, tip, axis, by_parameter, by_state)

    def _shine(
        self,
        values: Mapping[str, float],
        view: "_WallView",
        source: CellBeam,
        beam: BeamFrame,
        slopes: bool,
    ) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "k n"]]:
        """Irradiance per unit power, 1/mm², by five changes of the pose and by the beam's own."""
        at_px = np.asarray(view.camera.project(beam.spot))
        distance = float(beam.distance) + _OBLIQUE_MARGIN_MM
        if self.lens is None:
            reach = math.tan(values["half_angle"]) * (distance - values["b"])
        else:
            reach = self.lens.reach_mm(distance)
        near = self.cells.tiles_near(at_px, reach / values["scale"] + 2 * self.cells.side)
        if not near:
            near = self.cells.tiles_near(at_px, math.inf)[:1]
        own: dict[str, Any] = {
            "own": np.zeros(len(self.own)),
            "spread": self._of_cone if self.lens is None else self.lens.slopes(values),
        }
        parts = []
        for tile in near:
            given = view.lattice(*tile), source, beam
            if slopes:
                value, change = irradiance_and_slopes(*given, **own)
                parts.append(np.concatenate([np.asarray(value)[None], change]))
            else:
                value = irradiance_alone(*given, **own)
                parts.append(np.asarray(value)[None])
        numbers = np.concatenate([self.cells.tile(*tile) for tile in near])
        shine = np.concatenate(parts, axis=1)
        spreads = self._spreads(values)
        if spreads:
            shine = self._spread(values, spreads, numbers, shine)
        return numbers, shine

    @staticmethod
    def _spreads(values: Mapping[str, float]) -> list[str]:
        """Names of the parameters that say how the light spreads from cell to cell."""
        return [name for name in ("blur", "spread") if name in values]

    def _spread(
        self,
        values: Mapping[str, float],
        names: Sequence[str],
        numbers: Int[np.ndarray, "n"],
        shine: Float[np.ndarray, "k n"],
    ) -> Float[np.ndarray, "k+m n"]:
        """Light after a Gaussian blur by the camera and the spread in the wall, exp(-r/L).

        Each is followed by a derivative. The variance of exp(-r/L) is 3 L² along each side.
        """
        whole = np.zeros((len(shine), self.cells.along**2))
        whole[:, numbers] = shine
        growths: list[np.ndarray] = []
        for name in names:
            wide, kurtosis = (1.0, 0.0) if name == "blur" else (3.0**0.5 / values["scale"], 2.0)
            wide /= self.cells.side
            variance = (wide * values[name]) ** 2
            growths = [blurred(growth, variance, kurtosis) for growth in growths]
            _, grown, _ = blurred_with_growth(whole[0], variance, kurtosis)
            growths.append(2.0 * wide**2 * values[name] * grown)
            whole = blurred(whole, variance, kurtosis)
        if len(shine) > 1:
            whole = np.concatenate([whole, np.array(growths)])
        return whole[:, numbers]


class _WallView:
    """The wall behind the cells, for one scale, radius of the eye and pinhole."""

    def __init__(
        self,
        footage: Footage,
        cells: Cells,
        nodes: int,
        scale: float,
        eye_radius: float,
        kappa: float,
    ) -> None:
        file = footage.microscope
        k1, k2, p1, p2, k3 = file.distortion
        self.camera = optics.microscope(
            scale=scale,
            pinhole_height=1.0 / kappa - eye_radius if kappa else math.inf,
            eye_radius=eye_radius,
            principal_point=file.principal_point_px,
            distortion=(k1, k2, p1, p2, k3),
        )
        self.wall = phantom_wall(footage.kind, eye_radius=eye_radius)
        self.cells, self.nodes = cells, nodes
        centres = cells.centres()
        self.point, normal = map(np.asarray, pixels_see(self.camera, self.wall, centres))
        self.sight = np.asarray(self.camera.ray(jnp.asarray(centres))[1])
        across = float(self.camera.inverse_working_distance) ** 2
        aside = np.sum(np.square(self.point[:, :2]), axis=-1)
        depth = np.asarray(self.camera.depth(jnp.asarray(self.point)))
        self.coaxial = -np.sum(normal * self.sight, axis=-1) / (across * aside + depth**2)
        self.lattice = functools.cache(self._lattice)

    def _lattice(self, row: int, column: int) -> Any:
        size = TILE * self.cells.side
        corner = np.array([self.cells.left + column * size, self.cells.top + row * size]) - 0.5
        right = np.array([self.cells.side, 0.0])
        return square_lattice(
            self.camera, self.wall, corner=corner, right=right, count=TILE, nodes=self.nodes
        )


@eqx.filter_jit
def _poses(
    at: Float[Array, "9"],
    delayed: Float[Array, "frames delays"],
    delay_s: Float[Array, ""],
    motion: Float[Array, "3"],
    axis: Float[Array, "3"],
    camera: optics.Microscope,
    wall: optics.Surface,
) -> tuple[Float[Array, "frames 6"], Float[Array, "frames 6 9"]]:
    """Tip and axis of frames by the parameters `POSE`, and their derivatives."""

    def pose(at: Array, delayed: Array) -> Array:
        touch, u, v, lean, lean_sideways, boresight, boresight_sideways, scale, late = at
        spot = wall.intersect(*camera.ray(jnp.stack([u, v]))).point
        way, beam = beam_directions(
            motion=motion,
            axis=axis,
            lean=jnp.stack([lean, lean_sideways]),
            boresight=jnp.stack([boresight, boresight_sideways]),
        )
        gone = scale * reading_at(delayed, late / delay_s)
        return jnp.concatenate([spot - touch * beam - gone * way, beam])

    return jax.vmap(lambda own: (pose(at, own), jax.jacfwd(pose)(at, own)))(delayed)
