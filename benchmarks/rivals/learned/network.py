"""The network: from a window and its place to an ellipse and a distance, each with its sigma."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from eyespot.formats.inputs import InputError, in_file, read_text
from eyespot.formats.microscope import MicroscopeFile
from eyespot.formats.stack import FrameLabels

# Windows of a frame that the network gets: where they lie, their pixels, and the way back.
#
# The first window comes from the brightest blurred blob of the frame. It is cheap and right to a
# third of the spot's radius, which is enough: the network says where the ellipse lies in the
# window, and a second window is cut around that.

CELLS = 64  # along a side of a window
REACH = 1.9  # half a window's side over the spot's mean radius: rim and surroundings are inside
_LEAST_HALF_PX = 24
_STRIDE = 8  # px of a cell in which the blob is searched
_BLUR_CELLS = 1.5
_LEAST_CONTRAST = 2.0  # grey values of a blob over the frame's median
_DARK = 1e-6


class Guess(NamedTuple):
    """A rough circle, px."""

    x: float
    y: float
    radius: float


class PixelSquare(NamedTuple):
    """A square of whole pixels: its left and upper edges and its side, px."""

    left: int
    top: int
    side: int

    @classmethod
    def around(cls, guess: Guess) -> "PixelSquare":
        """The window for a spot of this place and mean radius."""
        half = max(REACH * guess.radius, _LEAST_HALF_PX)
        left, top = (round(at + 0.5 - half) for at in (guess.x, guess.y))
        return cls(left, top, round(2 * half))

    @property
    def half(self) -> float:
        """Half of the side, px."""
        return self.side / 2

    @property
    def centre(self) -> tuple[float, float]:
        """Centre in image coordinates, in which pixel centres are integers."""
        return self.left + self.half - 0.5, self.top + self.half - 0.5


def blob_in(image: np.ndarray) -> Guess | None:
    """The brightest blurred blob of an 8-bit frame; None in an even one."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    height, width = (max(side // _STRIDE, 1) for side in grey.shape)
    coarse = cv2.resize(grey.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    coarse = cv2.GaussianBlur(coarse, (0, 0), _BLUR_CELLS)
    dark, bright = float(np.median(coarse)), float(coarse.max())
    if bright - dark < _LEAST_CONTRAST:
        return None
    above = (coarse > (dark + bright) / 2).astype(np.uint8)
    _, labels, stats, centres = cv2.connectedComponentsWithStats(above)
    label = labels[np.unravel_index(np.argmax(coarse), coarse.shape)]
    per_x, per_y = grey.shape[1] / width, grey.shape[0] / height
    x, y = centres[label]
    area = stats[label, cv2.CC_STAT_AREA] * per_x * per_y
    return Guess((x + 0.5) * per_x - 0.5, (y + 0.5) * per_y - 0.5, float(np.sqrt(area / np.pi)))


def cut(image: np.ndarray, window: PixelSquare) -> Float[np.ndarray, "3 64 64"]:
    """Pixels of a window: square roots of the grey values, where noise is even, from 0 to 1.

    What lies outside of the frame repeats its border. A grey frame counts as three equal channels.
    """
    colour = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    left, top, side = window
    rows, columns = np.arange(top, top + side), np.arange(left, left + side)
    height, width = colour.shape[:2]
    inside = colour[np.ix_(rows.clip(0, height - 1), columns.clip(0, width - 1))]
    small = cv2.resize(inside.astype(np.float32), (CELLS, CELLS), interpolation=cv2.INTER_AREA)
    return np.sqrt(small / 255.0).transpose(2, 0, 1)


def evened(window: np.ndarray) -> np.ndarray:
    """A window with mean 0 and standard deviation 1 over all channels: exposure does not count."""
    values = np.asarray(window, np.float32)
    axes = (-3, -2, -1)
    spread = values.std(axis=axes, keepdims=True)
    return (values - values.mean(axis=axes, keepdims=True)) / np.maximum(spread, _DARK)


NUMBERS = ("x", "y", "size", "ratio_cos", "ratio_sin", "log_distance")
PLACES = 4  # numbers of `place_of`
_FIELD_MM, _HEIGHT_MM = 3.0, 200.0  # bring the place to the order of 1


def targets_of(labels: FrameLabels, window: PixelSquare) -> Float[np.ndarray, "6"]:
    """The true numbers of a window."""
    a, b = labels.half_max_semi_major_px, labels.half_max_semi_minor_px
    (x, y), half = window.centre, window.half
    q, turn = math.log(a / b), 2 * labels.half_max_angle_rad
    place = (labels.half_max_x_px - x) / half, (labels.half_max_y_px - y) / half
    size = math.log(REACH * math.sqrt(a * b) / half)
    return np.array([*place, size, q * math.cos(turn), q * math.sin(turn), math.log(labels.d_mm)])


def place_of(window: PixelSquare, microscope: MicroscopeFile) -> Float[np.ndarray, "4"]:
    """Where and how large a window is on the retina, and how high the pinhole is."""
    scale, height = microscope.scale_mm_px, microscope.pinhole_height_mm
    x, y = scale * (np.array(window.centre) - microscope.principal_point_px) / _FIELD_MM
    return np.array([math.log(scale * window.half), x, y, height / _HEIGHT_MM])


def ellipse_of(numbers: np.ndarray, window: PixelSquare) -> np.ndarray:
    """(x, y, semi-major, semi-minor, angle) in px and rad, of the first five numbers."""
    x, y = np.array(window.centre) + window.half * numbers[:2]
    radius = window.half / REACH * math.exp(numbers[2])
    q, angle = math.hypot(numbers[3], numbers[4]), math.atan2(numbers[4], numbers[3]) / 2
    return np.array([x, y, radius * math.exp(q / 2), radius * math.exp(-q / 2), angle])


def covariance_of(
    numbers: np.ndarray, sigmas: np.ndarray, window: PixelSquare
) -> Float[np.ndarray, "5 5"]:
    """Covariance of `ellipse_of`, px and rad, from independent errors of the numbers."""
    _, _, a, b, _ = ellipse_of(numbers, window)
    q = math.hypot(numbers[3], numbers[4])
    # Towards a circle the axes' direction is lost: there the ratio's error counts whichever way.
    along = np.array(numbers[3:5]) / q if q > 0 else np.array([1.0, 0.0])
    slopes = np.zeros((5, 5))
    slopes[0, 0] = slopes[1, 1] = window.half
    slopes[2, 2:] = a, *(a / 2 * along)
    slopes[3, 2:] = b, *(-b / 2 * along)
    floor = max(q, float(np.hypot(sigmas[3], sigmas[4])), 1e-9)
    slopes[4, 3:] = -along[1] / (2 * floor), along[0] / (2 * floor)
    return (slopes * np.square(sigmas[:5])) @ slopes.T


Numbers = Array | np.ndarray

_CHANNELS = ((3, 16, 5, 2), (16, 24, 3, 1), (24, 32, 3, 2), (32, 48, 3, 2), (48, 64, 3, 2))
"""(channels in, channels out, width, stride) of each convolution: 64 cells become 4."""

_SEEN = 4 * 4 * _CHANNELS[-1][1]
_WIDTH = 96
_SCALES = (0.1, 0.1, 0.1, 0.1, 0.1, 1.0)
"""Orders of magnitude of the numbers; steps of the optimiser are of the order of 1."""
_LEAST_LOG, _MOST_LOG = -9.0, 2.0  # of sigma: outside of it nothing is learnt


class Output(NamedTuple):
    """What the network says about a window: `NUMBERS` and logarithms of their standard deviations.

    `presence`: logit of "a spot is in the window, and half of its contour is visible".
    """

    mean: Float[Array, "*batch 6"]
    log_sigma: Float[Array, "*batch 6"]
    presence: Float[Array, "*batch"]


class SpotNetwork(eqx.Module):
    """Five convolutions and two dense layers; the distance has a branch that knows the place.

    The errors are normal with a standard deviation of their own in each window, which the network
    gives, too (Nix and Weigend 1994).
    """

    convolutions: tuple[eqx.nn.Conv2d, ...]
    norms: tuple[eqx.nn.GroupNorm, ...]
    dense: eqx.nn.Linear
    ellipse: eqx.nn.Linear
    with_place: eqx.nn.Linear
    distance: eqx.nn.Linear

    def __init__(self, *, key: PRNGKeyArray) -> None:
        keys = iter(jax.random.split(key, len(_CHANNELS) + 4))
        self.convolutions = tuple(
            eqx.nn.Conv2d(n, m, width, stride=stride, padding=width // 2, key=next(keys))
            for n, m, width, stride in _CHANNELS
        )
        self.norms = tuple(eqx.nn.GroupNorm(4, m) for _, m, _, _ in _CHANNELS)
        self.dense = eqx.nn.Linear(_SEEN, _WIDTH, key=next(keys))
        self.ellipse = eqx.nn.Linear(_WIDTH, 11, key=next(keys))
        self.with_place = eqx.nn.Linear(_WIDTH + PLACES, _WIDTH // 2, key=next(keys))
        self.distance = eqx.nn.Linear(_WIDTH // 2, 2, key=next(keys))

    def __call__(self, window: Float[Numbers, "3 64 64"], place: Float[Numbers, "4"]) -> Output:
        """What the network says about one window (`evened`) at a place."""
        seen = jnp.asarray(window)
        for convolution, norm in zip(self.convolutions, self.norms, strict=True):
            seen = jax.nn.relu(norm(convolution(seen)))
        features = jax.nn.relu(self.dense(seen.reshape(-1)))
        ellipse = self.ellipse(features)
        placed = jax.nn.relu(self.with_place(jnp.concatenate([features, place])))
        distance = self.distance(placed)
        log_sigma = jnp.concatenate([ellipse[5:10], distance[1:]])
        return Output(
            jnp.concatenate([ellipse[:5], distance[:1]]) * jnp.asarray(_SCALES, seen.dtype),
            jnp.clip(log_sigma, _LEAST_LOG, _MOST_LOG),
            ellipse[10],
        )


def loss(
    network: SpotNetwork,
    windows: Float[Numbers, "n 3 64 64"],
    places: Float[Numbers, "n 4"],
    targets: Float[Numbers, "n 6"],
    present: Float[Numbers, " n"],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Mean loss of some windows, and the part of it that can be compared between epochs.

    The loss is the negative logarithm of the normal density where a spot is present. Each summand
    is weighed by its sigma (not differentiated), without which hard windows are hardly learnt: beta
    = 0.5 in Seitzer et al. (2022). Presence has the cross entropy. The second result is the same
    without the weights, which change from epoch to epoch.
    """
    said = jax.vmap(network)(windows, places)
    z = (targets - said.mean) * jnp.exp(-said.log_sigma)
    summands = jnp.square(z) / 2 + said.log_sigma
    weights = jax.lax.stop_gradient(jnp.exp(said.log_sigma)) * len(NUMBERS)
    entropy = jnp.mean(jax.nn.softplus(said.presence) - present * said.presence)

    def over_spots(values: Float[Array, "n 6"]) -> Float[Array, ""]:
        return jnp.sum(present * jnp.sum(values, axis=1)) / jnp.maximum(jnp.sum(present), 1.0)

    return over_spots(weights * summands) + entropy, over_spots(summands) + entropy


# The trained network as an estimator: frame in, ellipse and distance with their sigmas out.

WEIGHTS = Path(__file__).with_name("weights.eqx")
SCALED = ("x", "y", "semi_major", "semi_minor", "distance")
"""Quantities whose sigmas have a factor from the split `validation`."""

_PASSES = 2  # the first window is the blob's, the second the first ellipse's


class Learned(NamedTuple):
    """What the estimator says about a frame; px, rad and mm.

    The ellipse (x, y, semi-major, semi-minor, angle) with its covariance (5 x 5), d, and the logit
    of a spot in the last window.
    """

    ellipse: np.ndarray
    covariance: np.ndarray
    distance_mm: float
    sigma_distance_mm: float
    presence: float


class LearnedEstimator:
    """Finds the spot with a blob, then twice with the network.

    It knows the light sources of the set that it was trained on, and no others: its distances are
    theirs. From the split `validation` are the `factors` of the sigmas of `SCALED`, and the least
    logit of a window that is not empty; without them the network is taken at its word.
    """

    def __init__(self, network: SpotNetwork, trust: Mapping[str, Any] | None = None) -> None:
        self._network = network
        said = trust or {"factors": dict.fromkeys(SCALED, 1.0), "least_presence": -math.inf}
        self._factors, self._least_presence = said["factors"], said["least_presence"]

    @classmethod
    def load(cls, weights: Path = WEIGHTS) -> "LearnedEstimator":
        """The estimator of a file of weights and the JSON file of the same name beside it.

        InputError if a file is missing or is not what `eyespot rivals train` wrote.
        """
        about = weights.with_suffix(".json")
        with in_file(about):
            try:
                trust = json.loads(read_text(about))["trust"]
                factors = {name: float(trust["factors"][name]) for name in SCALED}
                known = {"factors": factors, "least_presence": float(trust["least_presence"])}
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise InputError(f"cannot be read: {error}. Train again.") from error
        with jax.enable_x64(False):
            like = eqx.filter_eval_shape(SpotNetwork, key=jax.random.key(0))
        with in_file(weights):
            try:
                return cls(eqx.tree_deserialise_leaves(weights, like), known)
            except (OSError, RuntimeError, ValueError, EOFError) as error:
                raise InputError(f"not weights of this network ({error}). Train again.") from error

    def measure(self, image: np.ndarray, microscope: MicroscopeFile) -> Learned | None:
        """Measure an 8-bit frame; None if no spot is seen in it."""
        guess = blob_in(image)
        said: Learned | None = None
        for _ in range(_PASSES):
            if guess is None:
                return None
            said = self._said(image, guess, microscope)
            x, y, a, b, _ = said.ellipse
            inside = 0 <= x < image.shape[1] and 0 <= y < image.shape[0]
            guess = Guess(x, y, math.sqrt(a * b)) if inside else None
        unseen = guess is None or said is None or said.presence < self._least_presence
        return None if unseen else said

    def _said(self, image: np.ndarray, guess: Guess, microscope: MicroscopeFile) -> Learned:
        window = PixelSquare.around(guess)
        seen = evened(cut(image, window)).astype(np.float32)
        place = place_of(window, microscope).astype(np.float32)
        mean, log_sigma, presence = map(np.asarray, _forward(self._network, seen, place))
        numbers, sigmas = mean.astype(float), np.exp(log_sigma.astype(float))
        factors = self._factors
        each = np.array([factors[name] for name in SCALED[:4]] + [1.0])
        distance = math.exp(numbers[5])
        return Learned(
            ellipse=ellipse_of(numbers, window),
            covariance=covariance_of(numbers, sigmas, window) * np.outer(each, each),
            distance_mm=distance,
            sigma_distance_mm=distance * float(sigmas[5]) * factors["distance"],
            presence=float(presence),
        )


_forward = eqx.filter_jit(lambda network, seen, place: tuple(network(seen, place)))
