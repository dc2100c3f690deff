"""Makes the weights: trains, judges on validation, and writes beside them what was done."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import matplotlib
import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper import VISIBLE_ENOUGH
from benchmarks.reporting import BLUE, STYLE, VERMILION, save_figure
from benchmarks.rivals.learned.estimator import SCALED, Learned, LearnedEstimator, Trust
from benchmarks.rivals.learned.network import SpotNetwork
from benchmarks.rivals.learned.training import Epoch, kept_network, read_curve, samples_of, train
from benchmarks.sets.read.labelled_set import SetStack, read_set
from benchmarks.study import versions, write_json
from estimator import FrameLabels, read_microscope
from estimator.files import MANIFEST, written_whole
from estimator.run import progress
from optics import InputError

SCHEMA = 1
_LIBRARIES = ("equinox", "jax", "optax", "opencv-python-headless")


def make_weights(folder: Path, out: Path, *, epochs: int, stop: int, seed: int) -> None:
    """Train, or go on with a training that was stopped, and write weights.eqx and weights.json.

    Args:
        folder: a complete set with the splits train and validation.
        out: folder for the weights, the checkpoint and the curve; made if it is missing.
        epochs: along which the learning rate falls to 0.
        seed: of the weights and of the order of the frames.

    Raises:
        InputError: the set is incomplete or lacks a split, or `out` holds another training.
    """
    labelled = read_set(folder)
    manifest = folder / MANIFEST
    if labelled.missing or not manifest.is_file():
        raise InputError(f"{folder} is incomplete. Run `eyespot dataset` with its spec again.")
    splits = {
        split: [entry for entry in labelled.stacks if entry.split == split]
        for split in ("train", "validation")
    }
    if lacking := [split for split, stacks in splits.items() if not stacks]:
        raise InputError(f"{folder} has no split {lacking[0]}. Make a set that has one.")
    asked = {
        "set": labelled.name,
        "manifest_sha256": hashlib.sha256(manifest.read_bytes()).hexdigest(),
        "epochs": epochs,
        "seed": seed,
    }
    _claim(out, asked)
    network, done = kept_network(out)
    if done < stop:
        network = _trained(splits, out, epochs=epochs, stop=stop, seed=seed)
    found = judged(network, splits["validation"])
    with written_whole(out / "weights.eqx", replace=True) as partial:
        eqx.tree_serialise_leaves(partial, network)
    about = {
        "schema": SCHEMA,
        "command": shlex.join(["eyespot", *sys.argv[1:]]),
        **asked,
        "stopped_after": max(done, stop),
        "frames": {
            split: sum(len(entry.open().labels) for entry in stacks)
            for split, stacks in splits.items()
        },
        "trust": vars(found.trust),
        "validation": {"frames": found.frames, "rms": found.rms, "within_2_sigma": found.within_2},
        "weights_sha256": hashlib.sha256((out / "weights.eqx").read_bytes()).hexdigest(),
        "versions": versions() | {name: importlib.metadata.version(name) for name in _LIBRARIES},
    }
    write_json(out / "weights.json", about)
    with matplotlib.rc_context(STYLE):
        save_figure(curve_figure(read_curve(out / "curve.csv")), out / "curve")
    print(f"Wrote {out / 'weights.eqx'}.")


def _trained(
    splits: Mapping[str, Sequence[SetStack]], out: Path, *, epochs: int, stop: int, seed: int
) -> SpotNetwork:
    with progress("Reading", total=sum(map(len, splits.values()))) as advance:
        samples, validation = (
            samples_of(splits[split], seed, progress=advance) for split in ("train", "validation")
        )
    with progress("Training", total=stop) as advance:

        def show(epoch: Epoch) -> None:
            note = f"loss {epoch.train:.3f}, validation {epoch.validation:.3f}"
            advance(note=f"{note}, size {100 * epoch.size_error:.2f} %")

        return train(samples, validation, out, epochs=epochs, stop=stop, seed=seed, show=show)


def curve_figure(curve: list[Epoch]) -> Figure:
    """Losses and the error of the size by epoch."""
    figure = Figure(figsize=(7.0, 2.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    epochs = [epoch.epoch for epoch in curve]
    left.plot(epochs, [epoch.train for epoch in curve], color=BLUE, label="train")
    left.plot(epochs, [epoch.validation for epoch in curve], color=VERMILION, label="validation")
    left.set(xlabel="epoch", ylabel="loss")
    left.legend()
    right.plot(epochs, [100 * epoch.size_error for epoch in curve], color=VERMILION)
    right.set(xlabel="epoch", ylabel="RMS error of the radius (%), validation", yscale="log")
    return figure


def _claim(out: Path, asked: dict[str, object]) -> None:
    """Note what is trained in a folder, or check that it is the same training."""
    about = out / "training.json"
    if about.is_file():
        found = json.loads(about.read_text(encoding="utf-8"))
        for name, value in asked.items():
            if found.get(name) != value:
                raise InputError(
                    f"{out} holds a training with {name} {found.get(name)}, not {value}. Choose "
                    "another --out."
                )
        return
    out.mkdir(parents=True, exist_ok=True)
    if any(out.iterdir()):
        raise InputError(f"{out} contains other files than a training. Choose another --out.")
    write_json(about, asked)


_SHARE = 0.683  # of the errors within one sigma
_REFUSED = 0.01  # part of the visible spots that may be refused


class Judgement(NamedTuple):
    """What was measured on the split `validation`.

    Attributes:
        trust: the factors of the sigmas, and the least presence.
        frames: number of frames with a visible spot.
        rms: root mean square errors of `SCALED`, px and mm.
        within_2: part of the errors within two sigmas, after the factors.
    """

    trust: Trust
    frames: int
    rms: dict[str, float]
    within_2: dict[str, float]


def judged(network: SpotNetwork, stacks: Sequence[SetStack]) -> Judgement:
    """Measure all frames, and choose factors with which 68.3 % of the errors lie within a sigma."""
    estimator = LearnedEstimator(network)
    errors, sigmas, presences = [], [], []
    for entry in stacks:
        microscope = read_microscope(entry.folder / "microscope.json")
        stack = entry.open()
        for labels in stack.labels:
            if labels.visible_fraction < VISIBLE_ENOUGH:
                continue
            said = estimator.measure(stack.image(labels), microscope)
            presences.append(-np.inf if said is None else said.presence)
            if said is not None and _is_found(said, labels):
                errors.append(_errors(said, labels))
                variances = np.diag(said.covariance)[:4]
                sigmas.append([*np.sqrt(variances), said.sigma_distance_mm])
    z = np.abs(errors) / np.array(sigmas)
    factors = np.quantile(z, _SHARE, axis=0)
    trust = Trust(
        factors=dict(zip(SCALED, factors.tolist(), strict=True)),
        least_presence=float(np.quantile(presences, _REFUSED)),
    )
    rms, within = np.sqrt(np.mean(np.square(errors), axis=0)), np.mean(z < 2 * factors, axis=0)
    return Judgement(
        trust,
        len(presences),
        dict(zip(SCALED, rms.tolist(), strict=True)),
        dict(zip(SCALED, within.tolist(), strict=True)),
    )


def _is_found(said: Learned, labels: FrameLabels) -> bool:
    off = np.hypot(said.ellipse[0] - labels.half_max_x_px, said.ellipse[1] - labels.half_max_y_px)
    return bool(off <= labels.half_max_semi_major_px)


def _errors(said: Learned, labels: FrameLabels) -> list[float]:
    truth = (
        labels.half_max_x_px,
        labels.half_max_y_px,
        labels.half_max_semi_major_px,
        labels.half_max_semi_minor_px,
    )
    return [*(said.ellipse[:4] - truth), said.distance_mm - labels.d_mm]
