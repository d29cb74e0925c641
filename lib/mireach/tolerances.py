"""Every tolerance of the package, in four tiers; limits on counts and sizes stand where they are used.

Engines work in the units of the loop (`engines.units`), so "relative to the size of X" is relative to 1 there.
numba keeps compiled code by the file of the function: after a change here, change or touch `sets/kernels.py` as well.
"""

# -- machine: Rounding of an expression in IEEE doubles. Each covers what it names with room to spare.

ROUNDOFF = 2.0**-52  # twice the unit roundoff: a sum of k terms is off by less than k ROUNDOFF times their sizes
EXPRESSION = 2.0**-50  # rounding of a short expression, relative to the sum of the sizes of its terms
CORNER = 2.0**-50  # distance by which rounding moves a new corner, relative to the size of X
HALF_PLANE = 2.0**-49  # rounding of a half-plane through points, relative to their largest coordinate
LARGE_IMAGE = 2.0**-44  # rounding of a large image, relative to its size
AROUND = 2.0**-40  # boxes in floats that discard what cannot meet are enlarged by this, relative to their size
UNDERFLOW = 2.0**-1000  # more than all products of a linear program lose that are too small for a float
SMALL_PRODUCTS = 1e-290  # what a few operations lose where numbers are too small for full precision
SMALLEST = 2.0**-1060  # what one product loses that is too small for full precision

# -- geometry: When corners, rows or sets are the same. Relative to the size of the set, or to rows of length 1.

TIE = 2.0**-40  # a vertex this close to the hyperplane that cuts its cell lies on it
TOUCH = 1e-11  # closed sets, or vertices, that come this close touch
BOUND_GRID = 2.0**-36  # bounds of the cells are rounded up to multiples of this, in the units of the loop
CLOSE_BOUND = 2.0**-34  # a bound over a part of a cell further above its vertices is computed again in fractions
THIN_IMAGE = 2.0**-12  # the image of a cell that is thinner than this share of its length may be loose
FLAT_IMAGE = 2.0**-40  # the image of a cell is flat along an axis along which it is thinner
CLOSING = 2.0**-36  # least widening of an image by `exact_reach` and `attractor`
OPPOSITE_ROWS = 4e-15  # rows whose angle has a smaller sine are opposite up to rounding, as those of a template are
PARALLEL_ROWS = 1e-12  # rows of length about 1 whose determinant is below this have no vertex
TURN = 1e-12  # points are no corners of a hull where its boundary turns by a smaller sine
CUTTING_ROW = 1e-12  # a row that cuts off less of a box than this does not tighten a bound
GEOS_GRID = 1e-13  # grid on which GEOS combines polygons
NEEDLE_POINT = 1e-11  # a point of a linear program further outside its polytope lies beyond the tip of a needle
AT_REST = 1e-11  # a step that moves a state by less leaves it where it is
LEAST_SLACK = 1e-11  # smaller slacks of the maximal set would drown in the rounding of GEOS
PULL = 1e-10  # share of the way to a region's centre by which points are moved that rounding put outside
INWARD = 2.0**-30  # share of the way to a point of F by which a state is moved inward
FLAT_SET = 1e-9  # radius of the largest ball in a set below which it is flat
GRID_POINT = 1e-9  # a grid point this far outside a region still belongs to it
MODE_BOUNDARY = 1e-8  # a mode whose rows are violated by less than this and rounding counts as met
SINGULAR_ROWS = 1e-8  # two rows whose determinant is below this meet where floats cannot locate it
OVERLAP = 1e-7  # radius of the smallest ball that counts as an overlap of regions
NEAR_VERTEX = 1e-6  # candidates for a vertex that are inside to within this are decided in fractions
ALIGNED_NORMALS = 1e-6  # an exact normal replaces that of Qhull if they differ by less
OPPOSITE_NORMALS = 1e-6  # rows whose unit normals add up to less name the same boundary from both sides
BESIDE = 1e-6  # share of the way to a point at which another piece of the loop is searched
FLAT_DOMAIN = 2.0**-20  # half-widths of X x U below this share of the largest coordinate are taken as this share
NEEDLE_TIP = 1e-3  # two rows of length about 1 meet well if their determinant is at least this
LEAST_ERROR = 2.0**-10  # errors below this share of X's size count as this large

# -- solver: What a solver is asked for, and when its answer is used. Relative to 1 + the size of the value.

TINY_COEFFICIENT = 1e-12  # HiGHS leaves out coefficients that are not larger
FEASIBILITY = 1e-10  # HiGHS keeps constraints and reduced costs to within this, in units of the scaled row
MIP_GAP = 1e-10  # gap between the bound of a MILP and its best point at which the search may stop
MILP_MARGIN = 2e-10  # a bound may stay above the value by this, INTEGRALITY and the gap
INTEGRALITY = 1e-9  # feasibility in HiGHS's MILP; a binary this close to 0 or 1 counts as decided
CLOSE_VALUE = 1e-9  # an attained value this close to the value in floats ends the search
ERROR_GAP = 1e-9  # proven bound minus attained error of a fit at which the search ends, as a share of the error
LOOSE_BOUND = 1e-8  # a bound of an LP further above the value may be better with other multipliers
LOOSE_MILP_BOUND = 1e-7  # a bound of a MILP further above the value is computed again with smaller big-M
CVXPY_TOLERANCE = 1e-7  # added to the optimum of a solver of cvxpy, in units of v x
OPEN_BINARY = 1e-6  # a relaxed binary closer to an integer is branched on only if no other is open

# -- verdict: What "proven" and "refuted" allow. Relative to the size of X or U.

CLEAR = 1e-9  # floats that pass a limit by more pass it certainly; below, exact arithmetic decides
SAMPLED_INPUT = 1e-9  # by which Phi may leave U at a sampled state, relative to the terms of the row
SLACK = 1e-9  # default of `slack` of the maximal set
INPUT_TOLERANCE = 1e-7  # by which Phi may leave U where the MILP decides
OUTSIDE_X = 1e-7  # a simulated state this far outside of X counts as outside
MILP_RESOLUTION = 1e-6  # by which a bound of the MILP may exceed a limit that counts as kept, for three or more states
WRONG_BOUND = 1e-6  # a trajectory that exceeds a bound by more shows that the bound is wrong
LARGEST_INFLATION = 1e-6  # largest growth of a set to make a claim of a certificate exactly true
CVXPY_RESOLUTION = 1e-5  # as MILP_RESOLUTION, for a solver of cvxpy
