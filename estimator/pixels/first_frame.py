"""Explains a frame by itself: its pose, and the texture of a wall that is not known yet."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimator.image import CameraNoise, Outline
from estimator.pixels.beam import BeamLight
from estimator.pixels.belief import Belief, distinct, lit_px2
from estimator.pixels.cells import COUNT, Window
from estimator.pixels.frame_fit import STEPS, robust_fit, unlike_wall
from estimator.pixels.frame_model import contrast
from estimator.pixels.frame_state import FrameState
from estimator.pixels.look import Look, reach_px
from estimator.pixels.mix import Mix, evener_mix
from estimator.pixels.reference import Reference
from estimator.pixels.solution import Solution
from estimator.pixels.solver import Solver
from estimator.pixels.starts import (
    blurred_starts,
    likely_directions,
    mirrored_start,
    scanned_starts,
)
from estimator.pixels.texture import Texture, texture_of

_STEPS_FIRST = 14
_FEWEST = 30  # cells of a first frame; it has sixteen states
_AMBIENT = (-4.0, 3.0)  # log of ambient light over the beam's power: nearly nothing is known
_CLEAR = 3.0
"""Least light of the beam over the ambient one, from which the mixture of colours is chosen. Where
a lamp's reflection is as bright, the mixture that is even may lack the beam's colour."""
_SURPRISE = 1.5
"""Square of a first frame's surprise, above which its wall is not that of the reference."""
_AGAINST = 5.0  # standard deviations from the robot's axis that no pose has


class FirstFrame(NamedTuple):
    """What a frame by itself says.

    Attributes:
        beliefs: the best explanation and others that are nearly as good; none if there is none.
        mix: the mixture of channels in which they hold.
    """

    beliefs: list[Belief]
    mix: Mix


def explained_alone(
    beam: BeamLight, noise: CameraNoise, reference: Reference | None, look: Look, spot: Outline
) -> FirstFrame:
    """Explain a frame by itself.

    Args:
        beam: its light.
        noise: of the camera.
        reference: the wall without the spot; None if there is no image of it.
        look: the frame.
        spot: its outline.
    """

    def solver_for(mix: Mix, texture: Texture) -> Solver:
        known = None if reference is None else reference.seen_in(mix).known
        return Solver(beam, window, texture, known)

    picture, direction, sweep, robot = look
    window = Window.around(np.array([spot.x_px, spot.y_px]), reach_px(spot, sharp=beam.sharp))
    mix = picture.plain_mix(spot)
    cells = picture.cells(mix)
    solver = solver_for(mix, Texture.usual())
    own = np.zeros(beam.spread.shape[1])
    starts = scanned_starts(
        solver,
        lambda pose: FrameState(cells, pose, 0.0, 0.0, direction, _AMBIENT, sweep, robot),
        spot,
        own,
        likely_directions(beam, spot, direction),
    )
    if beam.sharp:
        starts = [blurred for start in starts for blurred in blurred_starts(start, spot)]
    found = [robust_fit(solver, [], start, own, steps=_STEPS_FIRST)[0] for start in starts]
    if not found:
        return FirstFrame([], mix)
    best = min(found, key=solver.unlikelihood_of)
    mirrored = mirrored_start(solver, best.frames[0], own)
    if mirrored is not None:
        found.append(robust_fit(solver, [], mirrored, own, steps=_STEPS_FIRST)[0])
    # Again with this wall's texture, in the channels in which it has the least.
    usable = picture.usable & ~window.pixels(unlike_wall(solver, best), picture.usable.shape)
    picture = replace(picture, usable=usable)
    clear = contrast(solver.model.light(best.frames[0], best.own), best.frames[0]) > _CLEAR
    if clear and not (noise.coarse_colours or picture.saturated.any()):
        mix = evener_mix(picture.channels, usable, window, best, mix)
    cells = picture.cells(mix)
    found = [
        solver.solve([], replace(one.frames[0], cells=cells), own, steps=STEPS) for one in found
    ]
    best = min(found, key=solver.unlikelihood_of)
    if np.count_nonzero(best.linear[0].weight) < _FEWEST:
        return FirstFrame([], mix)
    solver = solver_for(mix, learnt_texture(solver, best))
    again = [robust_fit(solver, [], one.frames[0], own) for one in found]
    # A pose may explain the light by chance, but not against the robot.
    as_told = [one for one in again if one[0].frames[0].axis_off < _AGAINST]
    beliefs = [
        Belief(
            solver=solver,
            kept=[(one.frames[0], one.linear[0])],
            solution=one,
            learnt_px2=lit_px2(solver, one),
            surprise=surprise.square,
            lost=surprise.square > _SURPRISE,
        )
        for one, surprise in as_told or again
    ]
    return FirstFrame(distinct(beliefs), mix)


def learnt_texture(solver: Solver, solution: Solution) -> Texture:
    """The texture that all frames of a solution show. Takes a second or two."""
    return texture_of(*solution.together, count=COUNT, side_mm=solver.model.side_mm)
