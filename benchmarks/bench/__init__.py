"""What `make bench` prints: speed and accuracy beside their alternatives.

__main__            `make bench`: every claim of speed or accuracy, printed in one run beside its
                    alternatives
cone_fit            Figures of the fit of the exact geometry to ellipses: noise-free contours, and
                    rendered stacks
dataset_speed       How fast labelled sets are made: workers beside one process, two workers
                    beside one
estimator_accuracy  Figures of the estimator, each beside the one asked, on ground truth that is
                    made here
estimator_lines     The frames on which the estimator is judged, and the figures asked of it there
estimator_methods   What is compared: both modes of the estimator, and peers on the same crops
estimator_pupil     The peer `pupil-detectors` in an environment of its own: it pulls in another
                    OpenCV
estimator_renders   Frames rendered by Mitsuba, with the labels that their scene gives: truth from
                    other code
estimator_speed     Time of a frame, both modes on the same frames in the same run
estimator_spotless  Frames without a spot: how often one is seen, and how soon a lost spot is
                    found again
estimator_tuning    What 20 % more or less of each constant of the detector changes
fit_speed           A thousand of the paper's fits as one batch, beside SciPy and NumPy one after
                    the other
frame_pose          Tip and axis from single rendered frames by all their pixels: a cone's, and a
                    calibrated lens's
geometry_speed      A million exact spots (128-point contour, ellipse, distance), and what one
                    inverse takes
image_fit           Figures of the fit to all pixels, on rendered stacks whose labels it does not
                    read
photon_fit          A lens fitted through its own glass: photons behind the bridge, Levenberg-
                    Marquardt in front
render_speed        How fast frames are made: from scene to disk, and beside the usual ways to
                    render a spot
study_speed         What a million geometries of the study of eccentricity take, errors of all
                    models written out
"""
