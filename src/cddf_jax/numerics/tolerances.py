"""All tolerances and limits of the solver, each with what it protects."""

# fixed points and roots
MAX_ITERATIONS = 100  # of a linear fixed point: one that does not settle shows as NaN, and does not hang
NEARLY = 1e3  # times rounding errors: a linear fixed point whose change is larger has not settled
CURVATURE_STEPS = 8  # from the curvature of parallel tendons: enough for rounding errors of any slanted tendon
STRAIN_STEPS = 6  # from the strain at rest: likewise for a cross-section in space
JOINT_STEPS = 6  # of r beyond a joint: r changes the angle there by mu d d' kappa only
REFINED = 1e-9  # the change that stands before the first march on finer nodes: so a change of 3e-11 there is the last
SAME_SLOPES = 1e2  # times the tolerance of the march: change of slopes by tensions that are searched for
LAST_GAIN = 64.0  # times the tolerance of the march: above it another march is made, also where marches converge fast

# directions of sliding
LEAST_TRAVEL = 1e-6  # of the length: rounding errors of a travel contradict no direction
NUM_FLIPS = 3  # choices that reverse the contradicted directions; after them all choices are tried in turn
MOST_LISTED = 64  # of all choices: ten tendons do not take a thousand solves

# wrap angle
SERIES = 1e-3  # of log(r): below it a series, as a quotient would be 0 / 0 without friction
NOT_LOCKED = 1e-6  # least r, so that the logarithm is finite where a tendon locks

# error estimate
ACCURACY = 1e-5  # a solve with a larger truncation error is not called successful
SAFETY = 2.0  # factor on what the nodes miss, so that the estimate is not below the error
AT_KINK = 0.045  # what a kink adds to it, over the last coefficients of the axis
AT_KINKS = 0.6  # likewise where there may be several in one element
LEAST_RATIO = 1e-3  # of r at the tip: errors of a tendon that slides out count 1 / r times, but this much at most
AT_MINIMUM = 0.17  # of the next coefficients of the turning: what a sharp minimum in space adds

# continuation in the loads
LARGEST_TURN = 1.0  # rad, of a cross-section in one step: a longer one may leave the path
FIRST_TURN = 0.35  # rad: at which the first step aims, because no prediction has been compared yet
LARGEST_MISS = 0.2  # rad, of a heading from its prediction: a larger one is another branch
LEAST_STEP = 1e-5  # of the loads: at a shorter step the path has ended
CRITICAL_STEP = 1e-4  # of the loads: in a longer step a change of stability may be another branch
MAX_TRIES = 200  # of steps: a lane that gets nowhere does not hold up its batch
MAX_CORRECTIONS = 16  # iterations of one try
ROUGH_AT_START = 5e-2  # as `ROUGH` at load fraction 0, whose state serves the first prediction only
ROUGH = 2e-2  # of the states along the path, relative: good enough to predict the next step
STEADY = 2e-1  # of the slopes along the path, relative: good enough to know the sign of stability

# tensions that reach targets
PARALLEL = 1e-9  # sine of the angle between two axes that count as parallel
FARTHEST = 100.0  # times the tension at which d kappa would come near 1: the search ends there
FIRST_TENSION = 0.05  # of the tension at which d kappa would come near 1
OTHER_TENSIONS = (0.0, 0.5, 5.0)  # if there is no equilibrium at the first one
MAX_EVALUATIONS = 200  # of equilibria in one search
REACHED = 1e-9  # of the size of a target
LEAST_MOVE = (1e-11, 1e-7)  # relative change of the tensions below which a search ends: undamped, damped
WELL_DETERMINED = 1e-8  # smallest pivot over the largest: below it other tensions do the same
MAX_ROUNDS = 60  # of searches that lower the sum of the tensions
OTHER_SEARCHES = 2  # where the first one does not reach the position, or not with directions that fit
BEYOND = 1.25  # times the best tensions, where a search starts that looks for other directions
LEAST_GAIN = 1e-10  # relative decrease of the sum; the rounds end at a smaller one
SAME_EFFECT = 1e-6  # of the largest slope: tensions that move the tip by less have no effect
ALIKE = 1e-6  # relative: two misses that count as the same
LEAST_LEFT = 0.1  # of a tension after one step, where slopes vanish without tension: tip angle and curvature in space
LEVEL = 1e-5  # change of the sum with a tension below which it counts as none

# history
HELD = 1e-10  # of a curvature: so near the limit of friction it is held, and rounding errors do not choose its slope
LEAST_TURN = 1e-11  # rad: below it the turn of a tendon counts as this, so that the limit of friction is smooth
ELASTIC = 1e-7  # of the largest offset, by which a tendon moves in an element before it slides
CORNER = 16  # p of the softened law: the higher, the sharper its corner between rest and sliding
SLIDING = 1e-9  # of 1 - z^p: a tendon with less slides; of z it is 6e-11, by which a body creeps where nothing changes
INCREMENT = 1e-10  # relative change in a round that has settled: slips to a thousandth of the elastic one
PATIENCE = 20  # rounds with whole steps; then as many with half of them, and so on
# elastic slip at first and at last, of the largest offset; factor on it after a round of a smaller change than the next
# number; most rounds; rounds for which the slopes of the mechanics stay
ATTEMPTS = (
    (ELASTIC, ELASTIC, 1.0, 0.0, 20.0, 8.0),  # an increment changes these slopes little
    (1e-3, ELASTIC, 0.03, 1.0, 60.0, 1.0),
    (1.0, 1e-5, 0.5, 1e-4, 320.0, 1.0),  # where tendons stick together: to softer laws, which the error estimate tells
    (1.0, 1e-4, 0.5, 1e-4, 320.0, 1.0),
    (1.0, 1e-3, 0.5, 1e-4, 320.0, 1.0),
)
