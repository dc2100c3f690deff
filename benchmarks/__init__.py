"""Studies, labelled sets and benchmarks.

bench/        Benchmarks of speed and accuracy: `make bench`, `python -m benchmarks.bench`
evaluation/   Computations shared by several studies: trials, tracked spots, model errors
predictions/  What an experiment will measure, written before it, and which of that came true
reporting/    Shared by all studies: run folder, page, tables, figures
rivals/       Other software and a learned estimator on labelled sets: `eyespot rivals`
sets/         Labelled sets: from a spec with distributions to splits of stacks on disk
studies/      The studies: one folder and one command each
"""
