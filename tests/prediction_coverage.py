"""Do 95 % of the predictions hold? Plans against stacks whose truth is drawn as the plan states.

Every stack is rendered from a scene of its own: each uncertain key has its value plus its stated
uncertainty times a normal number, the wall has another texture and the camera other noise.
"""

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.predictions.plan import (
    Judgement,
    Plan,
    judged,
    measured_as_planned,
    predicted,
)
from formats.calibration import write_calibration
from scenes import Scene, changed, load_scene, render_stack
from scenes.world.labels import true_calibration

UNCERTAIN = {
    "phantom.radius_mm": 0.3,
    "source.cone_k": 0.05,
    "source.cone_apex_offset_mm": 0.03,
    "motion.start_mm": 0.02,
    "motion.speed_mm_s": 0.002,
    "spot.eccentricity_mm": 0.03,
    "clocks.kinematics_offset_s": 0.01,
}


def planned_scene() -> Scene:
    """A withdrawal at c = 2.5 mm under a microscope at 200 mm, in six small frames."""
    return load_scene(
        None,
        [
            "source.kind=cone",
            "microscope.pinhole_height_mm=200",
            "microscope.width_px=320",
            "microscope.height_px=240",
            "microscope.scale_mm_px=0.0134",
            "spot.eccentricity_mm=2.5",
            "motion.start_mm=0.5",
            "motion.travel_mm=4",
            "motion.speed_mm_s=1",
            "motion.frames=6",
            'exposures.kinds=["metered"]',
        ],
    )


def plan_of(scene: Scene, folder: Path) -> Plan:
    """The plan with the scene's own calibration."""
    write_calibration(folder / "cone.json", true_calibration(scene))
    return predicted(scene, UNCERTAIN, calibration=folder / "cone.json", model="corrected")


def verdict(plan: Plan, scene: Scene, folder: Path, **changes: Any) -> Judgement:
    """Render the scene with other values, and compare it with the plan."""
    values = {key.replace("__", "."): value for key, value in changes.items()}
    name = "-".join(f"{key}{value}" for key, value in sorted(values.items())) or "as planned"
    stack = folder / name[:200]
    render_stack(changed(scene, values), stack)
    return judged(plan, measured_as_planned(plan, str(stack)))


def drawn(plan: Plan, number: int) -> dict[str, float | int]:
    """Values of a true scene, drawn as the plan states."""
    noise = np.random.default_rng([2, number])
    values: dict[str, float | int] = {
        key.replace(".", "__"): value + sigma * float(noise.standard_normal())
        for key, (value, sigma) in plan.uncertain.items()
    }
    return values | {"seed": number, "phantom__texture_seed": number}
