"""Monte Carlo moves of equal discs.

The occupancy grid has cells of side diameter / sqrt(2), whose diagonal is one diameter, so that a
cell holds one disc at most and its content is one number. A disc can only overlap discs up to two cells away.
"""

from mpsim.kernels.compiling import compiled, linked

EMPTY = -1


@linked
def is_free(x, y, grid, px, py, mover, diameter, cells_per_length):
    """Whether a disc at (px, py) overlaps no disc except, perhaps, `mover`."""
    columns, rows = grid.shape
    column, row = int(px * cells_per_length), int(py * cells_per_length)
    for c in range(max(column - 2, 0), min(column + 3, columns)):
        for r in range(max(row - 2, 0), min(row + 3, rows)):
            other = grid[c, r]
            if other != EMPTY and other != mover:
                dx, dy = x[other] - px, y[other] - py
                if dx * dx + dy * dy < diameter * diameter:
                    return False
    return True


@compiled
def sweep(x, y, grid, moves, low, x_high, y_high, diameter, cells_per_length):
    """One Monte Carlo move per disc, accepted if it leads into the box and to no overlap (Metropolis et al. 1953)."""
    for i in range(x.size):
        px, py = x[i] + moves[i, 0], y[i] + moves[i, 1]
        inside = (low <= px) & (px <= x_high) & (low <= py) & (py <= y_high)
        if inside and is_free(x, y, grid, px, py, i, diameter, cells_per_length):
            grid[int(x[i] * cells_per_length), int(y[i] * cells_per_length)] = EMPTY
            grid[int(px * cells_per_length), int(py * cells_per_length)] = i
            x[i], y[i] = px, py
