"""Labelled sets: from a spec with distributions to splits of stacks on disk.

Files of a set:

    SET/set.json              name, licence, seed, spec, versions, and all stacks with their splits,
                              conditions and drawn scene parameters (see `read_set`)
        SPLIT/STACK/…         a stack as `scenes.render_stack` writes it (see `read_stack`)
        SPLIT/metadata.jsonl  one line per image: `FrameLabels` with file names relative to SPLIT,
                              and its stack, condition and scene parameters
        README.md             data card; its YAML head lists the splits for Hugging Face
        croissant.json        the same for data loaders (MLCommons Croissant)
        histograms.png, samples.png, spec.toml, LICENSE
        manifest.json         size and SHA-256 of every other file; written last, so a set with a
                              manifest is complete

SPLIT is train, validation, test, adverse or unseen. The conditions of adverse, and which stacks are
partners in a pair, are in set.json and in the names of the stacks. The same spec gives the same
bytes.
"""
