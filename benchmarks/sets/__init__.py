"""Labelled sets: a spec with distributions becomes splits of stacks on disk.

formats/  Sets in other formats: `eyespot export`
make/     Renders what is missing, then finishes the set: `eyespot dataset`
read/     A set on disk
score/    How good spots are: `eyespot score`
spec/     What a set is to be

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
"""
