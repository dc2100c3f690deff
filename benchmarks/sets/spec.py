"""The spec file (TOML) of a labelled set (docs/datasets.md), and the stacks that it plans."""

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)
from pydantic import Strict as StrictType
from scipy.stats import qmc

from eyespot.formats.inputs import (
    FOLDER_NAME,
    InputError,
    Strict,
    at_most_three,
    check_schema,
    in_file,
    read_toml,
    shortened,
)
from eyespot.formats.settings_files import by_dotted_name, parsed_change, problems_of
from eyespot.scenes import Scene, SceneError, changed
from eyespot.scenes.description.scene_keys import OutsideWindow

# Distributions of a scene key; each maps a quantile in [0, 1) to a value.

_LARGEST = 1e12  # With ends up to this, an interval's width and quotient are finite.


def _ordered(interval: tuple[float, float]) -> tuple[float, float]:
    low, high = interval
    if not -_LARGEST <= low < high <= _LARGEST:
        raise InputError(
            f"an interval must be [low, high], within {_LARGEST:g}, with low < high; got "
            f"[{low:g}, {high:g}]. For a single value write key = value."
        )
    return interval


def _positive(interval: tuple[float, float]) -> tuple[float, float]:
    if interval[0] < 1 / _LARGEST:
        raise InputError(
            f"a log-uniform interval must lie above 0; got [{interval[0]:g}, {interval[1]:g}]. "
            "Raise its lower end, or use uniform."
        )
    return interval


def _finite(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if any(isinstance(value, float) and not math.isfinite(value) for value in values):
        raise InputError(
            "a choice must have finite values, because it becomes a label in JSON. Use a large "
            "number instead of inf."
        )
    return values


# Lax, because TOML has lists for tuples.
_Interval = Annotated[tuple[float, float], StrictType(False), AfterValidator(_ordered)]


class Uniform(Strict):
    """Uniform distribution on an interval."""

    uniform: _Interval


class LogUniform(Strict):
    """Log-uniform distribution: the logarithm is uniform."""

    log_uniform: Annotated[_Interval, AfterValidator(_positive)]


class Choice(Strict):
    """One of several values, all equally likely."""

    choice: Annotated[tuple[Any, ...], StrictType(False), AfterValidator(_finite)] = Field(
        min_length=2, max_length=4096
    )


Distribution = Uniform | LogUniform | Choice
KINDS = ("uniform", "log_uniform", "choice")


def _kind(change: Any) -> str:
    """The kind of distribution of a change, or "value"."""
    if isinstance(change, Distribution):
        return next(iter(type(change).model_fields))
    return next((kind for kind in KINDS if isinstance(change, Mapping) and kind in change), "value")


# Of a scene key: a distribution or a fixed value.
Change = Annotated[
    Annotated[Uniform, Tag("uniform")]
    | Annotated[LogUniform, Tag("log_uniform")]
    | Annotated[Choice, Tag("choice")]
    | Annotated[Any, Tag("value")],
    Discriminator(_kind),
]


HISTORY = {
    1: "the format of eyespot 0.1",
    2: "scenes are of format 2, with cones no wider than their fibre; a file without `schema` has "
    "this one",
}
SEED_KEYS = ("seed", "phantom.texture_seed", "clocks.seed", "motion.seed")
"""Scene keys that have a different value in every stack."""

_NAMED = resources.files("eyespot.benchmarks.sets") / "named"


def _dotted(table: Any) -> Any:
    return by_dotted_name(table, whole=KINDS) if isinstance(table, Mapping) else table


_Count = Annotated[int, Field(ge=0, le=4096)]
_Condition = Annotated[str, Field(pattern=FOLDER_NAME, max_length=60)]
_Changes = Annotated[dict[str, Change], BeforeValidator(_dotted)]


class Splits(Strict):
    """Number of stacks in each split."""

    train: _Count = Field(0, description="Number of stacks.")
    validation: _Count = Field(0, description="Number of stacks.")
    test: _Count = Field(0, description="Number of stacks.")


class Adverse(Strict):
    """The split with difficult conditions."""

    stacks: _Count = Field(description="Number of stacks per condition.")
    conditions: dict[_Condition, _Changes] = Field(
        min_length=1,
        max_length=4096,
        description="Changes by name; the name begins folders' names.",
    )


class Unseen(Strict):
    """The split that shows what no other split shows, such as walls of another generator."""

    stacks: _Count = Field(description="Number of stacks.")
    changes: _Changes = Field(min_length=1, description="Values or distributions.")


class SetSpec(Strict):
    """The spec of a labelled set."""

    schema_version: Literal[1, 2] = Field(
        2, alias="schema", description="Version of the format, and of the scenes'."
    )
    name: str = Field(pattern=r"^[a-z0-9][a-z0-9.-]{0,99}$", description="Of the set.")
    description: str = Field(description="For the data card.")
    licence: str = Field("CC-BY-4.0", description="Licence of the images and labels (SPDX name).")
    seed: int = Field(ge=0, lt=2**40, description="Of everything that is drawn.")
    splits: Splits = Field(Splits(), description="Stacks of train, validation and test.")
    scene: Annotated[dict[str, Any], BeforeValidator(_dotted)] = Field(
        {}, description="Values common to all stacks, by scene key; or a scene file."
    )
    vary: _Changes = Field({}, description="Distributions by scene key, drawn anew for each stack.")
    adverse: Adverse | None = Field(None, description="A split with difficult conditions.")
    unseen: Unseen | None = Field(None, description="A split that differs from all others.")
    impossible: Literal["refuse", "leave out"] = Field(
        "refuse",
        description="What happens if a drawn scene cannot be rendered: the set is refused, or made "
        "without these stacks, which set.json and the data card list.",
    )
    pairs: dict[_Condition, Annotated[dict[str, Any], BeforeValidator(_dotted)]] | None = Field(
        None, description="Every stack again with these values, by the end of the partner's name."
    )

    @model_validator(mode="after")
    def _is_possible(self) -> "SetSpec":
        named: dict[str, Mapping[str, Any]] = {"scene": self.scene, "vary": self.vary}
        named |= self.adverse.conditions if self.adverse else {}
        named |= {"unseen.changes": self.unseen.changes} if self.unseen else {}
        named |= {f"pairs.{name}": values for name, values in (self.pairs or {}).items()}
        for where, changes in named.items():
            if taken := [key for key in SEED_KEYS if key in changes]:
                raise InputError(
                    f"{where}.{taken[0]}: every stack gets its own seed from the set's `seed`. "
                    "Remove this key."
                )
        if fixed := [key for key, of in self.vary.items() if not isinstance(of, Distribution)]:
            raise InputError(
                f"vary.{fixed[0]} must be a distribution, one of {', '.join(KINDS)}; got "
                f"{shortened(self.vary[fixed[0]])}. Move a value that is common to all stacks to "
                "[scene]."
            )
        others = [split.stacks for split in (self.adverse, self.unseen) if split]
        if not any([*self.splits.model_dump().values(), *others]):
            raise InputError("a set needs stacks. Set the numbers in [splits] or [adverse].")
        return self


def named_specs() -> list[str]:
    """Names of the specs in this package."""
    return sorted(Path(file.name).stem for file in _NAMED.iterdir() if file.name.endswith(".toml"))


def load_spec(source: str | Path, changes: Sequence[str] = ()) -> SetSpec:
    """Read and validate a spec.

    Args:
        source: path of a TOML file, or the name of a spec in this package.
        changes: scene keys that get the same value in all stacks, each "table.key=value".

    Raises:
        InputError: the spec is missing or invalid.
    """
    where = shortened(str(source))[1:-1]
    path = _NAMED / f"{source}.toml" if str(source) in named_specs() else Path(source)
    try:
        with in_file(where):
            content = read_toml(Path(str(path)))
            check_schema(content.get("schema", 2), HISTORY, remedy="Write 2.")
        if isinstance(scene_file := content.get("scene"), str):
            path = Path(source).parent / scene_file
            with in_file(path):
                keys = by_dotted_name(read_toml(path))
            content["scene"] = {k: v for k, v in keys.items() if k not in ("schema", *SEED_KEYS)}
    except OSError as error:
        raise InputError(
            f"{shortened(str(error.filename))[1:-1]}: cannot be read ({error.strerror}). Give the "
            f"path of a spec, or one of {', '.join(named_specs())}."
        ) from error
    for change in changes:
        values = _dotted(parsed_change(change))
        scene, vary = (_dotted(content.get(name, {})) for name in ("scene", "vary"))
        if isinstance(scene, dict) and isinstance(vary, dict):  # if not, the model says so
            content["scene"] = scene | values
            content["vary"] = {key: own for key, own in vary.items() if key not in values}
    try:
        return SetSpec.model_validate(content)
    except ValidationError as error:
        raise InputError(problems_of(error, where, SetSpec)) from error


# From a spec to the scenes of all stacks, spread evenly over the distributions.

_MOST_STACKS = 2**20
"""Largest number of stacks in a set; with it, the seeds of two sets never overlap."""


@dataclass(frozen=True)
class PlannedStack:
    """One stack to render.

    The partner of a stack, which has a `pair`, has the other's name with the pair's at its end, and
    the same draws and seeds.
    """

    split: str
    name: str
    condition: str | None  # in the adverse split
    pair: str | None
    scene: Scene
    parameters: dict[str, Any]  # values of the scene keys that vary within the set, by dotted name


class ImpossibleStack(NamedTuple):
    """A stack that was drawn and cannot be rendered, with the condition that its scene fails.

    Attributes:
        parameters: what was drawn, by dotted scene key.
    """

    split: str
    name: str
    parameters: dict[str, Any]
    problem: SceneError


class Draw(NamedTuple):
    """All stacks that a spec asks for."""

    stacks: list[PlannedStack]
    impossible: list[ImpossibleStack]


def plan(spec: SetSpec, check: Callable[[Scene], None] = lambda scene: None) -> list[PlannedStack]:
    """The stacks of a set, in order, without those that the spec leaves out.

    Raises:
        SceneError: as `draw`.
    """
    return draw(spec, check).stacks


def impossible_report(drawn: Draw) -> str:
    """How many scenes are impossible, an example of each condition, and the window to ask for."""
    first: dict[str, ImpossibleStack] = {}
    counts = Counter(_condition(one.problem) for one in drawn.impossible)
    for one in drawn.impossible:
        first.setdefault(_condition(one.problem), one)
    if len(first) == 1 and not drawn.stacks:  # not the draws are wrong, but what they share
        one = drawn.impossible[0]
        return f"{one.split}/{one.name}: {one.problem}"
    examples = [
        f"{counts[what]}: {one.split}/{one.name}: {one.problem}" for what, one in first.items()
    ]
    total = len(drawn.stacks) + len(drawn.impossible)
    said = f"{len(drawn.impossible)} of {total} stacks are impossible. {at_most_three(examples)}"
    leaving = [e.problem for e in drawn.impossible if isinstance(e.problem, OutsideWindow)]
    if leaving:
        width, height = (max(sizes) for sizes in zip(*(e.needed_px for e in leaving), strict=True))
        said += (
            f" One window of {width} x {height} px shows all of these spots: --set "
            f"microscope.width_px={width} --set microscope.height_px={height}."
        )
    return said


def _condition(problem: SceneError) -> str:
    """A condition that a scene fails: the message without its numbers."""
    return re.sub(r"[-+]?\d[\d.e+-]*", "#", str(problem))


def draw(spec: SetSpec, check: Callable[[Scene], None] = lambda scene: None) -> Draw:
    """The stacks that a spec asks for, in order, possible and impossible ones.

    Every group of stacks uses its own block of one scrambled Sobol sequence (Owen 1998; Sobol
    1967). The length of a block is a power of two, so each block covers the distributions evenly.
    The n-th point of the sequence has the n-th seed. `check` raises SceneError if a scene is
    impossible; then its partners count as impossible, too.

    Raises:
        InputError: too many stacks.
        SceneError: a scene is impossible, and the spec does not leave such out, or all are: how
            many fail which condition, and the window that shows all spots.
    """
    groups: list[tuple[str, str | None, int, dict[str, Any]]] = [
        (split, None, count, {}) for split, count in spec.splits
    ]
    if spec.adverse:
        groups += [
            ("adverse", condition, spec.adverse.stacks, changes)
            for condition, changes in spec.adverse.conditions.items()
        ]
    if spec.unseen:  # last, so that it changes no other split
        groups.append(("unseen", None, spec.unseen.stacks, spec.unseen.changes))
    block = 2 ** math.ceil(math.log2(max(1, *(stacks for _, _, stacks, _ in groups))))
    if block * len(groups) > _MOST_STACKS:
        raise InputError(
            f"a set can have at most {_MOST_STACKS:,} stacks; this one has {len(groups)} groups of "
            f"up to {block}. Lower the numbers of stacks."
        )
    # Changes of a condition have priority over those of all groups.
    every = [spec.vary | changes for *_, changes in groups]
    drawn = sorted(
        {key for of in every for key, change in of.items() if isinstance(change, Distribution)}
    )
    pairs = spec.pairs or {}
    labelled = sorted({key for changes in (*every, *pairs.values()) for key in changes})
    points = np.empty((block * len(groups), 0))
    if drawn:
        # The sequence is balanced over powers of two.
        sequence = qmc.Sobol(len(drawn), rng=np.random.default_rng(spec.seed))
        points = sequence.random_base2(math.ceil(math.log2(block * len(groups))))
    found = Draw([], [])
    for number, (split, condition, stacks, changes) in enumerate(groups):
        for index in range(stacks):
            place = number * block + index
            quantiles = dict(zip(drawn, points[place], strict=True))
            own = [
                {key: _drawn(change, quantiles.get(key, 0.0)) for key, change in of.items()}
                for of in (spec.scene, spec.vary, changes)
            ]
            seed, partners = spec.seed * _MOST_STACKS + place, []
            try:
                for pair, values in ((None, {}), *pairs.items()):
                    name = "-".join(filter(None, [condition, f"{index:04d}", pair]))
                    scene = _possible(spec, [*own, values], seed, check)
                    labels = {key: scene_value(scene, key) for key in labelled}
                    partners.append(PlannedStack(split, name, condition, pair, scene, labels))
                found.stacks.extend(partners)
            except SceneError as problem:
                values = {key: value for of in own for key, value in of.items() if key in labelled}
                found.impossible.append(ImpossibleStack(split, name, values, problem))
    if found.impossible and not found.stacks:
        raise SceneError(impossible_report(found))
    if found.impossible and spec.impossible == "refuse":
        raise SceneError(
            f"{impossible_report(found)} A set without them would not be distributed as its spec "
            'says. Narrow [vary], or write impossible = "leave out"; the data card then shows what '
            "is missing."
        )
    return found


def _drawn(change: Any, quantile: float) -> Any:
    """The value of a distribution at a quantile; any other change is the value."""
    match change:
        case Uniform(uniform=(low, high)):
            return low + quantile * (high - low)
        case LogUniform(log_uniform=(low, high)):
            return low * (high / low) ** quantile
        case Choice():
            return change.choice[int(quantile * len(change.choice))]
    return change


def _possible(
    spec: SetSpec,
    changes: Sequence[Mapping[str, Any]],
    seed: int,
    check: Callable[[Scene], None],
) -> Scene:
    """The default scene after changes, with seeds of its own."""
    scene = Scene.model_validate({"schema": spec.schema_version})
    for values in changes:
        # The kind of motion comes first, because the other keys depend on it.
        scene = changed(scene, dict(sorted(values.items(), key=lambda v: v[0] != "motion.kind")))
    own = [key for key in SEED_KEYS if scene_value(scene, key) is not None]
    scene = changed(scene, dict.fromkeys(own, seed))
    check(scene)
    return scene


def scene_value(scene: Scene, key: str) -> Any:
    """A scene's value by its dotted key; None if its kind of motion lacks that key."""
    found: Any = scene
    for part in key.split("."):
        found = getattr(found, part, None)
    return found
