"""Studies, labelled sets and benchmarks.

bench/       What `make bench` prints: speed and accuracy beside their alternatives
evaluation/  What several studies compute: trials, tracked spots, model errors
reporting/   What all studies share: run folder, page, tables, figures
sets/        Labelled sets: a spec with distributions becomes splits of stacks on disk
studies/     The studies: each a folder, each one command
"""
