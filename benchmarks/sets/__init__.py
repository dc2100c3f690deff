"""Labelled sets: a spec with distributions becomes splits of stacks on disk.

    SET/set.json              name, licence, seed, spec as run, versions, and every stack with its
                              split, condition and drawn scene parameters (`read_set` reads it)
        SPLIT/STACK/…         a stack as `scenes.render_stack` writes it; `read_stack` opens it
        SPLIT/metadata.jsonl  one line an image: `FrameLabels` with file names as seen from SPLIT,
                              and its stack, condition and scene parameters
        README.md             data card; its YAML head tells Hugging Face's `datasets` the splits
        histograms.png, samples.png, spec.toml, LICENSE
        manifest.json         size and SHA-256 of every other file; written last, so that a set
                              that has one is whole

SPLIT is train, validation, test or adverse; the conditions of adverse are in set.json, and part of
its stacks' names. Everything follows from the spec: the same spec gives the same bytes.

spec           a spec as TOML, validated; the named ones lie in named/
distributions  uniform, log-uniform, choice: from a number in [0, 1) to a value
plan           the scene of every stack, from a Sobol sequence
cluster        Dask workers, one core each, or a scheduler that runs already
generate       renders what is missing, then finishes the set; worker: one stack
read           a set on disk; rows: its images one by one
manifest       its completeness
card           README.md, metadata.jsonl; pictures: its figures
estimate       frames, size and time before anything is rendered
command        `eyespot dataset`
stacks         what export and score go through: the stacks of a set, or one stack
export         `eyespot export`; formats/: one module a format
score_command  `eyespot score`; spots_of_set: spots files, or our own tracker's
score          images in groups; outcomes: found, missed, false; measures: errors and their sigma;
               conditions: the groups; score_table, score_figure: what is shown
"""

from benchmarks.sets.read import LabelledSet as LabelledSet
from benchmarks.sets.read import SetError as SetError
from benchmarks.sets.read import SetStack as SetStack
from benchmarks.sets.read import read_set as read_set
