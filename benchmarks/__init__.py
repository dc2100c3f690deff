"""The studies: each one command, each result with the figures and the CSV behind it.

validate     the main job, `eyespot validate`
trials       its scenes
tracking     its spots
model_error  models against the exact geometry
paper        what Zhou et al. 2020 report
report       report.html, summary.json, CSV
figures      the pictures
"""
