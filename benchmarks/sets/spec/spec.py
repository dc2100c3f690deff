"""The spec file (TOML) of a labelled set and its validation.

name = "eccentricity-v1"
description = "…"
seed = 2                            # sets with different seeds have different walls and noise
[splits]                            # number of stacks in each split
train = 32
validation = 8
test = 8
[scene]                             # common to all stacks; or: scene = "scene.toml"
source.kind = "cone"
[vary]                              # drawn anew for every stack
spot.eccentricity_mm = { uniform = [0.0, 8.0] }
source.cone_k = { log_uniform = [5.0, 25.0] }
microscope.pinhole_height_mm = { choice = [11.5, 200.0] }
[adverse]                           # a split with difficult conditions
stacks = 4                          # per condition
[adverse.conditions.saturation]     # changes of this condition: values or distributions
exposures.kinds = ["paper"]
[unseen]                            # a split that differs from all others, usually in its walls
stacks = 8
[unseen.changes]
phantom.wall = "photograph"
[pairs.short]                       # every stack again, with these values and nothing else changed
exposures.sensitivity_mm2_sr_mj = 2000.0
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from benchmarks.sets.spec.distributions import KINDS, Change, Distribution, by_dotted_name
from estimator.files import FOLDER_NAME
from optics import InputError, at_most_three, check_schema, in_file, read_toml, shortened
from scenes import parsed_change
from scenes.description import problem_sentence

HISTORY = {1: "the format of eyespot 0.1; a file without `schema` has this one"}
"""What changed with each version of the format that is read."""

SEED_KEYS = ("seed", "phantom.texture_seed", "clocks.seed", "motion.seed")
"""Scene keys that have a different value in every stack."""

_NAMED = resources.files("benchmarks.sets.spec") / "named"


class SpecError(InputError):
    """A spec is missing, invalid or impossible; the text says what to change."""


def _dotted(table: Any) -> Any:
    return by_dotted_name(table) if isinstance(table, Mapping) else table


_Count = Annotated[int, Field(ge=0, le=4096)]
_Condition = Annotated[str, Field(pattern=FOLDER_NAME, max_length=60)]
_Changes = Annotated[dict[str, Change], BeforeValidator(_dotted)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Splits(_Table):
    """Number of stacks in each split."""

    train: _Count = 0
    validation: _Count = 0
    test: _Count = 0


class Adverse(_Table):
    """The split with difficult conditions."""

    stacks: _Count = Field(description="Number of stacks per condition.")
    conditions: dict[_Condition, _Changes] = Field(
        min_length=1,
        max_length=4096,
        description="Changes by name; the name begins folders' names.",
    )


class Unseen(_Table):
    """The split that shows what no other split shows, such as walls of another generator."""

    stacks: _Count
    changes: _Changes = Field(min_length=1, description="Values or distributions.")


class SetSpec(_Table):
    """The spec of a labelled set.

    Attributes:
        vary: distributions by dotted scene key.
        adverse: None if the set has no such split.
        unseen: None if the set has no such split.
        pairs: values by the name that ends the names of the partners' folders; None without any.
    """

    schema_version: Literal[1] = Field(1, alias="schema")
    name: str = Field(pattern=r"^[a-z0-9][a-z0-9.-]{0,99}$")
    description: str
    licence: str = Field("CC-BY-4.0", description="Licence of the images and labels (SPDX name).")
    seed: int = Field(ge=0, lt=2**40)
    splits: Splits = Splits()
    scene: Annotated[dict[str, Any], BeforeValidator(_dotted)] = {}
    vary: _Changes = {}
    adverse: Adverse | None = None
    unseen: Unseen | None = None
    pairs: dict[_Condition, Annotated[dict[str, Any], BeforeValidator(_dotted)]] | None = None

    @model_validator(mode="after")
    def _is_possible(self) -> SetSpec:
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
        if fixed := [
            key for key, value in self.vary.items() if not isinstance(value, Distribution)
        ]:
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
        SpecError: the spec is missing or invalid; for an unknown key the message suggests the
            nearest known one.
    """
    where = shortened(str(source))[1:-1]
    path = _NAMED / f"{source}.toml" if str(source) in named_specs() else Path(source)
    try:
        with in_file(where, SpecError):
            content = read_toml(Path(str(path)))
            check_schema(content.get("schema", 1), HISTORY, remedy="Write 1.")
        if isinstance(scene_file := content.get("scene"), str):
            content["scene"] = _scene_keys(Path(source).parent / scene_file)
    except OSError as error:
        raise SpecError(
            f"{shortened(str(error.filename))[1:-1]}: cannot be read ({error.strerror}). Give the "
            f"path of a spec, or one of {', '.join(named_specs())}."
        ) from error
    for change in changes:
        _fix(content, _dotted(parsed_change(change)))
    try:
        return SetSpec.model_validate(content)
    except ValidationError as error:
        problems = [f"{where}: {_sentence(problem)}" for problem in error.errors()]
        raise SpecError(at_most_three(problems)) from error


def _fix(content: dict[str, Any], values: dict[str, Any]) -> None:
    """Set scene keys to fixed values."""
    scene, vary = (_dotted(content.get(name, {})) for name in ("scene", "vary"))
    if isinstance(scene, dict) and isinstance(vary, dict):  # if not, the model says so
        content["scene"] = scene | values
        content["vary"] = {key: change for key, change in vary.items() if key not in values}


def _scene_keys(path: Path) -> dict[str, Any]:
    """The keys of a scene file, except its schema and seeds."""
    with in_file(path, SpecError):
        content = by_dotted_name(read_toml(path))
    return {key: value for key, value in content.items() if key not in ("schema", *SEED_KEYS)}


def _sentence(problem: Any) -> str:
    path = [str(part) for part in problem["loc"]]
    return problem_sentence(problem, path, siblings=lambda: _siblings(path[:-1]))


def _siblings(path: list[str]) -> list[str]:
    tables: dict[str, type[BaseModel]] = {
        "splits": Splits,
        "adverse": Adverse,
        "unseen": Unseen,
    }
    model = tables.get(".".join(path), SetSpec)
    return [field.alias or name for name, field in model.model_fields.items()]
