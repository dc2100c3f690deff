"""The studies: each one command, each result with the figures and the CSV behind it.

studies      `eyespot study`: eccentricity, static, table-one, dynamic, medium, pose
sets         `eyespot dataset`, `export` and `score`: labelled sets
validate     the main job, `eyespot validate`
trials       its scenes
tracking     its spots
model_error  models against the exact geometry
paper        what Zhou et al. 2020 report
report       report.html, summary.json, CSV
conclusions  what was found, in sentences that follow the numbers
analysis     what the sentences rest on
tables       rows of the CSV files
figures      the pictures
strip        frames against distance
page         the HTML page
run_folder   a folder that holds one run, and goes on where it stopped
optics_figures  the figures of docs/optics.md
geometry_speed, render_speed, fit_speed, study_speed, dataset_speed, estimator_accuracy (with the
other estimator_ files), cone_fit, image_fit, frame_pose  what `make bench` prints
photon_fit   a lens found through the renderer
"""
