"""`make bench`: every claim of speed or accuracy, printed in one run beside its alternatives."""

from __future__ import annotations

import runpy

BENCHES = (
    "geometry_speed",
    "render_speed",
    "estimator_accuracy",
    "fit_speed",
    "cone_fit",
    "image_fit",
    "frame_pose",
    "study_speed",
    "dataset_speed",
)

if __name__ == "__main__":
    for bench in BENCHES:
        print(f"\n== benchmarks.bench.{bench}", flush=True)
        runpy.run_module(f"benchmarks.bench.{bench}", run_name="__main__")
