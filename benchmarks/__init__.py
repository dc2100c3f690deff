"""Studies, labelled sets and benchmarks.

bench/        Benchmarks of speed and accuracy: `make bench`, `python -m benchmarks.bench`
model_error   How far each model of the spot is from the truth; figures of it
paper         The paper's trials, tables and ways of measuring, and whether fits reproduce Table I
predictions/  What an experiment will measure, written before it, and which of that came true
reporting     Claims, tables, figures and sections of a report; the page
rivals/       Other software and a learned estimator on labelled sets: `eyespot rivals`
sets/         Labelled sets: from a spec with distributions to splits of stacks on disk
studies/      The studies, each a file and a command
study         One run of a study: its arguments, scene, stacks and folder
"""
