"""Fitted tables and their models: a net, the known classes of ground, hazard rates and their floors.

The files are `.npz`, or `.yaml` for few numbers, each with a card (`.md`) of the same name.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import yaml
from numpy.typing import NDArray

from alight.arrays import F16, F32, F64
from alight.learned.terms import DENSITY_TERMS, GROUND_TERMS, LAND_COVER_TERMS, NEAR_TERMS, RELIEF_TERMS

CELLS_AT_A_TIME = 8192  # cells per batch, so that hidden units or distances fit the CPU cache


def table_path(name: str) -> Path:
    """Return the path of a table in the package."""
    return Path(__file__).parent / f"{name}.npz"


def arrays_of(content: bytes, largest: int = 256_000_000) -> dict[str, NDArray[Any]]:
    """Decode the arrays of a table, by name.

    Args:
        content: bytes of an archive (.npz) without Python objects; they may be damaged.
        largest: largest allowed size of the decoded arrays, bytes.

    Raises:
        ValueError: the archive is damaged, holds Python objects, or decodes to more than `largest`.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > largest:
            raise ValueError(f"the table unpacks to {unpacked / 1e6:.0f} MB")
        with np.load(io.BytesIO(content), allow_pickle=False) as z:
            return {key: z[key] for key in z.files}
    except ValueError:
        raise
    except Exception as e:  # a damaged archive raises many types of errors
        raise ValueError(f"the table is damaged ({e})") from e


@dataclass(frozen=True, eq=False)
class FittedTable:
    """Fitted parameters of a function of features; the fields are the arrays of the file."""

    terms: tuple[str, ...]  # identifiers of the features (`alight.learned.terms`)

    stored: ClassVar[dict[str, type]] = {}  # types of arrays in the file, if not 32-bit floats
    used: ClassVar[type] = np.float32  # type of arrays in memory

    @classmethod
    def of(cls, content: bytes, terms: tuple[str, ...]) -> Self:
        """Read a table from the bytes of its file, and check it against the features that this version computes.

        Raises:
            ValueError: the table is damaged, has other features or wrong shapes, or holds a value that is not allowed.
        """
        arrays, names = arrays_of(content), [f.name for f in fields(cls)]
        if missing := [k for k in names if k not in arrays]:
            raise ValueError(f"the table has no {', '.join(missing)}")
        if tuple(map(str, arrays.pop("terms"))) != terms:
            raise ValueError("the table was fitted on other terms than this version computes; fit it anew (training/)")
        numbers: dict[str, Any] = {k: arrays[k].astype(cls.used) for k in names[1:]}
        table = cls(terms, **{k: v if v.ndim else float(v) for k, v in numbers.items()})
        if any(numbers[k].shape != shape for k, shape in table._shapes().items()):
            raise ValueError("the shapes of the table do not fit its terms")
        if not all(np.isfinite(v).all() for v in numbers.values()) or not table._is_sound():
            raise ValueError("the table holds numbers that are not finite, or not allowed")
        return table

    def to_bytes(self) -> bytes:
        """Encode the table as the content of its file (.npz)."""
        out, names = io.BytesIO(), [f.name for f in fields(self)][1:]
        numbers: dict[str, Any] = {k: np.asarray(getattr(self, k), self.stored.get(k, np.float32)) for k in names}
        np.savez_compressed(out, terms=np.array(self.terms), **numbers)
        return out.getvalue()

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shapes that the arrays must have."""
        raise NotImplementedError

    def _is_sound(self) -> bool:
        """Whether the values of a table with finite numbers and correct shapes are valid."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Net(FittedTable):
    """Network over standardised features, with one hidden layer of rectified linear units."""

    usual: F32  # (T,) mean of each feature
    spread: F32  # (T,) standard deviation of each feature
    hidden_weights: F32  # (T, U)
    hidden_bias: F32  # (U,)
    output_weights: F32  # (U, outputs)
    output_bias: F32  # (outputs,)

    clip: ClassVar = np.float32(4.0)  # standard deviations to which features are clipped
    stored: ClassVar = dict.fromkeys(("hidden_weights", "hidden_bias", "output_weights", "output_bias"), np.float16)

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        count, units, outputs = (len(self.terms),), self.hidden_bias.shape, self.output_bias.shape
        return {"usual": count, "spread": count, "hidden_weights": count + units, "output_weights": units + outputs}

    def _is_sound(self) -> bool:
        return bool((self.spread > 0).all())

    def standardised(self, found: Iterable[tuple[str, F32]]) -> F16:
        """Standardise and clip features (R, C), and return them as (T, R, C) in the order of the net.

        Features are computed and freed one by one, and stored with half precision, as all of them would take gigabytes.

        Raises:
            ValueError: a feature of the net is missing, repeated or unknown.
        """
        left = {name: i for i, name in enumerate(self.terms)}
        out = np.zeros((0, 0, 0), np.float16)
        for name, values in found:
            if name not in left:
                raise ValueError(f"terms that the net was not fitted on, or that are doubled: {name}")
            if len(left) == len(self.terms):
                out = np.empty((len(left), *values.shape), np.float16)
            i = left.pop(name)
            standard = (values - self.usual[i]) / self.spread[i]
            np.copyto(standard, 0, where=np.isnan(standard))  # unknown: usual
            np.clip(standard, -self.clip, self.clip, out=out[i])
        if left:
            raise ValueError(f"terms of the net that are missing: {', '.join(sorted(left))}")
        return out

    def outputs(self, found: Iterable[tuple[str, F32]]) -> F32:
        """Compute the outputs (outputs, R, C) from features (R, C) each.

        Raises:
            ValueError: a feature of the net is missing, repeated or unknown.
        """
        terms = self.standardised(found)
        x, hidden, output = terms.reshape(len(terms), -1), self.hidden_weights.T, self.output_weights.T
        out = np.empty((len(output), x.shape[1]), np.float32)
        for begin in range(0, x.shape[1], CELLS_AT_A_TIME):
            some = slice(begin, begin + CELLS_AT_A_TIME)
            units = hidden @ x[:, some].astype(np.float32) + self.hidden_bias[:, None]
            out[:, some] = output @ np.maximum(units, 0, out=units) + self.output_bias[:, None]
        return out.reshape(-1, *terms.shape[1:])


@dataclass(frozen=True, eq=False)
class KnownGround(FittedTable):
    """Class means of the training data and the spread around them (docs/method/land-cover.md, T6)."""

    usual: F32  # (T,) mean of each feature
    spread: F32  # (T,) standard deviation of each feature
    means: F32  # (K, T) class means of standardised features
    whitening: F32  # (T, T): `norm(row @ whitening)` is the Mahalanobis distance
    limit: float  # squared distance that holds 95 % of the cells of held-out scene families

    clip: ClassVar = np.float32(8.0)  # standard deviations to which features are clipped
    stored: ClassVar = {"means": np.float16, "limit": np.float64}

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        count = len(self.terms)
        return {"usual": (count,), "spread": (count,), "means": (len(self.means), count), "whitening": (count, count)}

    def _is_sound(self) -> bool:
        return bool((self.spread > 0).all())

    def novelty(self, values: F32) -> F32:
        """Compute the squared distance of features (N, T) to the nearest class mean, divided by `limit`, (N,)."""
        centres, out = self.means @ self.whitening, np.empty(len(values), np.float32)
        for first in range(0, len(values), CELLS_AT_A_TIME):
            some = slice(first, first + CELLS_AT_A_TIME)
            z = np.nan_to_num((values[some] - self.usual) / self.spread, copy=False)
            z = z.clip(-self.clip, self.clip) @ self.whitening
            square = (z * z).sum(axis=1)[:, None] - 2 * z @ centres.T + (centres * centres).sum(axis=1)
            out[some] = np.maximum(square.min(axis=1), 0) / np.float32(self.limit)
        return out


@dataclass(frozen=True, eq=False)
class Rate(FittedTable):
    """Expected number of hazards per touchdown. Its log is a sum of piecewise linear curves that never decrease."""

    knots: F64  # (T, K) values of each feature, ascending; curves are constant beyond their ends
    heights: F64  # (T, K) values of the curve at the knots, increasing from 0
    bias: float  # log rate where every curve is 0

    stored: ClassVar = {"bias": np.float64}
    used = np.float64

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        return dict.fromkeys(("knots", "heights"), (len(self.terms), self.knots.shape[-1]))

    def _is_sound(self) -> bool:
        return bool((np.diff(self.knots, axis=1) > 0).all() and (np.diff(self.heights, axis=1) >= 0).all())

    def log_rate(self, found: Mapping[str, F32]) -> F32:
        """Compute the log of the expected number of hazards per touchdown.

        `found`: features by identifier, arrays of one shape, which is the shape of the result.

        Raises:
            KeyError: a feature of the rate is missing.
        """
        total: F64 | float = self.bias
        for name, at, height in zip(self.terms, self.knots, self.heights, strict=True):
            total = total + np.interp(found[name], at, height)
        return np.asarray(total, np.float32)


class Floor(NamedTuple):
    """Lower bound of the expected number of hazards per touchdown, for one factor of P(safe), from a few features.

    The bound is a sum of products of curves of the features.
    """

    factor: str
    nearness: str  # name of the nearness that weights the lower bound
    products: tuple[dict[str, tuple[F64, F64]], ...]  # knots and values of curves, by feature identifier

    def expected(self, found: Mapping[str, F32]) -> F32:
        """Compute the lower bound of the expected number of hazards per touchdown.

        `found`: features by identifier, arrays of one shape, which is the shape of the result.
        """
        each = (math.prod(np.interp(found[k], *curve) for k, curve in p.items()) for p in self.products)
        return np.asarray(sum(each), np.float32)


RATES = {
    "relief_rate": RELIEF_TERMS, "density_rate": DENSITY_TERMS, "ground_rate": GROUND_TERMS,
    "near_obstacle_rate": NEAR_TERMS, "near_ground_rate": NEAR_TERMS,
}  # fmt: skip


@cache
def read_rate(name: str) -> Rate:
    """Read a rate of the package (one of `RATES`); cached."""
    return Rate.of(table_path(name).read_bytes(), RATES[name])


@cache
def read_net() -> Net:
    """Read the network for the land cover; cached."""
    return Net.of(table_path("land_cover").read_bytes(), LAND_COVER_TERMS)


@cache
def read_known() -> KnownGround:
    """Read the class means of known ground; cached."""
    return KnownGround.of(table_path("known_ground").read_bytes(), LAND_COVER_TERMS)


@cache
def read_floors() -> dict[str, Floor]:
    """Read the floors of the package (`floors.yaml`), by name; cached."""

    def curve(heights: list[float], at: Sequence[float] = (), log_of: Sequence[float] = ()) -> tuple[F64, F64]:
        knots: NDArray[Any] = np.array(at, np.float64) if at else np.log(log_of)
        return knots, np.array(heights, np.float64)

    return {
        name: Floor(f["factor"], f["nearness"], tuple({k: curve(**c) for k, c in p.items()} for p in f["sum"]))
        for name, f in _yaml("floors").items()
    }


class SigmaCoefficients(NamedTuple):
    """Coefficients of the sigma of a height (eq. 14), explained in `heights.yaml`."""

    fit: float
    floor_cells: float
    relief: float
    hidden_px: float
    fine_power: float
    broad_power: float
    noise_power: float


@cache
def read_sigma() -> SigmaCoefficients:
    """Read the coefficients of sigma; cached."""
    return SigmaCoefficients(**_yaml("heights")["sigma"])


@cache
def read_wrong_match() -> dict[str, float]:
    """Read the log odds of a wrong match by evidence, and their `constant` (eq. 15); cached."""
    return dict(_yaml("heights")["wrong_match"])


def _yaml(name: str) -> dict[str, Any]:
    return dict(yaml.safe_load(table_path(name).with_suffix(".yaml").read_text(encoding="utf-8")))
