"""Train the appearance model, and test it on held-out sites (docs/method/land-cover.md, T4)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from alight.arrays import F32, F64, I64, U8
from alight.records import InputError, Terrain
from alight.terrain.model import (
    CLIP,
    LEVELS,
    PIXEL,
    STRETCH,
    Head,
    Model,
    appearance_evidence,
    log_probability,
    log_softmax,
    scores,
    to_nearest,
)
from alight.training.confusion import Confusion, lines_of
from alight.training.patches import LabelledPatch, Report, Samples, measure_patches, quiet

COARSEST = STRETCH * PIXEL * 2 ** (LEVELS - 1)  # metres, largest usable pixel
UNTESTED = 3.0  # temperature of a model from one site, as its accuracy on other sites is unknown


def share_of_levels(report: Report, level: int) -> Report:
    """Return a callback that converts the progress within one level to progress over all levels, given to `report`."""
    return lambda share: report((level + share) / LEVELS)


def balance(kinds: NDArray[np.uint8], sites: NDArray[np.str_]) -> F64:
    """Return (N,) sample weights by which each class at each site weighs the square root of its sample count."""
    key = np.char.add(sites, kinds.astype(str))
    _, at, count = np.unique(key, return_inverse=True, return_counts=True)
    weight = 1 / np.sqrt(count[at])
    return np.asarray(weight / weight.mean())


def fit_logistic(z: F32, at: I64, weight: F64, count: int, penalty: float) -> tuple[F32, F32]:
    """Fit a multinomial logistic regression with a ridge penalty; return weights (K, F) and bias (K,).

    `z`: (N, F) features, `at`: (N,) class indices below `count` (K), `weight`: (N,) sample weights.
    """
    features = np.c_[z, np.ones(len(z))].astype(np.float64)
    goal = np.eye(count)[at]
    free = np.r_[np.ones(z.shape[1]), 0.0]  # the bias is not penalised

    def loss(flat: F64) -> tuple[float, F64]:
        w = flat.reshape(count, -1)
        log_p = log_softmax((features @ w.T).astype(np.float64))
        off = (np.exp(log_p) - goal) * weight[:, None] / len(z)
        value = -float((weight * (log_p * goal).sum(axis=1)).mean()) + 0.5 * penalty * float((w**2 @ free).sum())
        return value, np.asarray((off.T @ features + penalty * w * free).ravel())

    start = np.zeros(count * features.shape[1])
    found = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 300}).x.reshape(count, -1)
    return found[:, :-1].astype(np.float32), found[:, -1].astype(np.float32)


def fit_head(values: F32, at: I64, weight: F64, count: int, penalty: float = 1e-4) -> Head:
    """Fit the classifier of one level, with temperature 1; see `fit_logistic` for the arguments."""
    mean, spread = values.mean(axis=0), values.std(axis=0) + np.float32(1e-6)
    z = np.clip((values - mean) / spread, -CLIP, CLIP)
    weights, bias = fit_logistic(z, at, weight, count, penalty)
    centres = np.stack([np.average(z[at == k], axis=0, weights=weight[at == k]) for k in range(count)])
    within = np.cov((z - centres[at]).T)
    round_one = np.eye(len(mean)) * np.trace(within) / len(mean)
    metric = np.linalg.inv(0.7 * within + 0.3 * round_one)  # shrunk towards a sphere
    plain = [np.asarray(a, np.float32) for a in (mean, spread, weights, bias, centres, metric)]
    reach = float(np.median(to_nearest(z, centres, metric)))
    return Head(plain[0], plain[1], plain[2], plain[3], plain[4], plain[5], reach, temperature=1.0)


def _fit_without(s: Samples, kinds: U8, sites: NDArray[np.str_], classes: U8, out: str) -> tuple[F32, I64]:
    """Return the scores (n, K) of the original pictures of site `out` by a model of all other sites, and patches (n,).

    Classes that the other sites lack have the score -inf.
    """
    inside = sites[s.patch] != out
    training, test = s.of(inside), s.of(~inside & (s.variant == 0))
    known, at = np.unique(kinds[training.patch], return_inverse=True)
    weight = balance(kinds[training.patch], sites[training.patch])
    head = fit_head(training.values, at.astype(np.int64), weight, len(known))
    found = np.full((len(test.patch), len(classes)), -np.inf, np.float32)
    found[:, np.searchsorted(classes, known)] = scores(head, test.values)
    return found, test.patch


def _temperature(scored: F32, at: I64) -> float:
    """Fit the divisor that calibrates held-out scores (N, K); `at`: (N,) index of the true class.

    Rows whose true class was missing in training are ignored.
    """
    fair = np.isfinite(scored[np.arange(len(at)), at])
    values, truth = np.where(np.isfinite(scored), scored, -1e9)[fair], at[fair]
    if not len(truth):
        return 1.0

    def surprise(log_t: float) -> float:
        return -float(log_softmax(values / np.float32(np.exp(log_t)))[np.arange(len(truth)), truth].mean())

    return float(np.exp(minimize_scalar(surprise, bounds=np.log((0.5, 10.0)), method="bounded").x))


def patch_means(log_p: F32, patch: I64, count: int) -> F64:
    """Average log probabilities (N, K) over the rows of each patch, `patch` (N,), and normalise; NaN without rows.

    The result is (count, K). A log probability is at least -7, so that no single position decides.
    """
    n = np.bincount(patch, minlength=count)[:, None]
    floor = np.maximum(log_p, np.float32(-7.0))
    total = np.stack([np.bincount(patch, weights=floor[:, k], minlength=count) for k in range(log_p.shape[1])], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(log_softmax(total / n))


def leave_sites_out(samples: Samples, kinds: U8, sites: NDArray[np.str_]) -> tuple[Confusion, float]:
    """Test each site with a model of all other sites, at one level; return the confusion and the fitted temperature.

    A site without samples of this level, because its pixels are too coarse, is not tested.

    Raises:
        ValueError: there are samples of fewer than two sites.
    """
    every = np.unique(sites[samples.patch])
    if len(every) < 2:
        raise ValueError(f"leaving a site out needs two sites or more with pixels smaller than {COARSEST:.2f} m")
    classes = np.unique(kinds)
    parts = [_fit_without(samples, kinds, sites, classes, str(site)) for site in every]
    scored, patch = np.concatenate([a for a, _ in parts]), np.concatenate([b for _, b in parts])
    temperature = _temperature(scored, np.searchsorted(classes, kinds[patch]).astype(np.int64))
    log_p = log_softmax(np.where(np.isfinite(scored), scored / np.float32(temperature), np.float32(-1e4)))
    return _confusion(kinds, sites, classes, patch_means(log_p, patch, len(kinds))), temperature


def _confusion(kinds: U8, sites: NDArray[np.str_], classes: U8, log_p: F64) -> Confusion:
    tested = np.isfinite(log_p).all(axis=1)
    return Confusion(kinds[tested], sites[tested], classes, log_p[tested])


def _known(patches: list[LabelledPatch]) -> tuple[U8, NDArray[np.str_]]:
    return np.array([p.kind for p in patches], np.uint8), np.array([p.site for p in patches])


def train(patches: list[LabelledPatch], report: Report = quiet) -> tuple[Model, Confusion | None]:
    """Train a model; return it and its confusion at the finest level on held-out sites (None with one site).

    Raises:
        ValueError: there are fewer than two classes, or the pictures are too coarse for all levels.
    """
    kinds, sites = _known(patches)
    classes = np.unique(kinds)
    if len(classes) < 2:
        raise ValueError("a model needs pictures of two classes or more")
    heads: list[Head | None] = [None] * LEVELS
    first: Confusion | None = None
    for level in range(LEVELS):
        s = measure_patches(patches, level, share_of_levels(report, level))
        if set(kinds[s.patch]) != set(kinds):
            continue
        at = np.searchsorted(classes, kinds[s.patch]).astype(np.int64)
        head = fit_head(s.values, at, balance(kinds[s.patch], sites[s.patch]), len(classes))
        out, temperature = leave_sites_out(s, kinds, sites) if len(np.unique(sites[s.patch])) > 1 else (None, UNTESTED)
        first = first or out
        heads[level] = replace(head, temperature=temperature)
    if not any(heads):
        raise ValueError(f"the pictures are too coarse: a pixel must be smaller than {COARSEST:.2f} m")
    return Model(classes, tuple(heads), provenance(kinds, sites, first)), first


def provenance(kinds: U8, sites: NDArray[np.str_], left_out: Confusion | None) -> str:
    """Describe the training data of a model, and its confusion on held-out sites, in words."""
    of = ", ".join(f"{Terrain(k).name.lower()} {(kinds == k).sum()}" for k in np.unique(kinds))
    places = ", ".join(np.unique(sites))
    lines = [f"trained on {len(kinds)} patches ({of}) of {len(np.unique(sites))} site(s): {places}"]
    if left_out is not None:
        lines += ["each site judged by a model of the others:", *lines_of(left_out)]
    return "\n".join(lines)


def elsewhere(patches: list[LabelledPatch], report: Report = quiet) -> Confusion:
    """Test each site with a model of all other sites, at the finest level with samples of all classes and two sites.

    Raises:
        InputError: the pictures are too coarse.
        ValueError: there are fewer than two sites.
    """
    kinds, sites = _known(patches)
    for level in range(LEVELS):
        s = measure_patches(patches, level, report)
        enough = len(np.unique(sites[s.patch])) > 1 or level == LEVELS - 1
        if set(kinds[s.patch]) == set(kinds) and enough:
            return leave_sites_out(s, kinds, sites)[0]
    raise InputError(f"the pictures are too coarse: a pixel must be smaller than {COARSEST:.2f} m")


def judge_patches(model: Model, patches: list[LabelledPatch], report: Report = quiet) -> Confusion:
    """Compute the confusion of a given model on all patches, each at the finest level that it supports.

    Raises:
        InputError: the pictures are too coarse for the model.
    """
    kinds, sites = _known(patches)
    log_p = np.full((len(patches), len(model.classes)), np.nan)
    for level, head in enumerate(model.heads):
        if head is not None:
            s = measure_patches(patches, level, share_of_levels(report, level), variants=1)
            found = patch_means(log_probability(head, s.values), s.patch, len(patches))
            log_p = np.where(np.isnan(log_p), found, log_p)
    if np.isnan(log_p).all():
        raise _too_coarse(model)
    return _confusion(kinds, sites, model.classes, log_p)


def _too_coarse(model: Model) -> InputError:
    pixel = STRETCH * PIXEL * 2 ** max(level for level, head in enumerate(model.heads) if head is not None)
    return InputError(f"the pictures are too coarse for this model: a pixel must be smaller than {pixel:.2f} m")


def judge_pixels(model: Model, pictures: Iterable[tuple[str, U8, U8]], sampling: float) -> Confusion:
    """Compute the confusion of a model on the blocks of labelled pictures, which are treated as one site.

    Args:
        pictures: name, RGB picture (H, W, 3) and Terrain codes (H, W) of each picture.
        sampling: metres per pixel.

    Raises:
        InputError: the pictures are too coarse for the model, or no pixel has a class.
    """
    kinds, log_p = [], []
    for _, rgb, label in pictures:
        found = appearance_evidence(model, rgb, sampling)
        if found is None:
            continue
        rows, cols = found.shape[:2]
        kinds.append(cv2.resize(label, (cols, rows), interpolation=cv2.INTER_NEAREST).ravel())
        log_p.append(found.reshape(-1, found.shape[2]).astype(np.float64))
    if not kinds:
        raise _too_coarse(model)
    kind, predicted = np.concatenate(kinds), np.concatenate(log_p)
    if not kind.any():
        raise InputError("no pixel of the labels has a class; give its code, 1 to 8")
    predicted[kind == Terrain.UNKNOWN] = np.nan
    return _confusion(kind, np.full(len(kind), "pictures"), model.classes, predicted)
