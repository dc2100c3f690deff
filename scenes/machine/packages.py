"""Which Python packages does this machine need: all, or those that a rig uses?

As a script, which runs before anything is installed, it prints the requirements of a rig from the
pyproject.toml of the folder in which it is run: one a line, as pip reads them.
"""

import re
import tomllib
from pathlib import Path

NOT_ON_A_RIG = frozenset({"dask", "distributed", "drjit", "mitsuba", "optax", "scikit-image"})
"""What only renders scenes, makes sets on many processes, trains, or compares with rivals."""
EXTRAS_OF_A_RIG = ("console",)


def rig_requirements(pyproject: str) -> list[str]:
    """Requirements of a rig's environment, with their versions."""
    project = tomllib.loads(pyproject)["project"]
    named = [*project["dependencies"]]
    for extra in EXTRAS_OF_A_RIG:
        named += project["optional-dependencies"][extra]
    return [line for line in named if re.split(r"[^\w.-]", line)[0] not in NOT_ON_A_RIG]


if __name__ == "__main__":
    print(*rig_requirements(Path("pyproject.toml").read_text(encoding="utf-8")), sep="\n")
