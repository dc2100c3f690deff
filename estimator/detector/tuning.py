"""Every constant that decides what the sub-pixel mode measures, by stage.

Beside it stand its unit, what it decides, and where it comes from: derived from something else,
fitted to frames that are named, or else set by hand for a purpose. Lengths in "radii" are in radii
of the spot's ellipse in the same direction, those in "widths" in `Spot.edge_width_px`. Limits of
loops and sizes of grids stand where they are used. Settings for users are in
`settings.SubpixelSettings`.

A change by 20 % moves a semi-axis of some of 72 drawn frames by 1.5 px (Motion.ALONG), 1.3 px
(Saturated.READABLE), 0.9 px (WideView.OUTERMOST) and 0.7 px (WideView.SAMPLES, Sharp.REACH), that
of any other constant by less than 0.5 px.
"""

RAYS = 192  # round a contour: 2 px apart on one of 60 px, nearer bilinear samples share pixels
FEWEST_RAYS = 8  # that determine an ellipse (derived: 5 parameters, 3 for scatter) or a mean


class WideView:
    """Samples along a ray from near the centre to well outside the edge (`ellipse_rays`)."""

    INNERMOST = 0.05  # radii: the rays of the very centre show the same pixels
    OUTERMOST = 1.6  # radii: contains a first ellipse that is a third too small
    SAMPLES = 48  # 2 px apart at a radius of 60 px


class Search:
    """Bright regions of a window (`coarse`, `contour`)."""

    STRIDE = 4  # px: of one pixel that is searched; a spot of 15 px still spans seven of them
    REGIONS = 4  # offered from one window: some glints and reflections are brighter than the spot
    FAINTEST_STEP = 4  # 1/255 of the window's maximum: a smaller step may be noise
    # Step over the scatter of the window's darker part, half of which is a bell's flank where the
    # bell fills the window.
    SIGNIFICANT = 3.0
    PLATEAU = 0.8  # median over brightest part of a plateau; a bell has 0.7
    CONVEX = 0.85  # area over the convex hull's: a lobe has 0.95, a crescent less
    # Halves of one bell are brightest towards each other: root of the area by which these places
    # are closer than the middles (derived: 0.27, and 0 for lobes).
    TOWARDS = 0.12
    SMALLEST_PIECE = 0.1  # area of a part of a divided spot, over its largest part's
    HOLE = 0.04  # area of the dark holes of a ring, over its outline's: a fifth of the radius
    GLARE = 0.15  # area of something brighter, over its halo's: more than three large glints
    SMALLEST_AREA = 0.7  # over the smallest spot's: only a bell's bright part is in the region
    AROUND = 0.6  # radii: ring of background that is looked at round the last contour
    LIKE_LAST = 0.5  # relative change of area of the last frame's spot; a search sees larger ones
    UNHIDDEN = 0.1  # relative change of area up to which the region's centroid is the centre


class Channel:
    """The colour channel to measure in (`coarse`)."""

    SATURATED = 0.02  # fraction of a spot's pixels at full scale that changes its half level
    BRIGHTER = 1.2  # over grey: its weaker texture outweighs its noise, as red's on retinas
    FAINTEST = 0.1  # over the brightest channel: a fainter one does not replace grey


class Clipping:
    """The value at which a spot's pixels are clipped (`clipping`)."""

    ODD = 0.002  # share of the bright pixels above the level: hot pixels, writing over them
    FEWEST = 8  # pixels that have a value which is the level
    BELOW = 3  # next values below the level, none of which may have as many pixels
    SURE = 4.0  # standard deviations by which the level has more pixels than any of these
    BAND = 0.08  # heights of the spot's upper half: bands of values that are compared
    # Pixels in the band below a plateau over those in the next one. A blurred step that is clipped
    # below 0.97 of its height has less than 1.5, a whole one over 4.
    FLAT = 1.8
    RISES = 1.4  # the same ratio at a quarter of the band: 1.0 at a dome that is clipped
    UNEVEN = 1.5  # dark half of a drawn edge over its bright one: above it, the edge is clipped
    FLANK = 4.0  # the same pixels over those of a band of the flank: less than 3.7, and over 8
    FOOT = 0.05  # heights: darker pixels are background
    SHARP_PX = 1.2  # px: a narrower edge is drawn, a pixel wide; clipped or not, its place is known
    TURNS = 0.2  # share of neighbours whose second differences alternate; 0.4 with white noise
    ROUNDED = 4.0  # product of two second differences that rounding alone can have
    DEEP = 0.1  # share of the darker pixels amid the level's that rounding cannot explain


class Capture:
    """First fit: crossings of the region's half level (`ellipse_rays`)."""

    REACH = 1.75  # radii: size of the patch (derived: beyond the wide view of 1.6)
    EVERY = 2  # one of so many rays is used, for speed
    NEAR_ENOUGH = 0.1  # radii: a refinement bridges such a step, or distance of the half level
    LARGEST_STEP = 0.7  # radii: a larger step has lost the region
    TOLERANCE_PX = 1.5  # px: error of a crossing that always belongs: noise and pixel grid
    TOLERANCE = 0.02  # radii: the same for large spots on retinas
    FURTHEST = 0.2  # radii: error of a crossing that never belongs


class Refine:
    """Refinement of the captured ellipse (`edges`, `band`)."""

    # radii: edge width of a broad flank, between discs out of focus by a fifth of their radius,
    # whose light within shows texture apart from the edge, and linear flanks (0.28; bells 0.58)
    BROAD = 0.24
    SETTLED = 0.1  # widths: move after which the ellipse is not refined again
    SETTLED_BROAD = 0.005  # radii: the same for broad flanks
    SAME_WIDTH = 0.7  # new edge width over the former: a narrower edge is refined again
    LARGEST_STEP = 0.5  # radii: a larger step has lost the edge
    FURTHEST = 0.1  # radii: error of a sharp edge that never belongs: shafts and shadows
    SAME_EDGE = 0.5  # widths: an edge so near to the ellipse is the spot's, in spite of texture
    CLEAN = 0.1  # widths: scatter of a plain ellipse's edges; merged letters have 0.12 and more
    # Brightness over the mean ray's: darker rays are hidden, and rays brighter than its inverse
    # show a glint. A shadow takes up to 60 % of the light.
    DARKEST_GAIN = 0.6
    SHADED_NEIGHBOURS = 3  # rays averaged on either side of a shaded one
    # Harmonics round the contour that give the ellipse's errors (derived: an ellipse has 0 to 2,
    # and a round beam on a curved wall the third).
    LONG_WAVES = slice(4, 13)
    LONG_WAVES_BROAD = slice(3, 7)  # the same of broad flanks: texture is strongest at long waves
    NEXT_WAVES_BROAD = slice(7, 17)  # their ratio to the former shows how errors rise
    SHORT_WAVES = slice(25, 73)  # in which noise exceeds texture, on retinas
    NOISE_AT_MOST = 6.0  # long over short waves, in variance, by noise alone: rays share pixels
    MIDDLE_ALONE = 2.7  # variance of the half level from `Sharp.MIDDLE` of `Sharp.REACH` alone


class Sharp:
    """Refinement of a sharp edge (`band`)."""

    REACH = 3.0  # widths: profile on either side (derived: 0.1 % of a Gaussian's step is left)
    REACH_PX = 2.5  # px: the same of the narrowest edges (derived: pixel and interpolation)
    # px: edge width of a sharp disc, by a pixel's side and the interpolation between pixels:
    # 0.51 to 0.55 of drawn ones. With it a Gaussian of 1 px has 1.14 px, one of 2 px 2.08 px.
    PIXEL_EDGE_PX = 0.55
    MIDDLE = 0.8  # widths: half length of the cubic (derived: 0.3 % off a Gaussian edge there)
    BRIGHTEST_INSIDE = 1.5  # widths: where a sloping plateau is brightest; blur took 7 %
    PLATEAU = 2.6  # widths: where the edge's blur has ended (derived: 0.5 % of the step)
    SLOPE_DOUBT = 100.0  # variance of texture's longest wave over the next ones, on retinas
    # of that variance: what texture hides of a slope; a quarter on walls of spectrum 1/f, and all
    # of it on smooth ones.
    HIDDEN_SLOPE = 0.5
    SLOPE_SHOWS = 0.02  # radii: in narrower edges, texture counts more than the light's slope
    FORGIVEN = 0.1  # widths: shift of an edge that texture explains, on retinas
    # px: error of the half level between pixels. Fitted to rendered cones: sizes of oblique spots
    # are off by 0.005 px RMS, those of circles by 0.009 px.
    SIZE_PX = 0.005
    DEEPEST_SHADE = 0.08  # share of the light in which an edge is measured: 15 levels, noise 2
    SHADED_MISFIT = 0.06  # over its height; a shadow on a textured wall has 0.04, a shaft more
    SPOILED_RAYS = 3  # beside a ray without an edge: the rim of a shaft
    ROUGH = 5.0  # variance left over the typical one: a glint on the edge


class Broad:
    """Refinement of a broad flank (`edges`)."""

    FLANK = 0.9  # widths: flank on either side of the half level
    WIDEST = 0.5  # radii: the same, at most (derived: the top begins inside)
    FORGIVEN = 0.3  # widths: shift of an edge that texture explains, bells on retinas
    SHOULDER = 1.25  # widths: where a plateau begins to fall, linear flanks
    # Relative error of the shift to where each side's light is half of its own, as a flank's shape
    # leaves it: 0.05 to 0.12 for blurs of a fifth to a third of the radius.
    OWN_HALF_ERROR = 0.15
    TOP_DOUBT = 4.0  # variances that a top's or profile's shape must exceed, bells on retinas
    POWERS = 5  # coefficients of the polynomial through a top, light of glue lenses
    PEAK_ERROR = 0.003  # peak: fitted to bells exp(-t^p), p 1.7 to 3, and Moffat's: 0.1 to 0.7 %
    # Variance of the wall's slope under a spot over its surroundings': fitted to bells on a fundus
    # photograph.
    SLOPE_OVER_SURROUNDINGS = 1.5
    TOP_WAVES = slice(2, 5)  # harmonics: the longest that are not the light's own slope (derived)
    # Variance of the texture under the top over the contour's first wave: fitted to bells on
    # printed retinas, a fundus photograph and texture of spectrum 1/f.
    TOP_OVER_CONTOUR = 5.4


class ErrorGrowth:
    """How much larger an ellipse's errors are than the contour's shorter waves show (`edges`).

    A variance of long waves is 1 + factor * texture times that of the shorter ones, in sharp edges
    1 + factor * RISE * texture * edge width. All were fitted to printed retinas, those of broad
    flanks also to texture of spectrum 1/f.
    """

    STEEPNESS = 1.8  # power of the wavelength with which broad flanks' errors rise, to half a power
    STEEPEST = 2.8  # largest such power of a wall's texture (derived: two deviations more)
    RISE = 25.0  # 1/radii: rise with the edge width, to a factor of two
    SIZE, CENTRE, SHAPE = 3.0, 2.0, 1.0  # factors of sharp edges; the shape is axes and angle


class Saturated:
    """The edge of a saturated spot (`band`)."""

    READABLE = 0.95  # full scale: mean that noise does not take there (derived: 3 of 255 levels)
    VAGUEST = 0.02  # radii: standard error of an edge that is visible at all
    MISFIT = 0.01  # full scale: a disc is off a blurred step by 0.001, a lamp with a halo by 0.02
    # px beyond the edge: within a block of 8 px that has a part of it, and outside of such blocks.
    BLOCKS_PX = ((1.0, 6.0), (12.0, 21.0))
    SECTORS, FEWEST = 8, 20  # of the ring, and pixels that show how rough a sector is: to 16 %
    ROUGHER = 1.15  # near over far: raw frames 0.93 to 1.06, JPEG of quality 75 to 95 mostly more
    DOME = 0.06  # peak: standard deviation of a clipped plateau above its rim
    BELL_MISFIT = 0.03  # full scale: deviation of the flank from a bell's
    CUSP = 1.4  # least power of a bell; the glow round a lamp has 1
    POWER = 0.2  # standard deviation of the logarithm of a bell's power about a Gaussian's
    TAIL = 0.3  # standard deviation of the inverse of its tail's power, light of glue lenses
    MOST_HIDDEN = 1 / 3  # of the half maximum's area, or the peak is a guess (derived: Gaussian)


class HalfLevel:
    """Peak, background and edge width (`levels`)."""

    NEAR_EDGE = 0.35  # radii: from the ellipse to where the steepest fall may be
    WIDEST = 2.0  # radii: widest edge of a spot, more than three times a bell's
    DOME_DOUBT = 13.0  # variances that a dome must exceed to count, domes of 20 and 40 % on retinas
    FAR_ENOUGH = 0.9  # part of the radius where the background begins that must be in view
    BACKGROUND = 4.0  # widths: from the edge to the background (derived: 3e-5 of the step is left)
    TAILED = 0.3  # radii: edge width of bells with tails; linear flanks have none
    TAIL_END, TAIL_LEFT = 4.4, 0.005  # radii, peak: where the tail of a glue lens's bell ends
    RINGS = (0.0, 0.1, 0.2, 0.3, 0.4)  # radii: rings of the background, from where it begins
    SURROUNDINGS = (2.6, 2.9, 3.2, 3.5, 3.8, 4.1)  # radii: show the wall's slope; a bell has 1 %
    ROUNDING = 0.5  # levels of the search that hide the scatter of the background (derived)
    LIT_SURROUNDINGS = 0.03  # peak: darker ones, a few grey levels, do not show that slope


class Texture:
    """The wall's texture from its colours (`contour`)."""

    CELLS = 16  # on a semi-minor axis; finer texture averages out round a contour
    SHORT_WAVES = 2.4  # cells: blur beyond which waves are long, bells on retinas
    BY_CHANCE = 1.25  # rise of the variance round rings that other texture may make, on retinas
    LIFT = 0.1  # bright level: added to each channel; the logarithm of the dark is noise


class Motion:
    """A spot that moved during the exposure (`measuring`)."""

    SMEARED = 0.08  # radii: edge width from which a smear bends the contour, drawn frames
    UNEVEN = 0.2  # amplitude of the edge width's logarithm that texture does not reach, retinas
    SHARP = 0.3  # radii: widest edge beside the path (derived: a bell's is 0.58)
    ALONG = 0.85  # cosine to the path: normals whose edges are smeared by nearly all of it
    BESIDE = 0.25  # cosine to the path: normals whose edges are hardly smeared
    LONG_WAVES = 2.0  # px of the reduced patch: blur that takes texture out, retinas
    SURE = 3.0  # standard deviations: length of a path that differs from none
    OUTLYING = 3.0  # typical residuals: where a pixel counts half
    PARAMETERS = 12  # derived: ellipse 5, path 2, bend 2, width, two levels
    FLAT = 4.0  # widths: where an edge has ended (derived: 3e-5 of its step are left)


class Reflection:
    """A wet wall's specular reflection with the spot on it (`measuring`)."""

    POWERS = 5  # of either coordinate in a bell's surface, rendered wet walls
    SMALLEST = 0.02  # area of what stands out, over the bell's
    SHARPEST = 0.05  # radii: widest rim of a spot on a reflection, rendered wet walls
    SMOOTHEST = 0.008  # radii: scatter of that rim; more is the wall's texture
    # radii: the same of what stands out, in the pixels of the search: of drawn spots on reflections
    # 0.034 at most, but for one in fifty; of texture under bells mostly 0.05 to 0.09.
    ROUGHEST = 0.04
    SEEN = 0.25  # fraction of that rim that is visible; 0.3 where a reflection ends on a spot


class Verdict:
    """Spot or not (`verdict`)."""

    # Area of the region over that of the seen part of the ellipse. Where a shaft over the middle
    # hides half of the contour, one of two segments has 1/4 - 1/(2 pi) = 0.09 of the ellipse.
    LIT = 0.18
    FAINTEST = 8.0  # standard deviations of the background: spots on even walls; optic discs have 5
    ROUGHEST = 0.05  # radii: scatter of the sharp edges of an ellipse, spotless frames
    COARSEST = 0.17  # widths: scatter of the edges; on textured walls 0.12, of hexagons 0.23
    CORNERS = slice(5, 9)  # harmonics: five to eight corners; fewer are coarser (derived)
    CORNERED = 0.5  # of the contour's waves: one of them; hexagons 0.7 and more, texture 0.3
    SOFT = 0.1  # radii: edge width of optic discs and more
    # Widths: as `COARSEST`, of soft edges of light that is less than twice as bright as needed.
    # Bells on such walls have up to 0.086, drawn optic discs 0.094 and more.
    SOFT_COARSEST = 0.09
    STEEPER = 1.2  # single rays over their mean: sharp edges 1.15, words in thick letters 1.6
    VAGUEST = 0.01  # radii: standard error of the size of an ellipse seen in part, shafts
    WHOLE = 0.96  # coverage from which an ellipse is seen as a whole
    SHORTEST_ARC = 0.3  # fraction of a contour that identifies an ellipse, spotless frames
    FILLED = 0.75  # area of a region over its ellipse's, below which something hides a part
    RIVAL = 0.5  # area of a second spot or lobe over the first's that makes the choice ambiguous
    NEAR_SPOT = 1.5  # semi-major axes: within it, another region is the spot's halo or a part
    LESS_SEEN = 0.1  # loss of coverage from which the whole frame is searched for a better view


class Hollow:
    """Dark places inside an ellipse (`contour`)."""

    SHARE = 0.02  # of the ellipse's area: shafts at any angle leave 0.019, letters 0.03 and more
    SIDE = 48  # of the grid of pixels that spans the ellipse: a thin shaft is five wide
    BEHIND = 0.6  # radii: where the light behind the edge is looked at
    # Share of the visible edge behind which it is dark there (derived: a shaft of half a diameter
    # through the middle makes 0.44 dark, and hides a third of the edge).
    RING = 0.6


class Trimming:
    """Robust fit of an ellipse to offsets (`ellipse`)."""

    MOST = 0.6  # of the edges that the plain fit must keep: no other ellipse has as many
    BELONGS = 3.5  # standard deviations (derived: 0.05 % of normal errors are larger)
    THIRD = 0.4307  # standard deviations that a third of normal errors stay below (derived)


class SpotProfile:
    """Shape of a spot's profile (`shape`)."""

    LEVELS = (0.25, 0.5, 0.75)  # peak above background: isophotes whose radii are compared
    BACKGROUND = 2.5  # radii: where the background begins
    CORE = 0.9  # radii: inner part of the spot that may be saturated


class FieldStop:
    """A camera's round field, a lit disc like a spot (`verdict`).

    Set between 40 photographs of DRIVE and one of skimage, in brackets, and any spots.
    """

    SMALLEST = 0.25  # radius over the frame's shorter side (0.27 and more)
    # Longest axis over the shortest (up to 1.005, where its rim is in view; 1.03 by a camera's
    # pixels that are not quite square). A spot square to the wall is as round.
    ROUND = 1.03
    DARK = 0.09  # of the peak: light round it (up to 0.084)
    DIM = 0.2  # of the peak: the same where rounding would hide the wall's texture
    # The same where it is plain: stray light, or a curve that lifts black (drawn, up to 0.3).
    PLAINEST = 0.4
    # Unevenness of that light over the disc's. A spot's wall goes on round it: 0.48 and more on
    # rendered walls. Fields have 0.43 and less.
    PLAIN = 0.45
    # Standard deviation of the light along its rim, of the mean (0.03 to 0.25; from 0.013 on where
    # a part of a photograph is shown enlarged). Discs on an even wall have less.
    UNEVEN = 0.012


class Faint:
    """Where a spot may be that was not measured (`tracking`)."""

    CONTRAST = 0.25  # (peak - background) / background of a spot under the haze of a wet wall
    FILLED = 0.8  # least share of the ellipse round a region that the region takes up


class Small:
    """Small spots, fitted to their pixels (`coarse`, `pixel_fit`, `verdict`)."""

    LARGEST_PX = 15.0  # px: semi-minor axis below which the pixel grid spoils profiles
    # px: from an edge that nothing but pixels blurs to where its pixels end (derived: half a
    # diagonal, and twice the width that is left).
    SHARP_EDGE_PX = 1.5
    OPENING_PX = 61  # px: what is wider than a bell's foot is no small spot (derived: twice 30)
    PARAMETERS = 10  # derived: ellipse 5, steepness, height, plane 3
    REACH = 3.0  # radii: size of the patch (derived: a Gaussian has 0.2 % there)
    CELLS = 24  # on the longer side of a patch: four on a radius
    TEXTURE_LENGTHS = (3.0, 30.0)  # px: of the wall's texture, spectrum 1/f and printed retinas
    BRIGHT, DARK = 0.25, 0.02  # of the peak: where noise and texture are seen, not between them
    RING = 0.5  # radii: between the corners of the line by which a beam's profile is its own
    SHOWN = 0.1  # of the clearest component of that line: fainter ones look like the fit's own
    VAGUEST = 0.1  # radii: standard error of a size
    CORNERED = 0.06  # of the peak: a wave of the light along the contour; beams 0.036, boxes 0.13
    ROUGHEST = 0.2  # of the light: standard deviation of what is no such spot's
    # radii: the middle, where a ring has less than half of its light; that light; the contour
    RINGS = (0.15, 0.55, 0.7, 0.85, 1.0)
    FOOT = 3.0  # widths, at least a pixel's: from the contour to where a spot's light has ended
    # Standard deviations beside a spot, and its light, of what stands out there and is another's.
    STANDS_OUT, FOREIGN = 5.0, 0.03
    AT_LIMIT = 3.0  # standard deviations of a pixel below the limit, within which a flat top is cut
