"""The image model on all chunks of a fit, on all cores."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from calibration.pixels.chunks import Chunk, Problem, Sums, linearised, look, sums
from calibration.pixels.misfit import Pixels
from optics.wall_light import LensTable


class Place(NamedTuple):
    """Where the model is evaluated.

    Attributes:
        problem: the fit.
        table: light of the lens, computed near `x`; None for a cone.
        x: the parameters, without exposures.
        over: relative excess of each frame's exposure over the reported one.
        exposures: whether exposures are parameters too.
    """

    problem: Problem
    table: LensTable | None
    x: Float[Array, "p"]
    over: Float[np.ndarray, "frames"]
    exposures: bool


def parts_at(place: Place, chunks: Sequence[Chunk]) -> list[Sums]:
    """The sums of every chunk."""

    def part(chunk: Chunk) -> Sums:
        over = place.over[int(chunk.frame)]
        return jax.block_until_ready(sums(place.problem, place.table, place.x, over, chunk))

    with ThreadPoolExecutor() as pool:
        # The first chunk runs alone, so that only one thread compiles.
        return [part(chunks[0]), *pool.map(part, chunks[1:])]


def pixels_at(place: Place, chunks: Sequence[Chunk]) -> Iterator[Pixels]:
    """The pixels of every frame with their residuals and derivatives, in the chunks' order."""
    p, frames = place.x.size, len(place.over)

    def of_frame(own: list[Chunk]) -> Pixels:
        frame, parts = int(own[0].frame), []
        for chunk in own:
            view = look(place.problem, place.table, place.x, chunk)
            off, derivatives = linearised(
                place.problem, place.table, place.x, place.over[frame], chunk
            )
            columns = (*chunk.pixels.T, view.direct, view.light, chunk.weight, off)
            rows = [*columns, *np.asarray(derivatives)[: p + place.exposures]]
            parts.append(np.array(rows)[:, chunk.weight > 0])
        u, v, direct, light, weight, residual, *slope = np.concatenate(parts, axis=1)
        slopes = np.zeros((p + frames * place.exposures, u.size))
        slopes[:p] = slope[:p]
        if place.exposures:
            slopes[p + frame] = slope[p]
        return Pixels(frame, u, v, direct, light, weight, residual, slopes)

    by_frame = [list(own) for _, own in itertools.groupby(chunks, lambda c: int(c.frame))]
    cores = os.cpu_count() or 1
    with ThreadPoolExecutor(cores) as pool:
        # No more frames than cores at a time, because the derivatives of all pixels take gigabytes.
        for first in range(0, len(by_frame), cores):
            yield from pool.map(of_frame, by_frame[first : first + cores])


def compile_model(place: Place, chunk: Chunk) -> None:
    """Compile what a fit evaluates for places and chunks of these shapes."""
    look(place.problem, place.table, place.x, chunk)
    parts_at(place, [chunk])
