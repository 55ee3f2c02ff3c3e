"""Tuning of planar parallax."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, NonNegative, Positive

Triple = tuple[Positive, Positive, Positive]


class PointsTuning(FrozenModel):
    """Constants for points that are triangulated before the ground is known."""

    features: int = Field(1500, ge=100, description="SIFT features in each view")
    contrast: Positive = Field(
        0.04, description="Least contrast of a SIFT feature by OpenCV; halved while a view has few, to a grey level"
    )
    enough_features: int = Field(300, ge=2, description="Features in a view from which no fainter ones are sought")
    longest_px: int = Field(960, ge=100, description="Longest side of the images on which features are found, px")
    least_angle: Positive = Field(
        0.02, description="Least angle between the rays of a point, rad, and baseline of two keyframes over the height"
    )
    most_pairs: int = Field(40, ge=1, description="Most pairs of views")
    descriptor_ratio: Fraction = Field(0.8, description="Largest ratio of best to second-best descriptor distance")
    neighbours: int = Field(8, ge=1, description="Nearest points over the ground that must agree on the height")
    supporters: int = Field(2, ge=0, description="Least number of these neighbours at a like height")
    like_height: Positive = Field(
        0.05, description="Difference of like heights, or 1-sigma of them before there is a map, over the height"
    )


class SweepTuning(FrozenModel):
    """Constants of the plane sweep along the rays of a view, with semi-global aggregation."""

    references: int = Field(2, ge=1, description="Views along whose rays a tile is swept, or what was not seen (batch)")
    max_tangent: Positive = Field(0.4, description="Horizontal over vertical distance of a preferred view (batch)")
    keep_share: Fraction = Field(0.7, description="Share of the views of a cell that has to agree on a plane")
    truncation: Positive = Field(1.5, description="Largest matching cost of a view, normalised grey")
    penalty_one_plane: Positive = Field(0.1, description="Penalty P1 for neighbours one plane apart, normalised grey")
    penalty_more_planes: Positive = Field(1.0, description="Penalty P2 for neighbours further apart, normalised grey")
    edge_discount: Fraction = Field(0.5, description="Share of P2 that is waived at edges of the reference image")
    most_planes: int = Field(192, ge=5, description="Most height planes of the coarsest images")
    halvings: int = Field(2, ge=0, le=4, description="Times that the images are halved for the first sweep (batch)")
    gap_cells: int = Field(2, ge=0, description="Half the width of gaps that are filled with their lowest rim, cells")
    least_wanted: Fraction = Field(0.25, description="Share of wanted cells from which a block is swept")


class RefinementTuning(FrozenModel):
    """Constants of the Gauss-Newton refinement of the heights."""

    iterations: int = Field(4, ge=1, description="Gauss-Newton steps on a tile (batch)")
    residual_scale: Positive = Field(
        0.35, description="Scale of the robust weight, normalised grey; from four times this the weight is 0"
    )
    step_px: Positive = Field(
        0.5,
        description="Largest step, parallax px; sigma of the newest view from which coarse images come first, cells",
    )
    plane_prior: Positive = Field(
        4500.0, description="Weight of the local plane: one over its variance, 1 / parallax px^2"
    )


class UncertaintyTuning(FrozenModel):
    """Constants of the height flags and of moving ground; sigma and wrong matches are fitted (`alight.learned`)."""

    max_outlier: Fraction = Field(0.45, description="Largest probability of a wrong match; above: UNSURE")
    min_contrast: Positive = Field(0.7, description="Least contrast of the views, grey levels; below: TEXTURE")
    max_residual: Fraction = Field(
        0.5, description="Largest share of the variance nearby that the views do not have in common; above: MOVING"
    )
    max_cost_ratio: Positive = Field(
        1.2,
        description="Largest mean ratio of best to second-best cost nearby; above: AMBIGUOUS. Half of it: not swept",
    )
    step_px: Positive = Field(
        4.0, description="Difference to a neighbour from which a cell is a STEP, or hides what is behind, parallax px"
    )
    near: int = Field(5, ge=1, description="Window of what is nearby, cells of half resolution or blocks of sums")
    cut: Positive = Field(0.55, description="Deviation from which a view sees something else, normalised grey")
    most_shared: Fraction = Field(
        0.05, description="Largest share of the variance that the views of an instant have in common; above: MOVING"
    )
    changed: Fraction = Field(
        0.8, description="Share of the variance between before and after a moment from which the ground changed; MOVING"
    )
    most_unlike: Fraction = Field(
        0.6, description="Share of their power in which all views differ, from which they contradict the map; MOVING"
    )
    came_unlike: Fraction = Field(
        0.45, description="The same where the views agreed before: somebody has come; MOVING, and remembered"
    )
    alike_before: Fraction = Field(
        0.2, description="Residual of the map (share of the variance) below which the views agreed there"
    )
    least_change: NonNegative = Field(
        0.02, description="Least variance of ground that changed or is contradicted, normalised grey^2"
    )
    least_seen: Fraction = Field(0.25, description="Least share of the cells of a block that a pair sees")
    least_views: int = Field(5, ge=2, description="Least number of views of a cell")


class RecursiveTuning(FrozenModel):
    """Constants for heights that are updated from keyframe to keyframe."""

    first_baseline: Positive = Field(
        0.12, description="Baseline over height from which the ground is sought in flight, and a new cell is swept"
    )
    first_views: int = Field(3, ge=2, description="Least number of views of that sweep")
    first_exposures: int = Field(4, ge=3, description="Exposures that a sweep uses")
    worse: Positive = Field(1.5, description="Ratio of new to old sigma from which a step leaves the map as it is")
    same_px: Positive = Field(
        2.0, description="Difference of sweep and map, less their common shift, that keeps the map's shape, parallax px"
    )
    share: Fraction = Field(
        0.25, description="Largest share of the window's cells that a step refines; three times as much at the start"
    )
    least_cells: int = Field(100_000, ge=1, description="Cells of the smallest window of which these are shares")
    least_sweep: int = Field(1_000_000, ge=1, description="Samples of first sweeps that a step may take in any case")
    most_sweep: int = Field(
        6_000_000, ge=1, description="Most samples of the first sweeps of a step; twice as many at the start"
    )
    backlog: Positive = Field(3.0, description="Keyframes over which sweeps are spread that are due together")
    patience: int = Field(2, ge=0, description="Keyframes that a sweep waits for the rest of its block at most")
    pace: Positive = Field(3.0, description="Refinements of a block for each keyframe that it then waits for the next")
    longest_wait: Positive = Field(8.0, description="Keyframes that it waits at most")
    watched: NonNegative = Field(
        1.5, description="Distance from below the newest view within which a block is refined with every keyframe, m"
    )
    unsettled: Fraction = Field(
        0.1, description="Share of heights replaced, newly trusted or refused from which a block is new again"
    )


class PoseRefinementTuning(FrozenModel):
    """Constants for refining keyframe poses together with the map."""

    cells: int = Field(1500, ge=100, description="Cells that take part")
    taken_share: Fraction = Field(0.5, description="Share of the heights that a step takes from its own views (eq. 16)")
    correlated: Positive = Field(4.0, description="Inflation of the variance: samples of neighbours are correlated")
    apparent_px: NonNegative = Field(0.03, description="1-sigma of the common error of a whole image, px")
    hold: Positive = Field(
        10.0, description="Sigmas of a cell (of an unknown one, the height) by which its height is held to the map"
    )
    plane_sigma: Triple = Field(
        (0.1, 0.1, 0.1),
        description="1-sigma of the ground's plane before there is a map: offset over height, tilts in rad",
    )
    wander: Triple = Field(
        (5e-5, 2e-4, 2e-4),
        description="1-sigma of the change of the map's plane with each keyframe: offset over height, tilts in rad",
    )


class ParallaxTuning(FrozenModel):
    """Constants of planar parallax on the world grid."""

    views: int = Field(16, ge=2, le=32, description="Most views that a cell uses (batch)")
    ring: int = Field(7, ge=3, le=16, description="Keyframes of the window (recursive), most views of a sweep (batch)")
    points: PointsTuning = PointsTuning()
    sweep: SweepTuning = SweepTuning()
    refinement: RefinementTuning = RefinementTuning()
    uncertainty: UncertaintyTuning = UncertaintyTuning()
    recursive: RecursiveTuning = RecursiveTuning()
    poses: PoseRefinementTuning = PoseRefinementTuning()
