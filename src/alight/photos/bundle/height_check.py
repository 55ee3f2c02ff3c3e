"""Check whether heights above ground can be trusted: evidence in the photos on the common error of all focal lengths.

Heights above ground, and relief, scale with the focal length, and pictures from one height fit any focal length. Each
piece of evidence is a likelihood of the ratio of the true to the used focal length (docs/method/bundle.md).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from alight.arrays import F64
from alight.photos.bundle.matching import BundleObservations
from alight.photos.bundle.solver import Adjustment, BundleState, Priors, solved_steps

RATIOS = np.exp(np.linspace(-np.log(8.0), np.log(8.0), 833))  # true over used focal length, in steps of 0.5 %
ALTITUDE_SIGMA = 1.0  # m, 1-sigma; heights above take-off are accurate to twice as much
SCORE_SIGMA = 0.04  # least sigma of a real lens; pictures were off by 0.03 where the adjustment reports 0.01
TOLERANCE = 0.05  # error of the ratio that is accepted
LIKELIER = 10.0  # factor by which another ratio must be likelier than 1
ELSEWHERE = 1e-4  # 1/m, likelihood of a take-off far above or below the ground of the map


class FocalScore(NamedTuple):
    """Estimate of log(true / used focal length) by the adjustment, and its uncertainty."""

    estimate: float
    sigma: float  # 1-sigma of the estimate
    baseline_sigma: float  # relative 1-sigma of an error that all GPS baseline lengths share

    @property
    def curve(self) -> F64:
        """Log-likelihood of each of `RATIOS`; its width allows for an estimate a fifth too large or half too small."""
        miss = np.log(RATIOS) - self.estimate
        share = np.where(miss * self.estimate > 0.0, 0.5, 0.2)
        return np.asarray(-0.5 * (miss / np.hypot(self.sigma, share * self.estimate)) ** 2)


class HeightCheck(NamedTuple):
    """Outcome of the check of heights: how far the focal length may be wrong, and why."""

    ratio: float  # most likely true over used focal length
    low: float  # bounds of the ratios that remain possible
    high: float
    because: str = ""  # evidence that contradicts the used focal length; empty: no contradiction

    @property
    def is_sharp(self) -> bool:
        """Whether the ratio is known to about a tenth."""
        return self.high < 1.25 * self.low

    @property
    def note(self) -> str:
        """Outcome in words, for the notes of a run."""
        found = f"true over used focal length {self.low:.2f} to {self.high:.2f}"
        if self.because:
            return f"contradicted: {found}"
        return f"agree with the photos: {found}" if self.is_sharp else f"cannot be checked: {found}"

    def reason(self, focal_px: float) -> str:
        """Return why heights are not to be trusted, and the remedy; empty if no evidence contradicts the heights."""
        if not self.because:
            return ""
        factor, likely = max(self.ratio, 1.0 / self.ratio), f"{self.ratio * focal_px:.0f}"
        value = likely if self.is_sharp else "PIXELS"
        return (
            f"heights are not to be trusted, by a factor of about {factor:.{2 if factor < 1.5 else 1}f}, because "
            f"{self.because}; the focal length is {focal_px:.0f} px, and about {likely} px would fit: give the true "
            f"one with --set sources.calibration={value}"
        )


def score_focal(
    obs: BundleObservations, priors: Priors, pixel_sigma: F64, loss: float, state: BundleState
) -> FocalScore:
    """Estimate the error that all focal lengths share, by one Gauss-Newton step in which they are free.

    The GPS residuals after the step inflate the sigma, which is `SCORE_SIGMA` at least. At least two photos must have
    different GPS positions.

    Args:
        obs, priors, pixel_sigma, loss: inputs of the last adjustment.
        state: solution of the last adjustment; not changed.
    """
    sigma, scales = priors.sigma_lens.copy(), [part.start for part in priors.lenses.parts]
    sigma[scales] = np.inf  # free, without a prior
    system = Adjustment(obs, replace(priors, sigma_lens=sigma), pixel_sigma, loss)
    S, rhs, _ = system.reduce(system.linearise(state), 0.0)
    focal = system.poses + np.searchsorted(system.free, scales)
    rest = np.setdiff1d(np.arange(len(S)), focal)
    column = S[:, focal].sum(axis=1)
    by_focal = solved_steps(S[np.ix_(rest, rest)] + 1e-9 * np.eye(len(rest)), column[rest])
    information = max(float(column[focal].sum() - column[rest] @ by_focal), 1e-12)
    step = float(rhs[focal].sum() - rhs[rest] @ by_focal) / information
    estimate = float(np.clip(step, *np.log(RATIOS[[0, -1]])))
    moved = state.centres - estimate * by_focal[: system.poses].reshape(-1, system.each)[:, :3]
    photos = np.unique(obs.photo)
    photos = photos[np.isfinite(priors.centres[photos]).all(axis=1)]
    miss, places = (moved - priors.centres)[photos], priors.centres[photos, :2]
    inflation = max(1.0, float(np.sqrt(((miss / priors.sigma_centres[photos]) ** 2).mean())))
    noise = np.sqrt((miss[:, :2] ** 2).sum() / max(2 * len(photos) - 4, 1))  # less two shifts, a turn, the scale
    baseline_sigma = float(noise / max(np.linalg.norm(places - places.mean(axis=0)), 1e-6))
    return FocalScore(estimate, float(np.hypot(inflation / np.sqrt(information), SCORE_SIGMA)), baseline_sigma)


def check_heights(score: FocalScore, up: F64, above: F64, ground: F64) -> HeightCheck:
    """Combine all evidence on the ratio of the true to the used focal length.

    Args:
        score: estimate by the adjustment.
        up: (n,) metres, heights of the cameras in the world by the pictures.
        above: (n,) metres, heights of the cameras above take-off by their tags; NaN: unknown.
        ground: (m, 3) metres, points on the ground.
    """
    log_ratio = np.log(RATIOS)
    curves = {f"the pictures themselves fit {np.exp(score.estimate):.2f} times the focal length": score.curve}
    tagged = np.isfinite(above)
    if tagged.any() and above[tagged].any():
        high = float(np.median(up))
        relative = float(np.median(above[tagged] - (up[tagged] - high)))
        by_tags, by_pictures = (v[tagged] - np.median(v[tagged]) for v in (above, up))
        energy = float(by_pictures @ by_pictures)
        if energy > 0.0:
            slope, sigma = float(by_pictures @ by_tags) / energy, ALTITUDE_SIGMA / np.sqrt(energy / tagged.sum())
            sigma = np.hypot(sigma, score.baseline_sigma)
            curves[
                f"the cameras climb by {np.ptp(by_tags):.1f} m by their altitudes and {np.ptp(by_pictures):.1f} m by "
                "the pictures"
            ] = -0.5 * ((RATIOS - slope) / sigma) ** 2
        if relative > 0.0 and len(ground):
            depth = high - float(np.median(ground[:, 2]))
            curves[
                f"the cameras are {relative:.1f} m above take-off by their tags and {depth:.1f} m above the "
                "ground by the pictures (if take-off was far above or below this ground: --set "
                "motion.bundle.focal=trusted)"
            ] = np.log(_take_off(relative, np.hypot(ALTITUDE_SIGMA, relative * score.baseline_sigma), ground, high))
    total = np.sum(list(curves.values()), axis=0)
    likelihood = np.exp(total - total.max())
    possible, middle = RATIOS[likelihood > 1.0 / LIKELIER], float(likelihood @ log_ratio / likelihood.sum())
    one, best = len(RATIOS) // 2, int(np.argmax(total))
    wrong = likelihood[one] < 1.0 / LIKELIER and abs(middle) > TOLERANCE
    against = sorted(((curve[best] - curve[one], why) for why, curve in curves.items()), reverse=True)
    because = " and ".join(why for size, why in against if size >= min(against[0][0], np.log(LIKELIER)))
    return HeightCheck(float(np.exp(middle)), float(possible[0]), float(possible[-1]), because if wrong else "")


def _take_off(relative: float, sigma: float, ground: F64, high: float) -> F64:
    """Return the likelihood of each of `RATIOS`, 1/m, if take-off was on the ground or on its extrapolated slope.

    The prior of the height of take-off is uniform over the heights of the slope with weight 3/4, and the distribution
    of the heights of `ground` with weight 1/4.

    Args:
        relative, sigma: metres, height of the cameras above take-off by the tags, and its 1-sigma.
        ground: (m, 3) metres, points on the ground.
        high: metres, height of the cameras in the world.
    """
    flat = ground[:, :2] - ground[:, :2].mean(axis=0)
    slope = np.linalg.lstsq(np.column_stack([flat, np.ones(len(flat))]), ground[:, 2], rcond=None)[0][:2]
    reach = np.abs(slope) @ np.ptp(flat, axis=0) / 2.0  # half the map's extent beyond each side
    most = np.quantile(ground[:, 2], np.linspace(0.02, 0.98, 67))
    places = np.concatenate([most, np.linspace(most[0] - reach, most[-1] + reach, 201)])
    misfit = (relative - RATIOS[:, None] * (high - places)) / sigma
    return np.asarray(np.exp(-0.5 * misfit**2).mean(axis=1) / (np.sqrt(2.0 * np.pi) * sigma) + ELSEWHERE)
