"""Constants in single precision: with a double-precision constant, a loop over float32 would compute in doubles."""

import numpy as np

ZERO, HALF, ONE, TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
