"""From a spec to the scenes of all stacks, spread evenly over the distributions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import qmc

from benchmarks.sets.spec.distributions import Distribution
from benchmarks.sets.spec.spec import SEED_KEYS, SetSpec
from optics import InputError
from scenes import Scene, SceneError, changed

_MOST_STACKS = 2**20
"""Largest number of stacks in a set; with it, the seeds of two sets never overlap."""


@dataclass(frozen=True, kw_only=True)
class PlannedStack:
    """One stack to render.

    Attributes:
        split: train, validation, test, adverse or unseen.
        condition: condition in the adverse split, else None.
        pair: name of the pair whose partner this stack is, else None. The other stack has the name
            without the pair's, the same draws and the same seeds.
        parameters: values of the scene keys that vary within the set, by dotted name.
    """

    split: str
    name: str
    condition: str | None
    pair: str | None
    scene: Scene
    parameters: dict[str, Any]


class _Group(NamedTuple):
    """Stacks that are drawn from the same distributions."""

    split: str
    condition: str | None
    stacks: int
    # Values and distributions by dotted name: those of all groups, and those of the condition.
    vary: dict[str, Any]
    condition_changes: dict[str, Any]

    @property
    def changes(self) -> dict[str, Any]:
        """Both; changes of the condition have priority."""
        return self.vary | self.condition_changes


def plan(spec: SetSpec) -> list[PlannedStack]:
    """The stacks of a set, in order.

    Every group of stacks uses its own block of one scrambled Sobol sequence (Owen 1998; Sobol
    1967). The length of a block is a power of two, so each block covers the distributions evenly.
    The n-th point of the sequence has the n-th seed.

    Raises:
        SceneError: a key is unknown, or a drawn scene is invalid.
    """
    groups = list(_groups(spec))
    block = 2 ** math.ceil(math.log2(max(1, *(group.stacks for group in groups))))
    if block * len(groups) > _MOST_STACKS:
        raise InputError(
            f"a set can have at most {_MOST_STACKS:,} stacks; this one has {len(groups)} groups of "
            f"up to {block}. Lower the numbers of stacks."
        )
    drawn = sorted(
        {k for group in groups for k, v in group.changes.items() if isinstance(v, Distribution)}
    )
    points = _sobol(len(drawn), block * len(groups), seed=spec.seed)
    pairs = spec.pairs or {}
    of_pairs = {key for values in pairs.values() for key in values}
    labelled = sorted({key for group in groups for key in group.changes} | of_pairs)
    return [
        _planned(
            group,
            index,
            pair,
            values,
            quantiles=dict(zip(drawn, points[number * block + index], strict=True)),
            seed=spec.seed * _MOST_STACKS + number * block + index,
            base=spec.scene,
            labelled=labelled,
        )
        for number, group in enumerate(groups)
        for index in range(group.stacks)
        for pair, values in ((None, {}), *pairs.items())
    ]


def _groups(spec: SetSpec) -> Iterator[_Group]:
    for split, count in spec.splits:
        yield _Group(split, None, count, spec.vary, {})
    if spec.adverse:
        for condition, changes in spec.adverse.conditions.items():
            yield _Group("adverse", condition, spec.adverse.stacks, spec.vary, changes)
    if spec.unseen:  # last, so that it changes no other split
        yield _Group("unseen", None, spec.unseen.stacks, spec.vary, spec.unseen.changes)


def _sobol(dimensions: int, count: int, *, seed: int) -> np.ndarray:
    if not dimensions:
        return np.empty((count, 0))
    # The sequence is balanced over powers of two.
    exponent = math.ceil(math.log2(count))
    return qmc.Sobol(dimensions, rng=np.random.default_rng(seed)).random_base2(exponent)


def _planned(
    group: _Group,
    index: int,
    pair: str | None,
    pair_values: dict[str, Any],
    *,
    quantiles: dict[str, float],
    seed: int,
    base: dict[str, Any],
    labelled: list[str],
) -> PlannedStack:
    def drawn(changes: dict[str, Any]) -> dict[str, Any]:
        return {
            key: change.value(quantiles[key]) if isinstance(change, Distribution) else change
            for key, change in changes.items()
        }

    name = "-".join(filter(None, [group.condition, f"{index:04d}", pair]))
    scene = Scene()
    try:
        for values in (base, drawn(group.vary), drawn(group.condition_changes), pair_values):
            # The kind of motion comes first, because the other keys depend on it.
            scene = changed(
                scene, dict(sorted(values.items(), key=lambda v: v[0] != "motion.kind"))
            )
    except SceneError as error:
        raise SceneError(f"{group.split}/{name}: {error}") from error
    scene = changed(scene, {key: seed for key in SEED_KEYS if _value(scene, key) is not None})
    return PlannedStack(
        split=group.split,
        name=name,
        condition=group.condition,
        pair=pair,
        scene=scene,
        parameters={key: _value(scene, key) for key in labelled},
    )


def _value(scene: Scene, key: str) -> Any:
    """A scene's value by its dotted key; None if its kind of motion lacks that key."""
    found: Any = scene
    for part in key.split("."):
        found = getattr(found, part, None)
    return found
