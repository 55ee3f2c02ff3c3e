"""Choice of blocks for a recursive step: budgets, rotation, changed and swept blocks, and the levels of effort."""

from __future__ import annotations

import numpy as np
import pytest
from descent_views import look

from alight.geometry import Grid
from alight.parallax.blocks import EFFORTS, SIDE, Blocks, Counts, Plan, Rectangle, cover, grown
from alight.pipeline.mapping.recursive_map import RecursiveMap
from alight.records import View
from alight.settings import load_settings
from alight.settings.tuning.parallax import RecursiveTuning

CELL, EVERY = 0.1, 4
WINDOW = Grid(0.05, 79.95, CELL, 6 * SIDE, 8 * SIDE)  # its blocks are 7 x 8: the rows begin within one
CHEAP = (40.0, 0.1)  # samples of a cell, reach
TUNING = RecursiveTuning(least_cells=1, watched=0.0)


def kinds(grid: Grid, fresh: float = 0.0) -> np.ndarray:
    """Kinds of all cells: known, except a share of the columns in the east, which is new and may be swept."""
    rows, cols = (-(-n // EVERY) for n in grid.shape)
    new = np.zeros((rows, cols), np.bool_)
    new[:, cols - round(fresh * cols) :] = True
    return np.array([new, np.zeros_like(new), ~new])


def taken(blocks: Blocks, grid: Grid, fresh: float = 0.0, effort: int = 0, sweep: tuple[float, float] = CHEAP) -> Plan:
    """Plan one step, and record its blocks as visited and unchanged."""
    blocks.move_to(grid)
    middle = (0.5 * grid.rows, 0.5 * grid.cols)
    plan = blocks.plan(blocks.counted(kinds(grid, fresh), EVERY), middle, *sweep, EFFORTS[effort])
    for r, c in plan.refine:
        known = np.ones((-(-(r.stop - r.start) // EVERY), -(-(c.stop - c.start) // EVERY)), np.bool_)
        blocks.visited((r, c), known, np.zeros_like(known), EVERY)
    return plan


def cells(plan: Plan, grid: Grid = WINDOW) -> np.ndarray:
    """Number of rectangles that hold each cell."""
    out = np.zeros(grid.shape, int)
    for box in plan.refine:
        out[box] += 1
    return out


def test_steps_cost_alike_and_leave_out_no_cell_for_long() -> None:
    blocks = Blocks(TUNING)
    seen = [cells(taken(blocks, WINDOW)) for _ in range(40)]
    assert max(int(s.max()) for s in seen) == 1  # rectangles share no cell
    shares = np.array([s.mean() for s in seen])
    assert shares[10:].max() <= TUNING.share
    assert shares.max() <= 3 * TUNING.share  # at the start
    assert shares[10:].min() > 0.0
    for k in range(10, 40 - 12):
        assert np.sum(seen[k : k + 12], axis=0).min() >= 1


def test_a_new_block_is_refined_with_every_keyframe_and_an_old_one_now_and_then() -> None:
    """With a budget for all blocks, the wait between refinements grows with their number."""
    blocks = Blocks(RecursiveTuning(share=1.0, least_cells=1_000_000, watched=0.0))
    visits = np.array([cells(taken(blocks, WINDOW))[0, 0] for _ in range(60)])
    assert visits[:4].sum() == 4
    assert 0.15 < visits[-30:].mean() < 0.5
    last = np.flatnonzero(visits)
    assert np.diff(last).max() <= TUNING.longest_wait + 1


def test_ground_below_the_vehicle_is_looked_at_with_every_keyframe() -> None:
    """Ground within 1.5 m below is refined with every keyframe, and the rest hardly less than without."""
    below = (slice(192 - 15, 192 + 15), slice(256 - 15, 256 + 15))
    watching, plain = Blocks(RecursiveTuning(least_cells=1, watched=1.5)), Blocks(TUNING)
    seen, without = ([cells(taken(b, WINDOW)) for _ in range(40)] for b in (watching, plain))
    assert all(s[below].all() for s in seen)
    assert not all(s[below].all() for s in without)
    rest = np.ones(WINDOW.shape, bool)
    rest[192 - SIDE : 192 + 2 * SIDE, 256 - SIDE : 256 + SIDE] = False
    assert np.mean([s[rest].mean() for s in seen]) > 0.9 * np.mean([s[rest].mean() for s in without])


def test_blocks_in_which_much_changed_are_new_again() -> None:
    blocks, every = Blocks(RecursiveTuning(share=1.0, least_cells=1_000_000, watched=0.0)), []
    for _ in range(30):
        blocks.move_to(WINDOW)
        plan = blocks.plan(blocks.counted(kinds(WINDOW), EVERY), (0.0, 0.0), *CHEAP, EFFORTS[0])
        every.append(cells(plan)[200, [30, 500]])
        for box in plan.refine:
            known = np.ones(tuple(-(-(s.stop - s.start) // EVERY) for s in box), np.bool_)
            west = np.arange(known.shape[1]) * EVERY + box[1].start < SIDE
            blocks.visited(box, known, known & west, EVERY)
    restless, settled = np.sum(every[10:], axis=0)
    assert restless >= 15  # a step may be too short for all of them
    assert settled < 0.6 * restless


def test_what_was_done_moves_along_with_the_raster() -> None:
    """A window that moves by whole cells keeps the state of its blocks; blocks of new ground are new."""
    still, moving = Blocks(TUNING), Blocks(TUNING)
    for _ in range(12):
        taken(still, WINDOW)
        taken(moving, WINDOW)
    on = WINDOW.window(0, 37, WINDOW.rows, WINDOW.cols)
    moving.move_to(on)
    moving.move_to(WINDOW)
    still.move_to(WINDOW)
    still.move_to(WINDOW)
    box = (slice(0, WINDOW.rows), slice(SIDE, 7 * SIDE))
    assert not moving.never_visited(box)
    far = WINDOW.window(0, 20 * SIDE, WINDOW.rows, WINDOW.cols)
    moving.move_to(far)
    assert moving.never_visited((slice(0, 10), slice(0, 10)))


def test_new_cells_are_swept_within_a_few_steps_and_refined_at_once() -> None:
    """All cells are new at the start: the sweeps are spread over several steps, and swept cells are refined at once."""
    tuning = RecursiveTuning(least_cells=1, share=0.5, least_sweep=1)
    blocks, left, done = Blocks(tuning), kinds(WINDOW, fresh=1.0), []
    for _ in range(6):
        blocks.move_to(WINDOW)
        plan = blocks.plan(blocks.counted(left, EVERY), (200.0, 200.0), *CHEAP, EFFORTS[0])
        done.append(sum((r.stop - r.start) * (c.stop - c.start) for r, c in plan.sweep))
        refined = cells(plan)
        for r, c in plan.sweep:
            assert (refined[r, c] == 1).all()
            for k, value in ((0, False), (2, True)):
                left[k, r.start // EVERY : -(-r.stop // EVERY), c.start // EVERY : -(-c.stop // EVERY)] = value
    whole = WINDOW.rows * WINDOW.cols
    assert sum(done) >= 0.97 * whole
    assert max(done) < 0.55 * whole


def test_a_sweep_that_costs_more_than_a_step_may_is_rough() -> None:
    blocks = Blocks(TUNING)
    assert not taken(blocks, WINDOW, 0.3).rough
    blocks = Blocks(TUNING)
    plan = taken(blocks, WINDOW, 0.3, sweep=(1e4, 0.0))
    assert plan.rough
    assert not plan.sweep


def test_few_new_cells_wait_and_are_not_forgotten() -> None:
    blocks = Blocks(TUNING)
    swept = [bool(taken(blocks, WINDOW, 8 / WINDOW.cols).sweep) for _ in range(12)]  # an eighth of the last blocks
    wait = TUNING.patience
    assert not any(swept[:wait])
    assert swept[wait]


@pytest.mark.parametrize("level", [1, 2, 3])
def test_less_effort_does_less(level: int) -> None:
    """Each level of effort works on a smaller share of the window than the level before."""

    def share(effort: int) -> float:
        blocks = Blocks(RecursiveTuning(least_cells=1, share=0.5))
        return float(np.mean([cells(taken(blocks, WINDOW, effort=effort)).mean() for _ in range(30)]))

    assert share(level) < share(level - 1)


def test_a_rectangle_grows_while_its_rim_is_urgent() -> None:
    urgency = np.array([[0.0, 0, 0, 0, 0], [0, 2, 2, 1, 0], [0, 2, 3, 1, 0], [0, 0, 0, 0, 0]])
    away = np.hypot(*np.mgrid[:4, :5])
    assert grown(urgency, away, 20.0) == Rectangle(1, 1, 3, 4)
    assert grown(urgency, away, 4.0).blocks <= 4
    assert grown(urgency, away, 0.0) == Rectangle(2, 2, 3, 3)  # the most urgent in any case
    boxes = cover(urgency, away, 1e6)
    held = np.zeros(urgency.shape, int)
    for b in boxes:
        held[b.top : b.bottom, b.left : b.right] += 1
    assert held.max() == 1
    assert (held[urgency >= 1] == 1).all()


def test_no_two_rectangles_share_a_block() -> None:
    """A block that is refined twice in a step starts twice from the same height, and the first result is lost."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        shape = rng.integers(6, 30, 2)
        urgency = np.where(rng.random(shape) < 0.5, rng.integers(1, 6, shape), 0).astype(np.float64)
        held = np.zeros(shape, int)
        for b in cover(urgency, rng.random(shape), float(SIDE**2 * urgency.size)):
            held[b.top : b.bottom, b.left : b.right] += 1
        assert held.max() == 1


def test_counts_are_of_the_cells_of_each_block() -> None:
    blocks = Blocks(TUNING)
    blocks.move_to(WINDOW)
    counts = blocks.counted(kinds(WINDOW, 0.5), EVERY)
    assert isinstance(counts, Counts)
    assert counts.known.sum() + counts.fresh.sum() == WINDOW.rows * WINDOW.cols / EVERY**2
    assert (counts.known[:, :4] > 0).all()
    assert (counts.known[:, 4:] == 0).all()


# -- effort of a whole step


def level_flight(count: int) -> list[View]:
    return [look(np.array([1.2 * k, 0.0, 40.0]), k) for k in range(count)]


def flown(effort: int) -> bytes:
    """Make the map of a short flight; return its bytes."""
    views = level_flight(10)
    lane = RecursiveMap(load_settings("", ["tuning.elevation.tile=64", "elevation.max_sigma=5"]).stages())
    assert lane.find_ground(views), lane.reason
    assert [lane.step([v], effort=effort) for v in views][-1]
    found = lane.snapshot()
    assert found is not None
    assert found.trusted.mean() > 0.3
    return found.height.tobytes() + found.sigma.tobytes() + found.flags.tobytes()


@pytest.mark.parametrize("effort", [0, 3])
def test_the_same_effort_gives_the_same_bits(effort: int) -> None:
    assert flown(effort) == flown(effort)
