"""Every constant of the sub-pixel mode, in one table.

A class is a stage of the measurement; an entry has a name, a value, and below it

    unit | meaning | origin

Units: "radii" are radii of the spot's ellipse in the same direction, "edge widths" are
`Spot.edge_width_px`, and "-" is a plain number. The origin is one of three:

- derived: it follows from something else, which is named.
- fitted: it was measured on frames, which are named.
- set by hand, for a purpose. A change of the largest by 20 % moves a semi-axis of some of 72 drawn
  frames by 1.5 px (Motion.ALONG), 1.3 px (Saturated.READABLE) and 0.7 px (Sharp.REACH), that of
  any other by less than 0.5 px.

What a user may want to change is in `settings.SubpixelSettings` instead.
"""

from __future__ import annotations

RAYS = 192
"""- | rays round a contour | set by hand: 2 px apart on a contour of 60 px, as far as pixels that
bilinear samples share
"""


class Rays:
    """The rays of an ellipse, along which profiles are sampled (`ellipse`)."""

    FEWEST = 8
    """rays | least number that determines an ellipse or a mean profile | derived: five parameters
    and three degrees of freedom for their scatter
    """


class WideView:
    """Samples along a ray from near the centre to well outside the edge (`levels`, `edges`)."""

    INNERMOST = 0.05
    """radii | first sample | set by hand: the rays of the very centre show the same pixels"""
    OUTERMOST = 1.6
    """radii | last sample | set by hand: contains a first ellipse that is a third too small"""
    SAMPLES = 48
    """- | samples on a ray | set by hand: 2 px apart at a radius of 60 px"""


class Search:
    """Bright regions of a window (`coarse`, `contour`)."""

    REGIONS = 4
    """- | regions offered from one window | set by hand for glints and reflections brighter than
    the spot, of drawn frames
    """
    FAINTEST_STEP = 4
    """1/255 of the window's maximum | least difference of peak and background that is not noise |
    set by hand
    """
    SIGNIFICANT = 3.0
    """- | step over the scatter of the darker part of a window from which it is looked at | set by
    hand: half of the darker part is a bell's own flank where it fills the window
    """
    DARKEST = 1e-12
    """any unit | signal that counts as none | derived: squares of the signal, and of 1e-6 of it,
    are float32 numbers, as they are of the brightest signal, 1e12
    """
    PLATEAU = 0.8
    """- | median of a region over its brightest part, from which it is a plateau | set by hand
    between bells (0.7) and discs on textured walls
    """
    CONVEX = 0.85
    """- | area of a lobe over its convex hull's | set by hand between lobes (0.95) and crescents"""
    TOWARDS = 0.12
    """root of the area | by which two pieces' brightest places are closer together than their
    middles if they are halves of one bell | derived: 0.27, and 0 of lobes
    """
    SMALLEST_PIECE = 0.1
    """- | area of a part of a divided spot, over its largest part's | set by hand"""
    HOLE = 0.04
    """- | area of the dark holes of a ring, over its outline's | set by hand: a fifth of the radius
    """
    GLARE = 0.15
    """- | area of something brighter, over that of its halo | set by hand: more than three large
    glints of drawn frames
    """
    SMALLEST_AREA = 0.7
    """- | area of a region over the smallest spot's | set by hand: only the bright part of a bell
    exceeds the search's level
    """
    SMALLEST_WINDOW = 5
    """px of the subsampled window | least side of a window that is searched | derived: the 3x3
    median filter needs neighbours
    """
    AROUND = 0.6
    """radii | width of the ring of background that is looked at round the last contour | set by
    hand
    """
    LIKE_LAST = 0.5
    """- | relative difference of area up to which a region may be the last frame's spot | set by
    hand: larger changes are left to a search
    """
    UNHIDDEN = 0.1
    """- | relative difference of area up to which a region's centroid is the spot's centre | set by
    hand
    """


class Channel:
    """The colour channel to measure in (`coarse`)."""

    SATURATED = 0.02
    """- | fraction of a spot's pixels at full scale that changes its half level | set by hand"""
    BRIGHTER = 1.2
    """- | channel's brightness over grey's from which its weaker texture outweighs its noise | set
    by hand for retinas, where red shows vessels least
    """
    FAINTEST = 0.1
    """brightest channel | least brightness of a channel that may replace grey | set by hand"""
    MOST_PX = 40_000
    """px | larger regions are subsampled for the search of a flat top | set by hand: 0.3 ms"""
    HOT = 0.005
    """- | fraction of a region's pixels that may be hot, or written over | set by hand"""


class Capture:
    """First fit: crossings of the candidate's half level (`edges`)."""

    REACH = 1.75
    """radii of the candidate | furthest edge | derived: beyond `WideView.OUTERMOST`"""
    EVERY = 2
    """- | one of so many rays is used | set by hand for speed"""
    REPEATS = 3
    """- | most captures of one candidate | set by hand"""
    STEPS = 3
    """- | most steps of one capture | set by hand"""
    NEAR_ENOUGH = 0.1
    """radii | step, or distance of the half level, after which a capture is not repeated | set by
    hand: a refinement bridges it
    """
    NEARNESS = 0.1
    """radii | of several crossings the nearest counts; nearer ones than this are almost equal | set
    by hand
    """
    LARGEST_STEP = 0.7
    """radii | a larger step has lost the candidate | set by hand"""
    TOLERANCE_PX = 1.5
    """px | error of a crossing that always belongs to the ellipse | set by hand: noise and pixel
    grid
    """
    TOLERANCE = 0.02
    """radii | the same for large spots | set by hand for retinas"""
    FURTHEST = 0.2
    """radii | error of a crossing that never belongs | set by hand: twice `Refine.FURTHEST`"""


class Refine:
    """Refinement of the captured ellipse (`edges`, `band`)."""

    BROAD = 0.17
    """radii | edge width from which an edge is a broad flank | set by hand between a disc of 60 px
    blurred by 8 px (0.13) and a Gaussian bell (0.58)
    """
    REPEATS = 3
    """- | most refinements | set by hand"""
    SETTLED = 0.1
    """edge widths | move after which the ellipse is not refined again | set by hand"""
    SETTLED_BROAD = 0.005
    """radii | the same for broad flanks | set by hand"""
    EXCHANGED_RAYS = 6
    """rays | changes of the inliers up to which an ellipse is settled | set by hand: 3 % of all"""
    SAME_WIDTH = 0.7
    """- | edge width over the former one, below which the ellipse is refined again | set by hand"""
    LARGEST_STEP = 0.5
    """radii | a larger step has lost the edge | set by hand"""
    FURTHEST = 0.1
    """radii | error of a sharp edge that never belongs to the ellipse | set by hand for shafts and
    shadows of drawn frames
    """
    SAME_EDGE = 0.5
    """edge widths | from the ellipse within which an edge is the spot's, texture or not | set by
    hand
    """
    CLEAN = 0.1
    """edge widths | scatter of the edges of what is plainly an ellipse | set by hand: merged
    letters scatter by 0.12 and more
    """
    DARKEST_GAIN = 0.6
    """- | brightness of a ray over the mean ray's: darker rays are hidden, rays brighter than its
    inverse show a glint | set by hand for shafts, and shadows that take 60 % of the light
    """
    SHADED_NEIGHBOURS = 3
    """rays | neighbours on either side with which a shaded ray is averaged | set by hand: as many
    as are spoilt by a shadow's rim
    """
    SAMPLING_PX = 0.7
    """px | distance of the samples on a ray | set by hand: less than the pixel grid resolves"""
    FEWEST_SAMPLES = 5
    """- | least number of samples on either side of the edge | derived: a cubic and one more"""
    MOST_SAMPLES = 16
    """- | most samples on either side of the edge | set by hand: speed"""
    LONG_WAVES = slice(4, 13)
    """harmonics round the contour | waves whose amplitude gives the ellipse's errors | derived: an
    ellipse has 0 to 2, and the outline of a round beam on a curved wall the third, which is shape
    """
    NEXT_WAVES_BROAD = slice(7, 17)
    """harmonics round the contour | the waves whose ratio to these shows how errors rise | derived:
    the next octave and a third
    """
    LONG_WAVES_BROAD = slice(3, 7)
    """harmonics round the contour | the same for broad flanks | set by hand: texture is strongest
    next to the harmonics that are fitted
    """
    SHORT_WAVES = slice(25, 73)
    """harmonics round the contour | waves in which noise exceeds texture | set by hand for retinas
    """
    NOISE_AT_MOST = 6.0
    """- | ratio of long to short waves, in variance, that noise alone can have | set by hand:
    neighbouring rays share pixels, so that noise falls with the harmonic
    """
    BESIDE = 5
    """- | one of so many samples of a band, at either end, lies beside the edge | derived: the band
    reaches to three edge widths, the edge to nearly two
    """
    INTERPOLATION_PX2 = 1 / 6
    """px^2 | variance of the blur by linear interpolation | derived: t (1 - t) on average over a
    pixel
    """
    NARROWEST_CUBIC = 2.6
    """samples | half length of the part of a profile through which a cubic is fitted | derived: it
    contains at least five samples
    """
    MIDDLE_ALONE = 2.7
    """- | variance of the half level's place over that of the whole flank | set by hand: the cubic
    uses only `Sharp.MIDDLE` of the `Sharp.REACH`
    """


class Sharp:
    """Refinement of a sharp edge (`band`)."""

    REACH = 3.0
    """edge widths | profile on either side | derived: beyond three standard deviations a Gaussian
    edge has 0.1 % of its step left
    """
    REACH_PX = 2.5
    """px | the same for edges narrower than the pixel grid | derived: pixel and interpolation"""
    MIDDLE = 0.8
    """edge widths | half length of the cubic through the half level | derived: a Gaussian edge
    differs from its Taylor cubic there by 0.3 % of the step
    """
    BRIGHTEST_INSIDE = 1.5
    """edge widths | from the edge to where a sloping plateau is brightest | set by hand: blur has
    taken 7 %
    """
    PLATEAU = 2.6
    """edge widths | from the edge to where its blur no longer shows | derived: 0.5 % of the step"""
    SLOPE_DOUBT = 100.0
    """- | variance of texture's longest wave over that of the next ones | set by hand for retinas
    """
    SLOPE_SHOWS = 0.02
    """radii | edge width from which the light's slope begins to count | set by hand: below, it
    moves the half level by less than texture does
    """
    FORGIVEN = 0.1
    """edge widths | shift of an edge by texture, which always belongs | set by hand for retinas"""
    SIZE_PX = 0.005
    """px | error of the place of the half level between pixels, the same for all rays | fitted to
    rendered cones: sizes of oblique spots are off by 0.005 px RMS, those of circles by 0.009 px
    """
    DEEPEST_SHADE = 0.08
    """- | share of the light in which an edge is still measured | set by hand: 15 grey levels,
    noise of two
    """
    SHADED_MISFIT = 0.06
    """- | deviation of a shaded profile from a dimmed mean, over its own height | set by hand
    between shadows on textured walls (0.04) and shafts
    """
    SPOILED_RAYS = 3
    """rays | neighbours of a ray without an edge that are not used | set by hand for rims of shafts
    """
    ROUGH = 5.0
    """- | variance left in a profile over the typical one: something else is in view | set by hand
    for glints on the edge
    """


class Broad:
    """Refinement of a broad flank (`edges`)."""

    FLANK = 0.9
    """edge widths | flank on either side of the half level | set by hand"""
    WIDEST = 0.5
    """radii | the same, at most | derived: the top begins inside"""
    FORGIVEN = 0.3
    """edge widths | shift of an edge by texture, which always belongs | set by hand for bells on
    retinas
    """
    SHOULDER = 1.25
    """edge widths | from the edge to where a plateau begins to fall | set by hand for linear flanks
    """
    SMALLEST_TOP = 0.35
    """radii | least part of a spot's top that is looked at | set by hand for bells"""
    LARGEST_TOP = 0.9
    """radii | largest part | derived: inside the edge"""
    TOP_DOUBT = 4.0
    """- | variances that a top's shape must exceed to count | set by hand for bells on retinas"""
    POWERS = 5
    """- | coefficients of the polynomial in the radius through a top | set by hand for light of
    glue lenses
    """
    PEAK_ERROR = 0.003
    """peak | error of the polynomial through a top without noise | fitted to bells exp(-t^p) with p
    from 1.7 to 3, and to Moffat's: 0.1 to 0.7 %
    """
    SLOPE_OVER_SURROUNDINGS = 1.5
    """- | variance of the wall's slope under a spot, in any direction, over the squared slope of
    its surroundings | fitted to bells on a fundus photograph
    """
    TOP_WAVES = slice(2, 5)
    """harmonics round the contour | longest waves that are not the light's own slope | derived"""
    TOP_OVER_CONTOUR = 5.4
    """- | variance of the texture under the top over that of the contour's first wave | fitted
    to bells on printed retinas, a fundus photograph and texture of spectrum 1/f
    """


class ErrorGrowth:
    """How much larger an ellipse's errors are than the contour's shorter waves show (`edges`).

    A variance of long waves is 1 + factor * texture times that of the shorter ones, in sharp edges
    1 + factor * RISE * texture * edge width.
    """

    STEEPNESS = 1.8
    """- | power of the wavelength with which broad flanks' errors rise, of a typical wall | fitted
    to printed retinas and to texture of spectrum 1/f, to half a power
    """
    STEEPEST = 2.8
    """- | largest such power of a wall's texture | derived: two deviations of half a power"""
    RISE = 25.0
    """1 / radii | rise with the edge width, sharp edges | fitted to printed retinas, to a factor of
    two
    """
    SIZE = 3.0
    """- | factor for the size, sharp edges | fitted as RISE"""
    CENTRE = 2.0
    """- | factor for the centre, sharp edges | fitted as RISE"""
    SHAPE = 1.0
    """- | factor for the difference of the axes and the angle, sharp edges | fitted as RISE
    """


class Saturated:
    """The edge of a saturated spot (`band`)."""

    READABLE = 0.95
    """full scale | mean value up to which noise does not reach full scale | derived: noise of 3 of
    255 levels, four standard deviations
    """
    VAGUEST = 0.02
    """radii | standard error of an edge that is visible at all | set by hand"""
    MISFIT = 0.01
    """full scale | deviation of the flank from a blurred step's | set by hand between discs (0.001)
    and lamps with a halo (0.02)
    """
    DOME = 0.06
    """peak | standard deviation of what a clipped plateau has above its rim | set by hand: domes of
    20 % look like plateaus
    """
    BELL_REACH = 1.0
    """radii | profile of a bell on either side of the half level | derived: from its centre to
    where a Gaussian has 6 % of its peak left
    """
    BELL_BINS = 32
    """- | bins of that profile | set by hand: texture in neighbouring bins is hardly correlated"""
    BELL_MISFIT = 0.03
    """full scale | deviation of the flank from a bell's | set by hand"""
    CUSP = 1.4
    """- | least power of a bell | set by hand: the glow round a lamp has 1"""
    POWER = 0.2
    """- | standard deviation of the logarithm of a bell's power about a Gaussian's | set by hand"""
    TAIL = 0.3
    """- | the same of the inverse of its tail's power | set by hand: light of glue lenses"""
    MOST_HIDDEN = 1 / 3
    """- | area at full scale over that of the half maximum, from which the peak is a guess |
    derived: the half level of a Gaussian is at 0.63 of full scale
    """
    BIN_PX = 0.25
    """px | bins of the profile of pixels | set by hand: less than the pixel grid resolves"""
    FEWEST_BINS = 8
    """- | least number of bins | derived: three parameters and five degrees of freedom"""
    STEPS = 25
    """- | most steps of the fit | set by hand"""
    SMALLEST_STEP = 1e-5
    """- | step of the logarithms and radii after which the fit ends | set by hand: a 1e-3 of a px
    """


class HalfLevel:
    """Peak, background and edge width (`levels`)."""

    NEAR_EDGE = 0.35
    """radii | from the ellipse to where the steepest fall may be | set by hand"""
    WIDEST = 2.0
    """radii | widest edge of a spot | set by hand: more than three times a Gaussian bell's"""
    DOME_DOUBT = 13.0
    """- | variances that a dome must exceed to count | set by hand for retinas, domes of 20 and 40
    %
    """
    FAR_ENOUGH = 0.9
    """- | part of the radius where the background begins that must be in view | set by hand"""
    BACKGROUND = 4.0
    """edge widths | from the edge to where the background begins | derived: a Gaussian edge has
    3e-5 of its step left
    """
    TAILED = 0.3
    """radii | edge width from which an edge is a bell's, with tails | set by hand: linear flanks
    have none, the light of glue lenses has
    """
    TAIL_END = 4.4
    """radii | where a bell's tail ends | set by hand for light of glue lenses"""
    TAIL_LEFT = 0.005
    """peak | what is left there | set by hand for light of glue lenses"""
    BESIDE = 5
    """rays of the rings | that are averaged for the scatter of the background | set by hand"""
    RINGS = (0.0, 0.1, 0.2, 0.3, 0.4)
    """radii | rings of the background, from where it begins | set by hand"""
    SURROUNDINGS = (2.6, 2.9, 3.2, 3.5, 3.8, 4.1)
    """radii | rings in which the wall's slope shows | set by hand: a Gaussian bell has 1 % of its
    peak left at the first
    """
    LIT_SURROUNDINGS = 0.03
    """peak | darkest surroundings that show the wall's slope | set by hand: a few grey levels"""
    NEARER = 0.75
    """- | the rings' distance from the edge times this, if they are out of view | set by hand"""
    TRIES = 6
    """- | how often | derived: 0.75^5 brings them to a quarter of the distance"""


class Texture:
    """The wall's texture from its colours (`contour`)."""

    CELLS = 16
    """- | cells on a semi-minor axis | set by hand: finer texture averages out round a contour"""
    SHORT_WAVES = 2.4
    """cells | blur beyond which waves are long | set by hand for bells on retinas"""
    BY_CHANCE = 1.25
    """- | rise of the variance round rings that other texture may make | set by hand for retinas"""
    LIFT = 0.1
    """bright level | light added to each channel | set by hand: the logarithm of the dark is noise
    """


class Motion:
    """A spot that moved during the exposure (`measuring`)."""

    SMEARED = 0.08
    """radii | edge width from which a smear bends the contour | set by hand for moving drawn frames
    """
    UNEVEN = 0.2
    """- | amplitude of the edge width's logarithm over the direction, beyond texture's | set by
    hand for retinas at rest
    """
    SHARP = 0.3
    """radii | widest edge beside the path | derived: a bell's is 0.58"""
    ALONG = 0.85
    """- | cosine to the path of normals whose edges are smeared by nearly all of it | set by hand
    """
    BESIDE = 0.25
    """- | cosine to the path of normals whose edges are hardly smeared | set by hand"""
    SIDE = 100
    """px | side to which larger patches are reduced | set by hand: 0.1 s"""
    LONG_WAVES = 2.0
    """px of the reduced patch | blur beyond which the wall's texture is taken out | set by hand for
    moving spots on retinas
    """
    SURE = 3.0
    """standard deviations | length of a path that differs from none | set by hand"""
    NODES = 1.2
    """1 / edge widths | places on the path at which the ellipse is summed | set by hand: closer
    than the edge is wide
    """
    STEPS = 12
    """- | most steps of the fit | set by hand"""
    SETTLED = 2e-4
    """radii | step after which the fit ends | set by hand: 0.01 px at a radius of 60 px"""
    OUTLYING = 3.0
    """typical residuals | where a pixel counts half | set by hand"""
    PARAMETERS = 12
    """- | parameters of a moving spot | derived: ellipse 5, path 2, bend 2, width, two levels"""
    LEAST_SHARE = 0.25
    """- | change of the pull by a step over what the weights say, at least | set by hand: 0.85 for
    normal errors
    """
    LEAST_LEFT = 0.01
    """- | part of a block's residuals that a fit leaves at least | set by hand: where a block alone
    determines a parameter
    """
    FLAT = 4.0
    """edge widths | beyond which an edge is flat | derived: 3e-5 of its step are left"""


class Reflection:
    """A wet wall's specular reflection with the spot on it (`measuring`)."""

    SIDE = 64
    """px | side to which the bell is reduced | set by hand: speed"""
    POWERS = 5
    """- | powers of either coordinate in the surface of a bell within its half level | set by hand
    for rendered wet walls
    """
    SMALLEST = 0.02
    """- | area of what stands out, over the bell's | set by hand"""
    SHARPEST = 0.05
    """radii | widest rim of a spot on a reflection | set by hand for rendered wet walls"""
    SMOOTHEST = 0.008
    """radii | scatter of that rim: more is the wall's texture | set by hand for bells on retinas"""
    SEEN = 0.25
    """- | fraction of that rim that is visible | set by hand: 0.3 where a reflection ends on a spot
    """


class Verdict:
    """Spot or not (`verdict`)."""

    FAINTEST = 8.0
    """standard deviations of the background | peak of the faintest spot, if texture could reach it
    | set by hand between spots on even walls and optic discs (5)
    """
    ROUGHEST = 0.05
    """radii | scatter of the sharp edges of an ellipse | set by hand for spotless frames"""
    COARSEST = 0.17
    """edge widths | scatter of the edges of an ellipse | set by hand between textured walls' spots
    (0.12) and hexagons (0.23)
    """
    STEEPER = 1.2
    """- | steepness of single rays over that of their mean | set by hand between sharp edges on
    textured walls (1.15) and words in thick letters (1.6 and more)
    """
    FINEST_PX = 1.0
    """px | width of an edge that is drawn in whole pixels | derived"""
    VAGUEST = 0.01
    """radii | standard error of the size of an ellipse that is seen in part | set by hand for
    shafts
    """
    WHOLE = 0.96
    """- | coverage from which an ellipse is seen as a whole | set by hand"""
    SHORTEST_ARC = 0.3
    """- | fraction of a contour that identifies an ellipse | set by hand for spotless frames"""
    FILLED = 0.75
    """- | area of a region over its ellipse's, below which something hides a part | set by hand"""
    RIVAL = 0.5
    """- | area of a second spot, or of a beam's second lobe, over the first's that makes the choice
    ambiguous | set by hand
    """
    NEAR_SPOT = 1.5
    """semi-major axes | from a spot within which another region is a part of it or its halo | set
    by hand
    """
    LESS_SEEN = 0.1
    """- | loss of coverage from which the whole frame is searched for a better view | set by hand
    """


class Hollow:
    """Dark places inside an ellipse (`contour`)."""

    SHARE = 0.02
    """- | area of dark places behind a visible edge, over the ellipse's | set by hand between
    shafts at any angle (0.019) and letters (0.03 and more)
    """
    SIDE = 48
    """- | side of the grid of pixels that spans the ellipse | set by hand: a shaft of a tenth of a
    diameter is five wide
    """
    DIRECTIONS = 36
    """- | directions of the straight ways out | set by hand: between two of them a way of a radius
    strays by 0.04 radii
    """


class Trimming:
    """Robust fit of an ellipse to offsets (`ellipse`)."""

    MOST = 0.6
    """- | fraction of the edges that the plain fit must keep, or random samples vote | set by hand:
    more than half, so that no other ellipse has as many
    """
    SAMPLES = 96
    """- | random samples of five edges | derived: with half of the edges on the ellipse, 95 % of
    runs have one pure sample
    """
    POSITIONS = 32
    """- | places round the contour that a sample's edges are drawn from | set by hand: they lie
    apart
    """
    STEPS = 8
    """- | most repetitions of the trimming | set by hand"""
    BELONGS = 3.5
    """standard deviations | error up to which an edge belongs | derived: 0.05 % of normal errors
    are larger
    """
    THIRD = 0.4307
    """standard deviations | error that a third of normal errors stay below | derived:
    NormalDist().inv_cdf(2 / 3)
    """


class SpotProfile:
    """Shape of a spot's profile (`shape`)."""

    LEVELS = (0.25, 0.5, 0.75)
    """peak above background | isophotes whose radii are compared | set by hand"""
    OUTERMOST = 3.0
    """radii | last sample of the profile | derived: the background begins at BACKGROUND"""
    SAMPLES = 121
    """- | samples of the profile | set by hand: 0.025 radii apart"""
    BACKGROUND = 2.5
    """radii | where the background begins | set by hand"""
    CORE = 0.9
    """radii | inner part of the spot that may be saturated | set by hand"""
    CORE_SAMPLES = 10
    """- | samples of the core | set by hand"""
    TOP = 95
    """percentile | of the core's values that must be below full scale | set by hand: a few glints
    do not make a channel useless
    """


class Faint:
    """Where a spot may be that was not measured (`tracking`)."""

    CONTRAST = 0.25
    """- | least (peak - background) / background | set by hand: texture alone reaches it, but a
    spot under the haze of a wet wall has no more
    """
    FILLED = 0.8
    """- | least share of the ellipse round a region that the region takes up | set by hand"""
