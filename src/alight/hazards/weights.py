"""Costs of the evidence against a footprint, from 51 simulated maps: `bench/ground_fit.py`."""

# term: usual value, and spread
TERMS: dict[str, tuple[float, float]] = {
    "coarse": (-0.8566, 0.001044),
    "rise": (-5.972, 5.529),
    "even": (-1.193, 0.6216),
    "broad": (-1.713, 0.6279),
    "over": (-4.112, 2.451),
    "unknown": (0.01932, 0.05026),
    "residual": (0.04985, 0.02362),
    "worst residual": (0.123, 0.06879),
    "cover": (-1.948, 1.486),
    "cover around": (-2.123, 1.425),
    "cover in the mean": (-3.751, 1.173),
    "cover beyond": (0.09176, 1.976),
    "cover far beyond": (-3.145, 1.059),
    "dark": (0.239, 0.09912),
    "bright": (0.1696, 0.06967),
    "tint": (0.7309, 0.4467),
}

# of each layer: inputs, outputs, and their weights, the bias last, as base 85 of 16 bit floats
LAYERS: tuple[tuple[int, int, str], ...] = (
    (
        16,
        16,
        "nGOU1@&U>fp(NlC$t*q{Hy8Of001ojP&6PVxDIYL0000000000000000000000000000000000000000000000000000000000000000"
        "0QYZib00000000000000000000000000000000000(<lG{00000000000000000000000000000000000<S+mL000000000000000000"
        "00000000000000000(HsB(0000000000000000000000000007z)005FR0000000000002NN00000000000000000000005UY0000000"
        "000000;<1R(<eAsqk!-2)sP003zu+ZtLnDl+{D000RM003b&N+19LNg4nE001By007D&WgO5n008I!00000001*M0000000000000000"
        "0000001ulDJB2_00000004d!)G3Y_KrZDP6AX7GHxJJ#3oHaO008q3HxYCcwJw4-005f>000000000000000006c#(k|5o00000wli@!"
        "008ee00000000000000000000IV2D}&@BJ}=QscW006Nm000000000000000002-dpelkg00000TsdA23o!gJe=TqxbRLE&_9nkIoGda"
        "j005INge;^e#5n93VY@OZW4z=*A-c`EM7;{R7P4$PUAjiL=)RJ?6hXW?",
    ),
    (32, 1, "MLC%}nK^1Fb`*a$G(BHDcP|q%001E>2|;Ev$2xsF!V~}i000000000000000IvD;L008tT00000008$aC$j"),
)
# log odds, and what they were worth on flights left out
CALIBRATION = (
    (
        -4.63,
        -2.33,
        -0.85,
        0.1,
        0.78,
        1.35,
        1.84,
        2.25,
        2.6,
        2.93,
        3.26,
        3.64,
        4.1,
        4.73,
        5.56,
        6.54,
        7.44,
        8.08,
        8.52,
        9.04,
        9.5,
        9.84,
    ),
    (
        -0.31,
        0.08,
        0.4,
        0.67,
        0.85,
        1.15,
        1.46,
        1.54,
        1.75,
        1.95,
        2.05,
        2.13,
        2.13,
        2.4,
        2.88,
        3.88,
        6.12,
        6.91,
        6.91,
        6.91,
        6.91,
        6.91,
    ),
)
